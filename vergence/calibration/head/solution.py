"""The head that fits best: the least sum of squares, by Levenberg and Marquardt."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from vergence.calibration.head.adjust import HeadAdjustment, Normal, State, Weights
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_MOST_STEPS: Final = 60
_SAME_COST: Final = 1e-3
"""Change of the cost below which the adjustment ends: a number that is a standard deviation beside
the best one changes it by 1."""
_ROUNDING: Final = 1e-9
"""Relative change of the cost that is rounding."""
_ROUGH: Final = 1e-3
"""Relative change of the cost of a robust fit that is no news: a fit of what is right follows."""
FIRST_USUAL: Final = 1e4
"""Mean square of a usual corner's residuals over sigma through the head's file: degrees of error.
"""
_LESS: Final = 0.7
"""Share by which it has to fall to be used."""
_MOST_DAMPING: Final = 1e9


@dataclass(frozen=True, eq=False)
class HeadSolution:
    """The head that fits best, and how surely."""

    problem: HeadAdjustment
    state: State
    normal: Normal
    weights: Weights

    @cached_property
    def head(self) -> HeadModel:
        """The head that was found."""
        return self.problem.about.with_parameters(self.state.values)

    @cached_property
    def squares(self) -> FloatArray:
        """(2, f, n) mean square of each corner's residuals over sigma; nan if it was not found."""
        seen = self.problem.frames.seen
        return np.where(seen, 0.5 * (self.normal.residuals**2).sum(axis=-1), np.nan)

    @cached_property
    def misread(self) -> FloatArray:
        """(f, 7) errors of the angles over their deviation; 0 where frames share one."""
        own = self.problem.joints
        sigma = np.where(own.sigma > 0.0, own.sigma, 1.0)
        return np.where(own.own, self.state.errors / sigma, 0.0)

    @cached_property
    def noise(self) -> float:
        """How many times sigma the residuals are: 1 where the detector's sigma is right."""
        counted: NDArray[np.bool_] = self.problem.frames.seen & (self.weights.corners > 0.0)
        own = self.problem.joints.own & np.asarray(counted.any(axis=(0, 2)))[:, None]
        # what a number of its own takes up of the measurements, those of angles by their share
        taken = float((own * (1.0 - self.angle_left)).sum()) + self.problem.size
        measured = 2.0 * float(counted.sum())
        return float(np.sqrt(2.0 * self.squares[counted].sum() / max(measured - taken, 1.0)))

    @cached_property
    def angle_left(self) -> FloatArray:
        """(f, 7) variance of each angle's error, over what it was before any image."""
        sigma = self.problem.joints.sigma
        inner = np.diagonal(np.linalg.inv(self.normal.inner), axis1=1, axis2=2)
        return np.asarray(inner / np.where(sigma > 0.0, sigma, 1.0) ** 2)


def solved(
    problem: HeadAdjustment,
    start: State,
    weights: Weights,
    *,
    usual: float = np.inf,
    tolerance: float = _SAME_COST,
) -> HeadSolution:
    """The unknowns with the least sum of squares, by Levenberg and Marquardt.

    Args:
        problem: a head, and what it saw.
        start: near by.
        weights: of corners and angles; 0 leaves one out.
        usual: mean square, over sigma, of a usual corner's residuals at the start: corners and
            angles that fit much worse than others count for less; inf for least squares.
        tolerance: change of the cost below which it ends.

    Raises:
        LinAlgError: the start is behind a camera, or leads nowhere.
    """
    robust = np.isfinite(usual)
    weights = weights._replace(usual=usual)
    state, now = start, problem.linearised(start, weights)
    if not np.isfinite(now.cost):
        raise np.linalg.LinAlgError("expected a start before the cameras")
    damping = 0.0
    for _ in range(_MOST_STEPS):
        larger = now.matrix.copy()
        # by what is known beforehand: a step along what the frames hardly tell is not held
        # back by what they tell well
        larger[np.diag_indices(problem.size)] += damping * problem.precision
        step = -cho_solve(cho_factor(larger), now.slope)
        moved = problem.moved(state, now, step)
        try:
            then = problem.linearised(moved, weights)
        except np.linalg.LinAlgError:  # a step behind a camera
            then = now._replace(cost=np.inf)
        change = now.cost - then.cost
        if change >= 0.0:
            state, now = moved, then
            damping *= 0.1
            usual = _usual(problem, now, weights)
            if robust and usual < _LESS * weights.usual:
                weights = weights._replace(usual=usual)
                now = problem.linearised(state, weights)
            elif change < max(tolerance, (_ROUGH if robust else _ROUNDING) * now.cost):
                break
        else:
            damping = max(10.0 * damping, 1.0)
            if damping > _MOST_DAMPING:
                break
    return HeadSolution(problem, state, now, weights)


def _usual(problem: HeadAdjustment, now: Normal, weights: Weights) -> float:
    """Mean square of the residuals of a usual corner, in units of sigma; 1 at least."""
    counted = problem.frames.seen & (weights.corners > 0.0)
    return max(0.5 * float(np.median((now.residuals[counted] ** 2).sum(axis=-1))), 1.0)
