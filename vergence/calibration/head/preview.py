"""Preview of a head calibration while it is recorded: a fit that grows pose by pose."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import (
    HeadAdjustment,
    HeadUnknowns,
    MeasurementWeights,
)
from vergence.calibration.head.fit import (
    HeadSolution,
    estimate_consensus_board_poses,
    fit_robustly,
    inlier_corners,
    parameter_prior_sigma,
)
from vergence.calibration.head.judge import clustered_head_covariance, head_and_term_covariance
from vergence.calibration.head.recording import HeadFrames
from vergence.calibration.uncertainty import depth_sigma_by_head
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.perception.locate import equivalent_corner_orders

DEPTHS_M: Final = (1.0, 2.5)
"""Distances straight ahead at which depth is judged, m (chosen: the range of use)."""
_ALWAYS_FITTED_POSES: Final = 60
"""Poses up to which each evaluation fits the head to all frames (chosen: the usual number)."""
_REFIT_GROWTH: Final = 2.5
"""Growth of the number of poses after which the head is fitted to all frames again (chosen: fits
take a time in proportion to all poses; in between the head moves by a fraction of its sigma)."""
_MOST_CHI_RATIO: Final = 1.5
"""Ratio of later poses' residuals at the last fit to that fit's own, above which the head is fitted
to all frames (chosen: it is hardly above 1 near the solution)."""
_LEAST_KEPT_FRACTION: Final = 0.5
"""Fraction of the later corners that have to fit (chosen: far below that of a board at rest)."""
_MOST_GROUPS: Final = 60
"""Most groups of poses by which the covariance is estimated (chosen: it takes a time in proportion
to the groups, and more hardly improve it)."""
_READING_STEPS: Final = 2
"""Steps of the readings' errors of later poses (numerical: they are nearly linear)."""


class CalibrationPreview(NamedTuple):
    """Preliminary calibration from the recording so far."""

    head: HeadModel
    """The fitted head."""
    values: FloatArray
    """(p,) its parameters, see `HeadModel.parameters`."""
    boards: BoardPoses
    """(b) poses of the board in frame 0."""
    depth_percent: FloatArray
    """(2,) standard deviation of depth at `DEPTHS_M` ahead that comes from the head's parameters,
    in per cent of the depth."""
    solution: HeadSolution
    """The last fit to all frames."""
    later: "PoseEquations | None"
    """What poses told after that fit; None after the fit itself."""


@dataclass(frozen=True, eq=False)
class PoseEquations:
    """Normal equations of a recording by pose, linearised where the last fit to all frames ended.

    Later poses add their own equations, and one step from that fit solves all: a fit to all frames
    takes a time in proportion to their number.
    """

    solution: HeadSolution
    """The last fit to all frames."""
    columns: NDArray[np.intp]
    """(poses, s_f) indices of each pose's unknowns, see `HeadAdjustment.frame_columns`."""
    blocks: FloatArray
    """(poses, s_f, s_f) part of each pose in the normal matrix."""
    slopes: FloatArray
    """(poses, s_f) part of each pose in the gradient."""
    matrix: FloatArray
    gradient: FloatArray
    squares: float
    """Sum of squares of all residuals, in units of sigma^2."""
    freedom: float
    """Number of residuals minus the effective number of the frames' own parameters."""
    ended_s: float
    """Time of the last frame."""

    @classmethod
    def of(cls, solution: HeadSolution) -> "PoseEquations":
        """Split the normal equations of frames by pose."""
        problem, frames = solution.problem, solution.problem.frames
        normal = problem.linearised(solution.state, solution.weights, keep_parts=True)
        assert normal.group_parts is not None
        squares, measured, taken = solution.squares_and_counts
        first = np.unique(frames.pose, return_index=True)[1]
        blocks, slopes = (np.add.reduceat(each, first) for each in normal.group_parts)
        return cls(
            solution, problem.frame_columns[first], blocks, slopes, normal.matrix, normal.gradient,
            squares, measured - taken,
            float(frames.time_s[-1]),
        )  # fmt: skip

    def with_later(self, frames: HeadFrames) -> "PoseEquations | None":
        """Add what frames after the last one tell; None where that takes a fit to all frames."""
        problem, state = self.solution.problem, self.solution.state
        late = replace(problem, frames=frames.select(frames.time_s > self.ended_s))
        if not len(late.frames.time_s):
            return None
        errors, known = (each.reading_error_unknowns for each in (late, problem))
        if (
            late.placement_count != problem.placement_count
            or len(equivalent_corner_orders(frames.target)) > 1
            or len(errors.shared_error_actuator) + len(known.shared_error_actuator)
            or (errors.has_frame_error[0] != known.has_frame_error[0]).any()
        ):
            return None
        # the readings follow the board and the head as they were fitted, without wrong corners
        there = late.start(state.boards)._replace(
            head_parameters=state.head_parameters,
            board_curvatures=state.board_curvatures,
            term_parameters=state.term_parameters,
        )
        typical_square = max(self.solution.reduced_chi, 1.0) ** 2
        eligible = late.frames.seen & late.frames.shown[..., None]
        weights = MeasurementWeights.of(eligible)._replace(cauchy_scale=typical_square)
        found = _with_readings_settled(late, there, weights)
        kept = inlier_corners(found, eligible, problem.scatter_ratio)
        if kept.sum() < _LEAST_KEPT_FRACTION * eligible.sum():
            return None  # the board has been moved far
        weights = MeasurementWeights.of(kept)
        more = PoseEquations.of(_with_readings_settled(late, found.state, weights))
        if more.squares > (_MOST_CHI_RATIO * self.solution.reduced_chi) ** 2 * more.freedom:
            return None  # the board has been moved, or the fit is not near enough
        padded = np.zeros((problem.shared_count + 1,) * 2)
        pull = np.zeros(problem.shared_count + 1)
        np.add.at(padded, (more.columns[:, :, None], more.columns[:, None]), more.blocks)
        np.add.at(pull, more.columns, more.slopes)
        return replace(
            self,
            columns=np.concatenate([self.columns, more.columns]),
            blocks=np.concatenate([self.blocks, more.blocks]),
            slopes=np.concatenate([self.slopes, more.slopes]),
            matrix=self.matrix + padded[:-1, :-1],
            gradient=self.gradient + pull[:-1],
            squares=self.squares + more.squares,
            freedom=self.freedom + more.freedom,
            ended_s=more.ended_s,
        )

    def preview(self) -> CalibrationPreview | None:
        """Solve the equations; None if they do not determine depth."""
        problem, state = self.solution.problem, self.solution.state
        step = np.append(-cho_solve(cho_factor(self.matrix), self.gradient), 0.0)
        squares = self.squares + float(self.gradient @ step[:-1])
        chi = float(np.sqrt(squares / max(self.freedom - problem.shared_count, 1.0)))
        slopes = self.slopes + np.einsum("fst,ft->fs", self.blocks, step[self.columns])
        groups = np.arange(len(slopes)) * min(len(slopes), _MOST_GROUPS) // len(slopes)
        covariance = clustered_head_covariance(
            problem, self.matrix, self.columns, self.blocks, slopes, chi, groups
        )
        first = problem.common_count
        boards = step[first : first + 6 * problem.placement_count].reshape(-1, 6)
        values = state.head_parameters + step[: len(problem.prior_mean)]
        return _preview(self.solution, values, state.boards.moved(boards), covariance, self)


def _with_readings_settled(
    problem: HeadAdjustment, state: HeadUnknowns, weights: MeasurementWeights
) -> HeadSolution:
    """Fit the frames' own reading errors while all else stays."""
    for _ in range(_READING_STEPS):
        normal = problem.linearised(state, weights)
        state = problem.moved(state, normal, np.zeros(problem.shared_count))
    return HeadSolution(problem, state, problem.linearised(state, weights), weights)


def _preview(
    solution: HeadSolution, values: FloatArray, boards: BoardPoses, covariance: FloatArray,
    later: PoseEquations | None = None,
) -> CalibrationPreview | None:  # fmt: skip
    head = solution.problem.nominal_head
    sigma = depth_sigma_m(head, values, covariance)
    if not np.isfinite(sigma).all():
        return None
    percent = 100.0 * sigma / np.array(DEPTHS_M)
    return CalibrationPreview(
        head.with_parameters(values), values, boards, percent, solution, later
    )


def preview_calibration(
    head: HeadModel, frames: HeadFrames, previous: CalibrationPreview | None = None
) -> CalibrationPreview | None:
    """Fit a head to frames so far, from `previous`; None if they do not determine a head yet."""
    try:
        if previous is not None:
            poses, fitted = (
                each.pose[-1] + 1 for each in (frames, previous.solution.problem.frames)
            )
            if _ALWAYS_FITTED_POSES < poses < _REFIT_GROWTH * fitted:
                known = previous.later or PoseEquations.of(previous.solution)
                with suppress(np.linalg.LinAlgError):  # then a fit to all frames follows
                    more = known.with_later(frames)
                    if more is not None:
                        return more.preview()
        begin = estimate_consensus_board_poses(head, frames)
        problem = HeadAdjustment(head, parameter_prior_sigma(head), begin.frames)
        near = problem.start(begin.boards)
        if previous is not None:
            near = near._replace(head_parameters=previous.values)
        found = fit_robustly(problem, begin.boards, begin.inlier_views, near)
        covariance = head_and_term_covariance(found)
    except np.linalg.LinAlgError:
        return None
    return _preview(found, found.state.head_parameters, found.state.boards, covariance)


def depth_sigma_m(
    nominal_head: HeadModel, values: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(2,) sigma, m, along N's z of points `DEPTHS_M` ahead, from (p, p) covariance alone."""
    head = nominal_head.with_parameters(values)
    ahead = np.array([[0.0, 0.0, depth_m] for depth_m in DEPTHS_M])
    points = ahead + head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    q = head.fixate(points, head.rest()[NECK])
    return depth_sigma_by_head(
        nominal_head, values, np.sqrt(np.diagonal(covariance)), covariance,
        (q, head.project(q, points)), np.array([[0.0, 0.0, 1.0]] * len(points)),
    )  # fmt: skip
