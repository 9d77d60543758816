"""A target on an ellipse anywhere in a workspace, which the eyes can follow, drawn per trial."""

from dataclasses import dataclass
from math import cos, pi, sin, sqrt, tan
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np

from vergence.envs.streams import (
    IntArray,
    RandomStreams,
    StreamKeys,
    StreamPurpose,
    random_words,
    to_uniform,
)
from vergence.envs.targets.board import POINT, Board, is_detectable_by_both_eyes, whole_board_text
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.placement import (
    MAX_CANDIDATES,
    HeadWithLimits,
    can_fixate,
    midpoint_between_eyes,
    random_point,
    uniform_between,
)
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.kernels import compiled, inlined, untyped_tuple
from vergence.models.head import HeadModel
from vergence.models.kinematics import Vector, eye_actuator_angle, has_motor_per_joint
from vergence.models.parts import SLOTS, FloatArray

_TASK: Final = int(StreamPurpose.TASK)
_CHECKED_PHASES: Final = 48
"""Points of an ellipse at which fixation and the actuators' limits are checked (numerical)."""
_PEAK_SEARCH_PHASES: Final = 256
"""Points of an ellipse among which its peak angular speed is sought (numerical)."""

# largest fraction of an actuator's limits that following a target needs; the rest is left for
# catching up with it (chosen: fast targets against this reserve)
_MAX_LIMIT_FRACTION: Final = 0.5


@dataclass(frozen=True, kw_only=True)
class OrbitTarget(Target):
    """A target on an ellipse of random position, plane and shape, at a speed drawn by the trial.

    Both eyes can fixate the whole ellipse with a margin of some degrees, and then see the whole
    board if the plant shows one. Following the target needs at most half of the actuators' speed
    and acceleration. Until time zero the target rests at its starting point. Flat ellipses are
    sweeps back and forth, steep ones are motions in depth.
    """

    kind: ClassVar[str] = "orbit"
    drawn_in_workspace: ClassVar[bool] = True
    length_fields: ClassVar[tuple[str, ...]] = ("depth",)
    depth: tuple[float, float] = (0.4, 2.5)
    """Nearest and farthest z, m; the centre is uniform in 1 / depth."""
    eccentricity: float = 0.4
    """Greatest angle of the centre from straight ahead, seen from between the eyes, rad."""
    radius: tuple[float, float] = (0.1, 0.35)
    """Least and greatest semi-major axis, as an angle at the centre's depth, rad."""
    speed: tuple[float, float] = (0.3490658503988659, 1.0471975511965976)
    """Range of a trial's peak angular speed, seen from between the eyes, rad/s."""
    turns: float = 1.25
    """Largest number of turns per second."""
    margin: float = 0.03490658503988659
    """Least distance of the angles at fixation from the actuators' limits, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("depth", "radius", "speed")
        for name, angle in (("eccentricity", self.eccentricity), ("radius", self.radius[1])):
            if not angle < 1.5:
                raise ConfigurationError(f"target.{name}: expected less than 1.5 rad, got {angle}")

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is valid."""
        n = len(ids)
        orbits = Orbits(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n))
        ranges = OrbitRanges(
            *self.depth, self.eccentricity, *self.radius, *self.speed, self.turns, self.margin
        )
        keys = StreamKeys(streams.seeds[ids], streams.trials[ids])
        found = draw_orbits(
            untyped_tuple(keys),
            untyped_tuple(HeadWithLimits.of(head)),
            untyped_tuple(ranges),
            untyped_tuple(board),
            untyped_tuple(orbits),
        )
        if not found:
            raise UnreachableTargetError(
                f"target: expected ellipses that this head can follow and "
                f"see{whole_board_text(board)}, got none of {MAX_CANDIDATES} of {self}"
            )
        before = orbits.centre + orbits.cosine
        rows = motion_rows(
            orbits.centre,
            before=before,
            cosine=orbits.cosine,
            sine=orbits.sine,
            omega=orbits.omega,
        )
        return rows, self._begin(head, before)


class OrbitRanges(NamedTuple):
    """The fields of an `OrbitTarget`, in the form kernels take."""

    min_z_m: float
    max_z_m: float
    max_angle_rad: float
    min_radius_rad: float
    max_radius_rad: float
    min_speed: float
    max_speed: float
    max_turns_per_s: float
    margin_rad: float


class Orbits(NamedTuple):
    """Ellipses `centre + cosine cos(omega t) + sine sin(omega t)`, one per trial."""

    centre: FloatArray
    """(n, 3) in N, m."""
    cosine: FloatArray
    """(n, 3) m."""
    sine: FloatArray
    """(n, 3) m."""
    omega: FloatArray
    """(n,) rad/s."""


@inlined
def _peak_rate(centre: Vector, first: Vector, second: Vector, eye: Vector) -> float:
    """Peak angular speed, seen from `eye`, of an ellipse at an omega of 1 rad/s."""
    peak = 0.0
    for k in range(_PEAK_SEARCH_PHASES):
        c, s = cos(2.0 * pi * k / _PEAK_SEARCH_PHASES), sin(2.0 * pi * k / _PEAK_SEARCH_PHASES)
        x = centre[0] + first[0] * c + second[0] * s - eye[0]
        y = centre[1] + first[1] * c + second[1] * s - eye[1]
        z = centre[2] + first[2] * c + second[2] * s - eye[2]
        vx = second[0] * c - first[0] * s
        vy = second[1] * c - first[1] * s
        vz = second[2] * c - first[2] * s
        ax, ay, az = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
        peak = max(peak, sqrt(ax * ax + ay * ay + az * az) / (x * x + y * y + z * z))
    return peak


@inlined
def _can_follow(
    gaze: HeadWithLimits,
    ranges: OrbitRanges,
    board: Board,
    centre: Vector,
    first: Vector,
    second: Vector,
    omega: float,
    angles: FloatArray,
    own: FloatArray,
) -> bool:
    """True if both eyes can fixate the whole ellipse, and turn as fast as it needs.

    The last two arguments are scratch arrays (_CHECKED_PHASES, 4) for angles of the eye joints and
    of the actuators.
    """
    direct = has_motor_per_joint(gaze.head)
    for k in range(_CHECKED_PHASES):
        c, s = cos(2.0 * pi * k / _CHECKED_PHASES), sin(2.0 * pi * k / _CHECKED_PHASES)
        x = centre[0] + first[0] * c + second[0] * s
        y = centre[1] + first[1] * c + second[1] * s
        z = centre[2] + first[2] * c + second[2] * s
        if not ranges.min_z_m <= z <= ranges.max_z_m:
            return False
        if not can_fixate(gaze, ranges.margin_rad, (x, y, z), angles[k]):
            return False
        # a fixated point is visible, but a board may be cut
        if len(board.outline) and not is_detectable_by_both_eyes(
            gaze.head, angles[k], (x, y, z), 0.0, board
        ):
            return False
        for i in range(SLOTS):
            own[k, i] = angles[k, i] if direct else eye_actuator_angle(gaze.head, i, angles[k])
    step = 2.0 * pi / _CHECKED_PHASES / omega
    for k in range(_CHECKED_PHASES):
        for j in range(SLOTS):
            last, now = own[k - 1, j], own[k, j]
            after = own[(k + 1) % _CHECKED_PHASES, j]
            if abs(after - last) > 2.0 * step * _MAX_LIMIT_FRACTION * gaze.speed_limits[j]:
                return False
            bend = abs(after - 2.0 * now + last) / (step * step)
            if bend > _MAX_LIMIT_FRACTION * gaze.acceleration_limits[j]:
                return False
    return True


@compiled
def draw_orbits(
    keys: StreamKeys, gaze: HeadWithLimits, ranges: OrbitRanges, board: Board, orbits: Orbits
) -> bool:
    """Draw ellipses for each trial until the eyes can follow one.

    Args:
        keys: `untyped_tuple`, keys of the n trials' random streams.
        gaze: `untyped_tuple`, the head that looks.
        ranges: `untyped_tuple`, the target's fields.
        board: `untyped_tuple`, shape of the target.
        orbits: `untyped_tuple`, the result.

    Returns:
        False if some trial has no valid candidate.
    """
    keys, gaze = StreamKeys(*keys), HeadWithLimits(*gaze)
    ranges, board, orbits = OrbitRanges(*ranges), Board(*board), Orbits(*orbits)
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    angles, own = np.empty((_CHECKED_PHASES, 4)), np.empty((_CHECKED_PHASES, SLOTS))
    for n in range(len(orbits.omega)):
        seed, trial = keys.seeds[n], keys.trials[n]
        # one speed for all candidates, else the selection would favour slow targets
        speed = uniform_between(
            random_words(seed, trial, _TASK, 0, 4)[0], ranges.min_speed, ranges.max_speed
        )
        found = False
        for attempt in range(MAX_CANDIDATES):
            words = random_words(seed, trial, _TASK, attempt, 1)
            centre = random_point(words, eye, ranges.min_z_m, ranges.max_z_m, ranges.max_angle_rad)
            radius = uniform_between(words[3], ranges.min_radius_rad, ranges.max_radius_rad)
            long = centre[2] * tan(radius)
            words = random_words(seed, trial, _TASK, attempt, 2)
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
            if not peak * 2.0 * pi * ranges.max_turns_per_s >= speed:
                continue
            omega = speed / peak
            if not _can_follow(gaze, ranges, board, centre, first, second, omega, angles, own):
                continue
            phase = 2.0 * pi * to_uniform(random_words(seed, trial, _TASK, attempt, 3)[0])
            c, s = cos(phase), sin(phase)
            for i in range(3):
                orbits.centre[n, i] = centre[i]
                orbits.cosine[n, i] = first[i] * c + second[i] * s
                orbits.sine[n, i] = second[i] * c - first[i] * s
            orbits.omega[n] = omega
            found = True
            break
        if not found:
            return False
    return True
