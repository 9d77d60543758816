"""Drawing the points of a workspace, and asking whether both eyes can fixate them."""

from math import cos, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence.envs.streams import Words, to_uniform
from vergence.models.fixation import fixate_eye
from vergence.models.head import HeadModel
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector

ATTEMPTS: Final = 1000
"""Candidates that are tried for a trial."""


class Gaze(NamedTuple):
    """The head that has to look, and what its joints can do."""

    head: PackedHead
    """(PACKED,) see `vergence.models.kinematics`."""
    lower: FloatArray
    """(7,) least angles, rad."""
    upper: FloatArray
    """(7,) greatest angles, rad."""
    velocity: FloatArray
    """(7,) greatest speeds, rad/s."""
    acceleration: FloatArray
    """(7,) greatest accelerations, rad/s^2."""

    @classmethod
    def of(cls, head: HeadModel) -> "Gaze":
        """That of a head model."""
        limits = head.limits
        return cls(head.packed, limits.lower, limits.upper, limits.velocity, limits.acceleration)


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
    """Whether both eyes can fixate a point with a margin to their limits.

    Args:
        gaze: the head that has to look.
        margin: rad.
        point: in N, m.
        angles: (4,) result: the eyes' angles, rad; whole if they can.
    """
    for eye in range(2):
        i, k = 3 + 2 * eye, 2 * eye
        angles[k], angles[k + 1] = fixate_eye(gaze.head, eye, point[0], point[1], point[2])
        for j in range(2):
            low, high = gaze.lower[i + j] + margin, gaze.upper[i + j] - margin
            if not low <= angles[k + j] <= high:
                return False
    return True
