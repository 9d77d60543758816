"""Measurement of a robot's loop: each eye turns about the direction of a fixed target."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.controllers.controller import make_controller
from vergence.envs.task import GazeTask, run_trial
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.delay.excitation import (
    CHIRP_RAD_S,
    drift_corrected_velocities,
    excitation_speeds,
)
from vergence.hardware.delay.image_fit import ImageFit, fit_latency_and_backlash
from vergence.hardware.delay.joint_fit import JointFit, fit_joint, fitted_angle_path
from vergence.hardware.delay.measurement import EyeLoop, LoopMeasurement
from vergence.hardware.delay.motor_model import FittedMotor
from vergence.hardware.delay.samples import LoopSamples, SampleCollector
from vergence.hardware.plant import HardwarePlant
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.triangulation import triangulate_views

_CENTRING_S: Final = 2.5
"""Time in which a slow controller turns the eyes to the target, s (chosen)."""
_CENTRING_GAIN: Final = 1.5
"""Gain of that controller, 1/s: stable with any plausible loop (chosen)."""
_MAX_AMPLITUDE_RAD: Final = 0.22
"""Greatest amplitude of the excitation, rad (chosen)."""
_EDGE_MARGIN_PX: Final = 90.0
"""Margin of the target's centre to the image's edge, px: half a tag (chosen)."""
_MIN_AMPLITUDE_RAD: Final = 0.04
"""Least amplitude with which a measurement is possible, rad (chosen)."""
_LATE_IMAGES_S: Final = 0.3
"""Time after the last command in which late images still arrive, s (chosen)."""
_TURNING_PROGRESS: Final = 0.9
"""Fraction of the progress that the turning takes; fits take the rest (chosen)."""
_ANGLE_STEP_RAD: Final = 1e-3
"""Finite-difference step of an actuator's angle, rad (numerical)."""
_MIN_RELATIVE_MOTION: Final = 0.2
"""Least image motion of a usable actuator, as a fraction of the best one's (chosen)."""


def measure_loop(
    config: HardwareConfig,
    eyes: Sequence[str] = EYE_NAMES,
    progress: Callable[[float], None] = lambda fraction: None,
    actuator: str | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
    view_check: bool = True,
) -> LoopMeasurement:
    """Turn each eye about the target's direction for some 25 s, and fit its loop.

    Args:
        config: the robot; its target is fixed and visible to both eyes at rest.
        eyes: names of the eyes to measure, `left` and `right`.
        progress: callback with the fraction that is done.
        actuator: actuator that turns; by default, for each eye the one that moves its image most.
        clock: see `HardwarePlant`.
        sleep: see `HardwarePlant`.
        view_check: see `HardwarePlant`.

    Raises:
        HardwareError: the robot was stopped, or the target is not visible.
        ConfigurationError: an eye has no room to turn, or this actuator does not turn it.
    """
    head, collector = config.head, SampleCollector(clock)
    slots = {name: actuator_slot(head, EYE_NAMES.index(name), actuator) for name in eyes}
    target = {"kind": "static", "point": (0.0, 0.0, 1.0)}
    options = {
        "config": config, "log": collector, "clock": clock, "sleep": sleep,
        "view_check": view_check,
    }  # fmt: skip
    task = GazeTask(1, head=head, plant="hardware", target=target, plant_options=options)
    look = make_controller("ibvs", head, task.layout, gain=_CENTRING_GAIN)
    turns = []
    with closing(task):
        task.prepare(look)
        for place, name in enumerate(eyes):

            def done(fraction: float, place: int = place) -> None:
                progress(_TURNING_PROGRESS * (place + fraction) / len(eyes))

            eye = EYE_NAMES.index(name)
            turns.append(_turn(config, task, look, collector, eye, slots[name], done))
    found = []
    # only now: a fit and its compilation would delay the thread that holds the joints
    for place, turn in enumerate(turns, 1):
        found.append(_fitted(config, turn))
        progress(_TURNING_PROGRESS + (1.0 - _TURNING_PROGRESS) * place / len(turns))
    return LoopMeasurement(eyes=tuple(found))


class _Turn(NamedTuple):
    """Data of one eye from its excitation."""

    eye: int
    slot: int
    samples: LoopSamples
    exposed: tuple[FloatArray, FloatArray, FloatArray]
    """Reading before the excitation: (7,) joints, (7,) joints at exposure, rad, (2, 2) pixels."""
    reply_s: float
    """Median time from a reading to its command, s."""


def _turn(
    config: HardwareConfig,
    task: GazeTask,
    look: Any,
    collector: SampleCollector,
    eye: int,
    slot: int,
    progress: Callable[[float], None],
) -> _Turn:
    head, name = config.head, EYE_NAMES[eye]
    assert isinstance(task.plant, HardwarePlant)
    period_s = head.timing.period_s
    read_s: list[float] = []
    collector.clear()
    steps = round(_CENTRING_S / period_s)
    run_trial(task, look, steps, lambda step: read_s.append(collector.clock()))
    reply_s = float(np.median(collector.reply_times_s(read_s)))
    reading = task.reading
    if not reading.visible[0, eye]:
        raise HardwareError(
            f"cameras.{name}: expected {config.target} in view, got images without it; cure: put "
            "it about 1 m ahead of the head at rest, in good light"
        )
    exposed = (
        reading.positions[0].copy(),
        reading.positions_at_exposure[0].copy(),
        reading.pixels[0].copy(),
    )
    reach = _reach(config, exposed[0], eye, slot, exposed[2][eye])

    def angle() -> float:
        motors: FloatArray = head.actuation.actuators_of(collector.newest)
        return float(motors[slot])

    max_speed = min(float(head.actuation.velocity[slot]), config.safety.speed_rad_s)
    way = excitation_speeds(reach, max_speed, period_s)
    quiet = round(_LATE_IMAGES_S / period_s)
    collector.clear()

    def all_of_them() -> Iterator[FloatArray]:
        for k, requested in enumerate(drift_corrected_velocities(slot, way, period_s, angle)):
            progress(k / len(way))
            yield requested
        yield from np.zeros((quiet, 7))

    task.plant.robot.exercise(all_of_them())
    samples = collector.samples(name, slot, config.cameras[eye].latency_s)
    return _Turn(eye, slot, samples, exposed, reply_s)


def _fitted(config: HardwareConfig, turn: _Turn) -> EyeLoop:
    samples = turn.samples
    fit, image = _fit(config.head, turn.eye, turn.slot, samples, _point(config.head, turn))
    late = float(np.hypot(fit.sigma.latency_s, samples.joint_time_sigma_s))
    fit = replace(fit, sigma=fit.sigma._replace(latency_s=late))
    if image is not None:
        late = float(np.hypot(image.latency_sigma_s, samples.joint_time_sigma_s))
        image = replace(image, latency_sigma_s=late)
    return EyeLoop(
        eye=EYE_NAMES[turn.eye],
        actuator=next(one.name for one in config.servos if one.slot == turn.slot),
        lag_ratio=float(config.head.actuation.lag_ratio[turn.slot]),
        model_acceleration_rad_s2=float(config.head.actuation.acceleration[turn.slot]),
        joint_fit=fit,
        image_fit=image,
        computing_s=turn.reply_s
        + (float(np.median(samples.detection_time_s)) if len(samples.detection_time_s) else 0.0),
    )


def _fit(
    head: HeadModel, eye: int, slot: int, samples: LoopSamples, point: FloatArray
) -> tuple[JointFit, ImageFit | None]:
    motors = head.actuation.actuators_of(samples.joint_angles)
    timing, k = head.timing, slot
    guess = FittedMotor(
        latency_s=timing.command_latency_s + timing.feedback_latency_s,
        lag_s=max(float(timing.lag_s * head.actuation.lag_ratio[k]), 2e-3),
        gain=1.0,
        inverse_acceleration=float(np.clip(1.0 / head.actuation.acceleration[k], 2e-4, 5.0)),
    )
    step = max(float(head.sensor.encoder_resolution_rad), 1e-5)
    recorded = samples.sent_s, samples.sent_velocities, samples.joints_s, motors[:, slot]
    fit = fit_joint(*recorded, guess, step)
    image = fit_latency_and_backlash(
        head, eye, slot, np.median(motors, axis=0), fitted_angle_path(fit.motor, *recorded),
        (float(samples.joints_s[0]), float(samples.joints_s[-1])),
        samples.received_s, samples.pixels, point, 1.5 * CHIRP_RAD_S,
    )  # fmt: skip
    return fit, image


def actuator_slot(head: HeadModel, eye: int, actuator: str | None = None) -> int:
    """Index in the 7-element command of the actuator that turns an eye.

    Args:
        head: the model.
        eye: 0 for left.
        actuator: its name; by default the one that moves the eye's image most.

    Raises:
        ConfigurationError: no eye has such an actuator, or it does not move this eye's image.
    """
    rest = head.rest()
    point = head.camera_poses(rest)[eye] @ np.array([0.0, 0.0, 1.0, 1.0])
    base = head.actuation.actuators_of(rest)
    before = head.project(rest, point[:3], distorted=False)[eye]

    def moved_px(slot: int) -> float:
        turned = base.copy()
        turned[slot] += _ANGLE_STEP_RAD
        after = head.project(head.actuation.joints_of(turned), point[:3], distorted=False)[eye]
        return float(np.linalg.norm(after - before))

    moved = {name: moved_px(NECK.stop + i) for i, name in enumerate(head.actuation.names)}
    able = [name for name in moved if moved[name] > _MIN_RELATIVE_MOTION * max(moved.values())]
    if actuator is not None and actuator not in able:
        raise ConfigurationError(
            f"actuator: expected one that turns the {EYE_NAMES[eye]} eye, {' or '.join(able)}, "
            f"got {actuator!r:.80}"
        )
    name = max(moved, key=moved.__getitem__) if actuator is None else actuator
    return NECK.stop + head.actuation.names.index(name)


def _point(head: HeadModel, turn: _Turn) -> FloatArray:
    """(3,) approximate position of the target, in N, m."""
    positions, at_exposure, pixels = turn.exposed
    point = triangulate_views(head, at_exposure[None], pixels[None]).point[0]
    if np.isfinite(point).all() and point[2] > 0.0:
        return np.asarray(point)
    T_N_C = head.camera_poses(positions)[turn.eye]
    return np.asarray((T_N_C @ np.array([0.0, 0.0, 1.0, 1.0]))[:3])


def _reach(
    config: HardwareConfig, positions: FloatArray, eye: int, slot: int, pixel: FloatArray
) -> float:
    """Greatest amplitude about the present angle within the image and the joint's limits, rad."""
    head = config.head
    size = head.cameras.size[eye]
    room_px = float(np.minimum(pixel, size - 1 - pixel).min()) - _EDGE_MARGIN_PX
    focal_px = float(head.cameras.focal[eye].mean())
    servo = next(one for one in config.servos if one.slot == slot)
    angle = float(head.actuation.actuators_of(positions)[slot])
    room = min(servo.upper_rad - angle, angle - servo.lower_rad) - 0.05
    reach = min(_MAX_AMPLITUDE_RAD, room_px / focal_px, room)
    if reach < _MIN_AMPLITUDE_RAD:
        raise ConfigurationError(
            f"servos.{servo.name}: expected {_MIN_AMPLITUDE_RAD:g} rad to either side in which "
            "the target "
            f"stays in view and the joint within its limits, got {max(reach, 0.0):.3f} rad; cure: "
            "put the target ahead of the head at rest"
        )
    return reach
