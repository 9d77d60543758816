"""Compare controllers on identical trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

from collections.abc import Mapping, Sequence
from typing import Any

from vergence.controllers.controller import Controller
from vergence.errors import ConfigurationError, UserControllerError
from vergence.eval.comparison.config import ROBOT, EvaluateConfig
from vergence.eval.comparison.contestant_job import ControllerFailure
from vergence.eval.comparison.contestants import BASELINE, BOUND
from vergence.eval.comparison.evaluation import Evaluation, EvaluationResult, row_fields
from vergence.eval.comparison.job import EvaluationJob
from vergence.eval.comparison.lineup import Lineup, resolve_lineup
from vergence.reporting.jobs import Mapper, SerialMapper

__all__ = [
    "BASELINE",
    "BOUND",
    "EvaluateConfig",
    "Evaluation",
    "EvaluationResult",
    "evaluate",
    "row_fields",
]


def evaluate(
    config: EvaluateConfig,
    extra_controllers: Mapping[str, Controller] | None = None,
    mapper: Mapper | None = None,
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    keep_going: bool = False,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: the configuration.
        extra_controllers: more controllers by their names in tables: any objects with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; None to run them one by one in this process. The numbers are the same
            for any mapper, except for the duration of `predict`.
        options: options of controllers, `options[controller][scenario]`, in place of a file's.
        keep_going: True to leave out a user-defined controller that raises, and to list it in
            `failures`; if only the baseline would remain, the error is raised all the same.

    Returns:
        The evaluation.

    Raises:
        UserControllerError: a user-defined controller raises, and is not to be left out.
        VergenceError: a name is unknown, an option has an invalid value, or a plant is a robot.
    """
    mapper = mapper or SerialMapper()
    if config.on_robot:
        raise ConfigurationError(
            f"plant: expected simulated ones, got {ROBOT}: "
            "vergence.eval.robot.evaluate.evaluate_on_robot runs it"
        )
    lineup = resolve_lineup(config, extra_controllers, mapper, options)
    return run_and_join(config, lineup, mapper, keep_going=keep_going)


def run_and_join(
    config: EvaluateConfig,
    lineup: Lineup,
    mapper: Mapper,
    robot_results: Sequence[EvaluationResult] = (),
    robot_failures: Sequence[ControllerFailure] = (),
    *,
    keep_going: bool,
) -> Evaluation:
    """Run the simulated trials and join them with a robot's results.

    Args:
        config: the configuration.
        lineup: the controllers, scenarios and plants.
        mapper: runs the jobs.
        robot_results: results of a robot's trials.
        robot_failures: failures of controllers in a robot's trials.
        keep_going: see `evaluate`, which also describes the result and the errors.
    """
    jobs = [
        EvaluationJob(
            contestant=one, resolved=resolved, scenario=scenario, plant=plant, head=lineup.head,
            episodes=config.trials, seed=config.seed, keep_going=keep_going,
        )
        for scenario, plant in lineup.scenario_plant_pairs
        if plant != ROBOT
        for one, resolved in lineup.contestants_by_scenario[scenario.name]
    ]  # fmt: skip
    results = mapper(jobs)
    outcomes = [one for one in (*results, *robot_results) if isinstance(one, EvaluationResult)]
    failures = [one for one in (*results, *robot_failures) if isinstance(one, ControllerFailure)]
    if failures and {one.controller for one in outcomes} <= {BASELINE}:
        raise UserControllerError(failures[0].message)
    return Evaluation(
        config=config,
        outcomes=outcomes,
        notes=lineup.notes,
        failures=[one.text for one in failures],
    )
