"""Drawing the points of a workspace, and asking whether both eyes can fixate them."""

from math import cos, pi, sin, tan
from typing import Any, Final

from vergence._jit import device
from vergence.envs.philox import to_uniform
from vergence.models.fixation import fixate_eye
from vergence.models.kinematics import eye_frames

ATTEMPTS: Final = 1000
"""Candidates that are tried for a trial."""


@device
def between(word: Any, low: float, high: float) -> Any:
    """A number that is uniform in a range, from a random word."""
    return low + to_uniform(word) * (high - low)


@device
def between_eyes(p: Any, rest: Any) -> Any:
    """The point in the middle of both eyes of a head at rest, in N, m."""
    left = eye_frames(p, 0, rest[3], rest[4])[2]
    right = eye_frames(p, 1, rest[5], rest[6])[2]
    return 0.5 * (left[3] + right[3]), 0.5 * (left[7] + right[7]), 0.5 * (left[11] + right[11])


@device
def place(words: Any, eye: Any, near: float, far: float, eccentricity: float) -> Any:
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
def can_fixate(
    p: Any, lower: Any, upper: Any, margin: float, x: float, y: float, z: float, angles: Any
) -> bool:
    """Whether both eyes can fixate a point with a margin to their limits.

    Args:
        p: (PACKED,) the head.
        lower: (7,) its joints' limits, rad.
        upper: (7,) their limits, rad.
        margin: rad.
        x: of the point in N, m, as are the following two.
        y: m.
        z: m.
        angles: (4,) result: the eyes' angles, rad; whole if they can.
    """
    for eye in range(2):
        i, k = 3 + 2 * eye, 2 * eye
        angles[k], angles[k + 1] = fixate_eye(p, eye, x, y, z)
        for j in range(2):
            if not lower[i + j] + margin <= angles[k + j] <= upper[i + j] - margin:
                return False
    return True
