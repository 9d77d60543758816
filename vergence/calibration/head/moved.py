"""Detection of a board that was moved during a recording: another placement of it.

After a large motion, views are left out of the fit, but agree with each other on another placement.
After a small motion, the fit distorts the head to suit both placements; then a step of the board's
pose at one moment reduces the sum of squares by far more than chance does.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.head.start import LEAST_CORNERS, estimate_consensus_board_poses

_LEAST_POSES: Final = 3
"""Fewest poses with the board at another placement (chosen: fewer are wrong detections)."""
_LEAST_CONTIGUOUS_FRACTION: Final = 0.5
"""Least fraction of the frames between the first and the last of a placement that show the board
there (chosen: a moved board stays, while wrong detections that happen to agree are scattered)."""
_MOST_SPREAD_SIZES: Final = 0.05
"""Largest spread of the corners among views of one placement, in board sizes (chosen: the head is
calibrated then, except for parameters that the first placement alone did not determine)."""


_MOVED_COST_DECREASE: Final = 80.0
"""Decrease of the sum of squares by a step of the board's pose (six parameters) from which on the
board was moved (chosen: 40 occur by chance once in a million moments, and backlash and other model
errors add to it)."""


class FramesWithNewPlacement(NamedTuple):
    """The frames with one more placement of the board."""

    frames: HeadFrames
    boards: BoardPoses
    """(b + 1) poses of the board in frame 0."""
    inlier_views: NDArray[np.bool_]
    """(2, f) True for views that agree with their placement."""
    remark: str


def find_new_placement(
    solution: HeadSolution, kept_corners: NDArray[np.bool_]
) -> FramesWithNewPlacement | None:
    """All frames with the board's placements on which left-out views agree; None if on no other."""
    frames = solution.problem.frames
    views = np.asarray(kept_corners.any(axis=-1))
    enough = frames.seen.sum(axis=-1) >= LEAST_CORNERS
    lost = enough.any(axis=0) & ~views.any(axis=0)
    if len(np.unique(frames.pose[lost])) < _LEAST_POSES:
        return None
    some = frames.select(lost)
    start = estimate_consensus_board_poses(
        solution.head, replace(some, placement=np.zeros(lost.sum(), dtype=np.intp))
    )
    size = float(np.ptp(frames.corners, axis=0).max())
    agreeing = np.flatnonzero(lost)[start.inlier_views.any(axis=0)]
    if (
        start.spread_m > _MOST_SPREAD_SIZES * size
        or len(np.unique(frames.pose[agreeing])) < _LEAST_POSES
    ):
        return None
    if len(agreeing) < _LEAST_CONTIGUOUS_FRACTION * (agreeing[-1] - agreeing[0] + 1):
        return None
    placement = frames.placement.copy()
    number = int(placement.max()) + 1
    placement[agreeing] = number
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    pixels[:, lost], sigma[:, lost] = start.frames.pixels, start.frames.sigma
    inlier_views = views.copy()
    inlier_views[:, lost] = start.inlier_views
    boards = solution.state.boards
    first, last = frames.time_s[agreeing[0]], frames.time_s[agreeing[-1]]
    return FramesWithNewPlacement(
        replace(frames, placement=placement, pixels=pixels, sigma=sigma),
        BoardPoses(
            np.concatenate([boards.rotation, start.boards.rotation]),
            np.concatenate([boards.translation, start.boards.translation]),
        ),
        inlier_views,
        f"the board stands elsewhere in {len(agreeing)} frames, from {first:.1f} to {last:.1f} s: "
        "counted as a new placement",
    )


def find_small_board_motion(solution: HeadSolution) -> FramesWithNewPlacement | None:
    """Frames with a new placement from the moment a small motion explains much; else None."""
    problem = solution.problem
    frames = problem.frames
    normal = problem.linearised(solution.state, solution.weights, keep_frame_parts=True)
    assert normal.frame_contributions is not None
    blocks, slopes = normal.frame_contributions
    size, six = problem.shared_count, np.arange(6)
    inverse = np.linalg.inv(normal.matrix)
    best, when = 0.0, 0
    board = problem.common_count
    across, own, pull = np.zeros((size + 1, 6)), np.zeros((6, 6)), np.zeros(6)
    for frame in range(len(frames.time_s) - 1, 0, -1):
        columns = problem.frame_columns[frame]
        np.add.at(across, columns, blocks[frame][:, board + six])
        own += blocks[frame][np.ix_(board + six, board + six)]
        pull += slopes[frame][board + six]
        if frames.placement[frame - 1] != frames.placement[frame]:
            across[:], own[:], pull[:] = 0.0, 0.0, 0.0
        elif frames.pose[frame - 1] != frames.pose[frame]:
            left = own - across[:-1].T @ inverse @ across[:-1]
            pulled = pull - across[:-1].T @ inverse @ normal.gradient
            gain = float(pulled @ np.linalg.lstsq(left, pulled, rcond=_RANK_TOLERANCE)[0])
            if gain > best:
                best, when = gain, frame
    if best < _MOVED_COST_DECREASE * max(solution.reduced_chi, 1.0) ** 2:
        return None
    placement = frames.placement.copy()
    later = (placement == placement[when]) & (np.arange(len(placement)) >= when)
    placement[later] = placement.max() + 1
    split = replace(frames, placement=placement)
    start = estimate_consensus_board_poses(problem.nominal_head, split)
    return FramesWithNewPlacement(
        start.frames,
        start.boards,
        start.inlier_views,
        f"the board seems to have been moved before {frames.time_s[when]:.1f} s: counted as "
        "a new placement",
    )


_RANK_TOLERANCE: Final = 1e-9
"""Relative cutoff of singular values: a few frames may not determine a step fully (numerical)."""
