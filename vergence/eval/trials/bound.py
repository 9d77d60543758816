r"""The time-optimal bound: a lower bound on the settling time of any controller.

A controller knows nothing of a target before it can read the first image in which the detector of
either eye finds it, after that trial's latency, jitter, dropped frames and missed detections. The
next control step reacts to the image, and its command takes effect after the command latency. From
then on the slowest actuator needs at least the minimum time to enter its settling band and stay
there, see `vergence.eval.trials.entry`; its motor crosses its backlash by the shortest way. Trials
are judged at control steps, so the time is rounded up to whole periods. It counts from the onset.

Several relaxations keep this a lower bound for every controller:

- An actuator's band is the widest that the eyes' error circles allow, whatever the other actuators
  do, see `vergence.eval.trials.bands`.
- Errors between control steps do not count: an actuator may pass the far edge of its band by
  `a T^2 / 8` and return within one period.
- The switch from full command to full reverse need not fall on a control step.
- Commands are not quantised and not lost, and the control loop does not stall.
- An outlier or a false detection counts as a detection.
- A servo with a second-order response has no lag, and its speed limit is the highest speed that its
  overshoot can reach.

Except for the servo's response, lost commands and stalls, each of them lowers the bound by no more
than a few milliseconds.

The goal minimises the true head's error as the controller measures it, see
`vergence.eval.trials.goal`. With model errors, the true head does not fixate the target there.
"""

from math import inf, isfinite
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plant import simulation_of
from vergence.envs.plants.conditions import Conditions
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.bands import actuator_settling_bands, eye_settling_bands
from vergence.eval.trials.entry import least_entry_time
from vergence.eval.trials.goal import least_reachable_error
from vergence.kernels import compiled, inlined
from vergence.models.parts import EYES, SLOTS, Actuation, FloatArray

_PERIOD_TOLERANCE: Final = 1e-6
"""Tolerance, in control periods, within which two times count as equal (numerical)."""


def settle_bound(
    task: GazeTask, band_px: float = 1.0, first_sight_s: FloatArray | None = None
) -> FloatArray:
    """Earliest time at which both eyes can have settled, for trials that have just begun.

    Args:
        task: trials at time zero, on a simulated plant. The targets are assumed to come to rest,
            at once or after a second jump. Nothing can be known of the second jump before its own
            first image; until then the eyes may have gone anywhere.
        band_px: the settling band, on the norm of each eye's true pixel error.
        first_sight_s: (n,) times at which the first image of the target could be read in trials on
            a robot, s; by default the times of the simulated loop.

    Returns:
        (n,) seconds since the onset, rounded up to a control step; 0 for eyes that look there
        already, inf if an actuator's range ends before the band or no eye ever sees the target.

    Raises:
        ConfigurationError: the plant is no simulation, trials have moved on, or the band is
            not above zero.
    """
    if not band_px > 0.0:
        raise ConfigurationError(f"band_px: expected more than 0, got {band_px}")
    simulation = simulation_of(task.plant)
    truth, conditions = simulation.truth_at_rest(), simulation.conditions
    if truth.time_s.any():
        raise ConfigurationError(
            f"task: expected trials at time zero, got one at {truth.time_s.max():.3f} s"
        )
    head, actuation = task.head, simulation.true_head.actuation
    period = head.timing.period_s
    motion_s = np.empty(task.num)
    goal, half_band = np.empty((2, task.num, SLOTS))
    find = eye_settling_bands if actuation.direct else actuator_settling_bands
    find(conditions.heads, head.packed, truth.target, band_px, goal, half_band)
    _motion_times(
        goal,
        half_band,
        np.ascontiguousarray(actuation.actuators_of(truth.positions)[:, EYES]),
        np.ascontiguousarray(truth.motors[:, EYES]),
        EyeActuatorLimits.of(actuation),
        EyeActuatorOverrides.of(conditions),
        period,
        motion_s,
    )
    beyond = truth.pixel_error - least_reachable_error(task, truth.target)
    inside = (np.linalg.norm(beyond, axis=-1) < band_px).all(axis=-1)
    sights = (
        simulation.first_detection_times()
        if first_sight_s is None
        else (first_sight_s, np.full(task.num, -inf))
    )
    first, last = (np.ceil(sight / period - _PERIOD_TOLERANCE) for sight in sights)
    moves_s = first * period + conditions.command_latency_s
    # The joints' bands enclose the error circle: an eye outside the circle has to move even if its
    # joints are within their bands.
    settled = np.maximum(np.ceil((moves_s + motion_s) / period - _PERIOD_TOLERANCE), last + 1.0)
    return np.where(inside, 0.0, settled * period - simulation.onset_s())


class EyeActuatorLimits(NamedTuple):
    """Motion limits of the eyes' actuators, (4,) each."""

    lower: FloatArray
    """Least angles, rad."""
    upper: FloatArray
    """Greatest angles, rad."""
    speed: FloatArray
    """Greatest velocity commands, rad/s; 0 for an actuator that does not exist."""
    acceleration: FloatArray
    """Greatest accelerations, rad/s^2; inf for no limit."""
    lag_ratio: FloatArray
    """Lags, as ratios to the head's lag."""

    @classmethod
    def of(cls, actuation: Actuation) -> "EyeActuatorLimits":
        """Take the limits of a head's eye actuators."""
        return cls(
            *(
                np.ascontiguousarray(values[EYES])
                for values in (
                    actuation.lower,
                    actuation.upper,
                    actuation.velocity,
                    actuation.acceleration,
                    actuation.lag_ratio,
                )
            )
        )


class EyeActuatorOverrides(NamedTuple):
    """Per-trial overrides of the motor limits, (n,) or (n, 4) by actuator of the eyes."""

    lag_s: FloatArray
    acceleration_ratio: FloatArray
    torque_falloff: FloatArray
    speed_gain: FloatArray
    backlash_rad: FloatArray

    @classmethod
    def of(cls, conditions: Conditions) -> "EyeActuatorOverrides":
        """Take the overrides from the trials' conditions.

        A second-order response with overshoot o never exceeds (1 + o) / (1 - o) times its greatest
        command, however it is driven. Its trials get this speed limit, their acceleration limit
        and no lag.
        """
        overrides = cls(
            *(
                np.array(values[:, EYES] if values.ndim > 1 else values)
                for values in (getattr(conditions, name) for name in cls._fields)
            )
        )
        over = conditions.overshoot
        overrides.lag_s[over > 0.0] = 0.0
        overrides.speed_gain[:] *= ((1.0 + over) / (1.0 - over))[:, None]
        return overrides


@compiled
def _motion_times(
    goal: FloatArray,
    half_band: FloatArray,
    start: FloatArray,
    begin: FloatArray,
    motors: EyeActuatorLimits,
    overrides: EyeActuatorOverrides,
    period: float,
    times: FloatArray,
) -> None:
    """Write the least time that the slowest actuator of each trial needs.

    Args:
        goal: (n, 4) goal angles of the eyes' actuators, rad; nan for no goal.
        half_band: (n, 4) largest deviations from the goals, rad.
        start: (n, 4) present angles of the actuators, rad.
        begin: (n, 4) present angles of their motors, within the backlash, rad.
        motors: `EyeActuatorLimits`.
        overrides: `EyeActuatorOverrides`.
        period: the control period, s.
        times: (n,) result, s.
    """
    for n in range(times.shape[0]):
        times[n] = 0.0
        for k in range(SLOTS):
            if not motors.speed[k] > 0.0:
                continue
            entry = inf
            if isfinite(goal[n, k]):
                turn = goal[n, k] - start[n, k]
                behind = start[n, k] - begin[n, k]
                # the motor's way through the backlash to the flank that pushes
                backlash_way = 0.5 * overrides.backlash_rad[n, k] + (
                    behind if turn > 0.0 else -behind
                )
                room = (
                    motors.upper[k] - begin[n, k] if turn > 0.0 else begin[n, k] - motors.lower[k]
                )
                top = overrides.speed_gain[n, k] * motors.speed[k]
                entry = _entry(
                    turn,
                    half_band[n, k],
                    max(backlash_way, 0.0),
                    room,
                    overrides.lag_s[n] * motors.lag_ratio[k],
                    overrides.acceleration_ratio[n] * motors.acceleration[k],
                    top,
                    overrides.torque_falloff[n] / top,
                    period,
                )
            times[n] = max(times[n], entry)


@inlined
def _entry(
    turn: float,
    half_band: float,
    backlash_way: float,
    room: float,
    lag: float,
    acceleration: float,
    speed: float,
    torque_falloff: float,
    period: float,
) -> float:
    """Least time in which an actuator at rest enters its band and stays there.

    Args:
        turn: angle from the actuator to its goal, signed, rad.
        half_band: largest deviation from the goal, rad.
        backlash_way: backlash that the motor has to cross before the actuator moves, rad.
        room: angle up to the motor's limit in that direction, rad.
        lag: time constant of the response, s.
        acceleration: greatest acceleration, rad/s^2.
        speed: greatest velocity command, rad/s.
        torque_falloff: loss of acceleration with speed, as a fraction per rad/s.
        period: the control period, s.
    """
    near = abs(turn) - half_band
    if near <= 0.0:
        return 0.0
    near, far = near + backlash_way, abs(turn) + half_band + backlash_way
    if acceleration < inf:
        far += acceleration * period * period / 8.0
    if near > room:
        return inf
    if far >= room:
        far = inf  # the end of the range stops it
    return least_entry_time(near, far, lag, acceleration, speed, torque_falloff)
