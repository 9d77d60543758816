r"""The time-optimal bound: no controller can settle before it.

Nothing can be known of a target's jump before the first image of it is readable. From then on
the slowest actuator needs at least the time in which it can come into its settling band to stay,
see `vergence.eval.trials.entry`. A trial is judged at its control steps, so the time is rounded up
to whole periods.

Three relaxations keep this a bound for every controller. An actuator's band is the widest that the
eyes' error circles allow, whatever the other actuators do, see `vergence.eval.trials.bands`.
Between two steps nobody looks: an actuator may pass the far edge by `a T^2 / 8` and be back within
one period. And the switch need not fall on a step. None is worth more than a few milliseconds.
Backlash is left out, which only makes eyes slower: a joint goes no further than what pushes it.

The goal is where the true head's error is least as the controller measures it, see
`vergence.eval.trials.goal`: with model errors, that is not where the true head fixates.
"""

from math import inf, isfinite
from typing import NamedTuple

import numpy as np

from vergence._jit import bare, compiled, device
from vergence.envs.plant import simulation_of
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.bands import bands_of_actuators, bands_of_eyes
from vergence.eval.trials.entry import fastest_entry
from vergence.eval.trials.goal import least_measured_error
from vergence.models.actuation import SLOTS, Actuation
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray


def settle_bound(task: GazeTask, band_px: float = 1.0) -> FloatArray:
    """The earliest time at which both eyes can have settled, of the trials that just began.

    Args:
        task: trials at time zero, on a simulated plant. The targets are taken to stay where
            they are at time zero.
        band_px: the settling band, on the norm of each eye's true pixel error.

    Returns:
        (n,) seconds since time zero, in whole control periods; 0 for eyes that look there
        already, inf where an actuator's range ends before the band.

    Raises:
        ConfigurationError: the plant is no simulation, trials have moved on, or the band is
            not above zero.
    """
    if not band_px > 0.0:
        raise ConfigurationError(f"band_px: expected more than 0, got {band_px}")
    simulation = simulation_of(task.plant)
    truth, conditions = simulation.truth(), simulation.conditions
    if truth.time_s.any():
        raise ConfigurationError(
            f"task: expected trials at time zero, got one at {truth.time_s.max():.3f} s"
        )
    head = task.head
    period, actuation = head.timing.period_s, head.actuation
    motion_s = np.empty(task.num)
    goal, slack = np.empty((2, task.num, SLOTS))
    find = bands_of_eyes if actuation.direct else bands_of_actuators
    find(conditions.heads, head.packed, truth.target, band_px, goal, slack)
    _motion_times(
        goal,
        slack,
        np.ascontiguousarray(actuation.actuators_of(truth.positions)[:, EYES]),
        conditions.lag_s,
        bare(Motors.of(actuation)),
        period,
        motion_s,
    )
    beyond = truth.pixel_error - least_measured_error(task)
    inside = (np.linalg.norm(beyond, axis=-1) < band_px).all(axis=-1)
    # a joint's band is wider than what the error circle leaves: an eye outside it has to move
    periods = np.maximum(np.ceil(motion_s / period - 1e-9), 1.0)
    return np.where(inside, 0.0, (conditions.latency_frames + periods) * period)


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


@compiled
def _motion_times(
    goal: FloatArray,
    slack: FloatArray,
    start: FloatArray,
    lag: FloatArray,
    motors: Motors,
    period: float,
    times: FloatArray,
) -> None:
    """How long the slowest actuator of each trial needs.

    Args:
        goal: (n, 4) where the actuators of the eyes have to be, rad, nan for nowhere.
        slack: (n, 4) how far off they may be, rad.
        start: (n, 4) where they are, rad.
        lag: (n,) s, of the head.
        motors: `bare`.
        period: the control period, s.
        times: (n,) result, s.
    """
    motors = Motors(*motors)
    for n in range(times.shape[0]):
        times[n] = 0.0
        for k in range(SLOTS):
            if not motors.speed[k] > 0.0:
                continue
            entry = inf
            if isfinite(goal[n, k]):
                entry = _entry(motors, k, goal[n, k], slack[n, k], start[n, k], lag[n], period)
            times[n] = max(times[n], entry)


@device
def _entry(
    motors: Motors, k: int, goal: float, slack: float, start: float, lag: float, period: float
) -> float:
    """The least time in which an actuator comes from rest at its start to within its slack."""
    turn = goal - start
    room = motors.upper[k] - start if turn > 0.0 else start - motors.lower[k]
    near = abs(turn) - slack
    far = abs(turn) + slack
    if motors.acceleration[k] < inf:
        far += motors.acceleration[k] * period * period / 8.0
    if near > room:
        return inf
    if far >= room:
        far = inf  # the end of the range stops it
    return fastest_entry(
        near, far, lag * motors.lag_ratio[k], motors.acceleration[k], motors.speed[k]
    )
