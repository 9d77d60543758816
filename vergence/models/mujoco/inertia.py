"""Mass and inertia of the links: assumed values of a balanced head, as no source states any.

A head made to turn fast is balanced. The counterweight of an eye (its second servo) puts the eye's
centre of mass on the axis of its first joint. The counterweight of the skull puts the common centre
of mass of the skull and both eyes on the axis of the neck's last joint, at the point nearest to the
axis of the joint before. A moving joint then disturbs the others little. The mass of a link depends
on its part in the head.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, NECK
from vergence.models.links import Body, chain_end
from vergence.models.parts import FloatArray


class LinkInertia(NamedTuple):
    """Mass and inertia of a link in its own frame."""

    mass: float
    """Mass, kg."""
    centre: FloatArray
    """(3,) position of the centre of mass, m."""
    moments: FloatArray
    """(3,) moments of inertia about the centre of mass along the frame's axes, kg m^2; the
    products of inertia are zero."""
    box_edges: FloatArray
    """(3,) edges of the solid box with these moments, m."""


class _Block(NamedTuple):
    """A solid box."""

    mass: float
    """Mass, kg."""
    edges: tuple[float, float, float]
    """Edges along the axes of the link's frame, m."""


_NECK_BASE: Final = _Block(0.30, (0.05, 0.09, 0.05))
"""The neck's first link: two servos and a bracket (chosen: assumed)."""
_NECK_MIDDLE: Final = _Block(0.20, (0.05, 0.05, 0.05))
"""A link between the neck's first and last: a servo (chosen: assumed)."""
_SKULL: Final = _Block(0.30, (0.10, 0.10, 0.05))
"""The neck's last link: the skull with its servos (chosen: assumed)."""
_EYE_FRAME: Final = _Block(0.060, (0.025, 0.025, 0.025))
"""A link that carries an eye: a frame with a servo (chosen: assumed)."""
_EYE: Final = _Block(0.030, (0.03, 0.03, 0.03))
"""The last link of an eye: its camera (chosen: assumed)."""


def link_inertia(head: HeadModel, joint: str) -> LinkInertia:
    """Mass, centre of mass and moments of inertia of the link that a joint turns.

    Args:
        head: one head; its links determine the centres of mass.
        joint: the name of one of its joints.

    Returns:
        The link's inertia in its frame.
    """
    bodies = head.links.bodies()
    place = [body.name for body in bodies].index(joint)
    block = _block(bodies, place)
    edges = np.array(block.edges)
    moments = block.mass / 12.0 * (np.square(edges).sum() - np.square(edges))
    return LinkInertia(block.mass, _centre(bodies, place), moments, edges)


def _block(bodies: tuple[Body, ...], place: int) -> _Block:
    if place == chain_end(bodies, None):
        return _SKULL
    if bodies[place].joints[0] < NECK.stop:
        return _NECK_BASE if bodies[place].parent == -1 else _NECK_MIDDLE
    ends = [chain_end(bodies, eye) for eye in range(len(EYE_NAMES))]
    return _EYE if place in ends else _EYE_FRAME


def _centre(bodies: tuple[Body, ...], place: int) -> FloatArray:
    body, mass = bodies[place], _block(bodies, place).mass
    carried = [i for i, other in enumerate(bodies) if other.parent == place]
    if place == chain_end(bodies, None):
        balance = _balance(bodies, place)
        moment = mass * balance
        for child in carried:
            moment += _mass_from(bodies, child) * (balance - bodies[child].pose[:3, 3])
        return np.asarray(moment / mass)
    if body.joints[0] >= NECK.stop and carried:
        moments = [-_mass_from(bodies, i) / mass * bodies[i].pose[:3, 3] for i in carried]
        return np.asarray(sum(moments[1:], start=moments[0]))
    if body.joints[0] < NECK.stop and body.parent == -1:
        return np.asarray(0.5 * bodies[carried[0]].pose[:3, 3])
    return np.zeros(3)


def _mass_from(bodies: tuple[Body, ...], place: int) -> float:
    """Mass of a link and of all links that it carries, kg."""
    carried = [i for i, other in enumerate(bodies) if other.parent == place]
    own = _block(bodies, place).mass
    return own + sum(_mass_from(bodies, child) for child in carried)


def _balance(bodies: tuple[Body, ...], skull: int) -> FloatArray:
    """Common centre of mass of the skull and the eyes, on the skull's axis, in the skull's frame.

    It is the point of the axis nearest to the axis of the neck's joint before. For a neck of one
    joint, it is at the mean height of the bodies that the skull carries.
    """
    if bodies[skull].parent == -1:
        heights = [body.pose[2, 3] for body in bodies if body.parent == skull]
        return np.array([0.0, 0.0, np.mean(heights) if heights else 0.0])
    pose = bodies[skull].pose
    axis, origin = pose[2, :3], -pose[:3, :3].T @ pose[:3, 3]
    across = axis[:2]
    distance = -(origin[:2] @ across) / (across @ across) if across @ across > 1e-6 else 0.0
    return np.array([0.0, 0.0, origin[2] + distance * axis[2]])
