"""An evaluation with a robot among its plants, in a run folder that it goes on with."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vergence.errors import ConfigurationError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.evaluate import complete
from vergence.eval.comparison.evaluation import Evaluation
from vergence.eval.comparison.lineup import line_up
from vergence.eval.jobs import Mapper, Progress, SerialMapper
from vergence.eval.reporting.runs import plain
from vergence.eval.robot.compare import RobotRun
from vergence.eval.robot.sessions import Sessions
from vergence.eval.robot.stage import make_stage
from vergence.hardware.config import HardwareConfig


def begun(run: Path) -> EvaluateConfig:
    """The configuration of an evaluation on a robot that has begun.

    Args:
        run: its run folder.

    Raises:
        ConfigurationError: it is none.
    """
    asked = Sessions(run).asked
    known = {field.name for field in dataclasses.fields(EvaluateConfig)}
    try:
        values: dict[str, Any] = {name: value for name, value in asked.items() if name in known}
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
    """Compare controllers on a robot, and on simulated plants beside it.

    Args:
        config: what to compare; one of the plants is `hardware`.
        run: the run folder, which is made if it is new, and takes logs and a journal of the trials.
        mapper: runs simulated trials; this process by default.
        progress: told the robot's trials done and their number.
        resume: whether the folder has some trials already.
        check: told of the robot once all else is ready; it may refuse it.
        keep_going: see `vergence.eval.comparison.evaluate.evaluate`.

    Returns:
        The evaluation.

    Raises:
        HardwareError: the robot was stopped; the trials that went to their end are in the folder.
        ChecksFailedError: the robot must not move yet.
        VergenceError: a name is unknown, or an option has a value that cannot be.
    """
    mapper = mapper or SerialMapper()
    lineup = line_up(config, None, mapper)
    hardware = lineup.hardware
    if hardware is None or not config.on_robot:
        raise ConfigurationError("plant: expected hardware among the plants, got none")
    stage = make_stage(config.stage, hardware, config.seed)
    asked = {**_asked(config), "stage": stage.name, **_judged_by(hardware)}
    robot = RobotRun(
        lineup=lineup, hardware=hardware, stage=stage, episodes=config.trials, seed=config.seed,
        sessions=Sessions(run, None if resume else plain(asked)),
    )  # fmt: skip
    for name in _judged_by(hardware):
        begun_with, now = robot.sessions.asked.get(name), plain(asked).get(name)
        if begun_with != now:
            raise ConfigurationError(
                f"resume: expected the {name} with which {run} was begun, {begun_with!s:.200}, got "
                f"{now!s:.200} in {hardware.path}"
            )
    failed = robot.run(progress, check=check, keep_going=keep_going)
    recorded = robot.recorded()
    outcomes = robot.outcomes(recorded, failed)
    evaluation = complete(config, lineup, mapper, outcomes, failed, keep_going=keep_going)
    evaluation.notes.append(robot.note(recorded))
    return evaluation


def _judged_by(hardware: HardwareConfig) -> dict[str, Any]:
    """What of a robot all trials of an evaluation have to share, by names; a port may change."""
    return {
        "head_digest": hardware.head.digest,
        "target": str(hardware.target),
        "latency_s": [camera.latency_s for camera in hardware.cameras],
        "loop": None if hardware.loop is None else dataclasses.asdict(hardware.loop),
        "places": [[str(one.target), one.point.tolist()] for one in hardware.places],
    }


def _asked(config: EvaluateConfig) -> dict[str, Any]:
    """A configuration by names, its paths from the root."""
    values = config.resolved()
    for name in ("hardware", "options"):
        if values[name] is not None:
            values[name] = values[name].absolute()
    return values
