"""Trials with one imperfection at one value, compared with the same trials untouched."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.plants.variation import Variation
from vergence.eval.trials.results import Trials
from vergence.eval.trials.scenarios import Scenario

_DEVIATIONS: Final = 3.0
_SETTLING_PERCENT: Final = 99
_SLOWER: Final = 2.0


class Point(NamedTuple):
    """What the trials that settle untouched come to at one value of an imperfection."""

    value: float
    band_px: float
    """The band of settling, px."""
    trials: int
    """How many settle untouched."""
    settled: int
    """How many of these still settle."""
    median_s: float
    """Their median settling time, where those that do not settle never do: inf where these are
    half of them or more; nan where none settles untouched."""
    untouched_median_s: float
    """The same of the untouched trials in the same band."""
    swinging: int = 0
    """How many of all trials at this value swing, see `vergence.eval.trials.fixation.swings`; of
    these none counts as settled."""

    @property
    def settles(self) -> bool:
        """Whether 99 % still settle."""
        return self.trials > 0 and 100 * self.settled >= _SETTLING_PERCENT * self.trials

    @property
    def keeps_pace(self) -> bool:
        """Whether the median is less than twice that of the untouched trials."""
        return self.median_s < _SLOWER * self.untouched_median_s


def moved(scenario: Scenario, name: str, value: float) -> Scenario:
    """A scenario with an imperfection at one value in every trial, all else as it is.

    Args:
        scenario: the scenario.
        name: the imperfection.
        value: what it is.
    """
    variation = scenario.variation or Variation()
    fixed: dict[str, Any] = {name: (value, value)}
    duration_s = scenario.duration_s
    if name == "onset_s":
        # what begins later has as much time
        duration_s += max(0.0, value - variation.greatest("onset_s", 0.0))
    return replace(
        scenario,
        variation=replace(variation, **fixed),
        duration_s=duration_s,
    )


def band_px(scenario: Scenario, name: str, value: float) -> float:
    """The band of settling: the scenario's, or three standard deviations of the noise.

    A controller that sees the target only through noise cannot keep its eyes stiller than it knows
    where to look. Nothing else widens the band: what is judged is the true error of the eyes, and
    neither outliers nor play nor steps of encoders keep it from being small.

    Args:
        scenario: the scenario.
        name: the imperfection that is moved.
        value: what it is.
    """
    if name != "detection_noise_px":
        return scenario.band_px
    return max(scenario.band_px, _DEVIATIONS * value)


class Measure:
    """Measures one controller in one scenario, each value once.

    Args:
        run: runs the controller's trials in a scenario.
        scenario: the scenario.
        name: the imperfection that is moved.
    """

    def __init__(self, run: Callable[[Scenario], Trials], scenario: Scenario, name: str) -> None:
        self._run = run
        self._scenario = scenario
        self._name = name
        self._untouched = run(scenario)
        self._those = np.isfinite(self._untouched.settle_s(scenario.band_px))
        self._found: dict[float, Point] = {}

    def __call__(self, value: float) -> Point:
        """What the trials come to at a value."""
        if value not in self._found:
            self._found[value] = self._at(value)
        return self._found[value]

    @property
    def points(self) -> list[Point]:
        """All that has been measured, by value."""
        return sorted(self._found.values())

    def _at(self, value: float) -> Point:
        band = band_px(self._scenario, self._name, value)
        count = int(self._those.sum())
        trials = self._run(moved(self._scenario, self._name, value))
        swinging = int(trials.swings.sum())
        if count == 0:
            return Point(value, band, 0, 0, np.nan, np.nan, swinging)
        settle_s = trials.settle_s(band)[self._those]
        return Point(
            value=value,
            band_px=band,
            trials=count,
            settled=int(np.isfinite(settle_s).sum()),
            median_s=float(np.median(np.where(np.isnan(settle_s), np.inf, settle_s))),
            # who settles in the scenario's band does so in a wider one
            untouched_median_s=float(np.median(self._untouched.settle_s(band)[self._those])),
            swinging=swinging,
        )
