"""Levenberg-Marquardt solver of a head's bundle adjustment."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from vergence.calibration.head.adjust import (
    HeadAdjustment,
    HeadUnknowns,
    MeasurementWeights,
    ReducedNormalEquations,
)
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_MOST_STEPS: Final = 60
"""Largest number of Levenberg-Marquardt steps (numerical)."""
_COST_TOLERANCE: Final = 1e-3
"""Change of the cost below which the adjustment ends; an error of one standard deviation in one
parameter changes the cost by 1 (numerical)."""
_COST_ROUNDING: Final = 1e-9
"""Relative change of the cost that counts as rounding (numerical)."""
_ROBUST_TOLERANCE: Final = 1e-3
"""Relative change of the cost below which a robust fit ends, as a fit to the inliers follows
(numerical)."""
FIRST_CAUCHY_SCALE: Final = 1e4
"""Typical mean square of a corner's residuals with the nominal head, in units of sigma^2 (chosen:
it corresponds to errors of degrees)."""
_SCALE_UPDATE_RATIO: Final = 0.7
"""Ratio to its old value below which the typical mean square replaces it (chosen)."""
_MOST_DAMPING: Final = 1e9
"""Damping above which the adjustment ends (numerical)."""


@dataclass(frozen=True, eq=False)
class HeadSolution:
    """Unknowns with the least cost, the normal equations there, and the weights used."""

    problem: HeadAdjustment
    state: HeadUnknowns
    normal: ReducedNormalEquations
    weights: MeasurementWeights

    @cached_property
    def head(self) -> HeadModel:
        """The fitted head."""
        return self.problem.nominal_head.with_parameters(self.state.head_parameters)

    @cached_property
    def squares(self) -> FloatArray:
        """(2, f, n) mean square of each corner's residuals, in sigma^2; nan if not found."""
        seen = self.problem.frames.seen
        return np.where(seen, 0.5 * (self.normal.residuals**2).sum(axis=-1), np.nan)

    @cached_property
    def normalised_reading_errors(self) -> FloatArray:
        """(f, 7) reading errors of single frames over their prior sigma; 0 for shared ones."""
        own = self.problem.reading_error_unknowns
        sigma = np.where(own.reading_sigma > 0.0, own.reading_sigma, 1.0)
        return np.where(own.has_frame_error, self.state.frame_errors / sigma, 0.0)

    @cached_property
    def reduced_chi(self) -> float:
        """Ratio of the residuals to sigma, root of the reduced chi-square: 1 if sigma is right."""
        counted: NDArray[np.bool_] = self.problem.frames.seen & (self.weights.corners > 0.0)
        own = (
            self.problem.reading_error_unknowns.has_frame_error
            & np.asarray(counted.any(axis=(0, 2)))[:, None]
        )
        # effective number of parameters: a reading error counts by its reduction of variance
        taken = float((own * (1.0 - self.reading_variance_ratio)).sum()) + self.problem.shared_count
        measured = 2.0 * float(counted.sum())
        return float(np.sqrt(2.0 * self.squares[counted].sum() / max(measured - taken, 1.0)))

    @cached_property
    def reading_variance_ratio(self) -> FloatArray:
        """(f, 7) ratio of posterior to prior variance of the reading errors, shared ones fixed."""
        sigma = self.problem.reading_error_unknowns.reading_sigma
        inner = np.diagonal(np.linalg.inv(self.normal.frame_normal_matrices), axis1=1, axis2=2)
        return np.asarray(inner / np.where(sigma > 0.0, sigma, 1.0) ** 2)


def solve(
    problem: HeadAdjustment,
    start: HeadUnknowns,
    weights: MeasurementWeights,
    *,
    cauchy_scale: float = np.inf,
    tolerance: float = _COST_TOLERANCE,
) -> HeadSolution:
    """Least squares by Levenberg and Marquardt; `cauchy_scale`, sigma^2, damps misfits."""
    robust = np.isfinite(cauchy_scale)
    weights = weights._replace(cauchy_scale=cauchy_scale)
    state, now = start, problem.linearised(start, weights)
    if not np.isfinite(now.cost):
        raise np.linalg.LinAlgError("expected a start before the cameras")
    damping = 0.0
    for _ in range(_MOST_STEPS):
        larger = now.matrix.copy()
        # damping in units of the prior: it does not hold back steps along directions that the
        # frames hardly determine because they determine others well
        larger[np.diag_indices(problem.shared_count)] += damping * problem.prior_information
        step = -cho_solve(cho_factor(larger), now.gradient)
        moved = problem.moved(state, now, step)
        try:
            then = problem.linearised(moved, weights)
        except np.linalg.LinAlgError:  # a step behind a camera
            then = now._replace(cost=np.inf)
        change = now.cost - then.cost
        if change >= 0.0:
            state, now = moved, then
            damping *= 0.1
            cauchy_scale = _typical_square(problem, now, weights)
            if robust and cauchy_scale < _SCALE_UPDATE_RATIO * weights.cauchy_scale:
                weights = weights._replace(cauchy_scale=cauchy_scale)
                now = problem.linearised(state, weights)
            elif change < max(
                tolerance, (_ROBUST_TOLERANCE if robust else _COST_ROUNDING) * now.cost
            ):
                break
        else:
            damping = max(10.0 * damping, 1.0)
            if damping > _MOST_DAMPING:
                break
    return HeadSolution(problem, state, now, weights)


def _typical_square(
    problem: HeadAdjustment, now: ReducedNormalEquations, weights: MeasurementWeights
) -> float:
    """Typical (median) mean square of a corner's residuals, in units of sigma^2; at least 1."""
    counted = problem.frames.seen & (weights.corners > 0.0)
    return max(0.5 * float(np.median((now.residuals[counted] ** 2).sum(axis=-1))), 1.0)
