"""A target that appears anywhere in a workspace and jumps again while the eyes still turn to it."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from vergence.envs.streams import IntArray, RandomStreams, StreamKeys, StreamPurpose, random_words
from vergence.envs.targets.board import POINT, Board, is_detectable_by_both_eyes
from vergence.envs.targets.moments import draw_event_times
from vergence.envs.targets.motion import motion_rows
from vergence.envs.targets.placement import (
    MAX_CANDIDATES,
    HeadWithLimits,
    can_fixate,
    midpoint_between_eyes,
    random_point,
)
from vergence.envs.targets.workspace import (
    RandomTarget,
    RandomTargetRanges,
    draw_target_and_start,
    larger_eye_turn,
)
from vergence.kernels import compiled, untyped_tuple
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_TASK: Final = int(StreamPurpose.TASK)
_SECOND_ATTEMPTS: Final = 100
"""Candidates for the second point per first point (numerical)."""


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
        n = len(ids)
        first, second, q = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 7))
        keys = StreamKeys(streams.seeds[ids], streams.trials[ids])
        gaze, space = HeadWithLimits.of(head), self._workspace()
        found = draw_double_steps(
            untyped_tuple(keys),
            untyped_tuple(gaze),
            untyped_tuple(space),
            untyped_tuple(board),
            first,
            second,
            q,
        )
        if not found:
            raise self._unseen("pairs of points", board)
        after = draw_event_times(streams, ids, *self.second_after)
        return motion_rows(first, second_jump_time=after, second_anchor=second), q


@compiled
def draw_double_steps(
    keys: StreamKeys,
    gaze: HeadWithLimits,
    workspace: RandomTargetRanges,
    board: Board,
    first_points: FloatArray,
    second_points: FloatArray,
    start_angles: FloatArray,
) -> bool:
    """Draw pairs of points for each trial until one is valid.

    Args:
        keys: `untyped_tuple`, keys of the n trials' random streams.
        gaze: `untyped_tuple`, the head that looks.
        workspace: `untyped_tuple`, the workspace.
        board: `untyped_tuple`, shape of the target.
        first_points: (n, 3) result: first position of the target, in N, m.
        second_points: (n, 3) result: position after the second jump, in N, m.
        start_angles: (n, 7) result: joint angles at the start, rad.

    Returns:
        False if some trial has no valid candidate.
    """
    keys, gaze, workspace, board = (
        StreamKeys(*keys),
        HeadWithLimits(*gaze),
        RandomTargetRanges(*workspace),
        Board(*board),
    )
    eye = midpoint_between_eyes(gaze.head, gaze.rest)
    begin, goal, last = np.empty(4), np.empty(4), np.empty(4)
    for n in range(len(first_points)):
        seed, trial = keys.seeds[n], keys.trials[n]
        start_angles[n] = gaze.rest
        found = False
        for attempt in range(MAX_CANDIDATES):
            fit, point = draw_target_and_start(
                seed, trial, attempt, gaze, workspace, board, eye, goal, begin
            )
            if not fit:
                continue
            first_points[n, 0], first_points[n, 1], first_points[n, 2] = point
            for again in range(_SECOND_ATTEMPTS):
                words = random_words(seed, trial, _TASK, attempt * _SECOND_ATTEMPTS + again, 3)
                point = random_point(
                    words, eye, workspace.min_z_m, workspace.max_z_m, workspace.max_angle_rad
                )
                found = (
                    can_fixate(gaze, workspace.margin_rad, point, last)
                    and larger_eye_turn(goal, last) >= workspace.min_eye_turn_rad
                    and is_detectable_by_both_eyes(
                        gaze.head, begin, point, workspace.border_px, board
                    )
                    and is_detectable_by_both_eyes(
                        gaze.head, goal, point, workspace.border_px, board
                    )
                )
                if found:
                    break
            if found:
                second_points[n, 0], second_points[n, 1], second_points[n, 2] = point
                start_angles[n, 3:] = begin
                break
        if not found:
            return False
    return True
