"""Measurement of a robot's loop: each eye turns about the direction of a fixed target."""

import datetime
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.controllers.controller import make_controller
from vergence.envs.task import GazeTask, run_trial
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.config import HardwareConfig, LoopConfig
from vergence.hardware.delay.image_fit import ImageFit, fit_latency_and_backlash
from vergence.hardware.delay.joint_fit import FittedMotor, JointFit, fit_joint, fitted_angle_path
from vergence.hardware.plant import HardwarePlant
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import CommandOrigin, LoggedCommand, LoggedDetection
from vergence.triangulation import triangulate_views

SLOW_RAD_S: Final = 0.15
"""Speed of the slow part, rad/s, which shows the backlash and that the joint follows (chosen)."""
CHIRP_RAD_S: Final = 0.8
"""Greatest speed of the chirp, rad/s: 10 ms of exposure blur a webcam's image by 5 px (chosen)."""
QUICK_RAD_S: Final = 2.5
"""Greatest speed of the reversals, which images need not resolve, rad/s: at twice this a weak joint
would hardly move, and the supervisor would stop it as stuck (chosen)."""
_SLOW_AMPLITUDE_RAD: Final = 0.06
"""Amplitude of the slow part, rad (chosen)."""
_CHIRP_HZ: Final = (0.4, 4.0)
"""First and last frequency of the chirp, Hz (chosen)."""
# Durations of the slow part, the chirp and the reversals, s (chosen: precision against time).
_SLOW_DURATION_S: Final = 4.8
_CHIRP_DURATION_S: Final = 9.0
_REVERSALS_DURATION_S: Final = 3.0

_DRIFT_GAIN: Final = 1.0
"""Gain of the correction towards the planned angle, 1/s (chosen)."""
_DELAY_PERIODS: Final = 3
"""Rough delay of a joint behind its commands, control periods (chosen)."""


def excitation_speeds(reach_rad: float, max_speed_rad_s: float, period_s: float) -> FloatArray:
    """(n,) speeds of the excitation, one per control period, rad/s."""

    def to_and_fro(way_rad: float, speed_rad_s: float, length_s: float) -> FloatArray:
        speed_rad_s = min(speed_rad_s, max_speed_rad_s)
        quarter = max(2, round(way_rad / speed_rad_s / period_s))
        turn = np.repeat([1.0, -1.0, -1.0, 1.0], quarter)
        times = max(1, round(length_s / period_s / len(turn)))
        return np.asarray(speed_rad_s * np.tile(turn, times))

    slow = to_and_fro(min(_SLOW_AMPLITUDE_RAD, reach_rad), SLOW_RAD_S, _SLOW_DURATION_S)
    # a sinusoid with growing frequency
    first, last = _CHIRP_HZ
    t = period_s * np.arange(round(_CHIRP_DURATION_S / period_s))
    rate = (last / first) ** (1.0 / _CHIRP_DURATION_S)
    frequency = first * rate**t
    most = np.minimum(min(CHIRP_RAD_S, max_speed_rad_s), 2.0 * np.pi * frequency * reach_rad)
    chirp = most * np.cos(2.0 * np.pi * (frequency - first) / np.log(rate))
    reversals = to_and_fro(reach_rad, QUICK_RAD_S, _REVERSALS_DURATION_S)
    return np.concatenate([slow, chirp, reversals, slow])


def drift_corrected_velocities(
    slot: int, speeds_rad_s: FloatArray, period_s: float, read_angle: Callable[[], float]
) -> Iterator[FloatArray]:
    """(7,) velocities for one actuator, with a slow correction against drift, rad/s."""
    middle = read_angle()
    way = np.concatenate([np.zeros(_DELAY_PERIODS + 1), np.cumsum(speeds_rad_s)])
    places = middle + period_s * way
    for speed, place in zip(speeds_rad_s, places, strict=False):
        requested = np.zeros(7)
        requested[slot] = speed + _DRIFT_GAIN * (place - read_angle())
        yield requested


class LoopSamples(NamedTuple):
    """Commands and measurements of one eye, with times of one monotonic clock."""

    sent_s: FloatArray  # (n,) times at which commands were sent, s
    sent_velocities: FloatArray  # (n,) commands of the actuator that turned, rad/s
    joints_s: FloatArray  # (m,) times of the joint measurements, s
    joint_angles: FloatArray  # (m, 7) joint angles, rad
    joint_time_sigma_s: float  # standard deviation of a common error of `joints_s`, s
    received_s: FloatArray  # (k,) times of receipt of the images, s
    pixels: FloatArray  # (k, 2) raw pixels of the target; nan if it was not found
    detection_time_s: FloatArray  # (k,) times from an image's receipt to its detection, s


class SampleCollector(RobotListener):
    """Keeps commands, joint angles and detections, with times of its clock."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.newest = np.zeros(7)
        self.clear()

    def clear(self) -> None:
        """Discard everything recorded so far."""
        self._commands: list[LoggedCommand] = []
        self._joints: list[tuple[float, FloatArray]] = []
        self._answered_s: list[float] = []
        self._detections: list[LoggedDetection] = []

    def command(self, command: LoggedCommand) -> None:
        """See `RobotListener.command`."""
        self._commands.append(command)

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """See `RobotListener.joints`."""
        self._joints.append((clock_s, positions))
        self._answered_s.append(self.clock() - clock_s)
        self.newest = positions

    def detection(self, found: LoggedDetection) -> None:
        """See `RobotListener.detection`."""
        self._detections.append(found)

    def reply_times_s(self, read_s: Sequence[float]) -> FloatArray:
        """Times from a policy's readings, received at these times, to its commands, s."""
        sent_s = [one.clock_s for one in self._commands if one.by == CommandOrigin.POLICY.value]
        count = min(len(sent_s), len(read_s))
        return np.subtract(sent_s[:count], read_s[:count])

    def samples(self, eye: str, slot: int, latency_s: float) -> LoopSamples:
        """Samples of one eye, dated by its latency, while a slot's actuator turned."""
        seen = [one for one in self._detections if one.eye == eye]
        received_s = np.array([one.exposed_s for one in seen]) + latency_s
        return LoopSamples(
            sent_s=np.array([one.clock_s for one in self._commands]),
            sent_velocities=np.array([one.sent[slot] for one in self._commands]),
            joints_s=np.array([one[0] for one in self._joints]),
            joint_angles=np.array([one[1] for one in self._joints]).reshape(-1, 7),
            # a reading is dated at the end of its request, but measured at any time until its
            # answer; the shortest exchange has the least of this machine's own delays
            joint_time_sigma_s=min(self._answered_s) / np.sqrt(3.0) if self._joints else 0.0,
            received_s=received_s,
            pixels=np.array([one.point_px for one in seen]).reshape(-1, 2),
            detection_time_s=np.array([one.ready_s for one in seen]) - received_s,
        )


_MOST_CORRELATION: Final = 0.9
"""Correlation of latency and lag above which it is reported (chosen)."""
_MISFIT_RAD: Final = 3e-3
"""Rms angle residual above which a misfit is reported, rad: twice that of timing errors for a servo
with a pure lag, and less than that of an overshoot of 10 % (measured:
tests/hardware/delay/test_fits.py)."""
_MISFIT_PX: Final = 1.0
"""Rms reprojection error above which a misfit is reported, px (chosen)."""
_MOST_SCALE_ERROR: Final = 0.05
"""Deviation of the image scale from 1 that is reported if it exceeds 3 sigma (chosen)."""
_MOST_LATENCY_DIFFERENCE_S: Final = 0.01
"""Difference of the eyes' latencies above which their mean is reported as a poor model, s
(chosen)."""


@dataclass(frozen=True, kw_only=True)
class EyeLoop:
    """Measured loop of one eye."""

    eye: str
    actuator: str
    lag_ratio: float
    """Ratio of the actuator's own lag to the head's, from the head file."""
    model_acceleration_rad_s2: float
    """The actuator's greatest acceleration in the head file, rad/s^2."""
    joint_fit: JointFit
    image_fit: ImageFit | None
    """Fit of the images; None if too few of them showed the target."""
    computing_s: float
    """Sum of the median times from an image's receipt to its detection and from a reading to its
    command, s."""


@dataclass(frozen=True, kw_only=True)
class LoopMeasurement:
    """Measured loop of a robot."""

    eyes: tuple[EyeLoop, ...]

    @property
    def latencies_s(self) -> dict[str, float]:
        """Least latency of each measured camera by eye, s; images arrive up to the jitter later."""
        return {
            one.eye: one.image_fit.least_latency_s for one in self.eyes if one.image_fit is not None
        }

    def loop(self) -> LoopConfig:
        """Combine the values of both eyes into one loop for the configuration."""
        joints = [one.joint_fit for one in self.eyes]
        images = [one.image_fit for one in self.eyes if one.image_fit is not None]
        limits = [one.acceleration_rad_s2 for one in joints]
        found: dict[str, list[tuple[float, float]]] = {
            "command_latency_s": [
                (max(one.motor.latency_s, 0.0), one.sigma.latency_s) for one in joints
            ],
            "lag_s": [
                (one.joint_fit.lag_s / one.lag_ratio, one.joint_fit.lag_sigma_s / one.lag_ratio)
                for one in self.eyes
            ],
            "speed_gain": [(one.motor.gain, one.sigma.gain) for one in joints],
            "backlash_rad": [(one.backlash_rad, one.backlash_sigma_rad) for one in images],
            "jitter_s": [
                (one.jitter_s, one.jitter_sigma_s) for one in images if one.jitter_s is not None
            ],
            "acceleration_ratio": [
                (
                    limit / one.model_acceleration_rad_s2,
                    one.joint_fit.acceleration_sigma / one.model_acceleration_rad_s2,
                )
                for one, limit in zip(self.eyes, limits, strict=True)
                if limit is not None and None not in limits
            ],
            "latency_s": [(one.least_latency_s, one.least_latency_sigma_s) for one in images],
        }
        # timing errors of readings on one line do not average out
        shared = ("command_latency_s", "latency_s")
        means = {name: _mean(pairs, name in shared) for name, pairs in found.items() if pairs}
        return LoopConfig(
            measured=datetime.date.today().isoformat(),
            computing_s=float(np.mean([one.computing_s for one in self.eyes])),
            sigma={
                name: sigma
                for name, (_, sigma) in means.items()
                if np.isfinite(sigma) or name == "latency_s"
            },
            **{name: value for name, (value, _) in means.items() if name != "latency_s"},
        )

    def misfits(self) -> list[str]:
        """Texts, a line each, on misfits of the model of a robot."""
        lines = []
        for one in self.eyes:
            if one.joint_fit.misfit_rad > _MISFIT_RAD:
                lines.append(
                    f"{one.actuator}: its angles are {1e3 * one.joint_fit.misfit_rad:.1f} mrad "
                    "(rms) beside those of a lag behind a latency, whose values are the nearest: a "
                    "servo that overshoots or slips, or a machine that pauses"
                )
            if one.image_fit is None:
                continue
            off = one.image_fit.scale - 1.0
            scaled = abs(off) > max(_MOST_SCALE_ERROR, 3.0 * one.image_fit.scale_sigma)
            # a joint that moves otherwise between its readings displaces the image too
            beside = one.image_fit.residual_px > _MISFIT_PX
            if scaled or (beside and one.joint_fit.misfit_rad <= _MISFIT_RAD):
                by = f"moves by {100.0 * abs(off):.0f} % {'more' if off > 0.0 else 'less'}, and "
                lines.append(
                    f"{one.eye} eye: its camera is not as the head file has it: the image "
                    f"{by if scaled else ''}is {one.image_fit.residual_px:.1f} px (rms) off its "
                    "motion; calibrate it"
                )
        return lines

    def rows(self) -> list[dict[str, Any]]:
        """One row per eye and quantity: `eye`, `actuator`, `what`, `value`, `sigma`, `unit`."""
        return [row for one in self.eyes for row in _rows(one)]

    def undetermined(self) -> list[str]:
        """Texts, a line each, on quantities that the measurement cannot determine."""
        lines = [
            "the age of the encoders' readings cannot be measured and is taken to be zero: image "
            "latency is measured relative to it, and command latency together with it"
        ]
        for one in self.eyes:
            joint = one.joint_fit
            if joint.acceleration_rad_s2 is None:
                lines.append(
                    f"{one.actuator}: its acceleration limit was not reached: at least "
                    f"{joint.peak_acceleration_rad_s2:.0f} rad/s^2"
                )
            if abs(joint.latency_lag_correlation) > _MOST_CORRELATION:
                lines.append(
                    f"{one.actuator}: command latency and lag are poorly separated "
                    f"(correlation {joint.latency_lag_correlation:.2f}); their sum is better known"
                )
            fit = one.image_fit
            if fit is None:
                lines.append(
                    f"{one.eye} eye: too few images showed the target to measure latency, jitter "
                    "and backlash"
                )
                continue
            if fit.jitter_s is None:
                lines.append(
                    f"{one.eye} eye: it turned too slowly to measure the jitter of its images, so "
                    "their mean latency stands for the least; raise safety.speed_rad_s"
                )
            backlash_rad, doubt_rad = fit.backlash_rad, 2.0 * fit.backlash_sigma_rad
            if backlash_rad < doubt_rad:
                lines.append(
                    f"{one.actuator}: backlash is no greater than its uncertainty, below "
                    f"{1e3 * (backlash_rad + doubt_rad):.1f} mrad"
                )
        latencies = list(self.latencies_s.values())
        if len(latencies) == 2 and abs(latencies[0] - latencies[1]) > _MOST_LATENCY_DIFFERENCE_S:
            lines.append(
                f"the cameras' latencies differ by {1e3 * abs(latencies[0] - latencies[1]):.0f} "
                "ms; a simulation has their mean"
            )
        return lines


def _mean(pairs: Sequence[tuple[float, float]], shared: bool) -> tuple[float, float]:
    """Mean of the values, and its standard deviation, at least half the range of the values."""
    values, sigmas = np.array(pairs).T
    own = float(np.sqrt(np.mean(sigmas**2) / (1 if shared else len(values))))
    return float(values.mean()), max(own, 0.5 * float(np.ptp(values)))


def _rows(eye_loop: EyeLoop) -> Iterator[dict[str, Any]]:
    joint, image = eye_loop.joint_fit, eye_loop.image_fit
    motor, sigma = joint.motor, joint.sigma
    rows: list[tuple[str, float | None, float, str]] = [
        ("command + feedback latency", 1e3 * motor.latency_s, 1e3 * sigma.latency_s, "ms"),
        ("joint lag", 1e3 * joint.lag_s, 1e3 * joint.lag_sigma_s, "ms"),
        ("speed gain", motor.gain, sigma.gain, ""),
        ("greatest acceleration", joint.acceleration_rad_s2, joint.acceleration_sigma, "rad/s^2"),
    ]
    if (friction := joint.friction_ratio) is not None:
        rows.append(("friction", 100.0 * friction, np.nan, "% of torque"))
    if image is not None:
        jitter_ms = None if image.jitter_s is None else 1e3 * image.jitter_s
        least_ms, sigma_ms = 1e3 * image.least_latency_s, 1e3 * image.least_latency_sigma_s
        rows += [
            ("image - feedback latency", least_ms, sigma_ms, "ms"),
            ("image jitter", jitter_ms, 1e3 * image.jitter_sigma_s, "ms"),
            ("play", 1e3 * image.backlash_rad, 1e3 * image.backlash_sigma_rad, "mrad"),
            ("image scale", image.scale, image.scale_sigma, ""),
        ]
    rows.append(("computing, in total", 1e3 * eye_loop.computing_s, np.nan, "ms"))
    for what, value, deviation, unit in rows:
        sure = value is not None and np.isfinite(deviation)
        yield {
            "eye": eye_loop.eye, "actuator": eye_loop.actuator, "what": what, "value": value,
            "sigma": deviation if sure else None, "unit": unit,
        }  # fmt: skip


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
    own = {"log": collector, "clock": clock, "sleep": sleep, "view_check": view_check}
    task = GazeTask(
        1, head=head, plant="hardware", target=target, plant_options=own | {"config": config}
    )
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
        found.append(_fitted(config, *turn))
        progress(_TURNING_PROGRESS + (1.0 - _TURNING_PROGRESS) * place / len(turns))
    return LoopMeasurement(eyes=tuple(found))


def _turn(
    config: HardwareConfig, task: GazeTask, look: Any, collector: SampleCollector, eye: int,
    slot: int, progress: Callable[[float], None],
) -> tuple[int, int, LoopSamples, FloatArray, float]:  # fmt: skip
    """Arguments of `_fitted`: eye, slot, samples, point near the target, and time to a command."""
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
    moments = reading.positions, reading.positions_at_exposure, reading.pixels
    positions, at_exposure, pixels = (values[0].copy() for values in moments)
    reach = _reach(config, positions, eye, slot, pixels[eye])

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
    point = triangulate_views(head, at_exposure[None], pixels[None]).point[0]
    if not (np.isfinite(point).all() and point[2] > 0.0):
        point = _ahead(head, eye, positions)
    return eye, slot, samples, point, reply_s


def _fitted(
    config: HardwareConfig, eye: int, slot: int, samples: LoopSamples, point: FloatArray,
    reply_s: float,
) -> EyeLoop:  # fmt: skip
    head = config.head
    timing, actuation = head.timing, head.actuation
    motors = actuation.actuators_of(samples.joint_angles)
    guess = FittedMotor(
        latency_s=timing.command_latency_s + timing.feedback_latency_s,
        lag_s=max(float(timing.lag_s * actuation.lag_ratio[slot]), 2e-3),
        gain=1.0,
        inverse_acceleration=float(np.clip(1.0 / actuation.acceleration[slot], 2e-4, 5.0)),
    )
    recorded = samples.sent_s, samples.sent_velocities, samples.joints_s, motors[:, slot]
    fit = fit_joint(*recorded, guess, max(float(head.sensor.encoder_resolution_rad), 1e-5))
    image = fit_latency_and_backlash(
        head, eye, slot, np.median(motors, axis=0), fitted_angle_path(fit.motor, *recorded),
        (float(samples.joints_s[0]), float(samples.joints_s[-1])),
        samples.received_s, samples.pixels, point, 1.5 * CHIRP_RAD_S,
    )  # fmt: skip
    late = float(np.hypot(fit.sigma.latency_s, samples.joint_time_sigma_s))
    fit = replace(fit, sigma=fit.sigma._replace(latency_s=late))
    if image is not None:
        late = float(np.hypot(image.latency_sigma_s, samples.joint_time_sigma_s))
        image = replace(image, latency_sigma_s=late)
    detection_s = samples.detection_time_s
    return EyeLoop(
        eye=EYE_NAMES[eye],
        actuator=next(one.name for one in config.servos if one.slot == slot),
        lag_ratio=float(actuation.lag_ratio[slot]),
        model_acceleration_rad_s2=float(actuation.acceleration[slot]),
        joint_fit=fit,
        image_fit=image,
        computing_s=reply_s + (float(np.median(detection_s)) if len(detection_s) else 0.0),
    )


def actuator_slot(head: HeadModel, eye: int, actuator: str | None = None) -> int:
    """Index in the 7-element command of the actuator that turns an eye.

    By default it is the one that moves the eye's image most.

    Raises:
        ConfigurationError: no eye has such an actuator, or it does not move this eye's image.
    """
    rest = head.rest()
    point = _ahead(head, eye, rest)
    base = head.actuation.actuators_of(rest)
    before = head.project(rest, point, distorted=False)[eye]

    def moved_px(slot: int) -> float:
        turned = base.copy()
        turned[slot] += _ANGLE_STEP_RAD
        after = head.project(head.actuation.joints_of(turned), point, distorted=False)[eye]
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


def _ahead(head: HeadModel, eye: int, q: FloatArray) -> FloatArray:
    """(3,) point 1 m ahead of an eye, in N."""
    return np.asarray((head.camera_poses(q)[eye] @ np.array([0.0, 0.0, 1.0, 1.0]))[:3])


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
            f"the target stays in view and the joint within its limits, got {max(reach, 0.0):.3f} "
            "rad; cure: put the target ahead of the head at rest"
        )
    return reach
