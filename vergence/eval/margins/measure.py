"""Trials with one imperfection fixed at a value, compared with trials of the unmodified scenario.

The reference trials have the same targets and random numbers, and no imperfection is moved.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.plants.variation import Variation
from vergence.eval.trials.results import Trials
from vergence.eval.trials.scenarios import Scenario

_BAND_NOISE_SIGMAS: Final = 3.0
"""Least settling band, in standard deviations of the detection noise (chosen)."""
_LEAST_SETTLED_PERCENT: Final = 99
"""Least percentage of the reference trials that settle which has to settle still (chosen)."""
_SLOWDOWN_LIMIT: Final = 2.0
"""Ratio of median settle times from which a controller counts as too slow (chosen)."""


class MarginPoint(NamedTuple):
    """Results at a value of an imperfection, over trials that settle in the unmodified scenario."""

    value: float
    band_px: float
    """The band of settling, px."""
    trials: int
    """Number of trials that settle in the unmodified scenario."""
    settled: int
    """Number of these that still settle."""
    median_s: float
    """Their median settle time, s, with inf for trials that do not settle: inf if half of them or
    more do not; nan if none settles in the unmodified scenario."""
    untouched_median_s: float
    """Median settle time of these trials in the unmodified scenario, to the same band, s."""
    swinging: int = 0
    """Number of all trials at this value that swing, see
    `vergence.eval.trials.fixation.detect_oscillation`; none of them counts as settled."""

    @property
    def settles(self) -> bool:
        """True if 99 % still settle."""
        return self.trials > 0 and 100 * self.settled >= _LEAST_SETTLED_PERCENT * self.trials

    @property
    def median_not_doubled(self) -> bool:
        """True if the median is less than twice the one in the unmodified scenario."""
        return self.median_s < _SLOWDOWN_LIMIT * self.untouched_median_s


def with_imperfection(scenario: Scenario, imperfection: str, value: float) -> Scenario:
    """Copy a scenario with one imperfection fixed at a value in every trial.

    Args:
        scenario: the scenario.
        imperfection: the imperfection.
        value: its value.
    """
    variation = scenario.variation or Variation()
    fixed: dict[str, Any] = {imperfection: (value, value)}
    duration_s = scenario.duration_s
    if imperfection == "onset_s":
        # trials with a later onset are longer, to leave the same time
        duration_s += max(0.0, value - variation.largest_value("onset_s", 0.0))
    return replace(
        scenario,
        variation=replace(variation, **fixed),
        duration_s=duration_s,
    )


def noise_widened_band_px(scenario: Scenario, imperfection: str, value: float) -> float:
    """Settling band: the scenario's, or three standard deviations of the detection noise if larger.

    Noise limits how well a controller knows the target, and so how still it can hold the eyes.
    Nothing else widens the band: the judged error is the true one, which can be small in spite of
    outliers, backlash and encoder quantisation.

    Args:
        scenario: the scenario.
        imperfection: the imperfection that is varied.
        value: its value.
    """
    if imperfection != "detection_noise_px":
        return scenario.band_px
    return max(scenario.band_px, _BAND_NOISE_SIGMAS * value)


class MarginMeasurement:
    """Measurement of one controller in one scenario by value of an imperfection, cached.

    Args:
        run: callback that runs the controller's trials in a scenario.
        scenario: the unmodified scenario.
        imperfection: the imperfection that is varied.
    """

    def __init__(
        self, run: Callable[[Scenario], Trials], scenario: Scenario, imperfection: str
    ) -> None:
        self._run = run
        self._scenario = scenario
        self._name = imperfection
        self._unmodified = run(scenario)
        self._settled_unmodified = np.isfinite(self._unmodified.settle_s(scenario.band_px))
        self._found: dict[float, MarginPoint] = {}

    def __call__(self, value: float) -> MarginPoint:
        """Measure at a value, or return the earlier measurement."""
        if value not in self._found:
            self._found[value] = self._at(value)
        return self._found[value]

    @property
    def points(self) -> list[MarginPoint]:
        """All measurements, sorted by value."""
        return sorted(self._found.values())

    def _at(self, value: float) -> MarginPoint:
        band = noise_widened_band_px(self._scenario, self._name, value)
        count = int(self._settled_unmodified.sum())
        trials = self._run(with_imperfection(self._scenario, self._name, value))
        swinging = int(trials.swings.sum())
        if count == 0:
            return MarginPoint(value, band, 0, 0, np.nan, np.nan, swinging)
        settle_s = trials.settle_s(band)[self._settled_unmodified]
        return MarginPoint(
            value=value,
            band_px=band,
            trials=count,
            settled=int(np.isfinite(settle_s).sum()),
            median_s=float(np.median(np.where(np.isnan(settle_s), np.inf, settle_s))),
            # trials that settle to the scenario's band also settle to a wider one
            untouched_median_s=float(
                np.median(self._unmodified.settle_s(band)[self._settled_unmodified])
            ),
            swinging=swinging,
        )
