"""Controllers compared on the same trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

import shlex
from collections.abc import Callable, Mapping
from typing import Any

from vergence.controllers.controller import Controller
from vergence.controllers.tuned import user_file
from vergence.entry_points import is_entry_point
from vergence.envs.plant import plant_type
from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError, ControllerError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.contestants import (
    BASELINE,
    BOUND,
    Contestant,
    contestants,
    that_can_be_made,
)
from vergence.eval.comparison.evaluation import ROW, Evaluation, Failure, Outcome
from vergence.eval.comparison.job import EvaluationJob
from vergence.eval.comparison.options import UNTUNED, Fitted, GivenOptions, fitted
from vergence.eval.jobs import Mapper, SerialMapper
from vergence.eval.trials.scenarios import Scenario, load_scenario
from vergence.eval.tuning.baseline import tune_baseline
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel

__all__ = [
    "BASELINE",
    "BOUND",
    "ROW",
    "EvaluateConfig",
    "Evaluation",
    "Outcome",
    "evaluate",
]


def evaluate(
    config: EvaluateConfig,
    others: Mapping[str, Controller] | None = None,
    mapper: Mapper | None = None,
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    keep_going: bool = False,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: what to compare.
        others: more controllers by the names that tables shall call them: any object with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; this process by default. The numbers are the same for any mapper,
            but for the time that `predict` takes.
        options: options by controller, and in these by scenario, in place of a file's.
        keep_going: whether a controller of somebody's own that raises is left out and told in
            `failures`, as long as another one but the baseline is left.

    Returns:
        The evaluation.

    Raises:
        ControllerError: a controller of somebody's own raises, and it is not to be left out.
        VergenceError: a name is unknown or an option has a value that cannot be.
    """
    as_seed(config.seed)
    if config.episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
    head = None if config.head is None else load_head(config.head)
    pairs, notes = _pairs(config)
    others = others or {}
    words = config.controllers or ((BASELINE,) if others else ())
    given = _given(config, options)
    everyone = contestants(words, others, given)
    notes += given.check_names(name for one in everyone for name in one.names)
    mapper = mapper or SerialMapper()
    if config.tune:
        tune_first(config, mapper, options)
    named = {*config.controllers, *others, BASELINE}
    able = {}
    for scenario in {scenario.name: scenario for scenario, _ in pairs}.values():
        model = scenario.model() if head is None else head
        able[scenario.name], missing = that_can_be_made(everyone, model, scenario, named)
        notes += missing
        notes += _untuned(able[scenario.name], model, scenario, config.head)
    jobs = [
        EvaluationJob(
            contestant=one, fitted=fitted, scenario=scenario, plant=plant, head=head,
            config=config, keep_going=keep_going,
        )
        for scenario, plant in pairs
        for one, fitted in able[scenario.name]
    ]  # fmt: skip
    results = mapper(jobs)
    outcomes = [one for one in results if isinstance(one, Outcome)]
    failures = [one for one in results if isinstance(one, Failure)]
    if failures and {one.controller for one in outcomes} <= {BASELINE}:
        raise ControllerError(failures[0].message)
    return Evaluation(
        config=config,
        outcomes=outcomes,
        notes=list(dict.fromkeys(notes)),
        failures=[f"{one.message} (left out of {one.scenario} on {one.plant})" for one in failures],
    )


def tune_first(
    config: EvaluateConfig,
    mapper: Mapper,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> None:
    """Tune the baseline for each scenario's head for which it is untuned.

    Args:
        config: what is to be compared.
        mapper: runs the trials.
        options: see `evaluate`.
        say: told what is tuned before it is, and what was found.

    Raises:
        VergenceError: a name is unknown, or what was found cannot be kept.
    """
    given = _given(config, options)
    for scenario in {scenario.name: scenario for scenario, _ in _pairs(config)[0]}.values():
        head = scenario.model() if config.head is None else load_head(config.head)
        found = fitted(BASELINE, head, scenario.name, given.of((BASELINE,), scenario.name))
        if found.tuned is False:
            say(f"tuning {BASELINE} for the head {head.name} in {scenario.name}")
            entry = tune_baseline(scenario, head, config.head, mapper)
            say(f"{BASELINE}: gain {entry.options['gain']:g}, kept in {user_file()}")


def _given(config: EvaluateConfig, options: Mapping[str, Mapping[str, Any]] | None) -> GivenOptions:
    if options is not None:
        return GivenOptions(options)
    return GivenOptions() if config.options is None else GivenOptions.read(config.options)


def _untuned(
    able: list[tuple[Contestant, Fitted]], head: HeadModel, scenario: Scenario, source: str | None
) -> list[str]:
    """A note on the controllers whose options were not found for this head."""
    names = [one.label for one, fitted in able if fitted.tuned is False]
    if not names:
        return []
    which = "" if source is None else f" --head {shlex.quote(source)}"
    how = f"vergence tune NAME --scenario {scenario.name}{which} --write tunes one"
    if BASELINE in names:
        how = f"--tune tunes {BASELINE} first, {how}"
    return [f"{', '.join(names)}: {UNTUNED}, {head.name}, in {scenario.name}; {how}"]


def _pairs(config: EvaluateConfig) -> tuple[list[tuple[Scenario, str]], list[str]]:
    """Each scenario with each plant that it runs on, and a note for each other plant."""
    scenarios = [load_scenario(name) for name in dict.fromkeys(config.scenarios)]
    for plant in config.plants:
        plant_type(plant)  # refuses what is no plant
    pairs, notes = [], []
    for scenario in scenarios:
        for plant in dict.fromkeys(config.plants):
            if plant in scenario.plants or is_entry_point(plant):
                pairs.append((scenario, plant))
            else:
                where = f"{scenario.name}, which runs on {', '.join(scenario.plants)}"
                notes.append(f"{plant} is left out of {where}")
    if not pairs:
        raise ConfigurationError(
            f"plant: expected one on which a scenario runs, got {plant} for {where}"
        )
    return pairs, notes
