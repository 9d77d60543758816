"""Evaluation with a robot among its plants; it can resume in an earlier run folder."""

import dataclasses
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vergence.errors import ConfigurationError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.evaluate import Evaluation, run_and_join
from vergence.eval.comparison.lineup import resolve_lineup
from vergence.eval.robot.compare import RobotRun
from vergence.eval.robot.evaluation_record import EvaluationRecord
from vergence.eval.robot.stage import make_stage
from vergence.hardware.config import HardwareConfig
from vergence.models.parts import EYE_NAMES
from vergence.reporting.jobs import Mapper, Progress, SerialMapper
from vergence.reporting.runs import toml_value


def read_begun_config(run: Path) -> EvaluateConfig:
    """Read the configuration of an evaluation on a robot that was begun earlier.

    Args:
        run: its run folder.

    Raises:
        ConfigurationError: the folder holds no such evaluation.
    """
    configuration = EvaluationRecord(run).configuration
    for name in ("episodes", "seed"):
        if type(configuration.get(name)) not in (int, type(None)):
            raise ConfigurationError(
                f"resume: expected a whole number of {name} in {run}, got "
                f"{configuration[name]!r:.80}"
            )
    known = {field.name for field in dataclasses.fields(EvaluateConfig)}
    try:
        values: dict[str, Any] = {
            name: value for name, value in configuration.items() if name in known
        }
        for name in ("controllers", "scenarios", "plants"):
            values[name] = tuple(map(str, values[name]))
        for name in ("hardware", "options"):
            values[name] = Path(values[name]) if name in values else None
        return EvaluateConfig(**values)
    except (KeyError, TypeError) as error:
        raise ConfigurationError(
            f"resume: expected what vergence evaluate has written, got {run}: {error}"
        ) from error


def evaluate_on_robot(
    config: EvaluateConfig,
    run: Path,
    mapper: Mapper | None = None,
    progress: Progress = lambda done, total: None,
    *,
    resume: bool = False,
    check: Callable[[HardwareConfig], None] = lambda hardware: None,
    keep_going: bool = False,
) -> Evaluation:
    """Compare controllers on a robot, and on simulated plants if asked for.

    Args:
        config: the comparison; one of its plants is `hardware`.
        run: the run folder, made if it is new; logs and the journal of trials go there.
        mapper: runs simulated trials; this process by default.
        progress: called with the number of the robot's trials done and their total.
        resume: true to continue the trials that the folder has.
        check: called with the robot once all else is ready; it may raise to refuse it.
        keep_going: see `vergence.eval.comparison.evaluate.evaluate`.

    Returns:
        The evaluation.

    Raises:
        HardwareError: the robot was stopped; completed trials are in the folder.
        ChecksFailedError: the robot must not move yet.
        VergenceError: a name is unknown, or the value of an option is not allowed.
    """
    mapper = mapper or SerialMapper()
    lineup = resolve_lineup(config, None, mapper)
    hardware = lineup.hardware
    if hardware is None or not config.on_robot:
        raise ConfigurationError("plant: expected hardware among the plants, got none")
    stage = make_stage(config.stage, hardware, config.seed)
    configuration = {**_with_absolute_paths(config), "stage": stage.name, "robot": _robot(hardware)}
    robot = RobotRun(
        lineup=lineup, hardware=hardware, stage=stage, episodes=config.trials, seed=config.seed,
        record=EvaluationRecord(run, None if resume else toml_value(configuration)),
    )  # fmt: skip
    before, now = robot.record.configuration.get("robot", {}), toml_value(configuration)["robot"]
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise ConfigurationError(
                f"resume: expected {name} of {hardware.path} as it was when {run} was begun, "
                f"{before.get(name)!s:.200}, got {now.get(name)!s:.200}"
            )
    failed = robot.run(progress, check=check, keep_going=keep_going)
    recorded = robot.recorded()
    outcomes = robot.outcomes(recorded, failed, keep_going=keep_going)
    evaluation = run_and_join(config, lineup, mapper, outcomes, failed, keep_going=keep_going)
    evaluation.notes.append(robot.report_note(recorded))
    return evaluation


def _robot(hardware: HardwareConfig) -> dict[str, Any]:
    """Configuration that must not change during an evaluation: all but ports and image sources."""
    found: dict[str, Any] = tomllib.loads(hardware.text)
    found |= {"head": hardware.head.digest}
    found.pop("emulator", None)
    found["bus"].pop("port", None)
    for eye in EYE_NAMES:
        found["cameras"][eye].pop("source", None)
    return found


def _with_absolute_paths(config: EvaluateConfig) -> dict[str, Any]:
    """A configuration as values by field, with absolute paths."""
    values = config.resolved()
    for name in ("hardware", "options"):
        if values[name] is not None:
            values[name] = values[name].absolute()
    return values
