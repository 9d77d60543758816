"""Robust fit of a head to frames of a board: outlier corners, views and readings are left out."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import HeadAdjustment, HeadUnknowns, MeasurementWeights
from vergence.calibration.head.solution import FIRST_CAUCHY_SCALE, HeadSolution, solve
from vergence.calibration.head.start import LEAST_CORNERS
from vergence.models.parts import NECK, FloatArray

_INLIER_GATE: Final = 5.0
"""Gate on a corner's residual or a reading's error, in standard deviations (chosen)."""
_LEAST_INLIER_FRACTION: Final = 0.5
"""Fraction of a view's corners that have to be inliers for the view to be kept (chosen)."""
_MOST_ROUNDS: Final = 6
"""Largest number of rounds of selecting corners and fitting (numerical)."""
_LEAST_SCATTER_RATIO: Final = 1.3
"""Ratio of the readings' scatter to its expectation by quantisation and backlash above which their
standard deviation is enlarged (chosen)."""
_SCATTER_TOLERANCE: Final = 0.05
"""Relative change of a scatter that needs no further fit (numerical)."""


@dataclass(frozen=True, eq=False)
class HeadFit:
    """A head, and its inlier corners."""

    solution: HeadSolution
    kept_corners: NDArray[np.bool_]
    """(2, f, n) True for kept corners, the inliers."""


def fit_robustly(
    problem: HeadAdjustment,
    initial_boards: BoardPoses,
    inlier_views: NDArray[np.bool_],
    start: HeadUnknowns | None = None,
) -> HeadFit:
    """Fit a head robustly, first to the (2, f) inlier views that agree on (b) boards in frame 0."""
    eligible = problem.frames.seen & (problem.frames.seen.sum(axis=-1) >= LEAST_CORNERS)[..., None]
    begin = problem.start(initial_boards)
    if start is not None:
        begin = begin._replace(
            head_parameters=start.head_parameters, board_curvatures=start.board_curvatures
        )
    first = MeasurementWeights.of(eligible & inlier_views[..., None])
    solution = solve(problem, begin, first, cauchy_scale=FIRST_CAUCHY_SCALE)
    if not inlier_views[eligible.any(axis=-1)].all():  # views that disagreed by the nominal head
        cauchy_scale = solution.weights.cauchy_scale
        solution = solve(
            problem, solution.state, MeasurementWeights.of(eligible), cauchy_scale=cauchy_scale
        )
    return refit_inliers_and_scatter(solution)


def refit_inliers_and_scatter(solution: HeadSolution) -> HeadFit:
    """Refine a solution on its inliers, with readings weighted by their scatter."""
    problem = solution.problem
    eligible = problem.frames.seen & (problem.frames.seen.sum(axis=-1) >= LEAST_CORNERS)[..., None]
    kept, scatter_ratio = np.zeros_like(eligible), np.ones(7)
    for _ in range(_MOST_ROUNDS):
        previous = kept, scatter_ratio
        scatter_ratio = reading_scatter_ratio(solution)
        kept = _inliers(solution, eligible, scatter_ratio)
        if not kept.any():
            raise np.linalg.LinAlgError("expected views that agree with each other, got none")
        if np.array_equal(kept, previous[0]) and np.allclose(
            scatter_ratio, previous[1], rtol=_SCATTER_TOLERANCE
        ):
            break
        problem = replace(problem, scatter_ratio=scatter_ratio)
        solution = solve(problem, solution.state, MeasurementWeights.of(kept))
    return HeadFit(solution, kept)


def _inliers(
    solution: HeadSolution, eligible: NDArray[np.bool_], scatter_ratio: FloatArray
) -> NDArray[np.bool_]:
    """(2, f, n) True for inlier corners of views with mostly inliers and plausible readings."""
    typical_square = _typical_square(solution, eligible)
    fit = eligible & (
        np.nan_to_num(solution.squares, nan=np.inf) < _INLIER_GATE**2 * typical_square
    )
    already = solution.problem.scatter_ratio
    known = np.ones(7) if already is None else already
    errors = np.abs(solution.normalised_reading_errors) * known / scatter_ratio
    wrong = errors > _INLIER_GATE * np.sqrt(typical_square)
    moved = np.abs(solution.problem.joints_from_actuators) > 0.0
    for eye in range(2):
        joints = moved[[3 + 2 * eye, 4 + 2 * eye]].any(axis=0)
        fit[eye] &= ~np.asarray((wrong & joints).any(axis=1))[:, None]
    keep_view = fit.sum(axis=-1) >= np.maximum(
        _LEAST_INLIER_FRACTION * eligible.sum(axis=-1), LEAST_CORNERS
    )
    # a wrong neck reading drops both views, unless one of them is wrong already and may explain it
    keep_view &= ~(keep_view.all(axis=0) & np.asarray(wrong[:, NECK].any(axis=1)))
    return np.asarray(fit & np.asarray(keep_view)[..., None])


def _typical_square(solution: HeadSolution, eligible: NDArray[np.bool_]) -> float:
    """Mean square of a corner, sigma^2, at least 1; the robust fit's if below the views' median."""
    counted = eligible & (solution.weights.corners > 0.0)
    return min(max(float(np.median(solution.squares[counted])), 1.0), solution.weights.cauchy_scale)


def reading_scatter_ratio(solution: HeadSolution) -> FloatArray:
    """(7,) scatter of readings over that of quantisation and backlash, at least 1."""
    own, already = solution.problem.reading_error_unknowns, solution.problem.scatter_ratio
    known = np.ones(7) if already is None else already
    found = np.ones(7)
    counted = np.asarray((solution.weights.corners > 0.0).any(axis=(0, 2)))
    typical_square = _typical_square(solution, solution.problem.frames.seen)
    for joint in range(7):
        used = own.has_frame_error[:, joint] & counted
        squares = solution.normalised_reading_errors[used, joint] ** 2
        if len(squares) < _LEAST_READINGS:
            continue
        # for a normal or a uniform distribution, without a few wrong readings
        trimmed_square = np.mean(
            squares[squares <= _INLIER_GATE**2 * max(float(np.median(squares)), 1e-12)]
        )
        expected = max(float(np.mean(1.0 - solution.reading_variance_ratio[used, joint])), 0.1)
        ratio = float(np.sqrt(trimmed_square / expected)) * known[joint]
        # noise of the corners enlarges the estimated reading errors as well
        found[joint] = ratio if ratio > _LEAST_SCATTER_RATIO * np.sqrt(typical_square) else 1.0
    return found


_LEAST_READINGS: Final = 20
"""Fewest readings of an actuator from which a scatter is estimated (chosen)."""
