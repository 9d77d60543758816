"""Gazes of a policy on a robot, each from rest, all in one log."""

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.reading import Reading, Truth
from vergence.envs.rollout import run_trial
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, HardwareError
from vergence.eval.reporting.runs import versions
from vergence.eval.robot.config import DeployConfig
from vergence.eval.robot.controller import RobotController
from vergence.eval.robot.gazes import Gazes
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.recorder import Recorder
from vergence.recording.writer import LogWriter

_MOST_GAZES: Final = 10_000


class Present(NamedTuple):
    """What a running gaze shows of itself."""

    number: int
    """Of the gaze, counted from 1."""
    step: int
    """Control periods since its beginning."""
    reading: Reading
    """Of one head."""
    pixel_error: FloatArray
    """(2, 2) measured, px; nan where not seen."""
    command: FloatArray
    """(7,) velocities that the policy asked for, rad/s."""
    late: int
    """Periods that were late so far."""


@dataclass(frozen=True, kw_only=True)
class Deployment:
    """What a deployment came to."""

    controller: str
    gazes: Gazes
    faults: tuple[str, ...]
    """Why the head was stopped; empty where it was not."""
    log: Path
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """The result as plain values, None for what has no answer."""
        return {
            "controller": self.controller,
            **self.gazes.summary(),
            "faults": list(self.faults),
            "log": str(self.log),
        }


def deploy(
    config: DeployConfig,
    log: Path,
    *,
    show: Callable[[Present], None] = lambda present: None,
) -> Deployment:
    """Run gazes on a robot.

    Args:
        config: what to do.
        log: the new file to log to.
        show: told of each control period; it must not keep the loop.

    Returns:
        What they came to; also where a fault has stopped the head.

    Raises:
        VergenceError: something cannot be made, or the policy answers what cannot be.
        ChecksFailedError: the robot must not move yet.
    """
    hardware = load_hardware(config.hardware)
    head = hardware.head
    steps = _steps(config, head)
    robot = RobotController.of(config.controller, config.options)
    with ExitStack() as stack:
        controller, facts = stack.enter_context(robot.ready(head))
        writer = stack.enter_context(
            LogWriter(
                log,
                head=head,
                config=Path(config.hardware).read_text(encoding="utf-8-sig"),
                facts={
                    "controller": config.controller,
                    "options": json.dumps(facts),
                    "seed": str(config.seed),
                    "dry_run": str(config.dry_run),
                    **{f"version {name}": text for name, text in versions().items()},
                },
                images=config.images,
            )
        )
        task = _task(hardware, writer, moves=not config.dry_run)
        stack.callback(task.close)
        faults: list[str] = []
        gazes = Gazes(steps)
        all_steps = steps + head.timing.latency_frames  # the last error is known a latency later
        try:
            task.prepare(controller)
            for number in range(config.gazes):
                record = Recorder(task, all_steps)

                def keep(step: int, record: Recorder = record, number: int = number) -> None:
                    record(step)
                    if record.truth is not None:
                        writer.truth(Truth._make(rows[step] for rows in record.truth))
                    if step == all_steps and not config.images:
                        _keep_images(task, writer)
                    show(_present(task, number, step))

                try:
                    run_trial(
                        task, controller, all_steps, keep, seed=config.seed, first_trial=number
                    )
                finally:
                    gazes.add(task, record)
        except HardwareError as error:
            if not task.plant.fault:
                raise
            faults.append(str(error))
    notes = [writer.fault] if writer.fault else []
    return Deployment(
        controller=robot.label,
        gazes=gazes,
        faults=tuple(faults),
        log=log,
        notes=tuple(notes),
    )


def _steps(config: DeployConfig, head: HeadModel) -> int:
    rate_hz = head.timing.control_rate_hz
    if not 1 <= config.gazes <= _MOST_GAZES:
        raise ConfigurationError(f"gazes: expected 1 to {_MOST_GAZES}, got {config.gazes}")
    if not 1.0 <= config.duration_s * rate_hz <= 1e6:
        raise ConfigurationError(
            f"duration: expected seconds, at least one control period of 1/{rate_hz:g} s and at "
            f"most a million, got {config.duration_s}"
        )
    return round(config.duration_s * rate_hz)


def _task(hardware: HardwareConfig, log: LogWriter, *, moves: bool) -> GazeTask:
    # a robot looks at the world: all that it takes of a target is that trials begin at rest
    target = (
        {"kind": "random", "start": "rest"}
        if hardware.emulator
        else {"kind": "static", "point": (0.0, 0.0, 1.0)}
    )
    options = {"config": hardware, "log": log, "moves": moves}
    return GazeTask(1, head=hardware.head, plant="hardware", target=target, plant_options=options)


def _keep_images(task: GazeTask, log: LogWriter) -> None:
    """Log the last images of a gaze, for its picture."""
    images = task.plant.frames()
    exposed_s = float(task.reading.exposure_s[0])
    if images is not None and np.isfinite(exposed_s):
        for eye, image in enumerate(images):
            log.image(eye, image, log.begun_s + exposed_s)


def _present(task: GazeTask, number: int, step: int) -> Present:
    return Present(
        number=number + 1,
        step=step,
        reading=task.reading.copy(),
        pixel_error=task.pixel_error[0].copy(),
        command=task.command[0].copy(),
        late=task.plant.diagnostics().get("late_periods", 0),
    )
