"""Measure the margins of controllers: vary one imperfection at a time from its expected value.

```python
margins = measure_margins(MarginsConfig(controllers=("ibvs-tuned",), scenarios=("workspace",)))
margins.rows()                                   # what margins.json holds
measure_margins(MarginsConfig(imperfections=("command_latency_s",)), {"mine": my_policy})
```
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from vergence.controllers.controller import Controller
from vergence.envs.plants.conditions import IMPERFECTIONS, LOOP_PARTS, Variation
from vergence.errors import ConfigurationError, UnknownNameError, UserControllerError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.evaluate import ContestantJob, ControllerFailure, MadeController
from vergence.eval.comparison.lineup import Lineup, resolve_lineup
from vergence.eval.trials.results import Trials
from vergence.eval.trials.scenarios import SCENARIOS, Scenario
from vergence.models.head import HeadModel
from vergence.reporting.jobs import Mapper, SerialMapper

__all__ = ["MarginsConfig", "measure_margins"]


@dataclass(frozen=True, kw_only=True)
class MarginsConfig(EvaluateConfig):
    """The margins to measure; `episodes` is the number of trials at each value, 200 by default."""

    imperfections: tuple[str, ...] = ()
    """Imperfections to vary, by the names of `vergence.eval.margins.run.IMPERFECTION_RANGES`;
    all by default."""

    default_trials: ClassVar[int] = 200


class ImperfectionRange(NamedTuple):
    """Search range of one imperfection's margins, and how they are shown."""

    label: str
    lowest: float
    highest: float
    """Ends of the range, `lowest` and `highest`, in the unit of `IMPERFECTIONS`."""
    unit: str
    """Unit in tables and figures; empty for a ratio."""
    scale: float
    """Factor from the unit of `IMPERFECTIONS` to that unit."""


IMPERFECTION_RANGES: Final = {
    name: ImperfectionRange(one.label, *one.search_range, *one.display_unit)
    for part in LOOP_PARTS
    for name, one in IMPERFECTIONS.items()
    if one.part == part
}
"""Search ranges by name, in the order of tables and figures: part by part of the loop.

An imperfection that each actuator has of its own gets the same value for all of them. Onset and
frame phase are not faults: a controller that is sensitive to them relies on knowledge that it
cannot have.
"""


class SearchInterval(NamedTuple):
    """Search range of one imperfection's margins in one scenario, with the expected value."""

    low: float
    expected: float
    """Start of the search: the model's value; if the scenario draws the imperfection, the value of
    the drawn range that is nearest to the model's."""
    high: float


def search_interval(imperfection: str, scenario: Scenario, head: HeadModel) -> SearchInterval:
    """Search range of an imperfection's margins, widened to hold the expected value."""
    expected = float(np.max(IMPERFECTIONS[imperfection].nominal(head)))
    drawn = None if scenario.variation is None else getattr(scenario.variation, imperfection)
    if drawn is not None:
        expected = min(max(expected, drawn[0]), drawn[1])
    searched = IMPERFECTION_RANGES[imperfection]
    return SearchInterval(min(searched.lowest, expected), expected, max(searched.highest, expected))


def has_effect(imperfection: str, scenario: Scenario) -> bool:
    """True if it has an effect: the size of random events has none in a scenario without events."""
    chance = IMPERFECTIONS[imperfection].probability
    if not chance:
        return True
    variation = scenario.variation
    return variation is not None and variation.largest_value(chance, 0.0) > 0.0


GRID_FRACTIONS: Final = (
    1 / 64,
    1 / 32,
    1 / 16,
    1 / 8,
    1 / 4,
    3 / 8,
    1 / 2,
    5 / 8,
    3 / 4,
    7 / 8,
    1.0,
)
"""Grid values as fractions of the way from the expected value to the end of the search (chosen:
resolution against number of runs)."""
BISECTIONS: Final = 4
"""Bisections of the bracket (chosen: resolution against number of runs)."""


def last_holding_value(holds: Callable[[float], bool], begin: float, end: float) -> float | None:
    """Last value on the way to another at which a condition holds; None if not even at `begin`.

    The search tests the values of a grid until the first at which the condition fails. The grid is
    finest next to the expected value, where fragile controllers fail. Bisection then narrows the
    bracket between the last value at which the condition holds and that first one. A failure
    between two grid values that both hold is not detected.
    """
    if not holds(begin):
        return None
    if begin == end:
        return begin
    good = begin
    for share in GRID_FRACTIONS:
        value = end if share == 1.0 else _rounded(begin + share * (end - begin))
        if not holds(value):
            return _between(holds, good, value)
        good = value
    return good


def _between(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """Bisect between a value at which the condition holds and one at which it fails."""
    for _ in range(BISECTIONS):
        middle = _rounded(0.5 * (good + bad))
        if holds(middle):
            good = middle
        else:
            bad = middle
    return good


def _rounded(value: float) -> float:
    """Round to six significant digits, so that the tested value is exactly the written one."""
    return float(f"{value:.6g}")


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
    """Copy a scenario with one imperfection fixed at a value in every trial."""
    variation = scenario.variation or Variation()
    fixed: dict[str, Any] = {imperfection: (value, value)}
    duration_s = scenario.duration_s
    if imperfection == "onset_s":
        # trials with a later onset are longer, to leave the same time
        duration_s += max(0.0, value - variation.largest_value("onset_s", 0.0))
    return replace(scenario, variation=replace(variation, **fixed), duration_s=duration_s)


def noise_widened_band_px(scenario: Scenario, imperfection: str, value: float) -> float:
    """Settling band: the scenario's, or three standard deviations of the detection noise if larger.

    Nothing but noise widens the band: the judged error is the true one, which can be small in spite
    of outliers, backlash and encoder quantisation.
    """
    if imperfection != "detection_noise_px":
        return scenario.band_px
    return max(scenario.band_px, _BAND_NOISE_SIGMAS * value)


class MarginMeasurement:
    """Measurement of one controller in one scenario by value of an imperfection, cached."""

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


RANGE_ENDS: Final = ("settles_low", "settles_high", "doubles_low", "doubles_high")
MARGIN_ROW_FIELDS: Final = ("controller", "scenario", "imperfection", "unit", *RANGE_ENDS)
"""The fields of a row of margins.json."""


@dataclass(frozen=True, kw_only=True)
class Margin:
    """Margin of one imperfection: the ranges about the expected value in which criteria hold.

    Each end is a measured value: the farthest one up to which the criterion holds at every measured
    value from the expected one on. It may be the end of the searched range. Both ends are None if
    the criterion does not even hold at the expected value.
    """

    controller: str
    scenario: str
    imperfection: str
    range: SearchInterval
    """Searched range."""
    settles_low: float | None
    """Low end of the range in which 99 % of the trials that settle in the unmodified scenario still
    settle."""
    settles_high: float | None
    """High end of that range."""
    doubles_low: float | None
    """Low end of the range in which the median settle time of these trials is less than twice that
    in the unmodified scenario."""
    doubles_high: float | None
    """High end of that range."""
    points: list[MarginPoint]
    """All measurements, sorted by value."""
    head: HeadModel
    options: dict[str, Any]
    """The controller's options."""
    tuned: bool | None
    """True if the options were tuned for the head, see `ResolvedOptions`."""

    @property
    def unit(self) -> str:
        """The unit of all values."""
        return IMPERFECTIONS[self.imperfection].unit

    def row(self) -> dict[str, Any]:
        """The row of margins.json."""
        return {name: getattr(self, name) for name in MARGIN_ROW_FIELDS}

    def is_open(self, end: str) -> bool:
        """True if an end, of `RANGE_ENDS`, is that of the search and not of the imperfection."""
        value, one = getattr(self, end), IMPERFECTIONS[self.imperfection]
        if end.endswith("_low"):
            return bool(value == self.range.low > one.least)
        return bool(value == self.range.high < one.most)


@dataclass(frozen=True, kw_only=True)
class Margins:
    """All margins of a run."""

    config: MarginsConfig
    margins: list[Margin]
    notes: list[str] = field(default_factory=list)
    """Notes on controllers and imperfections that are left out, and on untuned controllers."""
    failures: list[str] = field(default_factory=list)
    """Errors of user-defined controllers, which are left out."""

    def rows(self) -> list[dict[str, Any]]:
        """The rows of margins.json: plain values, None for no value."""
        return [one.row() for one in self.margins]

    def groups(self) -> dict[tuple[str, str], list[Margin]]:
        """The margins of each controller in each scenario."""
        found: dict[tuple[str, str], list[Margin]] = {}
        for one in self.margins:
            found.setdefault((one.scenario, one.controller), []).append(one)
        return found

    def by_scenario(self) -> dict[str, list[Margin]]:
        """The margins in each scenario."""
        found: dict[str, list[Margin]] = {}
        for one in self.margins:
            found.setdefault(one.scenario, []).append(one)
        return found


@dataclass(frozen=True, kw_only=True)
class MarginJob(ContestantJob[Margin]):
    """Measure the margin of one imperfection."""

    imperfection: str

    def _evaluate(self, made: MadeController) -> Margin:
        span = search_interval(self.imperfection, self.scenario, made.head)
        measure = MarginMeasurement(
            partial(self._trials, made.controller), self.scenario, self.imperfection
        )
        settles = [
            last_holding_value(lambda value: measure(value).settles, span.expected, end)
            for end in (span.low, span.high)
        ]
        doubles = [
            last_holding_value(lambda value: measure(value).median_not_doubled, span.expected, end)
            for end in (span.low, span.high)
        ]
        return Margin(
            controller=self.contestant.label,
            scenario=self.scenario.name,
            imperfection=self.imperfection,
            range=span,
            settles_low=settles[0],
            settles_high=settles[1],
            doubles_low=doubles[0],
            doubles_high=doubles[1],
            points=measure.points,
            head=made.head,
            options=made.options,
            tuned=self.resolved.tuned,
        )


def measure_margins(
    config: MarginsConfig,
    extra_controllers: Mapping[str, Controller] | None = None,
    mapper: Mapper | None = None,
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    keep_going: bool = False,
) -> Margins:
    """Find the largest deviation of each imperfection from the model that controllers tolerate.

    At every value the trials of the unmodified scenario run again, with the same targets and random
    numbers, and with the imperfection at that value in every trial.

    Args:
        config: the configuration, with exactly one plant.
        extra_controllers: more controllers by their labels, see
            `vergence.eval.comparison.evaluate`.
        mapper: runs the jobs; this process by default. The result is the same for any mapper.
        options: options by controller, and within these by scenario.
        keep_going: True to leave a user-defined controller that raises out of the scenario, and to
            report it in `failures`, unless no margins would remain.

    Returns:
        The margins.

    Raises:
        UserControllerError: a user-defined controller raises, and is not to be left out.
        VergenceError: a name is unknown, a scenario's target never rests, or an option has an
            invalid value.
    """
    for name in config.imperfections:
        if name not in IMPERFECTION_RANGES:
            raise UnknownNameError("imperfection", name, list(IMPERFECTION_RANGES))
    if len(set(config.plants)) != 1:
        raise ConfigurationError(
            f"plant: expected one with --margins, got {', '.join(config.plants) or 'none'}"
        )
    mapper = mapper or SerialMapper()
    lineup = resolve_lineup(config, extra_controllers, mapper, options, include_baseline=False)
    for scenario, _ in lineup.scenario_plant_pairs:
        if scenario.target_moves:
            rest = ", ".join(one.name for one in SCENARIOS.values() if not one.target_moves)
            raise ConfigurationError(
                f"scenario: expected one of {rest} with --margins, got {scenario.name}, whose "
                "target never comes to rest"
            )
    jobs, notes = [], []
    for scenario, plant in lineup.scenario_plant_pairs:
        names, left_out = _imperfections(config, scenario, plant, lineup)
        notes += left_out
        jobs += [
            MarginJob(
                contestant=one, resolved=resolved, scenario=scenario, plant=plant, head=lineup.head,
                imperfection=name, episodes=config.trials, seed=config.seed, keep_going=keep_going,
            )
            for one, resolved in lineup.contestants_by_scenario[scenario.name]
            for name in names
        ]  # fmt: skip
    results = mapper(jobs)
    failed = [one for one in results if isinstance(one, ControllerFailure)]
    without = {(one.scenario, one.controller) for one in failed}
    found = [
        one
        for one in results
        if isinstance(one, Margin) and (one.scenario, one.controller) not in without
    ]
    if failed and not found:
        raise UserControllerError(failed[0].message)
    return Margins(
        config=config,
        margins=found,
        notes=[*lineup.notes, *notes],
        failures=list(dict.fromkeys(one.text for one in failed)),
    )


def _imperfections(
    config: MarginsConfig, scenario: Scenario, plant: str, lineup: Lineup
) -> tuple[list[str], list[str]]:
    """Imperfections to vary in a scenario, and a note for each one that is left out."""
    head = scenario.model() if lineup.head is None else lineup.head
    asked = [
        name
        for name in IMPERFECTION_RANGES
        if name in (config.imperfections or IMPERFECTION_RANGES)
    ]
    names = [name for name in asked if has_effect(name, scenario)]
    notes = [
        f"{name} is left out of {scenario.name}: it has no outliers"
        for name in asked
        if name not in names and config.imperfections
    ]
    expected = {name: search_interval(name, scenario, head).expected for name in names}
    refused = []
    for name in names:
        try:
            with_imperfection(scenario, name, expected[name]).task(
                1, plant=plant, head=lineup.head
            ).close()
        except ConfigurationError as error:
            refused.append(name)
            notes.append(f"{name} is left out of {scenario.name} on {plant}: {error}")
    if len(refused) == len(names):
        raise ConfigurationError(
            f"imperfection: expected one that {plant} can have in {scenario.name}, "
            f"got {', '.join(asked)}"
        )
    return [name for name in names if name not in refused], notes
