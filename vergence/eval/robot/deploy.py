"""Deployment of a policy on a robot: gazes from rest, all in one log."""

import dataclasses
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.envs.plant import Plant
from vergence.envs.reading import Reading
from vergence.envs.targets.motion import Target
from vergence.envs.targets.prescribed import UnseenTarget
from vergence.envs.task import GazeTask, run_trial
from vergence.errors import ConfigurationError, VergenceError
from vergence.eval.gaze_trajectory import MM
from vergence.eval.robot.config import DeployConfig, ReplayConfig
from vergence.eval.robot.controller import RobotController
from vergence.eval.robot.gazes import MOST_PERIODS, RobotGazes
from vergence.eval.robot.replay import replay
from vergence.eval.robot.stage import REST_TARGET
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.plant import HardwarePlant
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.posture import LookAt, look_at
from vergence.recording import Recorder
from vergence.recording.events import warn_of_gap
from vergence.recording.follow import Click, ClickReader
from vergence.recording.log import read_log
from vergence.recording.writer import LogWriter
from vergence.reporting.runs import package_versions
from vergence.vision.objects.targets import GazeTarget, PlaceTarget, PointTarget, parse_gaze_target

_LOG: Final = logging.getLogger(__name__)
_MOST_GAZES: Final = 10_000
"""Largest number of gazes of a deployment (chosen: bounds the log, far above a useful number)."""


class GazeState(NamedTuple):
    """State of a running gaze, for display."""

    head: HeadModel
    """The model that the controller uses."""
    number: int
    """Number of the gaze, counted from 1."""
    step: int
    """Control periods since the beginning of the gaze."""
    reading: Reading
    """The sensors' reading of one head."""
    pixel_error: FloatArray
    """(2, 2) measured pixel error by eye, px; nan if not visible."""
    requested: FloatArray
    """(7,) velocities that the policy asked for, rad/s."""
    late_periods: int
    """Number of late control periods so far."""


@dataclass(frozen=True, kw_only=True)
class Deployment:
    """Result of a deployment."""

    controller: str
    gazes: RobotGazes
    log: Path
    error: VergenceError | KeyboardInterrupt | None
    """Reason for an early end; None if all gazes were run."""
    expected: LookAt | None = None
    """How well a place is looked at without images; None for a target in the images."""

    def summary(self) -> dict[str, Any]:
        """The result as plain values; None for undefined metrics."""
        faults = self.error.lines if isinstance(self.error, VergenceError) else ()
        return {
            "controller": self.controller,
            **self.gazes.summary(),
            "faults": list(faults),
            "log": str(self.log),
        }


def deploy(
    config: DeployConfig,
    log: Path,
    *,
    check: Callable[[HardwareConfig], None] = lambda hardware: None,
    show: Callable[[GazeState], None] = lambda present: None,
) -> Deployment:
    """Run gazes on a robot.

    An error in a gaze, such as a fault that stops the head or a policy that raises, ends the
    deployment and is reported in its result; so does Ctrl-C.

    Args:
        config: the deployment; with `resume`, only its missing gazes run, and the result has all.
        log: the new file to log to.
        check: called with the robot once all else is ready; it may raise to refuse it.
        show: called in each control period; it must not delay the loop.

    Raises:
        VergenceError: the deployment ended before any command was sent; the log is removed then.
        ChecksFailedError: the robot must not move yet.
    """
    hardware = load_hardware(config.hardware)
    look = _look(config)
    expected = None
    if look is not None:
        hardware = dataclasses.replace(hardware, target=look)
        if isinstance(look, PlaceTarget):
            expected = look_at(hardware.head, np.asarray(look.point_mm) / MM)
    gazes = RobotGazes(steps=_steps(config, hardware.head), dry_run=config.dry_run)
    robot = RobotController.of(config.controller, hardware.head, config.options)
    if config.resume is not None:
        _resume(config, config.resume, hardware, robot, gazes)
    error: VergenceError | KeyboardInterrupt | None = None
    with _open_log(config, hardware, robot, gazes, log) as writer:
        try:
            check(hardware)
            _gaze(config, hardware, robot, gazes, writer, show)
        except (VergenceError, KeyboardInterrupt) as stop:
            if not writer.commanded:
                writer.close()
                with suppress(OSError):
                    log.unlink()
                raise
            error = stop
            gazes.stopped = isinstance(stop, VergenceError)
            if isinstance(stop, VergenceError) and not writer.reason:
                writer.stopped("; ".join(stop.lines))
    return Deployment(controller=robot.name, gazes=gazes, log=log, error=error, expected=expected)


def _gaze(
    config: DeployConfig,
    hardware: HardwareConfig,
    robot: RobotController,
    gazes: RobotGazes,
    writer: LogWriter,
    show: Callable[[GazeState], None],
) -> None:
    # a real robot finds its target itself; the task's only makes trials begin at rest
    target: Mapping[str, Any] | Target = REST_TARGET
    if hardware.places_targets and isinstance(hardware.target, PlaceTarget):
        x, y, z = hardware.target.point_mm
        target = UnseenTarget(point=(x / MM, y / MM, z / MM), start="rest")
    elif hardware.places_targets:
        target = {"kind": "random", "start": "rest"}
    options = {
        "config": hardware,
        "log": writer,
        "moves": not config.dry_run,
        "view_check": config.view_check,
    }
    task = GazeTask(1, head=hardware.head, plant="hardware", target=target, plant_options=options)
    # the last pixel error is known only once its image has arrived
    steps = (gazes.steps or 0) + hardware.head.timing.latency_frames

    first = len(gazes.trials)
    clicks = ClickReader(writer.path) if isinstance(hardware.target, PointTarget) else None

    def gaze(number: int) -> None:
        record = Recorder(task, steps)

        def keep(step: int) -> None:
            record(step)
            if clicks is not None and (click := clicks.poll()) is not None:
                _follow(task.plant, click)
            show(_present(task, number, step))

        try:
            run_trial(task, robot.policy, steps, keep, seed=config.seed, first_trial=number)
            if not config.images:
                _keep_images(task, writer)
            if number == first:
                warn_of_gap(task.head, record.reading)
        finally:
            gazes.add(task, record)

    try:
        with robot.attributing_errors():
            task.prepare(robot.policy)
            for number in range(first, config.gazes):
                gaze(number)
    finally:
        task.close()
        if clicks is not None:
            clicks.close()


def _follow(plant: Plant, click: Click) -> None:
    """Follow a clicked point; say what cannot be followed."""
    assert isinstance(plant, HardwarePlant)
    try:
        plant.click(*click)
    except ConfigurationError as error:
        _LOG.warning("%s", error)


def _present(task: GazeTask, number: int, step: int) -> GazeState:
    return GazeState(
        head=task.head,
        number=number + 1,
        step=step,
        reading=task.reading.copy(),
        pixel_error=task.pixel_error[0].copy(),
        requested=task.command[0].copy(),
        late_periods=task.plant.diagnostics().get("late_periods", 0),
    )


def _keep_images(task: GazeTask, log: LogWriter) -> None:
    """Log the last images of a gaze, for its picture."""
    images = task.plant.frames()
    exposed_s = float(task.reading.exposure_s[0])
    if images is not None and np.isfinite(exposed_s):
        for eye, image in enumerate(images):
            log.image(eye, image, log.begun_s + exposed_s)


def _open_log(
    config: DeployConfig,
    hardware: HardwareConfig,
    robot: RobotController,
    gazes: RobotGazes,
    path: Path,
) -> LogWriter:
    return LogWriter(
        path,
        head=hardware.head,
        config=hardware.text,
        facts={
            **_facts(config, robot, gazes),
            **({"resumes": os.path.relpath(config.resume, path.parent)} if config.resume else {}),
            **{f"version {name}": text for name, text in package_versions().items()},
        },
        images=config.images,
    )


def _resume(
    config: DeployConfig,
    path: Path,
    hardware: HardwareConfig,
    robot: RobotController,
    gazes: RobotGazes,
) -> None:
    """Add the complete gazes of a log, and of the logs that it resumes, in their order."""
    if config.dry_run:
        raise ConfigurationError("resume: expected no --dry-run beside it, got both")
    log = read_log(path)
    if earlier := log.facts.get("resumes"):
        _resume(config, path.parent / earlier, hardware, robot, gazes)
    same = _facts(config, robot, gazes) | {"head": hardware.head.digest}
    of_log = log.facts | {"head": log.head.digest}
    for name, value in same.items():
        if of_log.get(name, "") != value:
            raise ConfigurationError(
                f"resume: expected the {name} of {path}, {of_log.get(name, '')!r:.80}, "
                f"got {value!r:.80}"
            )
    done = replay(ReplayConfig(log=path)).gazes
    gazes.add_complete(done)
    if path == config.resume and len(gazes.trials) >= config.gazes:
        raise ConfigurationError(
            f"resume: expected a log in which some of the {config.gazes} gazes are missing, got "
            f"{path}, with which {len(gazes.trials)} are complete"
        )


def _facts(config: DeployConfig, robot: RobotController, gazes: RobotGazes) -> dict[str, str]:
    """What makes two deployments parts of one, as a log states it."""
    return {
        "controller": robot.name,
        "controller_sha256": robot.sha256,
        "options": robot.stated_options,
        "steps": str(gazes.steps),
        "seed": str(config.seed),
        "dry_run": str(config.dry_run),
        **({} if (look := _look(config)) is None else {"target": str(look)}),
    }


def _look(config: DeployConfig) -> GazeTarget | None:
    """What is looked at in place of the configuration's target; None for that."""
    if config.target_mm is not None:
        if config.target is not None or config.pixel is not None:
            raise ConfigurationError("point: expected no --target beside it, got both")
        return PlaceTarget(point_mm=config.target_mm)
    if config.target is None and config.pixel is None:
        return None
    return parse_gaze_target("point" if config.target is None else config.target, config.pixel)


def _steps(config: DeployConfig, head: HeadModel) -> int:
    """Control periods of a whole gaze; refuses options out of range."""
    rate_hz = head.timing.control_rate_hz
    if not 1 <= config.gazes <= _MOST_GAZES:
        raise ConfigurationError(f"gazes: expected 1 to {_MOST_GAZES}, got {config.gazes}")
    if not 1.0 <= config.duration_s * rate_hz <= MOST_PERIODS:
        raise ConfigurationError(
            f"duration: expected {1.0 / rate_hz:.3g} to {MOST_PERIODS / rate_hz:g} s, from one to "
            f"{MOST_PERIODS} control periods, got {config.duration_s:g}"
        )
    return round(config.duration_s * rate_hz)
