"""Observations of eyes that follow given commands: exact, and made without the package's plants."""

from collections.abc import Callable
from math import floor, inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.controllers.reaching import Trial, run
from tests.joint_motion import respond
from vergence.controllers.prediction.predictor import SmithPredictor, prediction_fields
from vergence.envs.observation import AGE_S, Observation, ObservationLayout
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel

Array = NDArray[np.float64]
_STEP_S = 0.0005
PLACE = (0.05, -0.12, 0.9)
"""Position of a target at rest in N, m."""


class Recording(NamedTuple):
    """Observations of a head, and the ground truth."""

    observations: list[Observation]
    positions: Array
    """(steps, 4) true angles of the eyes' joints, rad."""


def resting(_time_s: float) -> Array:
    """A target that does not move."""
    return np.array(PLACE)


def record(
    head: HeadModel, commands: Array, *, target: Callable[[float], Array] = resting,
    latency_s: float = 0.0, lag_s: float | None = None, build_up: float = 0.0, ratio: float = 1.0,
    gain: float = 1.0, image_delay_s: float | None = None, noise_px: float = 0.0,
    spoil: Callable[[float, Array], Array] | None = None,
) -> Recording:  # fmt: skip
    """Let a head with four motors follow commands (steps, 4), rad/s; times and lags are in s.

    `target` gives its position in N, m, at a time, and `spoil` the detected errors (2, 2) of an
    exposure. The build-up is b in b lag^2 v'' + lag v' + v = u, and `ratio` that of acceleration
    limits to the head's. Lag and delay of images are the head's unless given.
    """
    timing, rng = head.timing, np.random.default_rng(0)
    lag = timing.lag_s if lag_s is None else lag_s
    delay = timing.latency_s if image_delay_s is None else image_delay_s
    period = timing.period_s
    q, v, w = head.rest()[3:], np.zeros(4), np.zeros(4)
    a = ratio * head.actuation.acceleration[3:]
    angles, speeds = [q], [v]
    for i in range(round(len(commands) * period / _STEP_S) if commands.any() else 1):
        k = floor((i * _STEP_S - latency_s + 1e-9) / period)
        u = gain * commands[k] if k >= 0 else np.zeros(4)
        if build_up > 0.0:
            push = (u - v - lag * w) / (build_up * lag * lag)
            w = np.clip(w + _STEP_S * push, -a, a)
            q, v = q + _STEP_S * (v + 0.5 * _STEP_S * w), v + _STEP_S * w
        else:
            q, v = respond(q, v, u, lag, a, _STEP_S)
        angles.append(q)
        speeds.append(v)
    times = _STEP_S * np.arange(len(angles))
    columns, rates = np.array(angles).T, np.array(speeds).T

    def at(time_s: float, of: Array) -> Array:
        return np.array([np.interp(time_s, times, column) for column in of])

    def image(exposed: float) -> Array:
        joints = np.concatenate([head.rest()[:3], at(exposed, columns)])
        pixels = head.project(joints, target(exposed), distorted=False)
        error = pixels - head.cameras.principal + noise_px * rng.standard_normal((2, 2))
        return error if spoil is None else spoil(exposed, error)

    images: dict[int, Array] = {}
    observations, positions, before = [], [], np.zeros(4)
    for k, command in enumerate(commands):
        now = k * period
        newest = floor((now - delay) * timing.frame_rate_hz + 1e-6)
        age, error = AGE_S, np.full((2, 2), np.nan)
        joints = np.concatenate([head.rest()[:3], at(now, columns)])
        if newest >= 0:
            exposed = newest / timing.frame_rate_hz
            if newest not in images:
                images[newest] = image(exposed)
            age, error = now - exposed, images[newest]
            if not timing.exposure_stamps:  # dated by its coming
                age += timing.latency_s - delay
        observations.append(
            Observation(
                pixel_error=error, visible=np.isfinite(error).all(axis=-1),
                image_age_s=np.array(age), positions=joints, positions_at_exposure=joints,
                velocities=np.concatenate([np.zeros(3), at(now, rates)]), last_command=before,
            )
        )  # fmt: skip
        positions.append(joints[3:])
        before = command
    return Recording(observations, np.array(positions))


def predicted(predictor: SmithPredictor, seen: Observation, state: Array) -> Any:
    """A prediction, by the names of its fields."""
    return prediction_fields(predictor.update(seen, state)).view(np.recarray)


def predict(predictor: SmithPredictor, recording: Recording) -> list[Any]:
    """Predictions from a recording, one per period."""
    state = predictor.initial()
    return [predicted(predictor, seen, state) for seen in recording.observations]


def predictor_of(head: HeadModel, *, moving: bool = False) -> SmithPredictor:
    """A predictor that learns all it can."""
    return SmithPredictor(head=head, layout=ObservationLayout.of(head), targets_move=moving)


def saccades(head: HeadModel, steps: int, name: str = "saccade", num: int = 12, **options) -> Trial:
    """Trials of a law on a kinematic plant with some options."""
    task = GazeTask(num, head=head, plant="kinematic", plant_options=options)
    return run(task, name, steps)


def turns(head: HeadModel, steps: int, *, speed: float = inf, time_s: float = 0.06) -> Array:
    """(steps, 4) commands that turn both eyes there and back in times of `time_s`, then rest.

    The second joints turn at `speed` at most.
    """
    fastest = np.minimum(head.actuation.velocity[3:], speed)
    commands = np.zeros((steps, 4))
    way = max(round(time_s / head.timing.period_s), 2)
    for i, side in enumerate((1.0, -1.0, -1.0, 1.0)):
        commands[2 + i * way : 2 + (i + 1) * way] = side * fastest * (0.2, 1.0, 0.2, 1.0)
    return commands
