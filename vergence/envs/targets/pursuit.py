"""Targets that the eyes can pursue, drawn per trial: on an ellipse, or wandering."""

from dataclasses import dataclass
from math import cos, hypot, pi, sin, sqrt, tan
from typing import ClassVar, Final, Literal

import numpy as np

from vergence.envs.streams import (
    IntArray,
    RandomStreams,
    StreamKeys,
    StreamPurpose,
    Words,
    random_words,
    to_uniform,
)
from vergence.envs.targets.motion import (
    POINT,
    Board,
    Target,
    is_detectable_by_both_eyes,
    motion_fields,
    motion_rows,
    point_between_knots,
    whole_board_text,
)
from vergence.envs.targets.workspace import (
    MAX_CANDIDATES,
    HeadWithLimits,
    Workspace,
    can_fixate,
    draw_event_times,
    midpoint_between_eyes,
    random_point,
    uniform_between,
)
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.kernels import compiled, inlined, subroutine
from vergence.models.head import HeadModel
from vergence.models.kinematics import Vector, eye_actuator_angle, has_motor_per_joint
from vergence.models.parts import SLOTS, FloatArray

_TASK: Final = int(StreamPurpose.TASK)
_CHECKED_PHASES: Final = 48
"""Points of an ellipse at which fixation and the actuators' limits are checked (numerical)."""
_PEAK_SEARCH_PHASES: Final = 256
"""Points of an ellipse among which its peak angular speed is sought (numerical)."""
_MAX_LIMIT_FRACTION: Final = 0.5
"""Largest fraction of an actuator's limits that following a target needs; the rest is left for
catching up with it (chosen: fast targets against this reserve)."""


def _none_found(what: str, target: Target, board: Board) -> UnreachableTargetError:
    return UnreachableTargetError(
        f"target: expected {what} that this head can follow and see{whole_board_text(board)}, got "
        f"none of {MAX_CANDIDATES} of {target}"
    )


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
        (anchor, cosine, sine), omega = np.empty((3, len(ids), 3)), np.empty(len(ids))
        if not draw_orbits(
            streams.keys_of(ids), HeadWithLimits.of(head),
            Workspace(self.depth, self.eccentricity, self.margin), self.radius, self.speed,
            self.turns, board, anchor, cosine, sine, omega,
        ):  # fmt: skip
            raise _none_found("ellipses", self, board)
        before = anchor + cosine
        rows = motion_rows(anchor, before=before, cosine=cosine, sine=sine, omega=omega)
        return rows, self._begin(head, before)


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
def _can_follow_orbit(
    gaze: HeadWithLimits, workspace: Workspace, board: Board, centre: Vector, first: Vector,
    second: Vector, omega: float, angles: FloatArray, own: FloatArray,
) -> bool:  # fmt: skip
    """True if both eyes can fixate the whole ellipse, and turn as fast as it needs.

    The last two arguments are scratch arrays for angles of the eye joints and of the actuators.
    """
    direct = has_motor_per_joint(gaze.head)
    for k in range(_CHECKED_PHASES):
        c, s = cos(2.0 * pi * k / _CHECKED_PHASES), sin(2.0 * pi * k / _CHECKED_PHASES)
        x = centre[0] + first[0] * c + second[0] * s
        y = centre[1] + first[1] * c + second[1] * s
        z = centre[2] + first[2] * c + second[2] * s
        if not workspace.depth[0] <= z <= workspace.depth[1]:
            return False
        if not can_fixate(gaze, workspace.margin, (x, y, z), angles[k]):
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
    keys: StreamKeys, gaze: HeadWithLimits, workspace: Workspace, radii: tuple[float, float],
    speeds: tuple[float, float], max_turns_per_s: float, board: Board, anchor: FloatArray,
    cosine: FloatArray, sine: FloatArray, omegas: FloatArray,
) -> bool:  # fmt: skip
    """Draw ellipses `anchor + cosine cos(omega t) + sine sin(omega t)` that the eyes can follow.

    The result is False if some trial has no valid candidate.
    """
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    angles, own = np.empty((_CHECKED_PHASES, 4)), np.empty((_CHECKED_PHASES, SLOTS))
    for n in range(len(omegas)):
        seed, trial = keys.seeds[n], keys.trials[n]
        # one speed for all candidates, else the selection would favour slow targets
        speed = uniform_between(random_words(seed, trial, _TASK, 0, 4)[0], speeds[0], speeds[1])
        found = False
        for attempt in range(MAX_CANDIDATES):
            words = random_words(seed, trial, _TASK, attempt, 1)
            centre = random_point(words, eye, workspace)
            long = centre[2] * tan(uniform_between(words[3], radii[0], radii[1]))
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
            if not peak * 2.0 * pi * max_turns_per_s >= speed:
                continue
            omegas[n] = omega = speed / peak
            found = _can_follow_orbit(
                gaze, workspace, board, centre, first, second, omega, angles, own
            )
            if not found:
                continue
            phase = 2.0 * pi * to_uniform(random_words(seed, trial, _TASK, attempt, 3)[0])
            c, s = cos(phase), sin(phase)
            for i in range(3):
                anchor[n, i] = centre[i]
                cosine[n, i] = first[i] * c + second[i] * s
                sine[n, i] = second[i] * c - first[i] * s
            break
        if not found:
            return False
    return True


@dataclass(frozen=True, kw_only=True)
class OccludedTarget(OrbitTarget):
    """A target that moves on the ellipse of `OrbitTarget` and is hidden for a part of it.

    It moves on while hidden and reappears elsewhere, where the eyes look if they have moved on with
    it. In the same trial, `orbit` with the same options has the same ellipse.
    """

    kind: ClassVar[str] = "occluded"
    gone_after: tuple[float, float] = (0.8, 2.5)
    """Earliest and latest time at which it disappears, s."""
    gone_s: float = 0.3
    """Duration of its absence, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("gone_after")

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`."""
        rows, q = super().draw(head, streams, ids, board)
        gone = draw_event_times(streams.keys_of(ids), *self.gone_after)
        fields = motion_fields(rows)
        fields["hidden_from"], fields["hidden_until"] = gone, gone + self.gone_s
        return rows, q


_SEGMENTS_PER_PATH: Final = 32
"""Segments of a path, after which the target goes back (chosen: variety against time to draw)."""
_SEGMENT_ATTEMPTS: Final = 50
"""Candidates tried for a segment (numerical)."""
_SAMPLES_PER_SEGMENT: Final = 4
"""Points of a segment at which fixation and the actuators' speeds are checked (numerical)."""


@dataclass(frozen=True, kw_only=True)
class WanderTarget(Target):
    """A random walk: straight on for a while, then on in another direction, near and far.

    Seen from between the eyes, the target moves at one angular speed, which the trial draws. At
    each turn it draws a direction (uniform), a rate of 1 / distance, and the time until the next
    turn. A segment is drawn again if it leaves the workspace, or if somewhere on it an eye cannot
    fixate the target with a margin of some degrees, or does not see the whole board then, if the
    plant shows one. Following the target needs at most half of the actuators' speed, but infinite
    acceleration at its turns: this is the purpose of the target, as no eye can stay on it there.
    Until time zero it rests at its starting point. After 32 segments it goes back along its path,
    and so never ends.
    """

    kind: ClassVar[str] = "wander"
    drawn_in_workspace: ClassVar[bool] = True
    length_fields: ClassVar[tuple[str, ...]] = ("depth",)
    depth: tuple[float, float] = (0.4, 2.5)
    """Nearest and farthest z, m; the starting point is uniform in 1 / depth."""
    eccentricity: float = 0.7
    """Greatest angle from straight ahead, seen from between the eyes, rad."""
    speed: tuple[float, float] = (0.08726646259971647, 0.6981317007977318)
    """Range of a trial's angular speed, seen from between the eyes, rad/s."""
    approach: float = 1.0
    """Greatest rate of 1 / distance from between the eyes, in both directions, 1/(m s)."""
    turn_after: tuple[float, float] = (0.15, 0.5)
    """Shortest and longest time from one turn to the next, s."""
    margin: float = 0.03490658503988659
    """Least distance of the angles at fixation from the actuators' limits, rad."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("depth", "speed", "turn_after")
        if not self.eccentricity < 1.5:
            raise ConfigurationError(
                f"target.eccentricity: expected less than 1.5 rad, got {self.eccentricity}"
            )
        if not self.speed[1] * self.turn_after[1] < 1.5:
            raise ConfigurationError(
                "target.turn_after: expected less than 1.5 rad from turn to turn at the greatest "
                f"speed, got {self.turn_after} s at {self.speed[1]:g} rad/s"
            )

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; segments are drawn until one is valid."""
        paths = np.empty((len(ids), 4 * (_SEGMENTS_PER_PATH + 2)))
        if not draw_paths(
            streams.keys_of(ids), HeadWithLimits.of(head),
            Workspace(self.depth, self.eccentricity, self.margin), self.speed, self.approach,
            self.turn_after, board, paths,
        ):  # fmt: skip
            raise _none_found("paths", self, board)
        beginning = paths[:, 5:8]
        return motion_rows(beginning, before=beginning, path=paths), self._begin(head, beginning)


@inlined
def _draw_next_knot(
    path: FloatArray, knot: int, words: Words, approach: float, segment_s: tuple[float, float]
) -> bool:
    """Draw the next knot of a path; True if it lies at a finite distance."""
    here, there = 4 * knot, 4 * knot + 4
    ex, ey, ez = path[1], path[2], path[3]
    x, y, z = path[here + 1] - ex, path[here + 2] - ey, path[here + 3] - ez
    r = sqrt(x * x + y * y + z * z)
    x, y, z = x / r, y / r, z / r
    span = uniform_between(words[0], segment_s[0], segment_s[1])
    nearness = 1.0 / r + uniform_between(words[1], -approach, approach) * span
    if nearness <= 0.0:
        return False
    # two directions orthogonal to the line of sight: one horizontal, one down
    level = hypot(x, z)
    ax, az = z / level, -x / level
    bx, by, bz = y * az, z * ax - x * az, -y * ax
    towards = 2.0 * pi * to_uniform(words[2])
    c = cos(path[0] * span) / nearness
    sa = sin(path[0] * span) * cos(towards) / nearness
    sb = sin(path[0] * span) * sin(towards) / nearness
    path[there] = path[here] + span
    path[there + 1] = ex + c * x + sa * ax + sb * bx
    path[there + 2] = ey + c * y + sb * by
    path[there + 3] = ez + c * z + sa * az + sb * bz
    return True


@subroutine
def _can_look(
    gaze: HeadWithLimits, workspace: Workspace, board: Board, eye: Vector, point: Vector,
    angles: FloatArray, own: FloatArray,
) -> bool:  # fmt: skip
    """True if a point is in the workspace, and both eyes can fixate it.

    The last two arguments are results: (4,) angles of the eye joints, and of the actuators.
    """
    x, y, z = point
    if not workspace.depth[0] <= z <= workspace.depth[1]:
        return False
    if hypot(x - eye[0], y - eye[1]) > z * tan(workspace.eccentricity):
        return False
    if not can_fixate(gaze, workspace.margin, point, angles):
        return False
    # a fixated point is visible, but a board may be cut
    if len(board.outline) and not is_detectable_by_both_eyes(gaze.head, angles, point, 0.0, board):
        return False
    direct = has_motor_per_joint(gaze.head)
    for i in range(SLOTS):
        own[i] = angles[i] if direct else eye_actuator_angle(gaze.head, i, angles)
    return True


@inlined
def _can_follow_path(
    gaze: HeadWithLimits, workspace: Workspace, board: Board, path: FloatArray, knot: int,
    angles: FloatArray, own: FloatArray,
) -> bool:  # fmt: skip
    """True if both eyes can fixate the whole segment after a knot, and turn as fast as it needs.

    The last two arguments are scratch arrays: angles of the eye joints, and of the actuators, with
    those at the knot in the first row.
    """
    eye = (path[1], path[2], path[3])
    step = (path[4 * knot + 4] - path[4 * knot]) / _SAMPLES_PER_SEGMENT
    for k in range(1, _SAMPLES_PER_SEGMENT + 1):
        point = point_between_knots(path, knot, path[4 * knot] + k * step)
        if not _can_look(gaze, workspace, board, eye, point, angles, own[k]):
            return False
        for i in range(SLOTS):
            if abs(own[k, i] - own[k - 1, i]) > _MAX_LIMIT_FRACTION * gaze.speed_limits[i] * step:
                return False
    return True


@compiled
def draw_paths(
    keys: StreamKeys, gaze: HeadWithLimits, workspace: Workspace, speeds: tuple[float, float],
    approach: float, segment_s: tuple[float, float], board: Board, paths: FloatArray,
) -> bool:  # fmt: skip
    """Draw paths for each trial, segment by segment, until the eyes can follow one.

    The result is False if some trial has no valid candidate.
    """
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    angles, own = np.empty(4), np.empty((_SAMPLES_PER_SEGMENT + 1, SLOTS))
    last = paths.shape[1] // 4 - 1
    for n in range(len(paths)):
        seed, trial, path = keys.seeds[n], keys.trials[n], paths[n]
        # one speed for all candidates, else the selection would favour slow targets
        path[0] = uniform_between(random_words(seed, trial, _TASK, 0, 4)[0], speeds[0], speeds[1])
        path[1], path[2], path[3] = eye
        knot = 0
        for attempt in range(MAX_CANDIDATES):
            words = random_words(seed, trial, _TASK, attempt, 1)
            point = random_point(words, eye, workspace)
            path[4] = 0.0
            path[5], path[6], path[7] = point
            knot = 1 if _can_look(gaze, workspace, board, eye, point, angles, own[0]) else 0
            tried = 0
            while 0 < knot < last and tried < _SEGMENT_ATTEMPTS:
                block = (attempt * last + knot) * _SEGMENT_ATTEMPTS + tried
                words = random_words(seed, trial, _TASK, block, 2)
                tried += 1
                if _draw_next_knot(path, knot, words, approach, segment_s) and _can_follow_path(
                    gaze, workspace, board, path, knot, angles, own
                ):
                    own[0] = own[_SAMPLES_PER_SEGMENT]
                    knot, tried = knot + 1, 0
            if knot == last:
                break
        if knot < last:
            return False
    return True
