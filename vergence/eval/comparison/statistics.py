"""Summaries of trials with bootstrap confidence intervals, the same for the same seed.

Trials are resampled with replacement, a thousand times, by a generator keyed by the seed and the
number of trials alone. Two controllers that ran the same trials are therefore resampled alike,
so that the interval of their ratio is a paired one: what makes a trial hard for both cancels.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.parts import FloatArray

RESAMPLES: Final = 1000
LEVEL: Final = 0.95
"""How often such an interval holds the value of all trials that could have been drawn."""
_BLOCK: Final = 2_000_000
"""Numbers resampled at once: a bound on memory."""

Statistic = Callable[[FloatArray], FloatArray]
"""(..., n) values to (...), over the last axis."""


class Interval(NamedTuple):
    """A value, and the interval it lies in with a probability of `LEVEL`."""

    value: float
    low: float
    high: float


def median(values: FloatArray) -> FloatArray:
    """The median over the last axis."""
    return np.asarray(np.median(values, axis=-1))


def mean(values: FloatArray) -> FloatArray:
    """The mean over the last axis: of booleans, the fraction that is true."""
    return np.asarray(np.mean(values, axis=-1))


def percentile(values: FloatArray, percent: float) -> FloatArray:
    """A percentile over the last axis: a value that occurred, the higher of the two nearest.

    Interpolation would have no answer between values that are infinite.
    """
    return np.asarray(np.percentile(values, percent, axis=-1, method="higher"))


p95: Final[Statistic] = partial(percentile, percent=95.0)


class Bootstrap:
    """Intervals for statistics of n trials.

    Args:
        num: n.
        seed: of the resampling.
        resamples: how often to resample.
    """

    def __init__(self, num: int, seed: int = 0, resamples: int = RESAMPLES) -> None:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, num])))
        rows = max(1, _BLOCK // num)
        self._blocks: list[NDArray[np.int32]] = [
            rng.integers(num, size=(min(rows, resamples - begin), num), dtype=np.int32)
            for begin in range(0, resamples, rows)
        ]

    def interval(self, values: ArrayLike, statistic: Statistic) -> Interval:
        """A statistic of all trials with its interval.

        Args:
            values: (n,) one a trial.
            statistic: of what.

        Returns:
            The value and its percentile interval.
        """
        array = np.asarray(values)
        if (array == array[0]).all():  # nothing to resample
            value = float(statistic(array))
            if array.dtype == np.bool_:
                return _unanimous(value, len(array))
            return Interval(value, value, value)
        return _interval(float(statistic(array)), self._resampled(array, statistic))

    def ratio(self, values: ArrayLike, others: ArrayLike, statistic: Statistic) -> Interval:
        """The ratio of a statistic of two controllers on the same trials, with its interval.

        Args:
            values: (n,) one a trial, the numerator's.
            others: (n,) one a trial, the denominator's.
            statistic: of what.

        Returns:
            The ratio and its paired interval.
        """
        top, bottom = np.asarray(values), np.asarray(others)
        drawn = self._resampled(top, statistic) / self._resampled(bottom, statistic)
        return _interval(float(statistic(top) / statistic(bottom)), drawn)

    def _resampled(self, values: NDArray[Any], statistic: Statistic) -> FloatArray:
        return np.concatenate([statistic(values[block]) for block in self._blocks])


def _unanimous(value: float, num: int) -> Interval:
    """The exact interval of a fraction where all trials, or none, have it (Clopper-Pearson)."""
    far = (0.5 * (1.0 - LEVEL)) ** (1.0 / num)
    return Interval(value, far, 1.0) if value == 1.0 else Interval(value, 0.0, 1.0 - far)


def _interval(value: float, drawn: FloatArray) -> Interval:
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(drawn, [tail, 100.0 - tail], method="nearest")
    return Interval(value, float(low), float(high))
