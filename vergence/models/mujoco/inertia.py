"""Mass and inertia of the links: assumed, as the article gives none, of a balanced head.

A head made to turn fast is balanced: the counterweight of an eye (its pan servo) puts the common
centre of mass on the eye's tilt axis, and the skull's puts that of the skull and both eyes where
the neck's roll axis is nearest to its pitch axis. A moving joint then disturbs the others little.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import JOINTS, LINKS
from vergence.models.parts import FloatArray

NECK_ARMATURE: Final = 0.1
"""kg m^2, the neck servos' rotors seen through their gears: MuJoCo Menagerie's value for the
joints of the SO-ARM100."""

EYE_ARMATURE: Final = 0.045
"""kg m^2, the eye servos' rotors seen through their gears: MuJoCo Menagerie's value for the
ROBOTIS OP3 and its Dynamixel XM430. Eyes driven by smaller servos have less, but then joints that
accelerate as fast as these would disturb one another by more than the encoders' resolution."""

_MASSES: Final = {
    "neck_yaw": 0.30,
    "neck_roll": 0.20,
    "neck_pitch": 0.30,
    "left_tilt": 0.060,
    "left_pan": 0.030,
    "right_tilt": 0.060,
    "right_pan": 0.030,
}
"""kg: two servos and a bracket, a servo, the skull with its servos, an eye's frame with its pan
servo, an eye with its camera."""

_EDGES: Final = {
    "neck_yaw": (0.05, 0.09, 0.05),
    "neck_roll": (0.05, 0.05, 0.05),
    "neck_pitch": (0.10, 0.10, 0.05),
    "left_tilt": (0.025, 0.025, 0.025),
    "left_pan": (0.03, 0.03, 0.03),
    "right_tilt": (0.025, 0.025, 0.025),
    "right_pan": (0.03, 0.03, 0.03),
}
"""m: edges, along the axes of the link's frame, of the solid box whose inertia a link has."""

FRAMES: Final = {joint: frame for frame, _parent, joint in LINKS if joint}
"""The frame that a joint turns about its z axis."""


class LinkInertia(NamedTuple):
    """What a link resists with, in its own frame."""

    mass: float
    """kg."""
    centre: FloatArray
    """(3,) centre of mass, m."""
    moments: FloatArray
    """(3,) moments about the centre along the frame's axes, kg m^2; there are no products."""
    edges: FloatArray
    """(3,) edges of the solid box with these moments, m."""


def armature(joint: str) -> float:
    """The inertia of a joint's rotor seen through its gear, kg m^2."""
    return NECK_ARMATURE if JOINTS.index(joint) < 3 else EYE_ARMATURE


def link_inertia(head: HeadModel, joint: str) -> LinkInertia:
    """Mass, centre of mass and moments of inertia of the link that a joint turns.

    Args:
        head: one head, whose links the centres follow.
        joint: one of `JOINTS`.

    Returns:
        The link's inertia in its frame.
    """
    edges = np.array(_EDGES[joint])
    moments = _MASSES[joint] / 12.0 * (np.square(edges).sum() - np.square(edges))
    return LinkInertia(_MASSES[joint], _centre(head, joint), moments, edges)


def _centre(head: HeadModel, joint: str) -> FloatArray:
    if joint == "neck_yaw":
        return 0.5 * _origin(head, 2)
    if joint.endswith("tilt"):
        eye = _origin(head, FRAMES[joint] + 1)
        return -_MASSES[joint.replace("tilt", "pan")] / _MASSES[joint] * eye
    if joint == "neck_pitch":
        balance = _nearest_to_roll_axis(head)
        moment = _MASSES[joint] * balance
        for tilt in ("left_tilt", "right_tilt"):
            eye_mass = _MASSES[tilt] + _MASSES[tilt.replace("tilt", "pan")]
            moment += eye_mass * (balance - _origin(head, FRAMES[tilt]))
        return np.asarray(moment / _MASSES[joint])
    return np.zeros(3)


def _nearest_to_roll_axis(head: HeadModel) -> FloatArray:
    """The point of the pitch axis nearest to the roll axis, in frame 3 (whose z is the axis)."""
    T_2_3 = np.matmul(*head.links.transforms(3))
    roll_axis, roll_origin = T_2_3[2, :3], -T_2_3[:3, :3].T @ T_2_3[:3, 3]
    across = roll_axis[:2]
    distance = -(roll_origin[:2] @ across) / (across @ across) if across @ across > 1e-6 else 0.0
    return np.array([0.0, 0.0, roll_origin[2] + distance * roll_axis[2]])


def _origin(head: HeadModel, frame: int) -> FloatArray:
    """Origin of a link's frame in its parent's."""
    return np.asarray(np.matmul(*head.links.transforms(frame))[:3, 3])
