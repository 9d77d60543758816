"""The best head from frames of a board, and the corners and readings that go with it."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import Poses
from vergence.calibration.head.adjust import HeadAdjustment, State, Weights
from vergence.calibration.head.solution import FIRST_USUAL, HeadSolution, solved
from vergence.calibration.head.start import LEAST_CORNERS
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray

_OUTLYING: Final = 5.0
"""Deviations beyond which a corner, or an angle that was read, is wrong."""
_HALF: Final = 0.5
"""Share of a view's corners that have to be right for any of them to count."""
_FITS: Final = 6
_NOISIER: Final = 1.3
"""Times their deviation by steps and play that readings must scatter before it counts."""
_SAME_SCATTER: Final = 0.05
"""Relative change of a scatter that changes nothing."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A head, and the corners that go with it."""

    solution: HeadSolution
    kept: NDArray[np.bool_]
    """(2, f, n)"""


def fitted(
    problem: HeadAdjustment, boards: Poses, agree: NDArray[np.bool_], near: State | None = None
) -> Fit:
    """The best head, and the corners that go with it."""
    enough = problem.frames.seen & (problem.frames.seen.sum(axis=-1) >= LEAST_CORNERS)[..., None]
    begin = problem.start(boards)
    if near is not None:
        begin = begin._replace(values=near.values, bend=near.bend)
    first = Weights.of(enough & agree[..., None])
    solution = solved(problem, begin, first, usual=FIRST_USUAL)
    if not agree[enough.any(axis=-1)].all():  # those that lay elsewhere through the head's file
        usual = solution.weights.usual
        solution = solved(problem, solution.state, Weights.of(enough), usual=usual)
    return settled(solution)


def settled(solution: HeadSolution) -> Fit:
    """The head of the corners and readings that go together, each weighed by how it scatters.

    Args:
        solution: near by, of corners most of which are right.

    Raises:
        LinAlgError: no views go together.
    """
    problem = solution.problem
    enough = problem.frames.seen & (problem.frames.seen.sum(axis=-1) >= LEAST_CORNERS)[..., None]
    kept, noisier = np.zeros_like(enough), np.ones(7)
    for _ in range(_FITS):
        before = kept, noisier
        noisier = scatter_of(solution)
        kept = _going_together(solution, enough, noisier)
        if np.array_equal(kept, before[0]) and np.allclose(noisier, before[1], rtol=_SAME_SCATTER):
            break
        if not kept.any():
            raise np.linalg.LinAlgError("expected views that go together, got none")
        problem = replace(problem, noisier=noisier)
        solution = solved(problem, solution.state, Weights.of(kept))
    return Fit(solution, kept)


def _going_together(
    solution: HeadSolution, enough: NDArray[np.bool_], noisier: FloatArray
) -> NDArray[np.bool_]:
    """(2, f, n) the corners that fit, of views most of whose corners and whose angles do."""
    usual = _usual(solution, enough)
    fit = enough & (np.nan_to_num(solution.squares, nan=np.inf) < _OUTLYING**2 * usual)
    already = solution.problem.noisier
    known = np.ones(7) if already is None else already
    wrong = np.abs(solution.misread) * known / noisier > _OUTLYING * np.sqrt(usual)
    moved = np.abs(solution.problem.to_joints) > 0.0
    for eye in range(2):
        joints = moved[[3 + 2 * eye, 4 + 2 * eye]].any(axis=0)
        fit[eye] &= ~np.asarray((wrong & joints).any(axis=1))[:, None]
    most = fit.sum(axis=-1) >= np.maximum(_HALF * enough.sum(axis=-1), LEAST_CORNERS)
    # a wrong view of one eye pulls at the neck, too
    most &= ~(most.all(axis=0) & np.asarray(wrong[:, NECK].any(axis=1)))
    return np.asarray(fit & np.asarray(most)[..., None])


def _usual(solution: HeadSolution, enough: NDArray[np.bool_]) -> float:
    """Mean square of the residuals of a usual corner, in units of sigma; 1 at least.

    With most of the views wrong, a robust fit knows better than their median.
    """
    counted = enough & (solution.weights.corners > 0.0)
    return min(max(float(np.median(solution.squares[counted])), 1.0), solution.weights.usual)


def scatter_of(solution: HeadSolution) -> FloatArray:
    """(7,) how many times what steps and play say the readings of each actuator scatter; >= 1."""
    own, already = solution.problem.joints, solution.problem.noisier
    known = np.ones(7) if already is None else already
    found = np.ones(7)
    counted = np.asarray((solution.weights.corners > 0.0).any(axis=(0, 2)))
    usual_corner = _usual(solution, solution.problem.frames.seen)
    for joint in range(7):
        used = own.own[:, joint] & counted
        squares = solution.misread[used, joint] ** 2
        if len(squares) < _LEAST_READINGS:
            continue
        # of a normal or an even distribution, a few wrong readings left out
        usual = np.mean(squares[squares <= _OUTLYING**2 * max(float(np.median(squares)), 1e-12)])
        expected = max(float(np.mean(1.0 - solution.angle_left[used, joint])), 0.1)
        times = float(np.sqrt(usual / expected)) * known[joint]
        # noise of the corners makes readings look wrong as well
        found[joint] = times if times > _NOISIER * np.sqrt(usual_corner) else 1.0
    return found


_LEAST_READINGS: Final = 20
"""Of an actuator, to tell how they scatter."""
