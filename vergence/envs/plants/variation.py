"""What differs from trial to trial, hidden from the controller: delay, lag, noise, drops, the head.

A robot's loop is never quite the one its model describes, and not the same one every day. A
variation draws it anew for each trial from the trial's own stream, so that a trial is the same
alone, in a vector and after other trials.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, Final

import numpy as np

from vergence._jit import compiled
from vergence.envs.streams import (
    IntArray,
    KeyArray,
    Purpose,
    Streams,
    random_words,
    to_normals,
    to_uniform,
)
from vergence.errors import ConfigurationError, refuse_unknown
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.perturbation import DEVIATES, ModelErrors, as_model_errors, perturb_by

Range = tuple[float, float]

_VARIATION: Final = int(Purpose.VARIATION)
LONGEST_S: Final = 1.0
"""What every delay and lag of a trial is shorter than, s."""
# a range that a person writes in decimal seconds may miss a whole period by rounding
_ROUNDING: Final = 1e-6


@dataclass(frozen=True, kw_only=True)
class Variation:
    """Ranges from which each trial draws its own conditions, uniformly; None for no variation.

    The head's preset, or the plant's option, holds where nothing is drawn.
    """

    latency_s: Range | None = None
    """Time from exposure to reading, in whole control periods within the range, s."""
    lag_s: Range | None = None
    """Time constant of the joints' response, s."""
    detection_noise_px: Range | None = None
    """Standard deviation of the detection, px."""
    dropped_frame_probability: Range | None = None
    """Probability that a frame never arrives."""
    model_errors: ModelErrors | None = None
    """Standard deviations by which the true head differs from its model."""

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if value is not None:
                value = _range(f"variation.{name}", value)
                object.__setattr__(self, name, value)
            if value is not None and name.endswith("_s") and not value[1] < LONGEST_S:
                raise ConfigurationError(
                    f"variation.{name}: expected seconds below {LONGEST_S:g} (is it in "
                    f"milliseconds?), got {value!r}"
                )
        if self.dropped_frame_probability is not None and self.dropped_frame_probability[1] > 1.0:
            raise ConfigurationError(
                "variation.dropped_frame_probability: expected 0 to 1, "
                f"got {self.dropped_frame_probability}"
            )
        if self.model_errors is not None:
            errors = as_model_errors(self.model_errors, "variation.model_errors")
            object.__setattr__(self, "model_errors", errors)

    def latency_frames(self, head: HeadModel) -> tuple[int, int] | None:
        """The least and the greatest latency in control periods, None where it does not vary.

        Args:
            head: whose control periods they are.

        Raises:
            ConfigurationError: no whole number of periods lies in the range.
        """
        if self.latency_s is None:
            return None
        rate = head.timing.control_rate_hz
        low = ceil(self.latency_s[0] * rate - _ROUNDING)
        high = floor(self.latency_s[1] * rate + _ROUNDING)
        if low > high:
            raise ConfigurationError(
                "variation.latency_s: expected a range that holds a whole number of periods of "
                f"{1.0 / rate:.6g} s, got {self.latency_s}"
            )
        return low, high

    def draw(self, streams: Streams, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Draw for the trials of some places.

        Args:
            streams: the trials' random streams.
            ids: (m,) the places.

        Returns:
            (m, 4) numbers from 0 to below 1, a column for each of `RANGES`, and (m, DEVIATES)
            standard normal numbers; these are empty where the heads do not vary.
        """
        shares = np.empty((len(ids), len(RANGES)))
        size = DEVIATES if self.model_errors is not None else 0
        deviates = np.empty((len(ids), size))
        _draw(streams.seeds, streams.trials, ids, shares, deviates)
        return shares, deviates

    def heads(self, head: HeadModel, deviates: FloatArray) -> HeadModel:
        """The true heads of trials.

        Args:
            head: the model they differ from.
            deviates: (m, DEVIATES) standard normal numbers.

        Returns:
            A population of shape (m,).
        """
        if self.model_errors is None:
            raise ConfigurationError("variation.model_errors: expected some, got None")
        geometry = perturb_by(head.geometry, self.model_errors, deviates)
        return dataclasses.replace(head, **geometry._asdict())


RANGES: Final = ("latency_s", "lag_s", "detection_noise_px", "dropped_frame_probability")
"""The fields of `Variation` that are ranges, in the order of what `Variation.draw` returns."""


def make_variation(variation: Mapping[str, Any] | Variation | None) -> Variation | None:
    """A variation from its fields.

    Args:
        variation: such as `{"latency_s": (0.03, 0.13)}`; `model_errors` may be a mapping too.

    Raises:
        ConfigurationError: a field is unknown or has a value that cannot be.
    """
    if variation is None or isinstance(variation, Variation):
        return variation
    if not isinstance(variation, Mapping):
        raise ConfigurationError(f"variation: expected ranges by field, got {variation!r:.80}")
    refuse_unknown("variation", variation, Variation.__dataclass_fields__)
    return Variation(**variation)


def _range(name: str, value: Any) -> Range:
    try:
        low, high = (float(bound) for bound in value)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name}: expected two numbers, got {value!r}") from error
    if not 0.0 <= low <= high < np.inf:
        raise ConfigurationError(f"{name}: expected 0 <= least <= greatest, got {value!r}")
    return low, high


@compiled
def _draw(
    seeds: KeyArray, trials: KeyArray, ids: IntArray, shares: FloatArray, deviates: FloatArray
) -> None:
    """Fill a row for each place; the first block is uniform, the second normal numbers."""
    size = deviates.shape[1]
    for m in range(ids.shape[0]):
        n = ids[m]
        words = random_words(seeds[n], trials[n], _VARIATION, 0, 1)
        for i in range(4):
            shares[m, i] = to_uniform(words[i])
        for lane in range((size + 3) // 4):
            words = random_words(seeds[n], trials[n], _VARIATION, 1, lane + 1)
            a, b = to_normals(words[0], words[1])
            c, d = to_normals(words[2], words[3])
            for i, number in enumerate((a, b, c, d)):
                if 4 * lane + i < size:
                    deviates[m, 4 * lane + i] = number
