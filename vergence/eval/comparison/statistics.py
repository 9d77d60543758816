"""Summaries of trials with bootstrap confidence intervals, reproducible by their seed.

Trials are resampled with replacement, a thousand times. The random generator depends only on the
seed and the number of trials, so two controllers that ran the same trials get the same resamples.
The interval of their ratio is therefore a paired one: the difficulty of a trial common to both
cancels.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.parts import FloatArray

RESAMPLES: Final = 1000
"""Bootstrap resamples of an interval (chosen: precision of its ends against time)."""
LEVEL: Final = 0.95
"""Confidence level: fraction of such intervals that hold the value of the whole population of
trials (chosen)."""
_MOST_BLOCK_VALUES: Final = 2_000_000
"""Most values resampled at once, a bound on memory (numerical)."""

Statistic = Callable[[FloatArray], FloatArray]
"""Function from (..., n) values to (...), over the last axis."""


class ConfidenceInterval(NamedTuple):
    """A statistic and its confidence interval at the level `LEVEL`."""

    value: float
    low: float
    high: float


def median(values: FloatArray) -> FloatArray:
    """The median over the last axis."""
    return np.asarray(np.median(values, axis=-1))


def mean(values: FloatArray) -> FloatArray:
    """The mean over the last axis; for booleans, the fraction that is true."""
    return np.asarray(np.mean(values, axis=-1))


def percentile(values: FloatArray, percent: float) -> FloatArray:
    """A percentile over the last axis: the higher of the two nearest values, not interpolated.

    Interpolation is undefined between infinite values.
    """
    return np.asarray(np.percentile(values, percent, axis=-1, method="higher"))


p95: Final[Statistic] = partial(percentile, percent=95.0)


class Bootstrap:
    """Intervals for statistics of n trials.

    Args:
        num: number of trials, n.
        seed: seed of the resampling.
        resamples: number of resamples.
    """

    def __init__(self, num: int, seed: int = 0, resamples: int = RESAMPLES) -> None:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, num])))
        rows = max(1, _MOST_BLOCK_VALUES // num)
        self._blocks: list[NDArray[np.int32]] = [
            rng.integers(num, size=(min(rows, resamples - begin), num), dtype=np.int32)
            for begin in range(0, resamples, rows)
        ]

    def interval(self, values: ArrayLike, statistic: Statistic) -> ConfidenceInterval:
        """A statistic of all trials with its interval.

        Args:
            values: (n,) one per trial.
            statistic: the statistic.

        Returns:
            The value and its percentile interval.
        """
        array = np.asarray(values)
        if (array == array[0]).all():  # nothing to resample
            value = float(statistic(array))
            if array.dtype == np.bool_:
                return _unanimous(value, len(array))
            return ConfidenceInterval(value, value, value)
        return _interval(float(statistic(array)), self._resampled(array, statistic))

    def ratio(
        self, numerator: ArrayLike, denominator: ArrayLike, statistic: Statistic
    ) -> ConfidenceInterval:
        """The ratio of a statistic of two controllers on the same trials, with its interval.

        Args:
            numerator: (n,) values of the numerator, one per trial.
            denominator: (n,) values of the denominator, one per trial.
            statistic: the statistic.

        Returns:
            The ratio and its paired interval.
        """
        top, bottom = np.asarray(numerator), np.asarray(denominator)
        drawn = self._resampled(top, statistic) / self._resampled(bottom, statistic)
        return _interval(float(statistic(top) / statistic(bottom)), drawn)

    def _resampled(self, values: NDArray[Any], statistic: Statistic) -> FloatArray:
        return np.concatenate([statistic(values[block]) for block in self._blocks])


def _unanimous(value: float, num: int) -> ConfidenceInterval:
    """The exact (Clopper-Pearson) interval of a fraction that is 0 or 1."""
    far = (0.5 * (1.0 - LEVEL)) ** (1.0 / num)
    return (
        ConfidenceInterval(value, far, 1.0)
        if value == 1.0
        else ConfidenceInterval(value, 0.0, 1.0 - far)
    )


def _interval(value: float, drawn: FloatArray) -> ConfidenceInterval:
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(drawn, [tail, 100.0 - tail], method="nearest")
    return ConfidenceInterval(value, float(low), float(high))
