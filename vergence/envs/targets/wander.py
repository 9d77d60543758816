"""A target that wanders through a workspace and turns at unpredictable times."""

from dataclasses import dataclass
from math import cos, hypot, pi, sin, sqrt, tan
from typing import ClassVar, Final, Literal, NamedTuple

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
from vergence.envs.targets.board import POINT, Board, is_detectable_by_both_eyes, whole_board_text
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.path import point_between_knots
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
from vergence.kernels import compiled, inlined, subroutine, untyped_tuple
from vergence.models.head import HeadModel
from vergence.models.kinematics import Vector, eye_actuator_angle, has_motor_per_joint
from vergence.models.parts import SLOTS, FloatArray

_TASK: Final = int(StreamPurpose.TASK)
_SEGMENTS_PER_PATH: Final = 32
"""Segments of a path, after which the target goes back (chosen: variety against time to draw)."""
_SEGMENT_ATTEMPTS: Final = 50
"""Candidates tried for a segment (numerical)."""
_SAMPLES_PER_SEGMENT: Final = 4
"""Points of a segment at which fixation and the actuators' speeds are checked (numerical)."""

# largest fraction of an actuator's speed limit that following a target needs; the rest is left for
# catching up with it (chosen: fast targets against this reserve)
_MAX_SPEED_FRACTION: Final = 0.5


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
        walk = WanderRanges(
            *self.depth,
            self.eccentricity,
            *self.speed,
            self.approach,
            *self.turn_after,
            self.margin,
        )
        keys = StreamKeys(streams.seeds[ids], streams.trials[ids])
        if not draw_paths(
            untyped_tuple(keys),
            untyped_tuple(HeadWithLimits.of(head)),
            untyped_tuple(walk),
            untyped_tuple(board),
            paths,
        ):
            raise UnreachableTargetError(
                f"target: expected paths that this head can follow and "
                f"see{whole_board_text(board)}, got none of {MAX_CANDIDATES} of {self}"
            )
        beginning = paths[:, 5:8]
        return motion_rows(beginning, before=beginning, path=paths), self._begin(head, beginning)


class WanderRanges(NamedTuple):
    """The fields of a `WanderTarget`, in the form kernels take."""

    min_z_m: float
    max_z_m: float
    max_angle_rad: float
    min_speed: float
    max_speed: float
    max_inverse_distance_rate: float
    min_segment_s: float
    max_segment_s: float
    margin_rad: float


@inlined
def _draw_next_knot(path: FloatArray, knot: int, words: Words, walk: WanderRanges) -> bool:
    """Draw the next knot of a path.

    Returns:
        True if it lies at a finite distance.
    """
    here, there = 4 * knot, 4 * knot + 4
    ex, ey, ez = path[1], path[2], path[3]
    x, y, z = path[here + 1] - ex, path[here + 2] - ey, path[here + 3] - ez
    r = sqrt(x * x + y * y + z * z)
    x, y, z = x / r, y / r, z / r
    span = uniform_between(words[0], walk.min_segment_s, walk.max_segment_s)
    nearness = (
        1.0 / r
        + uniform_between(words[1], -walk.max_inverse_distance_rate, walk.max_inverse_distance_rate)
        * span
    )
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
    gaze: HeadWithLimits,
    walk: WanderRanges,
    board: Board,
    eye: Vector,
    point: Vector,
    angles: FloatArray,
    own: FloatArray,
) -> bool:
    """True if a point is in the workspace, and both eyes can fixate it.

    The last two arguments are results: (4,) angles of the eye joints, and of the actuators.
    """
    x, y, z = point
    if not walk.min_z_m <= z <= walk.max_z_m:
        return False
    if hypot(x - eye[0], y - eye[1]) > z * tan(walk.max_angle_rad):
        return False
    if not can_fixate(gaze, walk.margin_rad, point, angles):
        return False
    # a fixated point is visible, but a board may be cut
    if len(board.outline) and not is_detectable_by_both_eyes(gaze.head, angles, point, 0.0, board):
        return False
    direct = has_motor_per_joint(gaze.head)
    for i in range(SLOTS):
        own[i] = angles[i] if direct else eye_actuator_angle(gaze.head, i, angles)
    return True


@inlined
def _can_follow(
    gaze: HeadWithLimits,
    walk: WanderRanges,
    board: Board,
    path: FloatArray,
    knot: int,
    angles: FloatArray,
    own: FloatArray,
) -> bool:
    """True if both eyes can fixate the whole segment after a knot, and turn as fast as it needs.

    The last two arguments are scratch arrays: (4,) angles of the eye joints, and
        (_SAMPLES_PER_SEGMENT + 1, 4)
    angles of the actuators, with those at the knot in the first row.
    """
    eye = (path[1], path[2], path[3])
    step = (path[4 * knot + 4] - path[4 * knot]) / _SAMPLES_PER_SEGMENT
    for k in range(1, _SAMPLES_PER_SEGMENT + 1):
        point = point_between_knots(path, knot, path[4 * knot] + k * step)
        if not _can_look(gaze, walk, board, eye, point, angles, own[k]):
            return False
        for i in range(SLOTS):
            if abs(own[k, i] - own[k - 1, i]) > _MAX_SPEED_FRACTION * gaze.speed_limits[i] * step:
                return False
    return True


@compiled
def draw_paths(
    keys: StreamKeys, gaze: HeadWithLimits, ranges: WanderRanges, board: Board, paths: FloatArray
) -> bool:
    """Draw paths for each trial, segment by segment, until the eyes can follow one.

    Args:
        keys: `untyped_tuple`, keys of the n trials' random streams.
        gaze: `untyped_tuple`, the head that looks.
        ranges: `untyped_tuple`, the target's fields.
        board: `untyped_tuple`, shape of the target.
        paths: (n, 4 + 4 k) result: paths of k knots, see `vergence.envs.targets.path`.

    Returns:
        False if some trial has no valid candidate.
    """
    keys, gaze, ranges, board = (
        StreamKeys(*keys),
        HeadWithLimits(*gaze),
        WanderRanges(*ranges),
        Board(*board),
    )
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    angles, own = np.empty(4), np.empty((_SAMPLES_PER_SEGMENT + 1, SLOTS))
    last = paths.shape[1] // 4 - 1
    for n in range(len(paths)):
        seed, trial, path = keys.seeds[n], keys.trials[n], paths[n]
        # one speed for all candidates, else the selection would favour slow targets
        path[0] = uniform_between(
            random_words(seed, trial, _TASK, 0, 4)[0], ranges.min_speed, ranges.max_speed
        )
        path[1], path[2], path[3] = eye
        knot = 0
        for attempt in range(MAX_CANDIDATES):
            words = random_words(seed, trial, _TASK, attempt, 1)
            point = random_point(words, eye, ranges.min_z_m, ranges.max_z_m, ranges.max_angle_rad)
            path[4] = 0.0
            path[5], path[6], path[7] = point
            knot = 1 if _can_look(gaze, ranges, board, eye, point, angles, own[0]) else 0
            tried = 0
            while 0 < knot < last and tried < _SEGMENT_ATTEMPTS:
                block = (attempt * last + knot) * _SEGMENT_ATTEMPTS + tried
                words = random_words(seed, trial, _TASK, block, 2)
                tried += 1
                if _draw_next_knot(path, knot, words, ranges) and _can_follow(
                    gaze, ranges, board, path, knot, angles, own
                ):
                    own[0] = own[_SAMPLES_PER_SEGMENT]
                    knot, tried = knot + 1, 0
            if knot == last:
                break
        if knot < last:
            return False
    return True
