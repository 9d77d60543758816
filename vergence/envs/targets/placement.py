"""Random points of a workspace, and the check that both eyes can fixate them."""

from math import cos, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import inlined
from vergence.envs.streams import Words, to_uniform
from vergence.models.actuation import SLOTS
from vergence.models.camera import inside_image, point_to_pixel
from vergence.models.fixation import fixate_coupled, fixate_eye
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, eye_actuator_angle
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector

ATTEMPTS: Final = 1000
"""Candidates tried for a trial (numerical)."""
_ROUNDING_RAD: Final = 1e-9
"""Rounding tolerance beyond an angle limit that is reached exactly, rad (numerical)."""


class GazingHead(NamedTuple):
    """The head that looks, with the limits of its actuators and joints."""

    head: PackedHead
    """(PACKED,) see `vergence.models.kinematics`."""
    rest: FloatArray
    """(7,) joint angles at rest, rad."""
    lower: FloatArray
    """(4,) lower angle limits of the eye actuators, rad."""
    upper: FloatArray
    """(4,) upper angle limits of the eye actuators, rad."""
    velocity: FloatArray
    """(4,) speed limits of the eye actuators, rad/s."""
    acceleration: FloatArray
    """(4,) acceleration limits of the eye actuators, rad/s^2."""
    joints: tuple[FloatArray, FloatArray] | None
    """(4,) each, lower and upper angle limits of the eye joints, rad; None if each has a motor."""

    @classmethod
    def of(cls, head: HeadModel) -> "GazingHead":
        """The `GazingHead` of a head model."""
        own, limits = head.actuation, head.limits
        return cls(
            head.packed,
            head.rest(),
            own.lower[EYES],
            own.upper[EYES],
            own.velocity[EYES],
            own.acceleration[EYES],
            None if own.direct else (limits.lower[EYES], limits.upper[EYES]),
        )


@inlined
def uniform_in(word: np.uint64, low: float, high: float) -> float:
    """Uniform number in a range, from a random word."""
    return low + to_uniform(word) * (high - low)


@inlined
def between_eyes(p: PackedHead, rest: FloatArray) -> Vector:
    """Midpoint between both eyes of a head at rest, in N, m."""
    left = eye_frames(p, 0, rest[3], rest[4]).camera
    right = eye_frames(p, 1, rest[5], rest[6]).camera
    return 0.5 * (left.x + right.x), 0.5 * (left.y + right.y), 0.5 * (left.z + right.z)


@inlined
def random_point(words: Words, eye: Vector, near: float, far: float, eccentricity: float) -> Vector:
    """Point from three random words: uniform in 1 / depth and in the angle from straight ahead.

    Args:
        words: at least three.
        eye: viewpoint of the angle, in N, m.
        near: least z, m.
        far: greatest z, m.
        eccentricity: greatest angle, rad.

    Returns:
        x, y and z in N, m.
    """
    z = 1.0 / uniform_in(words[0], 1.0 / far, 1.0 / near)
    slope = z * tan(eccentricity * to_uniform(words[1]))
    around = 2.0 * pi * to_uniform(words[2])
    return eye[0] + slope * cos(around), eye[1] + slope * sin(around), z


@inlined
def can_fixate(gaze: GazingHead, margin: float, point: Vector, angles: FloatArray) -> bool:
    """True if both eyes can fixate a point with a margin to their limits.

    For coupled joints, the angles are those of the least pixel errors, and both eyes must see the
    point then.

    Args:
        gaze: the head that looks.
        margin: least distance of the actuators from their limits, rad.
        point: in N, m.
        angles: (4,) result: angles of the eye joints, rad; complete only if both eyes can.
    """
    return _can_fixate(gaze, gaze.joints, margin, point, angles)


@inlined
def _can_fixate(
    gaze: GazingHead,
    joints: tuple[FloatArray, FloatArray] | None,
    margin: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if joints is not None:  # a function of its own, compiled only for coupled joints
        return _can_fixate_coupled(gaze, joints, margin, point, angles)
    for eye in range(2):
        k = 2 * eye
        angles[k], angles[k + 1] = fixate_eye(gaze.head, eye, point[0], point[1], point[2])
        for j in range(2):
            low, high = gaze.lower[k + j] + margin, gaze.upper[k + j] - margin
            if not low <= angles[k + j] <= high:
                return False
    return True


@inlined
def _can_fixate_coupled(
    gaze: GazingHead,
    joints: tuple[FloatArray, FloatArray],
    margin: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if not fixate_coupled(gaze.head, point[0], point[1], point[2], angles):
        return False
    for k in range(SLOTS):
        low, high = gaze.lower[k], gaze.upper[k]
        keep = margin if high > low else -_ROUNDING_RAD
        if not low + keep <= eye_actuator_angle(gaze.head, k, angles) <= high - keep:
            return False
        low, high = joints[0][k] - _ROUNDING_RAD, joints[1][k] + _ROUNDING_RAD
        if not low <= angles[k] <= high:
            return False
    for eye in range(2):
        x, y, z = point_in_eye(
            gaze.head, eye, angles[2 * eye], angles[2 * eye + 1], point[0], point[1], point[2]
        )
        u, v = point_to_pixel(gaze.head, eye, x, y, z, True)
        if not inside_image(gaze.head, eye, u, v):
            return False
    return True
