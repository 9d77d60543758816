"""Controllers compared on the same trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

from collections.abc import Mapping
from typing import Any

from vergence.envs.plant import PLANTS
from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.comparison.contestants import (
    BASELINE,
    BOUND,
    Contestant,
    contestants,
    that_can_be_made,
)
from vergence.eval.comparison.evaluation import ROW, EvaluateConfig, Evaluation, Outcome
from vergence.eval.comparison.job import EvaluationJob
from vergence.eval.jobs import Mapper, Progress, local_mapper
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.files.head_file import load_head

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
    others: Mapping[str, Any] | None = None,
    mapper: Mapper | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: what to compare.
        others: more controllers by the names that tables shall call them: any object with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; by default as many processes as the config says.
        progress: told how many of the jobs are done.

    Returns:
        The evaluation.

    Raises:
        VergenceError: a name is unknown or an option has a value that cannot be.
    """
    as_seed(config.seed)
    if config.episodes < 1:
        raise ConfigurationError(f"episodes: expected at least 1, got {config.episodes}")
    head = None if config.head is None else load_head(config.head)
    scenarios = [load_scenario(name) for name in dict.fromkeys(config.scenarios)]
    for plant in config.plants:
        if plant not in PLANTS:
            raise UnknownNameError("plant", plant, sorted(PLANTS))
    everyone: list[Contestant] = []
    notes: list[str] = []
    if config.controllers or not others:
        everyone = contestants(config.controllers)
    else:
        everyone = contestants((BASELINE,))
    everyone += [Contestant(label=name, source=one) for name, one in (others or {}).items()]
    pairs = []
    for scenario in scenarios:
        for plant in dict.fromkeys(config.plants):
            if plant in scenario.plants:
                pairs.append((scenario, plant))
            else:
                where = f"{scenario.name}, which runs on {', '.join(scenario.plants)}"
                notes.append(f"{plant} is left out of {where}")
    if not pairs:
        raise ConfigurationError(
            f"plant: expected one on which a scenario runs, got {plant} for {where}"
        )
    named = {*config.controllers, *(others or {}), BASELINE}
    able = {}
    for scenario in {scenario.name: scenario for scenario, _ in pairs}.values():
        model = scenario.model() if head is None else head
        able[scenario.name], missing = that_can_be_made(everyone, model, scenario.name, named)
        notes += missing
    jobs = [
        EvaluationJob(contestant=one, scenario=scenario, plant=plant, head=head, config=config)
        for scenario, plant in pairs
        for one in able[scenario.name]
    ]
    if mapper is None:
        mapper = local_mapper(min(config.workers, len(jobs)), progress)
    return Evaluation(config=config, outcomes=mapper(jobs), notes=list(dict.fromkeys(notes)))
