"""Replay of a log: metrics, pictures, and the commands of a policy run on its readings."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.controllers.controller import CONTROLLERS
from vergence.envs.task import GazeTask, run_trial
from vergence.errors import ConfigurationError
from vergence.eval.gaze import FinalState, GazeResult, gaze_result
from vergence.eval.gaze_config import GazeConfig
from vergence.eval.gaze_trajectory import MM
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.controller import RobotController
from vergence.eval.robot.gazes import RobotGazes
from vergence.eval.robot.stage import REST_TARGET
from vergence.models.parts import FloatArray
from vergence.recording import Recorder
from vergence.recording.log import REPLAYED_ENTRY_POINT, Log, LoggedTrial, ReplayedPlant, read_log

_NON_OPTION_ARGUMENTS: Final = ("name", "head", "layout")
"""Arguments of a controller that are not options."""
_MOST_STEPS_DIGITS: Final = 7
"""Largest number of digits of the log's `steps` (numerical: bounds memory, far beyond any gaze)."""


@dataclass(frozen=True, kw_only=True)
class RerunCommands:
    """Commands of a policy run on a log's readings, beside those of the log's own policy."""

    controller: str
    logged: list[FloatArray]
    """(steps, 7) per gaze: commands in the log, rad/s."""
    computed: list[FloatArray]
    """(steps, 7) per gaze: commands of the policy that was run again, rad/s."""

    def rows(self) -> list[dict[str, Any]]:
        """A row per gaze: number of commands, number of bitwise identical ones, and differences."""
        found = []
        for place, (logged, computed) in enumerate(zip(self.logged, self.computed, strict=True)):
            apart = np.nan_to_num(np.abs(computed - logged))
            found.append(
                {
                    "gaze": place + 1,
                    "commands": len(apart),
                    "identical": int((computed == logged).all(axis=-1).sum()),
                    "greatest_difference_rad_s": float(apart.max(initial=0.0)),
                    "rms_difference_rad_s": float(np.sqrt((apart**2).mean())) if len(apart) else 0,
                }
            )
        return found

    def summary(self) -> dict[str, Any]:
        """Totals over all gazes."""
        rows = self.rows()
        greatest = (row["greatest_difference_rad_s"] for row in rows)
        return {
            "controller": self.controller,
            "commands": sum(row["commands"] for row in rows),
            "identical": sum(row["identical"] for row in rows),
            "greatest_difference_rad_s": max(greatest, default=0.0),
        }


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Content of a log with its metrics."""

    log: Log
    gazes: RobotGazes
    results: list[GazeResult]
    """One per gaze."""
    rerun: RerunCommands | None
    """Commands of the policy that was run again; None if there was none."""
    notes: tuple[str, ...]
    """Remarks for the user."""

    def trajectory(self) -> pd.DataFrame:
        """A row per control period of all gazes; the first column is the gaze, counted from 1."""
        parts = [pd.DataFrame({"gaze": []}, dtype=np.int64)]
        for place, result in enumerate(self.results):
            parts.append(pd.DataFrame(result.trajectory))
            parts[-1].insert(0, "gaze", place + 1)
        return pd.concat(parts, ignore_index=True)

    def summary(self) -> dict[str, Any]:
        """The result as plain values; None for undefined metrics."""
        return {
            "log": str(self.log.path),
            "cut_off": self.log.truncation_reason or None,
            "controller": self.log.facts.get("controller", "unknown"),
            **self.gazes.summary(),
            "faults": list(self.log.stop_reasons),
            "rows": self.gazes.rows(),
            "again": None if self.rerun is None else self.rerun.summary(),
        }


def replay(
    config: ReplayConfig, progress: Callable[[float], None] = lambda fraction: None
) -> Replay:
    """Replay a log.

    A controller of the registry runs with the log's options if it is the log's own controller. User
    code never runs with the log's options, as logs are untrusted.

    Args:
        config: the log, and the controller to run again.
        progress: called with the fraction done.

    Raises:
        VergenceError: the log cannot be read, the policy cannot be made, or it raises.
    """
    log = read_log(config.log)
    if config.gaze is not None and not 1 <= config.gaze <= len(log.trials):
        raise ConfigurationError(
            f"gaze: expected 1 to {len(log.trials)}, as the log has them, got {config.gaze}"
        )
    if config.controller is None:
        if config.options is not None:
            raise ConfigurationError("options: expected them with --controller, got no controller")
        return _run(log, None, (), progress)
    same = config.controller == log.facts.get("controller")
    options = None
    if same and config.controller in CONTROLLERS and config.options is None:
        options = _options(log)
    controller = RobotController.of(config.controller, log.head, config.options, options)
    with controller.attributing_errors():
        return _run(log, controller, tuple(_notes(log, config, controller)), progress)


def _notes(log: Log, config: ReplayConfig, controller: RobotController) -> Iterator[str]:
    """Yield notes on differences between the controller and the log's."""
    ran, options = log.facts.get("controller_sha256", ""), log.facts.get("options", "{}")
    if config.controller in CONTROLLERS or not ran:
        return
    if ran != controller.sha256:
        yield f"{controller.name} is not the file that ran: its SHA-256 differs from the log's"
    elif config.options is None and options != controller.stated_options:
        yield f"the log's controller ran with {options:.200}: --options gives them"


class _ZeroVelocityPolicy:
    """A policy that commands zero velocities."""

    def __init__(self, count: int) -> None:
        self._action = np.zeros((1, count), np.float32)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """See `vergence.controllers.controller.Controller`."""
        return self._action, state


def _whole(digits: str) -> float:
    """Convert an integer of JSON; to a float, possibly inf, if it has 20 digits or more."""
    return int(digits) if len(digits) < 20 else float(digits)


def _options(log: Log) -> dict[str, Any]:
    """The options that the log's controller ran with."""
    try:
        found = json.loads(log.facts.get("options", "{}"), parse_int=_whole)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or not all(
        name.isidentifier() and name not in _NON_OPTION_ARGUMENTS for name in found
    ):
        raise ConfigurationError(f"{log.path}: options: expected them by name as JSON")
    return found


def _run(
    log: Log,
    controller: RobotController | None,
    notes: tuple[str, ...],
    progress: Callable[[float], None],
) -> Replay:
    policy = (
        _ZeroVelocityPolicy(log.head.actuation.count) if controller is None else controller.policy
    )
    # the replayed plant starts each trial as the log has it
    task = GazeTask(
        1,
        head=log.head,
        plant=REPLAYED_ENTRY_POINT,
        target=REST_TARGET,
        plant_options={"trials": log.trials},
    )
    plant = task.plant
    assert isinstance(plant, ReplayedPlant)
    gazes = RobotGazes(
        steps=_planned(log),
        dry_run=log.facts.get("dry_run") == str(True),
        stopped=bool(log.stop_reasons),
    )
    results, computed = [], []
    total, done = sum(trial.steps for trial in log.trials), 0

    def gaze(trial: LoggedTrial) -> None:
        record = Recorder(task, trial.steps)

        def keep(step: int) -> None:
            record(step)
            progress((done + step) / max(total, 1))

        run_trial(task, policy, trial.steps, keep)
        gazes.add(task, record)
        config = _gaze_config(log, record)
        results.append(gaze_result(config, task, record, FinalState.of(task)))
        computed.append(np.array(plant.commands).reshape(-1, 7))

    # prepare as before a robot's first gaze, since a policy may count its calls
    task.prepare(policy)
    for trial in log.trials:
        gaze(trial)
        done += trial.steps
    found = None
    if controller is not None:
        logged = [trial.requested_velocities() for trial in log.trials]
        found = RerunCommands(controller=controller.name, logged=logged, computed=computed)
    return Replay(log=log, gazes=gazes, results=results, rerun=found, notes=notes)


def _planned(log: Log) -> int | None:
    """Control periods of a whole gaze; None if the log does not state them."""
    text = log.facts.get("steps")
    if text is None:
        return None
    if not text.isdecimal() or len(text) > _MOST_STEPS_DIGITS:
        raise ConfigurationError(f"{log.path}: steps: expected a number, got {text!r:.40}")
    return max(1, int(text))


def _gaze_config(log: Log, record: Recorder) -> GazeConfig:
    """Configuration of a logged gaze, for its picture."""
    target = np.full(3, np.nan) if record.truth is None else record.truth.target[-1, 0]
    x, y, z = np.round(MM * target, 3).tolist()
    return GazeConfig(
        head=log.head.name,
        target_mm=(x, y, z),
        controller=log.facts.get("controller", "unknown"),
        plant="hardware",
        duration_s=float(record.reading.time_s[-1, 0]),
    )
