"""Calibration of a head from frames of a board, with checks of the result."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import rms_length
from vergence.calibration.head.adjust import HeadAdjustment, ReadingErrorTerms
from vergence.calibration.head.fit import (
    HeadSolution,
    estimate_consensus_board_poses,
    fit_robustly,
    parameter_prior_sigma,
)
from vergence.calibration.head.judge import (
    find_new_placement,
    find_small_board_motion,
    head_and_term_covariance,
    refuse_few_poses,
    refuse_fixed_eyes,
    refuse_implausible_solution,
    refuse_swapped_eyes,
    remark_on_changed_baseline,
    remark_on_few_views,
)
from vergence.calibration.head.recording import HeadFrames, sort_and_clean_frames
from vergence.calibration.head.terms import (
    AUTO,
    choose_terms,
    convert_for_terms,
    cross_validate_by_pose,
    with_backlash,
)
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray

_MOST_PLACEMENTS: Final = 8
"""Most fits to a recording, each after the first with another placement of the board (chosen)."""
_HARMONICS_HINT: Final = (
    ": a head file cannot store them; --terms harmonics estimates them, and calibrates the head "
    "for readings corrected by them"
)
_JOINT_AXES_REMARK: Final = (
    "the joints are described by their axes one by one, which may be turned in ways that D-H "
    "numbers lack"
)
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
    kept_corners: NDArray[np.bool_]
    """(2, f, n) True for kept corners, the inliers."""
    held_out_mean_squares: FloatArray
    """(2, f) mean squares of views by heads that were calibrated without them, in units of sigma^2;
    nan for views without kept corners."""
    recording_remarks: tuple[str, ...]
    """Remarks on the recording, a line each."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the recording and the calibration, a line each."""
        solution = self.solution
        said = (
            *term_remarks(solution, self.terms),
            *_noisy(solution),
            *remark_on_changed_baseline(solution),
        )
        return (*self.recording_remarks, *said)

    @property
    def nominal_head(self) -> HeadModel:
        """The nominal head, from its file."""
        return self.solution.problem.nominal_head

    @cached_property
    def head(self) -> HeadModel:
        """The calibrated head."""
        if not self.solution.problem.terms.is_backlash.any():
            return self.solution.head
        return with_backlash(self.solution.head, significant_backlash(self.solution, self.terms))

    @cached_property
    def terms(self) -> tuple[FittedTerm, ...]:
        """Parameters of the reading-error terms."""
        return fitted_terms(self.solution, self._covariance)

    @property
    def frames(self) -> HeadFrames:
        """Frames of the board."""
        return self.solution.problem.frames

    @property
    def kept_views(self) -> NDArray[np.bool_]:
        """(2, f) True for kept views, with at least one kept corner."""
        return np.asarray(self.kept_corners.any(axis=-1))

    @cached_property
    def rms_px(self) -> float:
        """Root mean square length of the kept corners' residuals, px."""
        left = self.solution.normal.residuals * self.frames.sigma
        return rms_length(left[self.kept_corners])

    @cached_property
    def rms_heldout_px(self) -> float:
        """Cross-validation counterpart of `rms_px`, by heads calibrated without the view, px."""
        mean = (
            np.nanmean(self.held_out_mean_squares)
            if np.isfinite(self.held_out_mean_squares).any()
            else np.nan
        )
        sigma = self.frames.sigma[self.kept_corners]
        return float(np.sqrt(2.0 * mean * np.mean(sigma**2)))

    @property
    def covariance(self) -> FloatArray:
        """(p, p) covariance of `HeadModel.parameters`."""
        p = len(self.solution.problem.prior_mean)
        return self._covariance[:p, :p]

    @cached_property
    def _covariance(self) -> FloatArray:
        return head_and_term_covariance(self.solution)

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
    report = progress or _ignore
    refuse_fixed_eyes(head)
    frames = sort_and_clean_frames(frames)
    refuse_few_poses(frames)
    file, head = head, convert_for_terms(head, terms)
    remarks: list[str] = []
    try:
        start = estimate_consensus_board_poses(head, frames)
        refuse_swapped_eyes(head, frames, start)
        report(0.1)
        problem = HeadAdjustment(head, parameter_prior_sigma(head, estimate_cameras), start.frames)
        reading_terms = ReadingErrorTerms.of_frames(head, start.frames, terms)
        problem = replace(problem, terms=reading_terms)
        fit = fit_robustly(problem, start.boards, start.inlier_views)
        for place in range(1, _MOST_PLACEMENTS):
            report(0.1 + 0.6 * place / (place + 1.0))
            more = find_new_placement(fit.solution, fit.kept_corners)
            near = None if more is None else fit.solution.state
            if more is None:
                more = find_small_board_motion(fit.solution)
            if more is None:
                break
            remarks.append(more.remark)
            problem = replace(problem, frames=more.frames)
            fit = fit_robustly(problem, more.boards, more.inlier_views, near)
        refuse_implausible_solution(fit.solution, fit.kept_corners)
        report(0.7)
        if tuple(terms) == (AUTO,):
            fit, suspected = choose_terms(fit, estimate_cameras)
            if suspected is not None:
                remarks.append(harmonics_remark(suspected) + _HARMONICS_HINT)
        if type(fit.solution.head.links) is not type(file.links):
            remarks.append(_JOINT_AXES_REMARK)
        report(0.8)
        views = cross_validate_by_pose(fit.solution, fit.kept_corners).view_mean_squares
    except np.linalg.LinAlgError:
        raise ConfigurationError(
            "expected frames that agree on where the board is, got some that do not: is the target "
            "of that size, and do the joint angles belong to the images, with the head's signs and "
            "zeros?"
        ) from None
    report(1.0)
    return HeadCalibration(
        solution=fit.solution,
        kept_corners=fit.kept_corners,
        held_out_mean_squares=views,
        recording_remarks=(*remarks, *remark_on_few_views(start.frames, fit.kept_corners)),
    )


def _noisy(solution: HeadSolution) -> list[str]:
    """Report joints whose readings scatter more than quantisation and backlash explain."""
    scatter_ratio, sigma = (
        solution.problem.scatter_ratio,
        solution.problem.reading_error_unknowns.reading_sigma,
    )
    if scatter_ratio is None:
        return []
    names = [
        *solution.problem.nominal_head.joints[:3],
        *solution.problem.nominal_head.actuation.names,
    ]
    wide = [joint for joint in range(len(names)) if scatter_ratio[joint] > 1.0]
    if not wide:
        return []
    worst = max(wide, key=lambda joint: scatter_ratio[joint])
    return [
        f"the readings of {', '.join(names[joint] for joint in wide)} scatter more than their "
        f"quantisation and backlash explain, those of {names[worst]} by "
        f"{np.rad2deg(sigma[worst]):.2g} degrees, {scatter_ratio[worst]:.1f} times as much: is "
        "there more backlash, did the joints rest, and do the angles belong to the images?"
    ]


def _ignore(fraction: float) -> None:
    """Ignore the progress."""


def fitted_terms(solution: HeadSolution, covariance: FloatArray) -> tuple[FittedTerm, ...]:
    """List the parameters of a solution's reading-error terms."""
    p = len(solution.problem.prior_mean)
    sigma = np.sqrt(np.diagonal(covariance)[p:]).tolist()
    numbers = zip(
        solution.problem.terms.names, solution.state.term_parameters.tolist(), sigma, strict=True
    )
    return tuple(FittedTerm(name, value, deviation, "rad") for name, value, deviation in numbers)


def significant_backlash(solution: HeadSolution, terms: Sequence[FittedTerm]) -> FloatArray:
    """(7,) backlash by actuator, rad; 0 if not significant."""
    out = np.zeros(7)
    for term, joint, is_backlash in zip(
        terms,
        solution.problem.terms.actuator_index,
        solution.problem.terms.is_backlash,
        strict=True,
    ):
        if is_backlash and term.significant:
            out[joint] = max(term.value, 0.0)
    return out


def term_remarks(solution: HeadSolution, terms: Sequence[FittedTerm]) -> list[str]:
    """Remark on the terms found, and on those that the head's file cannot hold."""
    reading_terms, nominal_head = solution.problem.terms, solution.problem.nominal_head
    names = [*nominal_head.joints[:3], *nominal_head.actuation.names]
    lines = []
    play = significant_backlash(solution, terms)
    if play.any():
        line = f"the actuators have backlash, in degrees: {_listed(names, play)}"
        if nominal_head.actuators is None and play[NECK.stop :].any():
            line += "; the head's file has the greatest of the eyes' for all of them"
        if play[: NECK.stop].any():
            line += "; a head's file has no place for that of the neck"
        lines.append(line)
    if not reading_terms.is_backlash.all():
        lines.append(
            f"{harmonics_remark(solution)}: the head is that of readings which are corrected by "
            "the terms of result.json"
        )
    return lines


def harmonics_remark(solution: HeadSolution) -> str:
    """Remark on the size of the encoder harmonics."""
    reading_terms, nominal_head = solution.problem.terms, solution.problem.nominal_head
    waves = reading_terms.evaluate(
        np.where(reading_terms.is_backlash, 0.0, solution.state.term_parameters)
    )[0]
    names = [*nominal_head.joints[:3], *nominal_head.actuation.names]
    return (
        "the encoders' readings are off by harmonics of the angle, in degrees up to: "
        f"{_listed(names, 0.5 * np.ptp(waves, axis=0))}"
    )


def _listed(names: Sequence[str], angles: FloatArray) -> str:
    return ", ".join(
        f"{name} {np.rad2deg(angle):.2g}"
        for name, angle in zip(names, angles.tolist(), strict=False)
        if angle > 0.0
    )
