"""Reading-error terms found by a calibration: their parameters, and remarks for the user."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.head.solution import HeadSolution
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray

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
