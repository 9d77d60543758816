r"""The time-optimal bound: no controller can settle before it.

Nothing can be known of a target before the first image of it in which either eye's detector finds
it can be read, with that trial's latency, jitter, dropped frames and missed detections. The next
control step answers it, the command's own latency passes, and from then on the slowest actuator
needs at least the time in which it can come into its settling band to stay, see
`vergence.eval.trials.entry`, its motor taking the shortest way through its play. A trial is judged
at its control steps, so the time is rounded up to whole periods, and counts from the onset.

Some relaxations keep this a bound for every controller. An actuator's band is the widest that the
eyes' error circles allow, whatever the other actuators do, see `vergence.eval.trials.bands`.
Between two steps nobody looks: an actuator may pass the far edge by `a T^2 / 8` and be back within
one period. The switch need not fall on a step. Commands have no steps and are not lost, the control
loop does not stall, and an outlier or a false detection counts as a sight. A servo of second order
has no lag, but the greatest speed that it can swing up to. But for that, and for what is lost or
stalls, none is worth more than a few milliseconds.

The goal is where the true head's error is least as the controller measures it, see
`vergence.eval.trials.goal`: with model errors, that is not where the true head fixates.
"""

from math import inf, isfinite
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import bare, compiled, device
from vergence.envs.plants.conditions import Conditions
from vergence.envs.plants.simulation import simulation_of
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.bands import bands_of_actuators, bands_of_eyes
from vergence.eval.trials.entry import fastest_entry
from vergence.eval.trials.goal import least_measured_error
from vergence.models.actuation import SLOTS, Actuation
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

_ROUNDING: Final = 1e-6
"""Share of a period by which two times may differ that are one."""


def settle_bound(
    task: GazeTask, band_px: float = 1.0, sight_s: FloatArray | None = None
) -> FloatArray:
    """The earliest time at which both eyes can have settled, of the trials that just began.

    Args:
        task: trials at time zero, on a simulated plant. The targets are taken to come to rest, at
            once or with a second jump. Of that nothing can be known before its own first image;
            until then the eyes may have gone anywhere.
        band_px: the settling band, on the norm of each eye's true pixel error.
        sight_s: (n,) when the first image of the target could be read, s, where trials on a robot
            have shown it; that of the simulated loop by default.

    Returns:
        (n,) seconds since the onset, up to a control step; 0 for eyes that look there already,
        inf where an actuator's range ends before the band or nobody ever sees the target.

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
    head, moved = task.head, simulation.true_head.actuation
    period = head.timing.period_s
    motion_s = np.empty(task.num)
    goal, slack = np.empty((2, task.num, SLOTS))
    find = bands_of_eyes if moved.direct else bands_of_actuators
    find(conditions.heads, head.packed, truth.target, band_px, goal, slack)
    _motion_times(
        goal,
        slack,
        np.ascontiguousarray(moved.actuators_of(truth.positions)[:, EYES]),
        np.ascontiguousarray(truth.motors[:, EYES]),
        bare(Motors.of(moved)),
        bare(Able.of(conditions)),
        period,
        motion_s,
    )
    beyond = truth.pixel_error - least_measured_error(task, truth.target)
    inside = (np.linalg.norm(beyond, axis=-1) < band_px).all(axis=-1)
    sights = simulation.first_sights() if sight_s is None else (sight_s, np.full(task.num, -inf))
    first, last = (np.ceil(sight / period - _ROUNDING) for sight in sights)
    moves_s = first * period + conditions.command_latency_s
    # a joint's band is wider than what the error circle leaves: an eye outside it has to move
    settled = np.maximum(np.ceil((moves_s + motion_s) / period - _ROUNDING), last + 1.0)
    return np.where(inside, 0.0, settled * period - simulation.onset_s())


class Motors(NamedTuple):
    """What the actuators of the eyes can do, (4,) each."""

    lower: FloatArray
    """Least angles, rad."""
    upper: FloatArray
    """Greatest angles, rad."""
    speed: FloatArray
    """Greatest commands, rad/s; 0 for one that does not exist."""
    acceleration: FloatArray
    """Greatest accelerations, rad/s^2, inf for none."""
    lag_ratio: FloatArray
    """Lags by that of the head."""

    @classmethod
    def of(cls, actuation: Actuation) -> "Motors":
        """Those of a head."""
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


class Able(NamedTuple):
    """What of that trials have otherwise, (n,) or (n, 4) by actuator of the eyes."""

    lag_s: FloatArray
    acceleration_ratio: FloatArray
    torque_falloff: FloatArray
    speed_gain: FloatArray
    backlash_rad: FloatArray

    @classmethod
    def of(cls, conditions: Conditions) -> "Able":
        """That of what they run with.

        A lag of second order with an overshoot o, driven as well as can be, stays below (1 + o) /
        (1 - o) of its greatest command: of it, no more than this speed and the acceleration count.
        """
        able = cls(
            *(
                np.array(values[:, EYES] if values.ndim > 1 else values)
                for values in (getattr(conditions, name) for name in cls._fields)
            )
        )
        over = conditions.overshoot
        able.lag_s[over > 0.0] = 0.0
        able.speed_gain[:] *= ((1.0 + over) / (1.0 - over))[:, None]
        return able


@compiled
def _motion_times(
    goal: FloatArray,
    slack: FloatArray,
    start: FloatArray,
    begin: FloatArray,
    motors: Motors,
    able: Able,
    period: float,
    times: FloatArray,
) -> None:
    """How long the slowest actuator of each trial needs.

    Args:
        goal: (n, 4) where the actuators of the eyes have to be, rad, nan for nowhere.
        slack: (n, 4) how far off they may be, rad.
        start: (n, 4) where they are, rad.
        begin: (n, 4) where their motors are, rad.
        motors: `bare`.
        able: `bare`.
        period: the control period, s.
        times: (n,) result, s.
    """
    motors, able = Motors(*motors), Able(*able)
    for n in range(times.shape[0]):
        times[n] = 0.0
        for k in range(SLOTS):
            if not motors.speed[k] > 0.0:
                continue
            entry = inf
            if isfinite(goal[n, k]):
                turn = goal[n, k] - start[n, k]
                behind = start[n, k] - begin[n, k]
                # the way to the flank that pushes
                play = 0.5 * able.backlash_rad[n, k] + (behind if turn > 0.0 else -behind)
                room = (
                    motors.upper[k] - begin[n, k] if turn > 0.0 else begin[n, k] - motors.lower[k]
                )
                top = able.speed_gain[n, k] * motors.speed[k]
                entry = _entry(
                    turn,
                    slack[n, k],
                    max(play, 0.0),
                    room,
                    able.lag_s[n] * motors.lag_ratio[k],
                    able.acceleration_ratio[n] * motors.acceleration[k],
                    top,
                    able.torque_falloff[n] / top,
                    period,
                )
            times[n] = max(times[n], entry)


@device
def _entry(
    turn: float,
    slack: float,
    play: float,
    room: float,
    lag: float,
    acceleration: float,
    speed: float,
    fade: float,
    period: float,
) -> float:
    """The least time in which an actuator comes from rest to within its slack.

    Args:
        turn: how far it has to turn, rad.
        slack: how far off it may be, rad.
        play: how far its motor turns before it turns, rad.
        room: how far the motor can turn that way, rad.
        lag: its lag, s.
        acceleration: its greatest, rad/s^2.
        speed: its greatest command, rad/s.
        fade: what its speed takes of the acceleration, per rad/s.
        period: the control period, s.
    """
    near = abs(turn) - slack
    if near <= 0.0:
        return 0.0
    near, far = near + play, abs(turn) + slack + play
    if acceleration < inf:
        far += acceleration * period * period / 8.0
    if near > room:
        return inf
    if far >= room:
        far = inf  # the end of the range stops it
    return fastest_entry(near, far, lag, acceleration, speed, fade)
