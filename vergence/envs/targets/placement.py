"""Drawing the points of a workspace, and asking whether both eyes can fixate them."""

from math import cos, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence.envs.streams import Words, to_uniform
from vergence.models.actuation import SLOTS
from vergence.models.camera import inside_image, point_to_pixel
from vergence.models.fixation import fixate_eye, fixate_tied
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, actuator_at
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector

ATTEMPTS: Final = 1000
"""Candidates that are tried for a trial."""
_ROUNDING_RAD: Final = 1e-9
"""What rounding may leave beyond a limit that is reached exactly."""


class Gaze(NamedTuple):
    """The head that has to look, and what its actuators and joints can do."""

    head: PackedHead
    """(PACKED,) see `vergence.models.kinematics`."""
    rest: FloatArray
    """(7,) joint angles at rest, rad."""
    lower: FloatArray
    """(4,) least angles of the actuators of the eyes, rad."""
    upper: FloatArray
    """(4,) their greatest angles, rad."""
    velocity: FloatArray
    """(4,) their greatest speeds, rad/s."""
    acceleration: FloatArray
    """(4,) their greatest accelerations, rad/s^2."""
    joints: tuple[FloatArray, FloatArray] | None
    """(4,) each, least and greatest angles of the eyes' joints, rad, where actuators tie them."""

    @classmethod
    def of(cls, head: HeadModel) -> "Gaze":
        """That of a head model."""
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


@device
def between(word: np.uint64, low: float, high: float) -> float:
    """A number that is uniform in a range, from a random word."""
    return low + to_uniform(word) * (high - low)


@device
def between_eyes(p: PackedHead, rest: FloatArray) -> Vector:
    """The point in the middle of both eyes of a head at rest, in N, m."""
    left = eye_frames(p, 0, rest[3], rest[4]).camera
    right = eye_frames(p, 1, rest[5], rest[6]).camera
    return 0.5 * (left.x + right.x), 0.5 * (left.y + right.y), 0.5 * (left.z + right.z)


@device
def place(words: Words, eye: Vector, near: float, far: float, eccentricity: float) -> Vector:
    """A point from three random words: uniform in 1 / depth and in the angle from straight ahead.

    Args:
        words: at least three.
        eye: where the angle is seen from, in N, m.
        near: least z, m.
        far: greatest z, m.
        eccentricity: greatest angle, rad.

    Returns:
        x, y and z in N, m.
    """
    z = 1.0 / between(words[0], 1.0 / far, 1.0 / near)
    slope = z * tan(eccentricity * to_uniform(words[1]))
    around = 2.0 * pi * to_uniform(words[2])
    return eye[0] + slope * cos(around), eye[1] + slope * sin(around), z


@device
def can_fixate(gaze: Gaze, margin: float, point: Vector, angles: FloatArray) -> bool:
    """Whether both eyes can look at a point with a margin to their limits.

    Where actuators tie the joints, the angles are those of the least pixel errors, and both eyes
    have to see the point then.

    Args:
        gaze: the head that has to look.
        margin: of the actuators, rad.
        point: in N, m.
        angles: (4,) result: the eyes' angles, rad; whole if they can.
    """
    return _can_fixate(gaze, gaze.joints, margin, point, angles)


@device
def _can_fixate(
    gaze: Gaze,
    joints: tuple[FloatArray, FloatArray] | None,
    margin: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if joints is not None:  # what that needs is compiled where it is needed alone
        return _can_fixate_tied(gaze, joints, margin, point, angles)
    for eye in range(2):
        k = 2 * eye
        angles[k], angles[k + 1] = fixate_eye(gaze.head, eye, point[0], point[1], point[2])
        for j in range(2):
            low, high = gaze.lower[k + j] + margin, gaze.upper[k + j] - margin
            if not low <= angles[k + j] <= high:
                return False
    return True


@device
def _can_fixate_tied(
    gaze: Gaze,
    joints: tuple[FloatArray, FloatArray],
    margin: float,
    point: Vector,
    angles: FloatArray,
) -> bool:
    if not fixate_tied(gaze.head, point[0], point[1], point[2], angles):
        return False
    for k in range(SLOTS):
        low, high = gaze.lower[k], gaze.upper[k]
        keep = margin if high > low else -_ROUNDING_RAD
        if not low + keep <= actuator_at(gaze.head, k, angles) <= high - keep:
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
