"""Ellipses anywhere in a workspace that eyes can follow, drawn for each trial."""

from math import cos, pi, sin, sqrt, tan
from typing import Any, Final

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.philox import Purpose, random_words, to_uniform
from vergence.models.fixation import fixate_eye
from vergence.models.kinematics import eye_frames

ATTEMPTS: Final = 1000
"""Ellipses that are tried for a trial."""
_TASK: Final = int(Purpose.TASK)
_PHASES: Final = 48
_FINE_PHASES: Final = 256
# what a target asks of a joint leaves the other half for catching up with it
_SHARE_OF_LIMITS: Final = 0.5


@device
def _between(word: Any, low: float, high: float) -> Any:
    return low + to_uniform(word) * (high - low)


@device
def _peak_rate(centre: Any, first: Any, second: Any, eye: Any) -> float:
    """Greatest angular speed, seen from `eye`, of an ellipse that is run with 1 rad/s."""
    peak = 0.0
    for k in range(_FINE_PHASES):
        c, s = cos(2.0 * pi * k / _FINE_PHASES), sin(2.0 * pi * k / _FINE_PHASES)
        x = centre[0] + first[0] * c + second[0] * s - eye[0]
        y = centre[1] + first[1] * c + second[1] * s - eye[1]
        z = centre[2] + first[2] * c + second[2] * s - eye[2]
        vx = second[0] * c - first[0] * s
        vy = second[1] * c - first[1] * s
        vz = second[2] * c - first[2] * s
        ax, ay, az = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
        peak = max(peak, sqrt(ax * ax + ay * ay + az * az) / (x * x + y * y + z * z))
    return peak


@device
def _can_follow(
    p: Any, lower: Any, upper: Any, velocity: Any, acceleration: Any, margin: float, near: float,
    far: float, centre: Any, first: Any, second: Any, omega: float, angles: Any,
) -> bool:  # fmt: skip
    """Whether both eyes can look at the whole ellipse, and turn as fast as it asks."""
    for k in range(_PHASES):
        c, s = cos(2.0 * pi * k / _PHASES), sin(2.0 * pi * k / _PHASES)
        x = centre[0] + first[0] * c + second[0] * s
        y = centre[1] + first[1] * c + second[1] * s
        z = centre[2] + first[2] * c + second[2] * s
        if not near <= z <= far:
            return False
        for eye in range(2):
            i = 3 + 2 * eye
            tilt, pan = fixate_eye(p, eye, x, y, z)
            if not lower[i] + margin <= tilt <= upper[i] - margin:
                return False
            if not lower[i + 1] + margin <= pan <= upper[i + 1] - margin:
                return False
            angles[k, 2 * eye], angles[k, 2 * eye + 1] = tilt, pan
    step = 2.0 * pi / _PHASES / omega
    for k in range(_PHASES):
        for j in range(4):
            last, now = angles[k - 1, j], angles[k, j]
            after = angles[(k + 1) % _PHASES, j]
            if abs(after - last) > 2.0 * step * _SHARE_OF_LIMITS * velocity[3 + j]:
                return False
            bend = abs(after - 2.0 * now + last) / (step * step)
            if bend > _SHARE_OF_LIMITS * acceleration[3 + j]:
                return False
    return True


@compiled
def choose_orbits(
    seeds: Any, trials: Any, p: Any, lower: Any, upper: Any, velocity: Any, acceleration: Any,
    depth: Any, eccentricity: float, radius: Any, speed: Any, turns: float, margin: float,
    rows: Any,
) -> bool:  # fmt: skip
    """Draw ellipses for each trial until the eyes can follow one.

    Args:
        seeds: (n,) keys of the trials' random numbers.
        trials: (n,) keys of the trials' random numbers.
        p: (PACKED,) the head.
        lower: (7,) its joints' limits, rad.
        upper: (7,) their limits, rad.
        velocity: (7,) their greatest speeds, rad/s.
        acceleration: (7,) their greatest accelerations, rad/s^2.
        depth: (2,) see `vergence.envs.targets.OrbitTarget`, as are the following five.
        eccentricity: rad.
        radius: (2,) rad.
        speed: (2,) rad/s.
        turns: 1/s.
        margin: rad.
        rows: (n, MOTION) result, the ellipses in rows of targets at rest.

    Returns:
        False if some trial has no fit candidate.
    """
    rest = np.minimum(np.maximum(lower, 0.0), upper)
    left = eye_frames(p, 0, rest[3], rest[4])[2]
    right = eye_frames(p, 1, rest[5], rest[6])[2]
    eye = (0.5 * (left[3] + right[3]), 0.5 * (left[7] + right[7]), 0.5 * (left[11] + right[11]))
    near, far = depth[0], depth[1]
    angles = np.empty((_PHASES, 4))
    for n in range(seeds.shape[0]):
        # one draw of the speed for all candidates, or those that can be followed would be slower
        fastest = _between(random_words(seeds[n], trials[n], _TASK, 0, 4)[0], speed[0], speed[1])
        found = False
        for attempt in range(ATTEMPTS):
            words = random_words(seeds[n], trials[n], _TASK, attempt, 1)
            z = 1.0 / _between(words[0], 1.0 / far, 1.0 / near)
            slope = z * tan(eccentricity * to_uniform(words[1]))
            around = 2.0 * pi * to_uniform(words[2])
            centre = (eye[0] + slope * cos(around), eye[1] + slope * sin(around), z)
            long = z * tan(_between(words[3], radius[0], radius[1]))
            words = random_words(seeds[n], trials[n], _TASK, attempt, 2)
            # any plane: its normal is uniform on the sphere, and the long axis within it too
            nz = 2.0 * to_uniform(words[0]) - 1.0
            across, turn = sqrt(1.0 - nz * nz), 2.0 * pi * to_uniform(words[1])
            ct, st = cos(turn), sin(turn)
            cr, sr = cos(2.0 * pi * to_uniform(words[2])), sin(2.0 * pi * to_uniform(words[2]))
            short = long * to_uniform(words[3])
            # two axes of the plane: one along the circle of latitude, one along the meridian
            e = (-st * cr + nz * ct * sr, ct * cr + nz * st * sr, -across * sr)
            f = (st * sr + nz * ct * cr, -ct * sr + nz * st * cr, -across * cr)
            first = (long * e[0], long * e[1], long * e[2])
            second = (short * f[0], short * f[1], short * f[2])
            peak = _peak_rate(centre, first, second, eye)
            if not peak * 2.0 * pi * turns >= fastest:
                continue
            omega = fastest / peak
            if not _can_follow(
                p, lower, upper, velocity, acceleration, margin, near, far, centre, first, second,
                omega, angles,
            ):  # fmt: skip
                continue
            phase = 2.0 * pi * to_uniform(random_words(seeds[n], trials[n], _TASK, attempt, 3)[0])
            c, s = cos(phase), sin(phase)
            for i in range(3):
                rows[n, 9 + i] = first[i] * c + second[i] * s
                rows[n, 12 + i] = second[i] * c - first[i] * s
                rows[n, 3 + i] = centre[i]
                rows[n, i] = centre[i] + rows[n, 9 + i]
            rows[n, 15] = omega
            rows[n, 18] = 1.0
            found = True
            break
        if not found:
            return False
    return True
