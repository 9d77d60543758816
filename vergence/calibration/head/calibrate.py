"""Calibration of a head from frames of a board, its depth errors, and a preview while it grows."""

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from vergence.calibration.adjustment import BoardPoses, rms_length
from vergence.calibration.head import judge
from vergence.calibration.head.adjust import (
    HeadAdjustment,
    HeadUnknowns,
    MeasurementWeights,
    ReadingErrorTerms,
)
from vergence.calibration.head.fit import (
    HeadSolution,
    estimate_consensus_board_poses,
    fit_robustly,
    inlier_corners,
    parameter_prior_sigma,
    restart,
)
from vergence.calibration.head.recording import HeadFrames, sort_and_clean_frames
from vergence.calibration.head.terms import (
    AUTO,
    choose_terms,
    convert_for_terms,
    cross_validate_by_pose,
    with_backlash,
)
from vergence.calibration.uncertainty import depth_sigma_by_head
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.models.posture import fixation_angles_and_visibility, midpoint_between_cameras
from vergence.perception.locate import equivalent_corner_orders
from vergence.triangulation import triangulate_views

_MOST_PLACEMENTS: Final = 8
"""Most fits to a recording, each after the first with another placement of the board (chosen)."""
_SIGNIFICANT_SIGMAS: Final = 2.0
"""Standard deviations above which a parameter is significant (chosen)."""


class FittedTerm(NamedTuple):
    """A parameter of a reading-error term."""

    name: str
    """Name such as `left_pan.play`."""
    value: float
    sigma: float
    unit: str

    @property
    def significant(self) -> bool:
        """True if it differs significantly from zero."""
        return abs(self.value) > _SIGNIFICANT_SIGMAS * self.sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadCalibration:
    """Calibration of a head from a recording."""

    solution: HeadSolution
    held_out_mean_squares: FloatArray
    """(2, f) mean squares of views by heads that were calibrated without them, in units of sigma^2;
    nan for views without kept corners."""
    recording_remarks: tuple[str, ...]
    """Remarks on the recording, a line each."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the recording and the calibration, a line each."""
        return (
            *self.recording_remarks,
            *_remarks_on_terms(self),
            *_remarks_on_scatter(self.solution),
            *judge.remark_on_changed_baseline(self.solution),
        )

    @property
    def nominal_head(self) -> HeadModel:
        """The nominal head, from its file."""
        return self.solution.problem.nominal_head

    @cached_property
    def head(self) -> HeadModel:
        """The calibrated head."""
        if not self.solution.problem.terms.is_backlash.any():
            return self.solution.head
        return with_backlash(self.solution.head, self.significant_backlash)

    @property
    def significant_backlash(self) -> FloatArray:
        """(7,) backlash by actuator, rad; 0 if not significant."""
        out, own = np.zeros(7), self.solution.problem.terms
        for term, joint, backlash in zip(
            self.terms, own.actuator_index, own.is_backlash, strict=True
        ):
            if backlash and term.significant:
                out[joint] = max(term.value, 0.0)
        return out

    @cached_property
    def terms(self) -> tuple[FittedTerm, ...]:
        """Parameters of the reading-error terms."""
        sigma = np.sqrt(np.diagonal(self._covariance)[len(self.solution.problem.prior_mean) :])
        values = self.solution.state.term_parameters.tolist()
        numbers = zip(self.solution.problem.terms.names, values, sigma.tolist(), strict=True)
        return tuple(FittedTerm(*each, "rad") for each in numbers)

    @property
    def frames(self) -> HeadFrames:
        """Frames of the board."""
        return self.solution.problem.frames

    @property
    def kept_corners(self) -> NDArray[np.bool_]:
        """(2, f, n) True for kept corners, the inliers."""
        return self.solution.kept_corners

    @property
    def kept_views(self) -> NDArray[np.bool_]:
        """(2, f) True for kept views, with at least one kept corner."""
        return np.asarray(self.kept_corners.any(axis=-1))

    @cached_property
    def residuals_px(self) -> FloatArray:
        """(2, f, n, 2) residuals projected minus measured, px."""
        return self.solution.normal.residuals * self.frames.sigma

    @cached_property
    def rms_px(self) -> float:
        """Root mean square length of the kept corners' residuals, px."""
        return rms_length(self.residuals_px[self.kept_corners])

    @cached_property
    def rms_heldout_px(self) -> float:
        """Cross-validation counterpart of `rms_px`, by heads calibrated without the view, px."""
        squares = self.held_out_mean_squares
        mean = np.nanmean(squares) if np.isfinite(squares).any() else np.nan
        sigma = self.frames.sigma[self.kept_corners]
        return float(np.sqrt(2.0 * mean * np.mean(sigma**2)))

    @property
    def covariance(self) -> FloatArray:
        """(p, p) covariance of `HeadModel.parameters`."""
        p = len(self.solution.problem.prior_mean)
        return self._covariance[:p, :p]

    @cached_property
    def _covariance(self) -> FloatArray:
        return judge.head_and_term_covariance(self.solution)

    @property
    def sigma(self) -> FloatArray:
        """(p,) standard deviations of `HeadModel.parameters`."""
        return np.sqrt(np.diagonal(self.covariance))


def calibrate_head(
    head: HeadModel,
    frames: HeadFrames,
    *,
    estimate_cameras: bool = True,
    terms: Collection[str] = (),
    progress: Callable[[float], None] | None = None,
) -> HeadCalibration:
    """Find a head's joints, eyes and cameras from frames of a board.

    Args:
        head: the nominal head, from its file.
        frames: frames of the board, taken while the head moved.
        estimate_cameras: True to estimate focal lengths, principal points and lenses too.
        terms: some of `TERMS`, or `AUTO` alone for the terms that the frames call for.
        progress: called with the fraction done.

    Raises:
        ConfigurationError: the frames give no calibration; the message says why.
    """
    report = progress or (lambda fraction: None)
    judge.refuse_fixed_eyes(head)
    frames = sort_and_clean_frames(frames)
    judge.refuse_few_poses(frames)
    file, head = head, convert_for_terms(head, terms)
    remarks: list[str] = []
    try:
        start = estimate_consensus_board_poses(head, frames)
        judge.refuse_swapped_eyes(head, frames, start)
        report(0.1)
        problem = HeadAdjustment(
            head, parameter_prior_sigma(head, estimate_cameras), start.frames,
            terms=ReadingErrorTerms.of_frames(head, start.frames, terms),
        )  # fmt: skip
        fit = fit_robustly(problem, start.boards, start.inlier_views)
        for place in range(1, _MOST_PLACEMENTS):
            report(0.1 + 0.6 * place / (place + 1.0))
            far = judge.find_new_placement(fit)
            more = far or judge.find_small_board_motion(fit)
            if more is None:
                break
            remarks.append(more.remark)
            problem = replace(problem, frames=more.frames)
            fit = fit_robustly(problem, more.boards, more.inlier_views, fit.state if far else None)
        judge.refuse_implausible_solution(fit)
        report(0.7)
        if tuple(terms) == (AUTO,):
            fit, suspected = choose_terms(fit, estimate_cameras)
            if suspected is not None:
                remarks.append(
                    f"{_remark_on_harmonics(suspected)}: a head file cannot store them; --terms "
                    "harmonics estimates them, and calibrates the head for readings corrected by "
                    "them"
                )
        if type(fit.head.links) is not type(file.links):
            remarks.append(
                "the joints are described by their axes one by one, which may be turned in ways "
                "that D-H numbers lack"
            )
        report(0.8)
        views, _ = cross_validate_by_pose(fit, fit.kept_corners)
    except np.linalg.LinAlgError:
        raise ConfigurationError(
            "expected frames that agree on where the board is, got some that do not: is the target "
            "of that size, and do the joint angles belong to the images, with the head's signs and "
            "zeros?"
        ) from None
    report(1.0)
    return HeadCalibration(
        solution=fit,
        held_out_mean_squares=views,
        recording_remarks=(*remarks, *judge.remark_on_few_views(start.frames, fit.kept_corners)),
    )


def actuator_names(head: HeadModel) -> list[str]:
    """List the names of the neck's joints and the eyes' actuators; empty for missing ones."""
    names = [*head.joints[NECK], *head.actuation.names]
    return names + [""] * (7 - len(names))


def _remarks_on_scatter(solution: HeadSolution) -> list[str]:
    """Report joints whose readings scatter more than quantisation and backlash explain."""
    ratio, names = solution.problem.scatter_ratio, actuator_names(solution.problem.nominal_head)
    wide, worst = np.flatnonzero(ratio > 1.0).tolist(), int(ratio.argmax())
    if not wide:
        return []
    sigma = solution.problem.reading_error_unknowns.reading_sigma[worst]
    return [
        f"the readings of {', '.join(names[joint] for joint in wide)} scatter more than their "
        f"quantisation and backlash explain, those of {names[worst]} by "
        f"{np.rad2deg(sigma):.2g} degrees, {ratio[worst]:.1f} times as much: is "
        "there more backlash, did the joints rest, and do the angles belong to the images?"
    ]


def _remarks_on_terms(found: HeadCalibration) -> list[str]:
    """Remark on the terms found, and on those that the head's file cannot hold."""
    head, play, lines = found.nominal_head, found.significant_backlash, []
    if play.any():
        line = f"the actuators have backlash, in degrees: {_listed(head, play)}"
        if head.actuators is None and play[NECK.stop :].any():
            line += "; the head's file has the greatest of the eyes' for all of them"
        if play[: NECK.stop].any():
            line += "; a head's file has no place for that of the neck"
        lines.append(line)
    if not found.solution.problem.terms.is_backlash.all():
        lines.append(
            f"{_remark_on_harmonics(found.solution)}: the head is that of readings which are "
            "corrected by the terms of result.json"
        )
    return lines


def _remark_on_harmonics(solution: HeadSolution) -> str:
    terms, values = solution.problem.terms, solution.state.term_parameters
    waves = terms.evaluate(np.where(terms.is_backlash, 0.0, values))[0]
    return (
        "the encoders' readings are off by harmonics of the angle, in degrees up to: "
        f"{_listed(solution.problem.nominal_head, 0.5 * np.ptp(waves, axis=0))}"
    )


def _listed(head: HeadModel, angles: FloatArray) -> str:
    return ", ".join(
        f"{name} {np.rad2deg(angle):.2g}"
        for name, angle in zip(actuator_names(head), angles.tolist(), strict=True)
        if angle > 0.0
    )


class DepthErrors(NamedTuple):
    """Errors along the line from midway between the eyes to fixated points; nan if out of reach."""

    distance_m: FloatArray
    """(n,) distance from midway between the eyes."""
    nominal_error_m: FloatArray
    """(n,) depth error of the nominal head, taking the calibrated head as the truth; positive if
    the triangulated point is too far."""
    nominal_error_norm_m: FloatArray
    """(n,) length of the nominal head's error in all three directions."""
    sigma_m: FloatArray
    """(n,) standard deviation of depth from the uncertainty of the calibration."""
    noise_floor_m: FloatArray
    """(n,) standard deviation of depth of a single settled fixation from the noise of pixels and
    encoders."""

    def percent(self, error_m: FloatArray) -> FloatArray:
        """(n,) errors in percent of the distance."""
        return np.asarray(1e2 * error_m / self.distance_m)


def points_at_angles(
    distance_m: ArrayLike, right_rad: ArrayLike = 0.0, down_rad: ArrayLike = 0.0
) -> FloatArray:
    """(n, 3) points at distances ahead, m, turned to the right and then down by angles (n,)."""
    across = np.cos(down_rad)
    directions = [np.sin(right_rad) * across, np.sin(down_rad), np.cos(right_rad) * across]
    return np.asarray(np.expand_dims(distance_m, -1) * np.stack(directions, axis=-1))


def predict_depth_errors(
    calibration: HeadCalibration, points_from_eyes_m: FloatArray
) -> DepthErrors:
    """Predict the errors of depth of the nominal head, and those that the calibration leaves.

    The calibrated head fixates (n, 3) points in N, relative to midway between the eyes; both heads
    triangulate them from the same joint angles and pixels. The uncertainty is to first order in the
    head's parameters, with derivatives by central differences.
    """
    head, nominal, fit = calibration.head, calibration.nominal_head, calibration.solution
    points = midpoint_between_cameras(head) + points_from_eyes_m
    distance = np.linalg.norm(points_from_eyes_m, axis=-1)
    along = points_from_eyes_m / distance[:, None]
    q, sees = fixation_angles_and_visibility(head, points)
    pixels = head.project(q, points)
    fix = triangulate_views(head, q, pixels)
    off = triangulate_views(nominal, q, pixels).point - points
    values, spread = fit.state.head_parameters, fit.problem.prior_sigma
    sigma = depth_sigma_by_head(nominal, values, spread, calibration.covariance, (q, pixels), along)
    floor = np.einsum("pi,pij,pj->p", along, fix.covariance, along)
    errors = (off * along).sum(axis=-1), np.linalg.norm(off, axis=-1), sigma, floor**0.5
    return DepthErrors(distance, *(np.where(sees, values, np.nan) for values in errors))


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
        frames = solution.problem.frames
        normal, *parts = solution.normal_and_frame_parts()
        squares, measured, taken = solution.squares_and_counts
        first = np.unique(frames.pose, return_index=True)[1]
        blocks, slopes = (np.add.reduceat(each, first) for each in parts)
        return cls(
            solution, solution.problem.frame_columns[first], blocks, slopes, normal.matrix,
            normal.gradient, squares, measured - taken, float(frames.time_s[-1]),
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
        there = restart(late, state)
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
            more,
            solution=self.solution,
            columns=np.concatenate([self.columns, more.columns]),
            blocks=np.concatenate([self.blocks, more.blocks]),
            slopes=np.concatenate([self.slopes, more.slopes]),
            matrix=self.matrix + padded[:-1, :-1],
            gradient=self.gradient + pull[:-1],
            squares=self.squares + more.squares,
            freedom=self.freedom + more.freedom,
        )

    def preview(self) -> CalibrationPreview | None:
        """Solve the equations; None if they do not determine depth."""
        problem, state = self.solution.problem, self.solution.state
        step = np.append(-cho_solve(cho_factor(self.matrix), self.gradient), 0.0)
        squares = self.squares + float(self.gradient @ step[:-1])
        chi = float(np.sqrt(squares / max(self.freedom - problem.shared_count, 1.0)))
        slopes = self.slopes + np.einsum("fst,ft->fs", self.blocks, step[self.columns])
        groups = np.arange(len(slopes)) * min(len(slopes), _MOST_GROUPS) // len(slopes)
        covariance = judge.clustered_head_covariance(
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
        covariance = judge.head_and_term_covariance(found)
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
