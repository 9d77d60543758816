"""Which errors of a head are fitted: parameters, readings, backlash; chosen by held-out poses."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from vergence.calibration.head.adjust import (
    TERM_KINDS,
    HeadAdjustment,
    HeadUnknowns,
    MeasurementWeights,
)
from vergence.calibration.head.fit import (
    HeadSolution,
    masked_mean,
    parameter_prior_sigma,
    refit_inliers_and_scatter,
    restart,
    solve,
)
from vergence.calibration.least_squares import ReducedNormalEquations
from vergence.errors import ConfigurationError
from vergence.models.geometry import JointAxes, multiply_poses
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray

FOLDS: Final = 5
"""Folds of the cross-validation (chosen: more take longer)."""
_FOLD_TOLERANCE: Final = 1.0
"""Change of the cost below which a fold's fit ends (numerical)."""


def cross_validate_by_pose(
    solution: HeadSolution, kept_corners: NDArray[np.bool_], scatter_ratio: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Judge views and readings by heads calibrated without their poses; (2, f, n) kept corners.

    Returns:
        (2, f) mean square of the corners of views, in units of sigma^2, and (poses) mean square of
        the corners plus mean square of the reading errors; nan without kept corners. One reading
        weighs as much as many corners, as its error is estimated from them.
    """
    problem, state, pose = solution.problem, solution.state, solution.problem.frames.pose
    views = np.full(kept_corners.shape[:2], np.nan)
    poses = np.full(int(pose.max()) + 1, np.nan)
    fold = pose * FOLDS // len(poses)
    for each in range(FOLDS):
        out = fold == each
        if not kept_corners[:, out].any() or not kept_corners[:, ~out].any():
            continue
        trained = problem.select(~out)
        known = MeasurementWeights.of(kept_corners[:, ~out])
        found = solve(trained, restart(trained, state), known, tolerance=_FOLD_TOLERANCE)
        # fit only the board and the reading errors of these frames again
        judged = replace(
            problem.select(out),
            nominal_head=found.head,
            prior_sigma=np.zeros(len(problem.prior_sigma)),
            terms=problem.terms.select(out).fixed_at(found.state.term_parameters),
            scatter_ratio=problem.scatter_ratio if scatter_ratio is None else scatter_ratio,
        )
        start = judged.start(state.boards)._replace(board_curvatures=state.board_curvatures)
        counted = kept_corners[:, out]
        best = solve(judged, start, MeasurementWeights.of(counted), tolerance=_FOLD_TOLERANCE)
        views[:, out] = masked_mean(best.squares, counted)
        total, count = np.where(counted, best.squares, 0.0).sum(axis=-1), counted.sum(axis=-1)
        own = judged.reading_error_unknowns.has_frame_error & np.asarray(count.any(axis=0))[:, None]
        for number in np.unique(pose[out]):
            here = pose[out] == number
            if count[:, here].any():
                squares = (best.normalised_reading_errors[here] ** 2)[own[here]]
                read = squares.sum() / max(own[here].sum(), 1)
                poses[number] = total[:, here].sum() / count[:, here].sum() + read
    return views, poses


def with_backlash(head: HeadModel, actuator_backlash_rad: FloatArray) -> HeadModel:
    """Set (7,) widths of backlash, not the neck's; one, the largest, if joints have own motors."""
    eyes = actuator_backlash_rad[EYES][: head.actuation.count]
    one = head.actuators is None
    sensor: dict[str, float | str] = {"backlash_rad": float(eyes.max(initial=0.0)) if one else 0.0}
    if eyes.any():
        sensor["encoder_side"] = "motor"
    own: dict[str, Any] = {} if one else {"actuators": {"backlash_rad": eyes}}
    return head.replace(sensor=sensor, **own)


_DROPPED_KEY_PREFIXES: Final = ("links", "eyes")
"""Prefixes of assumption keys that refer to D-H numbers, which the converted head lacks."""
AUTO: Final = "auto"
TERMS: Final = (*TERM_KINDS, "axes")
_FALSE_TRIAL_PROBABILITY: Final = 1e-3
"""Probability that an absent term is tried, if all errors are independent (chosen)."""
_LEAST_GAIN: Final = 0.02
"""Least gain of a term in the mean logarithm of the poses' mean squares by
`cross_validate_by_pose` (chosen: less is not worth a term)."""
_LEAST_GAIN_OF_PLAY: Final = 0.15
"""Least gain of backlash if readings scatter even with it. A reading error also changes the
difference to the previous reading, whose sign then predicts some of the error, just as with
backlash (chosen: readings that scatter by 0.1 degrees, four times their steps, gain 0.06 so)."""
_LEAST_TRIAL_FRACTION: Final = 0.5 * _LEAST_GAIN
"""Fraction of the mean squares of corners and readings, 2 together, by which a first step has to
reduce them for the term to be tried (chosen: the final reduction may be larger)."""
_MOST_FRAMES: Final = 200
"""Approximate number of frames on which terms are tried (chosen: more take longer)."""
_SIGNIFICANT_SIGMAS: Final = 2.0
"""Standard errors by which the mean gain over the poses has to exceed zero (chosen)."""


def parse_terms(text: str) -> tuple[str, ...]:
    """Parse terms: `none`, `auto`, or some of `TERMS` with commas between them."""
    terms = tuple(dict.fromkeys(text.split(","))) if text != "none" else ()
    if terms != (AUTO,) and not set(terms) <= set(TERMS):
        raise ConfigurationError(
            f"terms: expected none, {AUTO}, or some of {','.join(TERMS)}, got {text!r}"
        )
    return terms


def convert_for_terms(head: HeadModel, terms: Collection[str]) -> HeadModel:
    """Convert a head for terms: `axes` need joint axes, `play` a head without backlash."""
    head = dh_to_joint_axes(head) if "axes" in terms else head
    return with_backlash(head, np.zeros(7)) if "play" in terms else head


def choose_terms(
    fit: HeadSolution, estimate_cameras: bool
) -> tuple[HeadSolution, HeadSolution | None]:
    """Add the terms that a recording calls for, most significant first.

    Returns:
        The fit with those that a head's file can hold, which are not harmonics: readings are not
        corrected by them, so that the other parameters are best without them. If the recording
        calls for harmonics, also a fit of some frames with them, only to be reported; else None.
    """
    chosen: tuple[str, ...] = ()
    left, some = set(TERMS), _thinned(fit)
    while left:
        gains = _gains(some, chosen, left, estimate_cameras)
        if not gains:
            break
        best = max(gains, key=lambda term: gains[term])
        left.discard(best)
        with suppress(np.linalg.LinAlgError):  # the fit with this term fails
            richer = _richer(some, (*chosen, best), estimate_cameras)
            scatters = np.any(richer.problem.scatter_ratio != 1.0)
            least = _LEAST_GAIN_OF_PLAY if best == "play" and scatters else _LEAST_GAIN
            if _predicts_better(richer, some, least):
                some, chosen = richer, (*chosen, best)
    lasting = tuple(term for term in chosen if term != "harmonics")
    best_fit = _richer(fit, lasting, estimate_cameras) if lasting else fit
    return best_fit, some if lasting != chosen else None


def _thinned(fit: HeadSolution) -> HeadSolution:
    """Fit some of the frames of each pose, which select terms as well in less time."""
    own, state = fit.problem, fit.state
    frames = len(own.frames.time_s)
    some = np.arange(frames) % -(-frames // _MOST_FRAMES) == 0
    if some.all():
        return fit
    problem, kept = own.select(some), fit.kept_corners[:, some]
    start = restart(problem, state)._replace(frame_errors=state.frame_errors[some])
    return solve(problem, start, MeasurementWeights.of(kept))


def _richer(fit: HeadSolution, terms: Collection[str], cameras: bool) -> HeadSolution:
    """Fit the head with terms."""
    problem, start = _extended(fit, terms, cameras)
    # estimate the scatter of the readings again, as a term may explain it
    problem = replace(problem, scatter_ratio=np.ones(7))
    return refit_inliers_and_scatter(solve(problem, start, MeasurementWeights.of(fit.kept_corners)))


def _extended(
    solution: HeadSolution, terms: Collection[str], cameras: bool
) -> tuple[HeadAdjustment, HeadUnknowns]:
    """Extend a problem by terms; start from the same head."""
    own, state = solution.problem, solution.state
    nominal_head = convert_for_terms(own.nominal_head, terms)
    reading_terms = own.terms.with_terms(nominal_head, terms)
    problem = HeadAdjustment(
        nominal_head,
        parameter_prior_sigma(nominal_head, cameras),
        own.frames,
        scatter_ratio=own.scatter_ratio,
        terms=reading_terms,
    )
    known = dict(zip(own.terms.names, state.term_parameters.tolist(), strict=True))
    start = problem.start(state.boards)._replace(
        head_parameters=convert_for_terms(solution.head, terms).parameters(nominal_head).values,
        board_curvatures=state.board_curvatures,
        frame_errors=state.frame_errors,
        term_parameters=np.array([known.get(name, 0.0) for name in reading_terms.names]),
    )
    if len(start.shared_errors) == len(state.shared_errors):
        start = start._replace(shared_errors=state.shared_errors)
    return problem, start


def _gains(
    solution: HeadSolution, chosen: tuple[str, ...], left: Collection[str], cameras: bool
) -> dict[str, float]:
    """Reduction of squares by one step relative to chance, of terms worth a trial."""
    gains: dict[str, float] = {}
    chance: dict[str, float] = {}
    new = [term for term in TERM_KINDS if term in left]
    if new:
        problem, start = _extended(solution, (*chosen, *new), cameras)
        normal = problem.linearised(start, solution.weights)
        kinds = np.full(problem.shared_count, "", dtype=object)
        first = problem.common_count - len(problem.terms.names)
        kinds[first : problem.common_count] = problem.terms.kinds
        for term in new:
            mine = kinds == term
            others = ~mine & ~np.isin(kinds, [each for each in new if each != term])
            chance[term] = _chance(int(mine.sum()))
            gains[term] = _gain(normal, mine, others) / chance[term]
    if "axes" in left and not isinstance(solution.problem.nominal_head.links, JointAxes):
        problem, start = _extended(solution, (*chosen, "axes"), cameras)
        normal = problem.linearised(start, solution.weights)
        every = np.ones(problem.shared_count, dtype=np.bool_)
        chance["axes"] = _chance(len(problem.nominal_head.links.parameters))
        gains["axes"] = _gain(normal, every, ~every) / chance["axes"]
    noise = max(solution.reduced_chi, 1.0) ** 2
    # while a term is missing, its error enlarges the readings' sigma and so reduces the gain
    own = solution.problem.reading_error_unknowns.has_frame_error
    belief = float(solution.problem.scatter_ratio.max()) ** 2
    worth = _LEAST_TRIAL_FRACTION * 2.0 * own.sum() / belief
    return {
        term: gain / noise
        for term, gain in gains.items()
        if gain > noise and gain * chance[term] > worth
    }


def _gain(
    normal: ReducedNormalEquations, mine: NDArray[np.bool_], others: NDArray[np.bool_]
) -> float:
    """Predict the reduction of the sum of squares if some unknowns move and others follow."""
    M, slope = normal.matrix, normal.gradient
    across = np.linalg.solve(M[np.ix_(others, others)], M[np.ix_(others, mine)])
    own = M[np.ix_(mine, mine)] - M[np.ix_(mine, others)] @ across
    pull: FloatArray = slope[mine] - across.T @ slope[others]
    return float(pull @ np.linalg.solve(own, pull))


def _chance(numbers: int) -> float:
    """Bound on the reduction of the sum of squares by chance; inf without parameters."""
    return float(chi2.ppf(1.0 - _FALSE_TRIAL_PROBABILITY, numbers)) if numbers else np.inf


def _predicts_better(richer: HeadSolution, simpler: HeadSolution, least: float) -> bool:
    """True if a term's mean log gain on held-out poses is significant and reaches `least`."""
    kept = richer.kept_corners & simpler.kept_corners
    # judge the readings of both heads by the richer head's sigma
    rich, simple = richer.problem, simpler.problem
    sigma = [each.reading_error_unknowns.reading_sigma for each in (rich, simple)]
    ratio = np.divide(sigma[0], sigma[1], out=np.ones(7), where=sigma[1] > 0.0)
    _, simple_squares = cross_validate_by_pose(simpler, kept, ratio * simple.scatter_ratio)
    _, rich_squares = cross_validate_by_pose(richer, kept)
    less = np.log(simple_squares) - np.log(rich_squares)
    less = less[np.isfinite(less)]
    surely = _SIGNIFICANT_SIGMAS * np.std(less) / np.sqrt(max(len(less), 1))
    return len(less) > 1 and bool(np.mean(less) >= max(surely, least))


def dh_to_joint_axes(head: HeadModel) -> HeadModel:
    """Convert a head with D-H links to one with a free axis per joint; its geometry stays."""
    if isinstance(head.links, JointAxes):
        return head
    bodies = head.links.bodies()
    links = JointAxes(
        names=tuple(body.name for body in bodies),
        parts=tuple(_part(body.joints) for body in bodies),
        pose=np.array([body.pose for body in bodies]),
        frame=head.links.frame,
    )
    mounts = np.array([head.links.camera_mount(eye) for eye in range(2)])
    record = head.calibration
    if record is not None:
        cameras = {name: each for name, each in record.sigma.items() if ".camera." in name}
        record = replace(record, sigma=cameras)
    return replace(
        head,
        links=links,
        cameras=head.cameras.replaced(pose=multiply_poses(mounts, head.head_eye)),
        calibration=record,
        assumptions={
            key: why
            for key, why in head.assumptions.items()
            if not key.startswith(_DROPPED_KEY_PREFIXES)
        },
    )


def _part(joints: tuple[int, ...]) -> str:
    if joints[0] < NECK.stop:
        return "neck"
    return "both" if len(joints) > 1 else ("left", "right")[(joints[0] - NECK.stop) // 2]
