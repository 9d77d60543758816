"""A target on an ellipse anywhere in a workspace that eyes can follow, drawn for each trial."""

from dataclasses import dataclass
from math import cos, pi, sin, sqrt, tan
from typing import Any, ClassVar, Final, Literal

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.philox import Purpose, random_words, to_uniform
from vergence.envs.streams import IntArray, Streams
from vergence.envs.targets.motion import BEFORE, motion_rows
from vergence.envs.targets.placement import ATTEMPTS, between, between_eyes, can_fixate, place
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_TASK: Final = int(Purpose.TASK)
_PHASES: Final = 48
_FINE_PHASES: Final = 256
# what a target asks of a joint leaves the other half for catching up with it
_SHARE_OF_LIMITS: Final = 0.5
_AT_REST: Final = motion_rows(np.zeros(3))


@dataclass(frozen=True, kw_only=True)
class OrbitTarget(Target):
    """A target on an ellipse of any place, plane and shape, at the speed that a trial draws.

    Both eyes can fixate the whole ellipse with some degrees to spare, and following it asks
    for at most half of their joints' speed and acceleration. Until time zero the target stands
    at its beginning. Flat ellipses are sweeps back and forth, steep ones are motions in depth.
    """

    kind: ClassVar[str] = "orbit"
    depth: tuple[float, float] = (0.4, 2.5)
    """Nearest and farthest z, m; the centre is uniform in 1 / depth."""
    eccentricity: float = 0.4
    """Greatest angle of the centre from straight ahead, seen from between the eyes, rad."""
    radius: tuple[float, float] = (0.1, 0.35)
    """Least and greatest half of the long axis, as an angle at the centre's depth, rad."""
    speed: tuple[float, float] = (0.3490658503988659, 1.0471975511965976)
    """Range of the greatest angular speed of a trial, seen from between the eyes, rad/s."""
    turns: float = 1.25
    """Most turns per second."""
    margin: float = 0.03490658503988659
    """Least distance of the fixating angles from the joints' limits, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("depth", "radius", "speed"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ConfigurationError(
                    f"target.{name}: expected 0 < least <= greatest, got {(low, high)}"
                )
        for name, angle in (("eccentricity", self.eccentricity), ("radius", self.radius[1])):
            if not angle < 1.5:
                raise ConfigurationError(f"target.{name}: expected less than 1.5 rad, got {angle}")

    def draw(
        self, head: HeadModel, streams: Streams, ids: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is fit."""
        rows = np.repeat(_AT_REST, len(ids), axis=0)
        limits = head.limits
        found = choose_orbits(
            streams.seeds[ids],
            streams.trials[ids],
            head.packed,
            limits.lower,
            limits.upper,
            limits.velocity,
            limits.acceleration,
            self.depth,
            self.eccentricity,
            self.radius,
            self.speed,
            self.turns,
            self.margin,
            rows,
        )
        if not found:
            raise ConfigurationError(
                f"target: expected ellipses that this head can follow, got none of "
                f"{ATTEMPTS} of {self}"
            )
        return rows, self._begin(head, rows[:, BEFORE])


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
        if not can_fixate(p, lower, upper, margin, x, y, z, angles[k]):
            return False
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
        seeds: (n,) see `vergence.envs.targets.workspace.choose_targets`, as are the following four.
        trials: (n,).
        p: (PACKED,).
        lower: (7,) rad.
        upper: (7,) rad.
        velocity: (7,) the joints' greatest speeds, rad/s.
        acceleration: (7,) their greatest accelerations, rad/s^2.
        depth: (2,) see `OrbitTarget`, as are the following five.
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
    eye = between_eyes(p, rest)
    near, far = depth[0], depth[1]
    angles = np.empty((_PHASES, 4))
    for n in range(seeds.shape[0]):
        # one draw of the speed for all candidates, or those that can be followed would be slower
        fastest = between(random_words(seeds[n], trials[n], _TASK, 0, 4)[0], speed[0], speed[1])
        found = False
        for attempt in range(ATTEMPTS):
            words = random_words(seeds[n], trials[n], _TASK, attempt, 1)
            centre = place(words, eye, near, far, eccentricity)
            long = centre[2] * tan(between(words[3], radius[0], radius[1]))
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
