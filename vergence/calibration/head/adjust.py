r"""Bundle adjustment of a head: its numbers, the board, and every true joint angle.

The least sum of squares of

    (projected - measured) / sigma                       each corner in each eye and frame,
    e / sigma_e                                          each angle's error of reading,
    (x - x_0) / sigma_0                                  each number of the head, as it was believed

over the head's numbers x, the board's poses in frame 0 and its bend, and the errors e. Errors of
one frame alone are eliminated frame by frame (Schur complement), so that some hundred unknowns are
left, whose normal matrix is assembled from small blocks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from vergence.calibration.adjustment import Poses
from vergence.calibration.head.chain import Chain, board_points
from vergence.calibration.head.frames import HeadFrames, JointErrors
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

BEND: Final = 3
"""Curvatures of the board, see `vergence.calibration.adjustment`."""
_BEND_SIGMA: Final = 0.5
"""Of a curvature, 1/m: 0.6 mm at the edge of a board of 100 mm."""
_NOTHING: Final = 1e-6
"""Precision of what is unknown, 1/rad^2 and 1/m^2."""
_MOST_STEPS: Final = 60
_SAME_COST: Final = 1e-3
"""Change of the cost below which the adjustment ends: a number that is a standard deviation beside
the best one changes it by 1."""
_ROBUST: Final = 3.0
"""Times the usual residual of a view from which on it counts for less."""


class State(NamedTuple):
    """Values of all unknowns."""

    values: FloatArray
    """(p,) see `HeadModel.parameters`."""
    bend: FloatArray
    """(3,) curvatures of the board, 1/m."""
    boards: Poses
    """(b) in frame 0."""
    shared: FloatArray
    """(r,) errors of resting joints, rad."""
    errors: FloatArray
    """(f, 7) errors of single frames, rad."""


class Normal(NamedTuple):
    """The problem at a state, its frames' own errors eliminated."""

    cost: float
    """Sum of squares, weighted."""
    views: FloatArray
    """(2, f) mean square of the residuals over sigma of each view; nan without corners."""
    matrix: FloatArray
    """(s, s) normal matrix of what is shared: numbers, bend, boards, shared errors."""
    slope: FloatArray
    """(s,)"""
    back: FloatArray
    """(f, 7, s_f) how the frames' own errors follow what is shared, with `columns`."""
    offset: FloatArray
    """(f, 7) how they move by themselves."""
    residuals: FloatArray
    """(2, f, n, 2) over sigma; 0 for corners that were not found."""


@dataclass(frozen=True, eq=False)
class HeadAdjustment:
    """The problem: a head as it is believed to be, and what it saw.

    Args:
        about: the head as its file has it, from which rotations are counted.
        spreads: (p,) deviations of its numbers from what they are; 0 for those that are held.
        frames: what it saw.
    """

    about: HeadModel
    spreads: FloatArray
    frames: HeadFrames

    @cached_property
    def joints(self) -> JointErrors:
        """Which angles are unknown."""
        return JointErrors.of(self.about, self.frames)

    @cached_property
    def nominal(self) -> FloatArray:
        """(p,) the numbers as they were believed."""
        return self.about.parameters().values

    @cached_property
    def to_joints(self) -> FloatArray:
        """(7, 7) joint angles per actuator angle."""
        out = np.eye(7)
        if not self.about.actuation.direct:
            out[EYES, EYES] = self.about.actuation.to_joints
        return out

    @cached_property
    def boards(self) -> int:
        """Number of places of the board."""
        return int(self.frames.placement.max()) + 1

    @property
    def size(self) -> int:
        """Number of what is shared."""
        return len(self.nominal) + BEND + 6 * self.boards + len(self.joints.runs)

    @cached_property
    def _heights(self) -> FloatArray:
        """(n, 3) see `Adjustment`."""
        x, y = self.frames.corners[:, :2].T
        return np.column_stack([0.5 * x * x, 0.5 * y * y, x * y])

    @cached_property
    def precision(self) -> FloatArray:
        """(s,) what is known of each shared unknown before any image, over its square."""
        flat = len(self.frames.corners) <= 4
        bend = 1e-6 if flat else _BEND_SIGMA
        # places of the board that no frame shows must have some pose
        known = np.full(self.size, _NOTHING)
        sigma = np.maximum(self.spreads, 1e-9)
        known[: len(sigma)] = 1.0 / sigma**2
        known[len(sigma) : len(sigma) + BEND] = 1.0 / bend**2
        if len(self.joints.runs):
            known[-len(self.joints.runs) :] = 1.0 / self.joints.sigma[self.joints.runs] ** 2
        return known

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """(f, s_f) where each frame's own blocks are among what is shared; -1 for nowhere."""
        p, f = len(self.nominal), len(self.frames.time_s)
        head = np.broadcast_to(np.arange(p + BEND), (f, p + BEND))
        board = p + BEND + 6 * self.frames.placement[:, None] + np.arange(6)
        run = self.joints.run
        run = np.where(run >= 0, p + BEND + 6 * self.boards + run, -1)
        return np.concatenate([head, board, run], axis=1)

    def angles(self, state: State) -> FloatArray:
        """(f, 7) true joint angles, rad."""
        own = self.joints
        errors = np.where(own.own, state.errors, 0.0)
        if len(own.runs):
            errors = errors + np.where(own.run >= 0, state.shared[own.run], 0.0)
        return self.about.actuation.joints_of(own.angles + errors)

    def corners(self, state: State) -> FloatArray:
        """(n, 3) the bent board's corners, metres."""
        out = self.frames.corners.copy()
        out[:, 2] += self._heights @ state.bend
        return out

    def linearised(self, state: State, weight: FloatArray) -> Normal:
        """The normal equations at a state.

        Args:
            state: the unknowns' values.
            weight: (2, f) of each view.
        """
        chain, q = Chain(self.about, state.values), self.angles(state)
        points, turned = board_points(self.corners(state), state.boards, self.frames.placement)
        f, own = len(q), self.joints
        residuals = np.zeros(self.frames.pixels.shape)
        normals = state.boards.rotation[self.frames.placement][:, :, 2]
        sigma = np.where(own.sigma > 0.0, own.sigma, 1.0)
        kept = np.where(own.own, state.errors / sigma, 0.0)
        p, width = len(self.nominal), self.columns.shape[1]
        blocks, slopes = np.zeros((f, width, width)), np.zeros((f, width))
        inner = np.broadcast_to(np.eye(7) / sigma**2, (f, 7, 7)).copy()
        pull, across = kept / sigma, np.zeros((f, 7, width))
        for eye in range(2):
            seen = chain.seen(eye, q, points, turned)
            found = self.frames.seen[eye][..., None]
            scale = np.where(found, 1.0 / np.where(found, self.frames.sigma[eye], 1.0), 0.0)
            raw = seen.pixels - np.where(found, self.frames.pixels[eye], 0.0)
            residuals[eye] = np.where(found, scale * raw, 0.0)
            root = np.sqrt(weight[eye])
            scale = (root[:, None, None] * scale)[..., None]
            r = (root[:, None, None] * residuals[eye]).reshape(f, -1, 1)
            lift = np.einsum("fncj,fj->fnc", seen.by_board[..., 3:], normals)
            by_bend = lift[..., None] * self._heights[None, :, None]
            by_angle = seen.by_joints @ self.to_joints
            by_run = np.where((own.run >= 0)[:, None, None], by_angle, 0.0)
            rows = np.concatenate([seen.by_head, by_bend, seen.by_board, by_run], axis=-1)
            L = np.where(scale > 0.0, scale * rows, 0.0).reshape(f, -1, rows.shape[-1])
            mine = np.where(own.own[:, None, None], by_angle, 0.0)
            A = np.where(scale > 0.0, scale * mine, 0.0).reshape(f, -1, 7)
            columns = np.concatenate([chain.columns[eye], np.arange(p, width)])
            blocks[:, columns[:, None], columns] += L.transpose(0, 2, 1) @ L
            slopes[:, columns] += (L.transpose(0, 2, 1) @ r)[..., 0]
            inner += A.transpose(0, 2, 1) @ A
            pull += (A.transpose(0, 2, 1) @ r)[..., 0]
            across[:, :, columns] += A.transpose(0, 2, 1) @ L
        back = np.linalg.solve(inner, np.concatenate([across, pull[..., None]], axis=-1))
        back, offset = back[..., :-1], back[..., -1]
        blocks -= across.transpose(0, 2, 1) @ back
        slopes -= (across.transpose(0, 2, 1) @ offset[..., None])[..., 0]
        matrix, slope = np.zeros((self.size + 1,) * 2), np.zeros(self.size + 1)
        columns = self.columns
        head = len(self.nominal) + BEND
        # the head's own block is every frame's; the rest is added where it belongs
        matrix[:head, :head] = blocks[:, :head, :head].sum(axis=0)
        rest = columns[:, head:]
        np.add.at(
            matrix, (np.arange(head)[None, :, None], rest[:, None, :]), blocks[:, :head, head:]
        )
        np.add.at(matrix, (rest[:, :, None], rest[:, None, :]), blocks[:, head:, head:])
        np.add.at(slope, columns, slopes)
        matrix[head:, :head] = matrix[:head, head:].T
        matrix, slope = matrix[:-1, :-1], slope[:-1]
        away = self._away(state)
        matrix[np.diag_indices(self.size)] += self.precision
        slope = slope + self.precision * away
        squares = (residuals**2).sum(axis=(-2, -1))
        count = 2.0 * self.frames.seen.sum(axis=-1)
        views = np.divide(squares, count, out=np.full(squares.shape, np.nan), where=count > 0)
        cost = float((weight * squares).sum() + (kept**2).sum() + (self.precision * away**2).sum())
        return Normal(cost, views, matrix, slope, back, offset, residuals)

    def _away(self, state: State) -> FloatArray:
        """(s,) how far the shared unknowns are from what was believed."""
        away = np.zeros(self.size)
        p = len(self.nominal)
        away[:p], away[p : p + BEND] = state.values - self.nominal, state.bend
        if len(self.joints.runs):
            away[-len(self.joints.runs) :] = state.shared
        return away

    def moved(self, state: State, now: Normal, step: FloatArray) -> State:
        """The state after a step of what is shared, its frames' errors following."""
        p, b = len(self.nominal), 6 * self.boards
        padded = np.append(step, 0.0)
        follow = now.offset + np.einsum("fjs,fs->fj", now.back, padded[self.columns])
        return State(
            state.values + step[:p],
            state.bend + step[p : p + BEND],
            state.boards.moved(step[p + BEND : p + BEND + b].reshape(-1, 6)),
            state.shared + step[p + BEND + b :],
            np.where(self.joints.own, state.errors - follow, 0.0),
        )

    def of(self, frames: NDArray[np.bool_]) -> "HeadAdjustment":
        """The problem of some of the frames alone."""
        return HeadAdjustment(self.about, self.spreads, self.frames.of(frames))

    def start(self, boards: Poses) -> State:
        """The head as it is believed to be, before boards.

        Args:
            boards: (b or more) their poses in frame 0.
        """
        return State(
            self.nominal.copy(),
            np.zeros(BEND),
            boards.of(np.arange(self.boards)),
            np.zeros(len(self.joints.runs)),
            np.zeros(self.joints.angles.shape),
        )

    def solved(
        self,
        start: State,
        weight: FloatArray,
        *,
        robust: bool = False,
        tolerance: float = _SAME_COST,
        progress: Callable[[float], None] | None = None,
    ) -> "HeadSolution":
        """The unknowns with the least sum of squares, by Levenberg and Marquardt.

        Args:
            start: near by.
            weight: (2, f) of each view; 0 leaves it out.
            robust: whether views that fit much worse than others count for less.
            tolerance: change of the cost below which it ends.
            progress: called with the fraction done.

        Raises:
            LinAlgError: the start is behind a camera.
        """
        kept = weight
        state, now = start, self.linearised(start, weight)
        if not np.isfinite(now.cost):
            raise np.linalg.LinAlgError("expected a start before the cameras")
        damping = 0.0
        for number in range(_MOST_STEPS):
            if robust:
                weight = kept * robust_weight(now.views, kept)
                # another weight changes the rows of a view alike: the next state is near enough
                now = self.linearised(state, weight)
            larger = now.matrix.copy()
            # by what is known beforehand: a step along what the frames hardly tell is not held
            # back by what they tell well
            larger[np.diag_indices(self.size)] += damping * self.precision
            step = -cho_solve(cho_factor(larger), now.slope)
            moved = self.moved(state, now, step)
            then = self.linearised(moved, weight)
            change = now.cost - then.cost
            if np.isfinite(then.cost) and change >= 0.0:
                state, now = moved, then
                damping *= 0.1
                if change < tolerance:
                    break
            else:
                damping = max(10.0 * damping, 1.0)
                if damping > 1e9:
                    break
            if progress is not None:
                progress(min(0.1 * number, 0.9))
        return HeadSolution(self, state, now, weight)


def robust_weight(views: FloatArray, kept: FloatArray) -> FloatArray:
    """(2, f) weights of views by how well they fit, after Cauchy.

    Args:
        views: (2, f) mean squares over sigma; nan without corners.
        kept: (2, f) 0 for those that do not count.
    """
    counted = np.isfinite(views) & (kept > 0.0)
    usual = max(float(np.median(views[counted])), 1.0)
    return np.where(counted, 1.0 / (1.0 + np.nan_to_num(views) / (_ROBUST**2 * usual)), 0.0)


@dataclass(frozen=True, eq=False)
class HeadSolution:
    """The head that fits best, and how surely."""

    problem: HeadAdjustment
    state: State
    normal: Normal
    weight: FloatArray
    """(2, f) of each view."""

    @cached_property
    def head(self) -> HeadModel:
        """The head that was found."""
        return self.problem.about.with_parameters(self.state.values)

    @cached_property
    def noise(self) -> float:
        """How many times sigma the residuals are."""
        counted = self.problem.frames.seen & (self.weight > 0.0)[..., None]
        measured = 2 * int(counted.sum())
        residuals = np.where(counted[..., None], self.normal.residuals, 0.0)
        own = int(self.problem.joints.own.sum())
        return float(np.sqrt((residuals**2).sum() / max(measured - own - 50, 1)))

    @cached_property
    def inverse(self) -> FloatArray:
        """(s, s) the inverse of the normal matrix."""
        return np.asarray(np.linalg.inv(self.normal.matrix))

    @property
    def covariance(self) -> FloatArray:
        """(p, p) of the head's numbers."""
        p = len(self.problem.nominal)
        return self.inverse[:p, :p]
