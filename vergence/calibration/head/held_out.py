"""Cross-validation of a head: views judged by heads that were calibrated without their poses."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.adjust import MeasurementWeights
from vergence.calibration.head.solution import HeadSolution, solve
from vergence.models.parts import FloatArray

FOLDS: Final = 5
"""Folds of the cross-validation (chosen: more take longer)."""
_FOLD_TOLERANCE: Final = 1.0
"""Change of the cost below which a fold's fit ends (numerical)."""


class CrossValidationErrors(NamedTuple):
    """Mean squares of residuals by view and by pose, of heads fitted without these poses."""

    view_mean_squares: FloatArray
    """(2, f) mean square of the corners in units of sigma^2; nan for views without kept corners."""
    pose_mean_squares: FloatArray
    """(poses) mean square of the corners plus mean square of the reading errors, in units of
    sigma^2; nan for poses without kept corners. One reading weighs as much as many corners, as its
    error is estimated from them."""


def cross_validate_by_pose(
    solution: HeadSolution, kept_corners: NDArray[np.bool_], scatter_ratio: FloatArray | None = None
) -> CrossValidationErrors:
    """Judge views and readings by heads calibrated without their poses; (2, f, n) kept corners."""
    problem, pose = solution.problem, solution.problem.frames.pose
    views = np.full(kept_corners.shape[:2], np.nan)
    poses = np.full(int(pose.max()) + 1, np.nan)
    fold = pose * FOLDS // len(poses)
    for each in range(FOLDS):
        out = fold == each
        if not kept_corners[:, out].any() or not kept_corners[:, ~out].any():
            continue
        trained = problem.select(~out)
        start = trained.start(solution.state.boards)._replace(
            head_parameters=solution.state.head_parameters,
            board_curvatures=solution.state.board_curvatures,
            term_parameters=solution.state.term_parameters,
        )
        found = solve(
            trained, start, MeasurementWeights.of(kept_corners[:, ~out]), tolerance=_FOLD_TOLERANCE
        )
        # fit only the board and the reading errors of these frames again
        judged = replace(
            problem.select(out),
            nominal_head=found.head,
            prior_sigma=np.zeros(len(problem.prior_sigma)),
            terms=problem.terms.select(out).fixed_at(found.state.term_parameters),
            scatter_ratio=problem.scatter_ratio if scatter_ratio is None else scatter_ratio,
        )
        known = judged.start(solution.state.boards)._replace(
            board_curvatures=solution.state.board_curvatures
        )
        best = solve(
            judged, known, MeasurementWeights.of(kept_corners[:, out]), tolerance=_FOLD_TOLERANCE
        )
        counted = kept_corners[:, out]
        total = np.where(counted, best.squares, 0.0).sum(axis=-1)
        count = counted.sum(axis=-1)
        views[:, out] = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
        own = judged.reading_error_unknowns.has_frame_error & np.asarray(count.any(axis=0))[:, None]
        for number in np.unique(pose[out]):
            here = pose[out] == number
            corners = total[:, here].sum() / max(count[:, here].sum(), 1)
            squares = (best.normalised_reading_errors[here] ** 2)[own[here]]
            read = squares.sum() / max(own[here].sum(), 1)
            poses[number] = corners + read if count[:, here].any() else np.nan
    return CrossValidationErrors(views, poses)
