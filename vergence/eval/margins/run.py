"""Measure the margins of controllers: vary one imperfection at a time from its expected value.

```python
margins = measure_margins(MarginsConfig(controllers=("ibvs-tuned",), scenarios=("workspace",)))
margins.rows()                                   # what margins.json holds
measure_margins(MarginsConfig(imperfections=("command_latency_s",)), {"mine": my_policy})
```
"""

from collections.abc import Mapping
from typing import Any

from vergence.controllers.controller import Controller
from vergence.errors import ConfigurationError, UnknownNameError, UserControllerError
from vergence.eval.comparison.contestant_job import ControllerFailure
from vergence.eval.comparison.lineup import Lineup, resolve_lineup
from vergence.eval.margins.config import MarginsConfig
from vergence.eval.margins.job import MarginJob
from vergence.eval.margins.margins import Margin, Margins
from vergence.eval.margins.measure import with_imperfection
from vergence.eval.margins.ranges import IMPERFECTION_RANGES, has_effect, search_interval
from vergence.eval.trials.scenarios import SCENARIOS, Scenario
from vergence.reporting.jobs import Mapper, SerialMapper

__all__ = ["MarginsConfig", "measure_margins"]


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
