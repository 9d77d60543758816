"""Random points of a workspace, and the check that both eyes can fixate them."""

from math import cos, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.streams import Words, to_uniform
from vergence.kernels import inlined
from vergence.models.fixation import fixate_coupled, fixate_eye
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PackedHead,
    Vector,
    eye_actuator_angle,
    eye_frames,
    inside_image,
    point_in_eye,
    point_to_pixel,
)
from vergence.models.parts import EYES, SLOTS, FloatArray

MAX_CANDIDATES: Final = 1000
"""Candidates tried for a trial (numerical)."""
_ROUNDING_RAD: Final = 1e-9
"""Rounding tolerance beyond an angle limit that is reached exactly, rad (numerical)."""


class HeadWithLimits(NamedTuple):
    """The head that looks, with the limits of its actuators and joints."""

    head: PackedHead
    """(PACKED,) see `vergence.models.kinematics`."""
    rest: FloatArray
    """(7,) joint angles at rest, rad."""
    lower: FloatArray
    """(4,) lower angle limits of the eye actuators, rad."""
    upper: FloatArray
    """(4,) upper angle limits of the eye actuators, rad."""
    speed_limits: FloatArray
    """(4,) speed limits of the eye actuators, rad/s."""
    acceleration_limits: FloatArray
    """(4,) acceleration limits of the eye actuators, rad/s^2."""
    joint_limits: tuple[FloatArray, FloatArray] | None
    """(4,) each, lower and upper angle limits of the eye joints, rad; None if each has a motor."""

    @classmethod
    def of(cls, head: HeadModel) -> "HeadWithLimits":
        """The `HeadWithLimits` of a head model."""
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
def uniform_between(word: np.uint64, low: float, high: float) -> float:
    """Uniform number in a range, from a random word."""
    return low + to_uniform(word) * (high - low)


@inlined
def midpoint_between_eyes(p: PackedHead, rest: FloatArray) -> Vector:
    """Midpoint between both eyes of a head at rest, in N, m."""
    left = eye_frames(p, 0, rest[3], rest[4]).camera
    right = eye_frames(p, 1, rest[5], rest[6]).camera
    return 0.5 * (left.x + right.x), 0.5 * (left.y + right.y), 0.5 * (left.z + right.z)


@inlined
def random_point(
    words: Words, viewpoint: Vector, min_z_m: float, max_z_m: float, max_angle_rad: float
) -> Vector:
    """Point from three random words: uniform in 1 / depth and in the angle from straight ahead.

    Args:
        words: at least three.
        viewpoint: origin of the angle, in N, m.
        min_z_m: least z, m.
        max_z_m: greatest z, m.
        max_angle_rad: greatest angle, rad.

    Returns:
        x, y and z in N, m.
    """
    z = 1.0 / uniform_between(words[0], 1.0 / max_z_m, 1.0 / min_z_m)
    slope = z * tan(max_angle_rad * to_uniform(words[1]))
    around = 2.0 * pi * to_uniform(words[2])
    return viewpoint[0] + slope * cos(around), viewpoint[1] + slope * sin(around), z


@inlined
def can_fixate(gaze: HeadWithLimits, margin_rad: float, point: Vector, angles: FloatArray) -> bool:
    """True if both eyes can fixate a point with a margin to their limits.

    For coupled joints, the angles are those of the least pixel errors, and both eyes must see the
    point then.

    Args:
        gaze: the head that looks.
        margin_rad: least distance of the actuators from their limits, rad.
        point: in N, m.
        angles: (4,) result: angles of the eye joints, rad; complete only if both eyes can.
    """
    return _can_fixate(gaze, gaze.joint_limits, margin_rad, point, angles)


@inlined
def _can_fixate(
    gaze: HeadWithLimits,
    joint_limits: tuple[FloatArray, FloatArray] | None,
    margin_rad: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if joint_limits is not None:  # a function of its own, compiled only for coupled joints
        return _can_fixate_coupled(gaze, joint_limits, margin_rad, point, angles)
    for eye in range(2):
        k = 2 * eye
        angles[k], angles[k + 1] = fixate_eye(gaze.head, eye, point[0], point[1], point[2])
        for j in range(2):
            low, high = gaze.lower[k + j] + margin_rad, gaze.upper[k + j] - margin_rad
            if not low <= angles[k + j] <= high:
                return False
    return True


@inlined
def _can_fixate_coupled(
    gaze: HeadWithLimits,
    joint_limits: tuple[FloatArray, FloatArray],
    margin_rad: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if not fixate_coupled(gaze.head, point[0], point[1], point[2], angles):
        return False
    for k in range(SLOTS):
        low, high = gaze.lower[k], gaze.upper[k]
        keep = margin_rad if high > low else -_ROUNDING_RAD
        if not low + keep <= eye_actuator_angle(gaze.head, k, angles) <= high - keep:
            return False
        low, high = joint_limits[0][k] - _ROUNDING_RAD, joint_limits[1][k] + _ROUNDING_RAD
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
