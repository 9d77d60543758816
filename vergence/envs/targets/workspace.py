"""Random points of a workspace that both eyes can fixate, and targets that appear there."""

from dataclasses import dataclass
from math import cos, hypot, pi, sin, tan
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
from vergence.envs.targets.motion import (
    POINT,
    Board,
    Target,
    is_detectable_by_both_eyes,
    motion_rows,
    whole_board_text,
)
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.kernels import compiled, inlined, subroutine
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

    head: PackedHead  # (PACKED,) see `vergence.models.kinematics`
    rest: FloatArray  # (7,) joint angles at rest, rad
    lower: FloatArray  # (4,) lower angle limits of the eye actuators, rad
    upper: FloatArray  # (4,) upper angle limits of the eye actuators, rad
    speed_limits: FloatArray  # (4,) speed limits of the eye actuators, rad/s
    acceleration_limits: FloatArray  # (4,) acceleration limits of the eye actuators, rad/s^2
    joint_limits: tuple[FloatArray, FloatArray] | None
    """(4,) each, lower and upper angle limits of the eye joints, rad; None if each has a motor."""

    @classmethod
    def of(cls, head: HeadModel) -> "HeadWithLimits":
        """The limits of a head model."""
        own, limits = head.actuation, head.limits
        return cls(
            head.packed, head.rest(), own.lower[EYES], own.upper[EYES], own.velocity[EYES],
            own.acceleration[EYES],
            None if own.direct else (limits.lower[EYES], limits.upper[EYES]),
        )  # fmt: skip


class Workspace(NamedTuple):
    """Where the points of a target may lie, and the reserve of the eyes that fixate them."""

    depth: tuple[float, float]  # nearest and farthest z, m
    eccentricity: float  # greatest angle from straight ahead, rad
    margin: float  # least distance of the angles at fixation from the actuators' limits, rad


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
def random_point(words: Words, viewpoint: Vector, workspace: Workspace) -> Vector:
    """Point from three random words: uniform in 1 / depth and in the angle from straight ahead."""
    z = 1.0 / uniform_between(words[0], 1.0 / workspace.depth[1], 1.0 / workspace.depth[0])
    slope = z * tan(workspace.eccentricity * to_uniform(words[1]))
    around = 2.0 * pi * to_uniform(words[2])
    return viewpoint[0] + slope * cos(around), viewpoint[1] + slope * sin(around), z


@inlined
def can_fixate(gaze: HeadWithLimits, margin_rad: float, point: Vector, angles: FloatArray) -> bool:
    """True if both eyes can fixate a point with a margin to their limits.

    For coupled joints, the angles are those of the least pixel errors, and both eyes must see the
    point then.
    """
    return _can_fixate(gaze, gaze.joint_limits, margin_rad, point, angles)


@inlined
def _can_fixate(
    gaze: HeadWithLimits, joint_limits: tuple[FloatArray, FloatArray] | None, margin_rad: float,
    point: Vector, angles: FloatArray,
) -> bool:  # fmt: skip
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
    gaze: HeadWithLimits, joint_limits: tuple[FloatArray, FloatArray], margin_rad: float,
    point: Vector, angles: FloatArray,
) -> bool:  # fmt: skip
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


_TASK: Final = int(StreamPurpose.TASK)
# lane of the random words (numerical); the first four are used for positions and speeds
_EVENT_TIME_LANE: Final = 5


@compiled
def draw_event_times(keys: StreamKeys, earliest: float, latest: float) -> FloatArray:
    """(n,) a moment for each of some trials, uniform in a range, s."""
    moments = np.empty(len(keys.seeds))
    for n in range(len(moments)):
        words = random_words(keys.seeds[n], keys.trials[n], _TASK, 0, _EVENT_TIME_LANE)
        moments[n] = uniform_between(words[0], earliest, latest)
    return moments


_START_ATTEMPTS: Final = 100
"""Starts tried for a candidate target (numerical)."""


@dataclass(frozen=True, kw_only=True)
class RandomTarget(Target):
    """A target that appears anywhere in a workspace, uniform in eccentricity and in 1 / depth.

    Both eyes can fixate it with a margin of some degrees and see it at time zero (the whole board,
    if the plant shows one), and the eyes must turn by at least `shift`. With `start="fixation"` the
    eyes start on another point of the workspace.
    """

    kind: ClassVar[str] = "random"
    drawn_in_workspace: ClassVar[bool] = True
    length_fields: ClassVar[tuple[str, ...]] = ("depth",)
    depth: tuple[float, float] = (0.3, 2.5)
    """Nearest and farthest z, m."""
    eccentricity: float = 0.7
    """Greatest angle from straight ahead, seen from between the eyes, rad."""
    margin: float = 0.03490658503988659
    """Least distance of the angles at fixation from the actuators' limits, rad."""
    shift: float = 0.03490658503988659
    """Least turn of the eye that turns farther, rad."""
    border: float = 0.0
    """Least distance of the target from the images' edges at time zero, px: a reserve for true
    heads that differ from their model."""
    start: Literal["rest", "fixation"] = "fixation"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("depth")
        if not 0.0 < self.eccentricity < 1.5:
            raise ConfigurationError(
                f"target.eccentricity: expected 0 to 1.5 rad, got {self.eccentricity}"
            )

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is valid."""
        points, _none, q = self._draw_points(head, streams.keys_of(ids), board, "points")
        return motion_rows(points), q

    def _draw_points(
        self, head: HeadModel, keys: StreamKeys, board: Board, what: str, jumps: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Points (n, 3), the ones to which they jump, if they do, and starting angles (n, 7)."""
        n = len(keys.seeds)
        points, later, q = np.empty((n, 3)), np.empty((n if jumps else 0, 3)), np.empty((n, 7))
        if not draw_targets(
            keys, HeadWithLimits.of(head), Workspace(self.depth, self.eccentricity, self.margin),
            self.shift, self.border, self.start == "fixation", board, points, later, q,
        ):  # fmt: skip
            raise UnreachableTargetError(
                f"target: expected a workspace that this head can look at, got none of "
                f"{MAX_CANDIDATES} {what} of {self} that both eyes can fixate and "
                f"see{whole_board_text(board)}"
            )
        return points, later, q


@inlined
def larger_eye_turn(begin: FloatArray, goal: FloatArray) -> float:
    """Turn of the eye that turns farther, rad, between angles of the eyes, (4,) and (4,)."""
    left = hypot(goal[0] - begin[0], goal[1] - begin[1])
    return max(left, hypot(goal[2] - begin[2], goal[3] - begin[3]))


@subroutine
def draw_target_and_start(
    seed: np.uint64, trial: np.uint64, attempt: int, gaze: HeadWithLimits, workspace: Workspace,
    shift: float, border_px: float, fixating: bool, board: Board, viewpoint: Vector,
    target_angles: FloatArray, start_angles: FloatArray,
) -> tuple[bool, Vector]:  # fmt: skip
    """Draw one candidate for a target, and starts for it until one is valid."""
    words = random_words(seed, trial, _TASK, attempt, 1)
    point = random_point(words, viewpoint, workspace)
    if not can_fixate(gaze, workspace.margin, point, target_angles):
        return False, point
    # many starts for one target: if both were drawn anew, few peripheral targets would be left, as
    # they are visible from few points of the workspace
    for again in range(_START_ATTEMPTS if fixating else 1):
        other = random_point(
            random_words(seed, trial, _TASK, attempt + again, 2), viewpoint, workspace
        )
        if not fixating:
            start_angles[:] = gaze.rest[3:]
        elif not can_fixate(gaze, workspace.margin, other, start_angles):
            continue
        turns = larger_eye_turn(start_angles, target_angles) >= shift
        if turns and is_detectable_by_both_eyes(gaze.head, start_angles, point, border_px, board):
            return True, point
    return False, point


_SECOND_ATTEMPTS: Final = 100
"""Candidates for the second point per first point (numerical)."""


@compiled
def draw_targets(
    keys: StreamKeys, gaze: HeadWithLimits, workspace: Workspace, shift: float, border_px: float,
    fixating: bool, board: Board, points: FloatArray, later_points: FloatArray,
    start_angles: FloatArray,
) -> bool:  # fmt: skip
    """Draw candidates for each trial until one is valid; False if some trial has none.

    Each point has a second one, for a jump, if there is room for some in `later_points`.
    """
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    begin, goal, last = np.empty(4), np.empty(4), np.empty(4)
    for n in range(len(points)):
        seed, trial = keys.seeds[n], keys.trials[n]
        start_angles[n] = gaze.rest
        found = False
        for attempt in range(MAX_CANDIDATES):
            found, point = draw_target_and_start(
                seed, trial, attempt, gaze, workspace, shift, border_px, fixating, board, eye,
                goal, begin,
            )  # fmt: skip
            if not found:
                continue
            points[n, 0], points[n, 1], points[n, 2] = point
            for again in range(_SECOND_ATTEMPTS if len(later_points) else 0):
                words = random_words(seed, trial, _TASK, attempt * _SECOND_ATTEMPTS + again, 3)
                point = random_point(words, eye, workspace)
                found = can_fixate(gaze, workspace.margin, point, last)
                found = found and larger_eye_turn(goal, last) >= shift
                for angles in (begin, goal):
                    found = found and is_detectable_by_both_eyes(
                        gaze.head, angles, point, border_px, board
                    )
                if found:
                    later_points[n, 0], later_points[n, 1], later_points[n, 2] = point
                    break
            if found:
                start_angles[n, 3:] = begin
                break
        if not found:
            return False
    return True


@dataclass(frozen=True, kw_only=True)
class DoubleStepTarget(RandomTarget):
    """A target that appears as `RandomTarget` does, and soon jumps to another point.

    The second point meets the conditions of the first: both eyes can fixate it with the margin,
    and turn to it from the first point by `shift` or more. Both eyes see it (the whole board, if
    the plant shows one) from their start and while they fixate the first point, and so most likely
    at all times in between.
    """

    kind: ClassVar[str] = "double-step"
    second_after: tuple[float, float] = (0.1, 0.2)
    """Shortest and longest time from the first jump to the second, s. Longer than the age of most
    images, so that the eyes have set off, yet shorter than this age plus the turn, so that they
    have not arrived and must change their goal on the way."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._refuse_unordered("second_after")

    def draw(
        self, head: HeadModel, streams: RandomStreams, ids: IntArray, board: Board = POINT
    ) -> tuple[FloatArray, FloatArray]:
        """See `Target.draw`; candidates are drawn until one is valid."""
        keys = streams.keys_of(ids)
        first, second, q = self._draw_points(head, keys, board, "pairs of points", jumps=True)
        after = draw_event_times(keys, *self.second_after)
        return motion_rows(first, second_jump_time=after, second_anchor=second), q
