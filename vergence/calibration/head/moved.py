"""A board that was moved meanwhile: another place of it.

If it was moved far, its views are left out of the fit, and agree with each other on another place.
If it was moved by a little, the fit bends the head to suit both places; then a step of the board's
pose at one moment would make the sum of squares smaller by far more than chance does.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import Poses
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.head.start import LEAST_CORNERS, started

_LEAST_POSES: Final = 3
"""In which the board has to stand elsewhere: fewer are wrong detections."""
_IN_A_ROW: Final = 0.5
"""Share of the frames from the first to the last of a place that show it there: a moved board stays
where it is, and wrong detections that happen to agree lie here and there."""
_TOGETHER: Final = 0.05
"""Of the board's size: views of one place agree on its corners by less, through a head that is
calibrated but for what the first place alone did not tell."""


_SURELY: Final = 80.0
"""Decrease of the sum of squares by a step of the board's pose, six numbers, from which on it was
moved: chance brings 40 once in a million moments, play and what else is wrong of a head some more.
"""


class AnotherPlace(NamedTuple):
    """The frames with one place of the board more."""

    frames: HeadFrames
    boards: Poses
    """(b + 1) in frame 0."""
    agree: NDArray[np.bool_]
    """(2, f) the views that go with their place."""
    remark: str


def another_place(solution: HeadSolution, kept: NDArray[np.bool_]) -> AnotherPlace | None:
    """Find a place of the board on which views agree that were left out.

    Args:
        solution: of the views that were kept.
        kept: (2, f, n) their corners.
    """
    frames = solution.problem.frames
    views = np.asarray(kept.any(axis=-1))
    enough = frames.seen.sum(axis=-1) >= LEAST_CORNERS
    lost = enough.any(axis=0) & ~views.any(axis=0)
    if len(np.unique(frames.pose[lost])) < _LEAST_POSES:
        return None
    some = frames.of(lost)
    start = started(solution.head, replace(some, placement=np.zeros(lost.sum(), dtype=np.intp)))
    size = float(np.ptp(frames.corners, axis=0).max())
    agreeing = np.flatnonzero(lost)[start.agree.any(axis=0)]
    if start.spread_m > _TOGETHER * size or len(np.unique(frames.pose[agreeing])) < _LEAST_POSES:
        return None
    if len(agreeing) < _IN_A_ROW * (agreeing[-1] - agreeing[0] + 1):
        return None
    placement = frames.placement.copy()
    number = int(placement.max()) + 1
    placement[agreeing] = number
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    pixels[:, lost], sigma[:, lost] = start.frames.pixels, start.frames.sigma
    agree = views.copy()
    agree[:, lost] = start.agree
    boards = solution.state.boards
    first, last = frames.time_s[agreeing[0]], frames.time_s[agreeing[-1]]
    return AnotherPlace(
        replace(frames, placement=placement, pixels=pixels, sigma=sigma),
        Poses(
            np.concatenate([boards.rotation, start.boards.rotation]),
            np.concatenate([boards.translation, start.boards.translation]),
        ),
        agree,
        f"the board stands elsewhere in {len(agreeing)} frames, from {first:.1f} to {last:.1f} s: "
        "counted as another place of it",
    )


def step_between(solution: HeadSolution) -> AnotherPlace | None:
    """Find the moment at which the board was moved, if one step of it explains much.

    Args:
        solution: of all that goes together.

    Returns:
        The frames with another place from that moment on, whose board and views have to be found
        anew.
    """
    problem = solution.problem
    frames = problem.frames
    normal = problem.linearised(solution.state, solution.weights, by_frame=True)
    assert normal.by_frame is not None
    blocks, slopes = normal.by_frame
    size, six = problem.size, np.arange(6)
    inverse = np.linalg.inv(normal.matrix)
    best, when = 0.0, 0
    board = problem.common
    across, own, pull = np.zeros((size + 1, 6)), np.zeros((6, 6)), np.zeros(6)
    for frame in range(len(frames.time_s) - 1, 0, -1):
        columns = problem.columns[frame]
        np.add.at(across, columns, blocks[frame][:, board + six])
        own += blocks[frame][np.ix_(board + six, board + six)]
        pull += slopes[frame][board + six]
        if frames.placement[frame - 1] != frames.placement[frame]:
            across[:], own[:], pull[:] = 0.0, 0.0, 0.0
        elif frames.pose[frame - 1] != frames.pose[frame]:
            left = own - across[:-1].T @ inverse @ across[:-1]
            pulled = pull - across[:-1].T @ inverse @ normal.slope
            gain = float(pulled @ np.linalg.lstsq(left, pulled, rcond=_RANK)[0])
            if gain > best:
                best, when = gain, frame
    if best < _SURELY * max(solution.noise, 1.0) ** 2:
        return None
    placement = frames.placement.copy()
    later = (placement == placement[when]) & (np.arange(len(placement)) >= when)
    placement[later] = placement.max() + 1
    split = replace(frames, placement=placement)
    start = started(problem.about, split)
    return AnotherPlace(
        start.frames,
        start.boards,
        start.agree,
        f"the board seems to have been moved before {frames.time_s[when]:.1f} s: counted as "
        "another place of it",
    )


_RANK: Final = 1e-9
"""Relative: steps of the board that a few frames do not tell."""
