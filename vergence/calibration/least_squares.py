"""Least squares of many groups with unknowns of their own: equations, elimination, damped steps.

A view of a board has its own pose, a frame of a head its own reading errors. These are eliminated
(Schur complement), so that the equations of the shared unknowns remain: with the Jacobians J by the
shared unknowns and P by a group's own,

    J' = J - P (P^T P)^-1 P^T J,    covariance = (J'^T J')^-1,

which is the shared block of the full problem's covariance. It is computed as a difference of sums:
where a group's own unknowns explain nearly all, as of boards within 0.6 degrees of frontal, sigmas
hold to 2e-3 only.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vergence.models.parts import FloatArray

_MOST_STEPS: Final = 60
"""Largest number of steps; ten are usual, more only if a lens has more coefficients than the views
determine and these wander along a valley (numerical)."""
_LEAST_DAMPING: Final = 1e-13
"""Damping of the first step; it matters only if the matrix is singular (numerical)."""
_MOST_DAMPING: Final = 1e9
"""Damping above which the iteration ends (numerical)."""
_ROUNDING: Final = 1e-12
"""Relative change of a cost by rounding (numerical)."""
_ABSOLUTE_RIDGE: Final = 1e-200
"""Ridge that lets a view without corners have an inverse (numerical)."""

_State = TypeVar("_State")
_Normal = TypeVar("_Normal")


def damped_least_squares(
    linearised: Callable[[_State], _Normal],
    moved: Callable[[_State, _Normal, FloatArray, FloatArray], _State],
    state: _State,
    *,
    tolerance: float,
    relative_tolerance: float,
    damping_unit: FloatArray | None = None,
    reweighted: Callable[[_State, _Normal], _Normal | None] | None = None,
) -> tuple[_State, _Normal]:
    """Levenberg and Marquardt's method for one problem or a batch of independent ones.

    Args:
        linearised: normal equations at a state; may raise `LinAlgError`. Attributes: `cost` (...),
            sum of squares; `matrix` (..., s, s); `gradient` (..., s), half of the cost's.
        moved: the state after a step (..., s) of a damping (...).
        state: the start; of a batch a NamedTuple of arrays (..., ...), as the equations are then.
        tolerance: change of the cost below which the iteration ends.
        relative_tolerance: the same, as a fraction of the cost.
        damping_unit: (s,) what damping multiplies; None for the normal matrix's diagonal.
        reweighted: after a step, the normal equations with other weights, or None for the same.

    Raises:
        numpy.linalg.LinAlgError: the start has no finite cost.
    """
    now: Any = linearised(state)
    then: Any
    if np.ndim(now.cost) == 0 and not np.isfinite(now.cost):
        raise np.linalg.LinAlgError("expected a start before the cameras")
    damping = np.full(np.shape(now.cost), _LEAST_DAMPING)
    for _ in range(_MOST_STEPS):
        unit = np.diagonal(now.matrix, axis1=-2, axis2=-1)
        unit = unit if damping_unit is None else damping_unit
        step = -_solve_damped(now.matrix, damping[..., None] * unit, now.gradient[..., None])[
            ..., 0
        ]
        there = moved(state, now, step, damping)
        try:
            then = linearised(there)
            change = now.cost - then.cost
        except np.linalg.LinAlgError:  # a step behind a camera
            then, change = now, np.full_like(damping, -np.inf)
        better = np.asarray(change >= 0.0)
        state, now = choose(better, there, state), choose(better, then, now)
        damping = np.where(
            better, np.maximum(0.1 * damping, _LEAST_DAMPING), np.maximum(10.0 * damping, 1.0)
        )
        other = reweighted(state, now) if reweighted is not None and better.all() else None
        if other is not None:
            now = other
            continue
        limit = np.maximum(tolerance, relative_tolerance * np.asarray(now.cost))
        # a rejected step ends it only where no step can be better but by rounding
        rounding = np.minimum(limit, _ROUNDING * np.maximum(now.cost, 1.0))
        done = np.abs(change) <= np.where(better, limit, rounding)
        if (done | (damping > _MOST_DAMPING)).all():
            break
    return state, now


def choose(better: NDArray[np.bool_], new: _State, old: _State) -> _State:
    """Select the new values of the problems that are better."""
    if better.ndim == 0:
        return new if better else old
    both: Any = (new, old)
    chosen: _State = type(both[0])(
        *(
            np.where(better.reshape(-1, *[1] * (one.ndim - 1)), one, other)
            for one, other in zip(*both, strict=True)
        )
    )
    return chosen


def _solve_damped(matrix: FloatArray, more: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (..., s, s) equations with a larger diagonal, by (..., s), scaled to ones."""
    size = range(matrix.shape[-1])
    larger = matrix.copy()
    larger[..., size, size] += more + _ABSOLUTE_RIDGE
    scale = 1.0 / np.sqrt(larger[..., size, size])[..., None]
    scaled = larger * scale * scale.swapaxes(-1, -2)
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


class ReducedNormalEquations(NamedTuple):
    """Normal equations of shared unknowns; each group's own ones eliminated (Schur complement).

    A group has unknowns of its own: a view the board's pose, a frame of a head its reading errors.
    """

    cost: float
    """Sum of squares."""
    matrix: FloatArray
    """(s, s) normal matrix of the shared unknowns."""
    gradient: FloatArray
    """(s,) gradient, half of the cost's."""
    own_by_shared: FloatArray
    """(g, o, s_g) negative derivative of each group's own unknowns by those in its columns."""
    own_step: FloatArray
    """(g, o) negative step of the groups' own unknowns while the shared ones stay."""
    own_matrix: FloatArray
    """(g, o, o) normal matrix of each group's own unknowns."""
    residuals: FloatArray
    """(c, g, n, 2) residuals divided by sigma; 0 for corners that were not found."""
    group_parts: tuple[FloatArray, FloatArray] | None
    """(g, s_g, s_g) and (g, s_g) each group's parts of matrix and gradient, if they were kept."""


class GroupedEquations:
    """Sums of the equations of groups, from which `ReducedNormalEquations` follow.

    Args:
        columns: (g, s_g) places of each group's unknowns among the shared ones; -1 for none.
        common_count: how many leading ones all groups have in common.
        own_matrix: (g, o, o) the prior's normal matrix of the groups' own unknowns.
        own_gradient: (g, o) the prior's gradient.
        keep_parts: keep the parts of each group.
    """

    def __init__(
        self, columns: NDArray[np.intp], common_count: int, own_matrix: FloatArray,
        own_gradient: FloatArray, *, keep_parts: bool = False,
    ) -> None:  # fmt: skip
        groups, width = columns.shape
        self._columns, self._common = columns, common_count
        self._own_matrix, self._own_gradient = own_matrix.copy(), own_gradient.copy()
        self._across = np.zeros((groups, own_matrix.shape[-1], width))
        self._matrix = np.zeros((common_count, common_count))
        self._blocks = np.zeros((groups, width, width - common_count))
        self._gradients = np.zeros((groups, width))
        self._parts = np.zeros((groups, width, width)) if keep_parts else None

    def add(self, jacobian: FloatArray, residuals: FloatArray, columns: NDArray[np.intp]) -> None:
        """Add (g, m) residuals with (g, m, k + o) Jacobian, own unknowns last, at (k,) columns."""
        known = len(columns)
        common = columns[columns < self._common]
        count = len(common)
        turned = jacobian.transpose(0, 2, 1)
        # group by group: one large product would wait for threads, where others use the CPU too
        product, pulls = turned @ jacobian, (turned @ residuals[..., None])[..., 0]
        # all groups share the common block: sum it at once
        self._matrix[np.ix_(common, common)] += product[:, :count, :count].sum(axis=0)
        self._blocks[:, columns] += product[:, :known, count:known]
        if self._parts is not None:
            self._parts[:, columns[:, None], columns] += product[:, :known, :known]
        self._gradients[:, columns] += pulls[:, :known]
        self._own_matrix += product[:, known:, known:]
        self._own_gradient += pulls[:, known:]
        self._across[:, :, columns] += product[:, known:, :known]

    def reduced(
        self, cost: float, residuals: FloatArray, prior_information: FloatArray,
        deviation: FloatArray,
    ) -> ReducedNormalEquations:  # fmt: skip
        """Eliminate the own unknowns; (s,) prior of the shared ones and deviation from its mean."""
        common, across, gone = self._common, self._across, self._across.transpose(0, 2, 1)
        diagonal = np.einsum("gii->gi", self._own_matrix)
        solved = _solve_damped(
            self._own_matrix, _LEAST_DAMPING * diagonal,
            np.concatenate([across, self._own_gradient[..., None]], axis=-1),
        )  # fmt: skip
        by_shared, step = solved[..., :-1], solved[..., -1]
        gradients = self._gradients - (gone @ step[..., None])[..., 0]
        parts = None if self._parts is None else (self._parts - gone @ by_shared, gradients)
        # -1, the last, takes what belongs to no unknown
        size = len(prior_information) + 1
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        matrix[:common, :common] = self._matrix
        matrix[:common, :common] -= (gone[:, :common] @ by_shared[..., :common]).sum(axis=0)
        others = self._blocks - gone @ by_shared[..., common:]
        rest = self._columns[:, common:]
        np.add.at(matrix, (np.arange(common)[None, :, None], rest[:, None, :]), others[:, :common])
        np.add.at(matrix, (rest[:, :, None], rest[:, None, :]), others[:, common:])
        np.add.at(gradient, self._columns, gradients)
        matrix[common:, :common] = matrix[:common, common:].T
        return ReducedNormalEquations(
            cost + float((prior_information * deviation**2).sum()),
            matrix[:-1, :-1] + np.diag(prior_information),
            gradient[:-1] + prior_information * deviation,
            by_shared, step, self._own_matrix, residuals, parts,
        )  # fmt: skip
