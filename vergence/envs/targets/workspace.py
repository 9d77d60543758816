"""A target that appears anywhere in a workspace, drawn for each trial."""

from dataclasses import dataclass
from math import hypot
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np

from vergence.envs.streams import IntArray, RandomStreams, StreamKeys, StreamPurpose, random_words
from vergence.envs.targets.board import POINT, Board, is_detectable_by_both_eyes, whole_board_text
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.placement import (
    MAX_CANDIDATES,
    HeadWithLimits,
    can_fixate,
    midpoint_between_eyes,
    random_point,
)
from vergence.envs.targets.target import Target
from vergence.errors import ConfigurationError, UnreachableTargetError
from vergence.kernels import compiled, inlined, subroutine, untyped_tuple
from vergence.models.head import HeadModel
from vergence.models.kinematics import Vector
from vergence.models.parts import FloatArray

_TASK: Final = int(StreamPurpose.TASK)
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
        points, q = np.empty((len(ids), 3)), np.empty((len(ids), 7))
        keys = StreamKeys(streams.seeds[ids], streams.trials[ids])
        found = draw_targets(
            untyped_tuple(keys),
            untyped_tuple(HeadWithLimits.of(head)),
            untyped_tuple(self._workspace()),
            untyped_tuple(board),
            points,
            q,
        )
        if not found:
            raise self._unseen("points", board)
        return motion_rows(points), q

    def _workspace(self) -> "RandomTargetRanges":
        return RandomTargetRanges(
            *self.depth,
            self.eccentricity,
            self.margin,
            self.shift,
            self.border,
            self.start == "fixation",
        )

    def _unseen(self, what: str, board: Board) -> UnreachableTargetError:
        return UnreachableTargetError(
            f"target: expected a workspace that this head can look at, got none of "
            f"{MAX_CANDIDATES} {what} of {self} that both eyes can fixate and "
            f"see{whole_board_text(board)}"
        )


class RandomTargetRanges(NamedTuple):
    """The fields of a `RandomTarget`, in the form kernels take."""

    min_z_m: float
    max_z_m: float
    max_angle_rad: float
    margin_rad: float
    min_eye_turn_rad: float
    border_px: float
    starts_fixating: bool
    """True if the eyes start on a point of the workspace, False if at rest."""


@inlined
def larger_eye_turn(begin: FloatArray, goal: FloatArray) -> float:
    """Turn of the eye that turns farther, rad, between angles of the eyes, (4,) and (4,)."""
    left = hypot(goal[0] - begin[0], goal[1] - begin[1])
    return max(left, hypot(goal[2] - begin[2], goal[3] - begin[3]))


@subroutine
def draw_target_and_start(
    seed: np.uint64,
    trial: np.uint64,
    attempt: int,
    gaze: HeadWithLimits,
    workspace: RandomTargetRanges,
    board: Board,
    viewpoint: Vector,
    target_angles: FloatArray,
    start_angles: FloatArray,
) -> tuple[bool, Vector]:
    """Draw one candidate for a target, and starts for it until one is valid.

    Args:
        seed: the trial's seed.
        trial: its number.
        attempt: number of the candidate.
        gaze: the head that looks.
        workspace: the workspace.
        board: shape of the target.
        viewpoint: the point between the eyes, in N, m.
        target_angles: (4,) result: the eyes' angles that fixate the target, rad.
        start_angles: (4,) result: their angles at the start, rad.

    Returns:
        True if target and start are valid, and the target's position in N, m.
    """
    words = random_words(seed, trial, _TASK, attempt, 1)
    point = random_point(
        words, viewpoint, workspace.min_z_m, workspace.max_z_m, workspace.max_angle_rad
    )
    if not can_fixate(gaze, workspace.margin_rad, point, target_angles):
        return False, point
    # many starts for one target: if both were drawn anew, few peripheral targets would be left, as
    # they are visible from few points of the workspace
    for again in range(_START_ATTEMPTS if workspace.starts_fixating else 1):
        words = random_words(seed, trial, _TASK, attempt + again, 2)
        other = random_point(
            words, viewpoint, workspace.min_z_m, workspace.max_z_m, workspace.max_angle_rad
        )
        if not workspace.starts_fixating:
            start_angles[:] = gaze.rest[3:]
        elif not can_fixate(gaze, workspace.margin_rad, other, start_angles):
            continue
        if larger_eye_turn(
            start_angles, target_angles
        ) >= workspace.min_eye_turn_rad and is_detectable_by_both_eyes(
            gaze.head, start_angles, point, workspace.border_px, board
        ):
            return True, point
    return False, point


@compiled
def draw_targets(
    keys: StreamKeys,
    gaze: HeadWithLimits,
    workspace: RandomTargetRanges,
    board: Board,
    points: FloatArray,
    start_angles: FloatArray,
) -> bool:
    """Draw candidates for each trial until one is valid.

    Args:
        keys: `untyped_tuple`, keys of the n trials' random streams.
        gaze: `untyped_tuple`, the head that looks.
        workspace: `untyped_tuple`, the workspace.
        board: `untyped_tuple`, shape of the target.
        points: (n, 3) result: positions of the targets, in N, m.
        start_angles: (n, 7) result: joint angles at the start, rad.

    Returns:
        False if some trial has no valid candidate.
    """
    keys, gaze, space, board = (
        StreamKeys(*keys),
        HeadWithLimits(*gaze),
        RandomTargetRanges(*workspace),
        Board(*board),
    )
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    goal, begin = np.empty(4), np.empty(4)
    for n in range(len(points)):
        seed, trial = keys.seeds[n], keys.trials[n]
        start_angles[n] = gaze.rest
        for attempt in range(MAX_CANDIDATES):
            found, point = draw_target_and_start(
                seed, trial, attempt, gaze, space, board, eye, goal, begin
            )
            if found:
                break
        else:
            return False
        points[n, 0], points[n, 1], points[n, 2] = point
        start_angles[n, 3:] = begin
    return True
