"""Optional terms of a head: which of them its recording calls for.

The numbers of a head's file leave out that its actuators have play, that its encoders' discs are
off their axes, and, by D-H numbers, that a joint is not parallel to the one before. Each is a term
that a calibration may have. It is tried where a step of its numbers alone would make the sum of
squares smaller than chance does, and taken if it predicts poses surely better that it has not seen.
"""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from vergence.calibration.head.adjust import HeadAdjustment, Normal, State, Weights
from vergence.calibration.head.fit import Fit, settled
from vergence.calibration.head.held_out import held_out
from vergence.calibration.head.play import without_play
from vergence.calibration.head.prior import spreads_of
from vergence.calibration.head.reading_terms import RULES
from vergence.calibration.head.solution import HeadSolution, solved
from vergence.errors import ConfigurationError
from vergence.models.by_axes import as_axes
from vergence.models.head import HeadModel
from vergence.models.joint_axes import JointAxes
from vergence.models.parts import FloatArray

AUTO: Final = "auto"
TERMS: Final = (*RULES, "axes")
_CHANCE: Final = 1e-3
"""Probability that a term is tried that is not there, if all errors are independent."""
_LEAST_GAIN: Final = 0.02
"""Of the logarithm of what is held against a pose, see `HeldOut`: less is not worth a term."""
_LEAST_GAIN_OF_PLAY: Final = 0.15
"""The same of play where readings scatter with it, too: an error of a reading is an error of its
change from the one before, by whose sign some of it is told, as if by play. With readings that
scatter by 0.1 degrees, four times their steps, that is 0.06."""
_WORTH: Final = 0.5 * _LEAST_GAIN
"""Share of the mean square of corners and readings, 2 together, that a first step has to take up
for the term to be tried: all that it takes up in the end may be more."""
_MOST_FRAMES: Final = 200
"""By which terms are tried."""
_SURELY: Final = 2.0
"""Standard errors of its mean over the poses."""


def parse_terms(text: str) -> tuple[str, ...]:
    """Terms from a word: `none`, `auto`, or some of `TERMS` with commas between them.

    Raises:
        ConfigurationError: it is none of these.
    """
    terms = tuple(dict.fromkeys(text.split(","))) if text != "none" else ()
    if terms != (AUTO,) and not set(terms) <= set(TERMS):
        raise ConfigurationError(
            f"terms: expected none, {AUTO}, or some of {','.join(TERMS)}, got {text!r}"
        )
    return terms


def described(head: HeadModel, terms: Collection[str]) -> HeadModel:
    """A head in the form that has the numbers of its terms."""
    head = as_axes(head) if "axes" in terms else head
    return without_play(head) if "play" in terms else head


class Chosen(NamedTuple):
    """The head with the terms that its recording calls for."""

    fit: Fit
    """With those that a head's file has a place for: harmonics have none, and without them the
    other numbers are best as they are without them."""
    suspected: HeadSolution | None
    """With harmonics, of some of the frames, where these are called for, too."""


def choose_terms(fit: Fit, cameras: bool) -> Chosen:
    """Add the terms that a recording calls for, most telling first.

    Args:
        fit: of the head without any.
        cameras: whether the cameras are free, see `spreads_of`.
    """
    chosen: tuple[str, ...] = ()
    left, some = set(TERMS), _thinned(fit)
    while left:
        gains = _gains(some.solution, chosen, left, cameras)
        if not gains:
            break
        best = max(gains, key=lambda term: gains[term])
        left.discard(best)
        with suppress(np.linalg.LinAlgError):  # a term that leads nowhere
            richer = _richer(some, (*chosen, best), cameras)
            scatters = np.any(richer.solution.problem.noisier != 1.0)
            least = _LEAST_GAIN_OF_PLAY if best == "play" and scatters else _LEAST_GAIN
            if _predicts_better(richer, some, least):
                some, chosen = richer, (*chosen, best)
    lasting = tuple(term for term in chosen if term != "harmonics")
    return Chosen(
        _richer(fit, lasting, cameras) if lasting else fit,
        some.solution if lasting != chosen else None,
    )


def _thinned(fit: Fit) -> Fit:
    """The fit of some of the frames of each pose, which tell terms as well in less time."""
    own, state = fit.solution.problem, fit.solution.state
    frames = len(own.frames.time_s)
    some = np.arange(frames) % -(-frames // _MOST_FRAMES) == 0
    if some.all():
        return fit
    problem, kept = own.of(some), fit.kept[:, some]
    start = problem.start(state.boards)._replace(
        values=state.values, bend=state.bend, errors=state.errors[some]
    )
    return Fit(solved(problem, start, Weights.of(kept)), kept)


def _richer(fit: Fit, terms: Collection[str], cameras: bool) -> Fit:
    """The fit with terms."""
    problem, start = _extended(fit.solution, terms, cameras)
    # how readings scatter is found anew: a term may explain it
    problem = replace(problem, noisier=None)
    return settled(solved(problem, start, Weights.of(fit.kept)))


def _extended(
    solution: HeadSolution, terms: Collection[str], cameras: bool
) -> tuple[HeadAdjustment, State]:
    """The same problem with terms, and the same head in it."""
    own, state = solution.problem, solution.state
    about = described(own.about, terms)
    rules = own.terms.with_rules(about, terms)
    problem = HeadAdjustment(
        about, spreads_of(about, cameras), own.frames, noisier=own.noisier, terms=rules
    )
    known = dict(zip(own.terms.names, state.terms.tolist(), strict=True))
    start = problem.start(state.boards)._replace(
        values=described(solution.head, terms).parameters(about).values,
        bend=state.bend,
        errors=state.errors,
        terms=np.array([known.get(name, 0.0) for name in rules.names]),
    )
    if len(start.shared) == len(state.shared):
        start = start._replace(shared=state.shared)
    return problem, start


def _gains(
    solution: HeadSolution, chosen: tuple[str, ...], left: Collection[str], cameras: bool
) -> dict[str, float]:
    """By how many times chance a step of each term's numbers makes the sum of squares smaller.

    Only of terms with which it is more than chance does.
    """
    gains: dict[str, float] = {}
    chance: dict[str, float] = {}
    new = [term for term in RULES if term in left]
    if new:
        problem, start = _extended(solution, (*chosen, *new), cameras)
        normal = problem.linearised(start, solution.weights)
        kinds = np.full(problem.size, "", dtype=object)
        first = problem.common - len(problem.terms.names)
        kinds[first : problem.common] = problem.terms.kinds
        for term in new:
            mine = kinds == term
            others = ~mine & ~np.isin(kinds, [each for each in new if each != term])
            chance[term] = _chance(int(mine.sum()))
            gains[term] = _gain(normal, mine, others) / chance[term]
    if "axes" in left and not isinstance(solution.problem.about.links, JointAxes):
        problem, start = _extended(solution, (*chosen, "axes"), cameras)
        normal = problem.linearised(start, solution.weights)
        every = np.ones(problem.size, dtype=np.bool_)
        chance["axes"] = _chance(len(problem.about.links.parameters))
        gains["axes"] = _gain(normal, every, ~every) / chance["axes"]
    noise = max(solution.noise, 1.0) ** 2
    # readings that scatter by an error that a term explains are believed less until it is there
    own, noisier = solution.problem.joints.own, solution.problem.noisier
    belief = 1.0 if noisier is None else float(noisier.max()) ** 2
    worth = _WORTH * 2.0 * own.sum() / belief
    return {
        term: gain / noise
        for term, gain in gains.items()
        if gain > noise and gain * chance[term] > worth
    }


def _gain(normal: Normal, mine: NDArray[np.bool_], others: NDArray[np.bool_]) -> float:
    """How much smaller the sum of squares is if some numbers move and others follow."""
    M, slope = normal.matrix, normal.slope
    across = np.linalg.solve(M[np.ix_(others, others)], M[np.ix_(others, mine)])
    own = M[np.ix_(mine, mine)] - M[np.ix_(mine, others)] @ across
    pull: FloatArray = slope[mine] - across.T @ slope[others]
    return float(pull @ np.linalg.solve(own, pull))


def _chance(numbers: int) -> float:
    """The sum of squares that so many numbers take up by chance at most; inf for none."""
    return float(chi2.ppf(1.0 - _CHANCE, numbers)) if numbers else np.inf


def _predicts_better(richer: Fit, simpler: Fit, least: float) -> bool:
    """Whether a head with a term surely does better on poses that it does not know, by so much."""
    kept = richer.kept & simpler.kept
    # readings are judged alike: as surely as the richer head takes them
    rich, simple = richer.solution.problem, simpler.solution.problem
    noisier = np.ones(7) if simple.noisier is None else simple.noisier
    known = simple.joints.sigma > 0.0
    ratio = np.divide(rich.joints.sigma, simple.joints.sigma, out=np.ones(7), where=known)
    less = np.log(held_out(simpler.solution, kept, ratio * noisier).poses) - np.log(
        held_out(richer.solution, kept).poses
    )
    less = less[np.isfinite(less)]
    surely = _SURELY * np.std(less) / np.sqrt(max(len(less), 1))
    return len(less) > 1 and bool(np.mean(less) >= max(surely, least))
