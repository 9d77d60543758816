"""Variation from trial to trial, hidden from the controller: latencies, lags, faults, the head.

A robot's loop never quite equals its model, and changes from day to day. A variation draws the loop
anew for each trial from the trial's own random stream, so that a trial is the same alone, in a
vector and after other trials.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

import numpy as np

from vergence.envs.plants.imperfections import (
    IMPERFECTIONS,
    Imperfections,
    is_valid_range,
    valid_range_text,
)
from vergence.envs.streams import (
    IntArray,
    KeyArray,
    StreamPurpose,
    random_words,
    to_normals,
    to_uniform,
)
from vergence.envs.validation import real_number_array
from vergence.errors import ConfigurationError, refuse_unknown
from vergence.kernels import compiled
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import DEVIATES, ModelErrors, as_model_errors, perturb_by_deviates

Range = tuple[float, float]

_VARIATION: Final = int(StreamPurpose.VARIATION)
RANGES: Final = tuple(IMPERFECTIONS)
"""Fields of `Variation` that are ranges."""


@dataclass(frozen=True, kw_only=True)
class Variation(Imperfections[Range | None]):
    """Ranges from which each trial draws its own conditions, uniformly; None for no variation.

    The ranges have the names of `vergence.envs.plants.imperfections`, such as
    `latency_s=(0.03, 0.13)`. An imperfection of actuators is drawn for each actuator separately.
    Without a range, the plant's option or the head's preset holds.
    """

    model_errors: ModelErrors | None = None
    """Standard deviations of the true head from its model."""

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _range(name, value))
        if self.model_errors is not None:
            errors = as_model_errors(self.model_errors, "variation.model_errors")
            object.__setattr__(self, "model_errors", errors)

    def largest_value(self, name: str, given: float) -> float:
        """Largest value of one of `RANGES` in any trial.

        Args:
            name: one of `RANGES`.
            given: the value if it is not drawn.
        """
        span: Range | None = getattr(self, name)
        return given if span is None else span[1]

    def ranges(self, names: tuple[str, ...]) -> FloatArray:
        """(n, 2) the ranges of these of `RANGES`; nan where nothing is drawn."""
        spans = (getattr(self, name) for name in names)
        return np.array([(np.nan, np.nan) if span is None else span for span in spans])

    def draw_head_deviates(self, seeds: KeyArray, trials: KeyArray) -> FloatArray:
        """Draw the random numbers of the true heads of trials.

        Args:
            seeds: (m,) the trials' seeds.
            trials: (m,) their numbers.

        Returns:
            (m, DEVIATES) standard normal numbers.
        """
        numbers = np.empty((len(seeds), DEVIATES))
        _draw_normals(seeds, trials, numbers)
        return numbers

    def make_true_heads(self, head: HeadModel, deviates: FloatArray) -> HeadModel:
        """Make the true heads of trials.

        Args:
            head: the model that they differ from.
            deviates: (m, DEVIATES) standard normal numbers.

        Returns:
            A population of shape (m,).
        """
        if self.model_errors is None:
            raise ConfigurationError("variation.model_errors: expected some, got None")
        geometry = perturb_by_deviates(head.geometry, self.model_errors, deviates)
        return dataclasses.replace(head, **geometry._asdict())


def make_variation(variation: Mapping[str, Any] | Variation | None) -> Variation | None:
    """Make a variation from its fields.

    Args:
        variation: fields, as `{"latency_s": (0.03, 0.13)}`; `model_errors` may be a mapping too.

    Raises:
        ConfigurationError: a field is unknown or has an invalid value.
    """
    if variation is None or isinstance(variation, Variation):
        return variation
    if not isinstance(variation, Mapping):
        raise ConfigurationError(f"variation: expected ranges by field, got {variation!r:.80}")
    refuse_unknown("variation", variation, Variation.__dataclass_fields__)
    return Variation(**variation)


def _range(name: str, value: Any) -> Range:
    try:
        low, high = map(float, real_number_array(value))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(
            f"variation.{name}: expected two numbers, got {value!r}"
        ) from error
    if not np.isfinite([low, high]).all():
        raise ConfigurationError(f"variation.{name}: expected finite numbers, got {value!r}")
    if not low <= high:
        raise ConfigurationError(f"variation.{name}: expected least <= greatest, got {value!r}")
    if not is_valid_range(name, low, high):
        raise ConfigurationError(
            f"variation.{name}: expected {valid_range_text(name)}, got {value!r}"
        )
    return low, high


@compiled
def draw_conditions(
    seeds: KeyArray,
    trials: KeyArray,
    ids: IntArray,
    trial_ranges: FloatArray,
    actuator_ranges: FloatArray,
    loop: FloatArray,
    own: FloatArray,
) -> None:
    """Draw the conditions of the trials of some environments, except their heads.

    Args:
        seeds: (n,) the trials' seeds.
        trials: (n,) their numbers.
        ids: (m,) environment indices.
        trial_ranges: (p, 2) the ranges of `PER_TRIAL`; nan where nothing is drawn.
        actuator_ranges: (k, 2) the ranges of `PER_ACTUATOR`; nan likewise.
        loop: (n, p + 1) conditions by trial; those that are drawn are replaced.
        own: (n, k, 7) conditions by actuator, likewise.
    """
    count, numbers = trial_ranges.shape[0], actuator_ranges.shape[0] * own.shape[2]
    for m in range(ids.shape[0]):
        n = ids[m]
        for lane in range((count + 3) // 4):
            words = random_words(seeds[n], trials[n], _VARIATION, 0, lane + 1)
            for i in range(4):
                at = 4 * lane + i
                if at < count and isfinite(trial_ranges[at, 0]):
                    low, high = trial_ranges[at, 0], trial_ranges[at, 1]
                    loop[n, at] = low + to_uniform(words[i]) * (high - low)
        for lane in range((numbers + 3) // 4):
            words = random_words(seeds[n], trials[n], _VARIATION, 2, lane + 1)
            for i in range(4):
                at = 4 * lane + i
                one, slot = at // own.shape[2], at % own.shape[2]
                if at < numbers and isfinite(actuator_ranges[one, 0]):
                    low, high = actuator_ranges[one, 0], actuator_ranges[one, 1]
                    own[n, one, slot] = low + to_uniform(words[i]) * (high - low)


@compiled
def _draw_normals(seeds: KeyArray, trials: KeyArray, numbers: FloatArray) -> None:
    """Fill one row of standard normal numbers per trial."""
    size = numbers.shape[1]
    for m in range(seeds.shape[0]):
        for lane in range((size + 3) // 4):
            words = random_words(seeds[m], trials[m], _VARIATION, 1, lane + 1)
            a, b = to_normals(words[0], words[1])
            c, d = to_normals(words[2], words[3])
            for i, number in enumerate((a, b, c, d)):
                if 4 * lane + i < size:
                    numbers[m, 4 * lane + i] = number
