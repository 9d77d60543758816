r"""A joint's time-optimal motion to an angle, computed one control period at a time.

The joint follows its command u, held for a period T, by `dv/dt = clip((u - v) / lag, -a, a)`. The
time-optimal motion is as fast as possible while the joint can still stop at the goal. So the
command of a period is the largest one under which the joint, with full braking afterwards, stops at
the goal and not beyond: with (q', v') its exact state at the period's end and `S(v)` its shortest
stopping distance, u solves

    q'(u) + S(v'(u)) = goal,   |u| <= u_max

The left side increases with u. S counts whole periods of full braking and a last one that ends at
rest. Near the goal this is a deadbeat law of two periods: with e = exp(-T / lag), `q + lag v` moves
by exactly u T, and the last period stops a velocity v within `v (lag - T e / (1 - e))`.
"""

from math import exp, inf
from typing import Final, NamedTuple

from vergence.kernels import inlined
from vergence.models.motion import follow_joint

_LEAST_LAG_S: Final = 1e-4
"""Lower bound of the lag, s (numerical)."""
_MAX_BRAKING_PERIODS: Final = 1000
"""Largest number of braking periods that are simulated (numerical)."""
_MAX_ROOT_ITERATIONS: Final = 20
"""Iteration limit of the root finder (numerical)."""
_TOLERANCE_RAD: Final = 1e-6
"""Convergence tolerance of the stopping angle, rad (numerical)."""


class JointTiming(NamedTuple):
    """Lag, limits and control period of one joint, and its derived stopping properties."""

    lag: float
    """Time constant, s."""
    max_command: float
    """Largest command, rad/s."""
    max_acceleration: float
    """Largest acceleration, rad/s^2, inf for none."""
    period: float
    """The control period, s."""
    decay: float
    """Factor exp(-period / lag) that a period leaves of the difference between command and
    velocity."""
    smooth_stop_speed: float
    """Largest speed that a last period can stop within the acceleration limit, rad/s."""
    last_stop_speed: float
    """Largest speed that a last period can stop at all, rad/s."""
    last_distance_per_speed: float
    """Distance moved in a last period per unit of its initial speed, up to `smooth_stop_speed`,
    s."""
    last_distance: float
    """Distance moved in a last period from the speed `last_stop_speed`, rad."""


@inlined
def joint_timing(
    lag: float, max_command: float, max_acceleration: float, period: float
) -> JointTiming:
    """Compute the timing of one joint from its lag, its limits and the control period."""
    lag = max(lag, _LEAST_LAG_S)
    e = exp(-period / lag)
    per_speed = lag - period * e / (1.0 - e)
    smooth_stop_speed = min(
        max_acceleration * lag * (1.0 - e), max_command * (1.0 - e) / e if e > 0.0 else inf
    )
    last_stop_speed, distance = smooth_stop_speed, per_speed * smooth_stop_speed
    if max_acceleration * lag <= max_command and max_acceleration * period > smooth_stop_speed:
        last_stop_speed, distance = (
            max_acceleration * period,
            0.5 * max_acceleration * period * period,
        )
    return JointTiming(
        lag,
        max_command,
        max_acceleration,
        period,
        e,
        smooth_stop_speed,
        last_stop_speed,
        per_speed,
        distance,
    )


@inlined
def signed_stopping_distance(velocity: float, joint: JointTiming) -> float:
    """Shortest signed distance that a joint moves until it rests, in the direction of v, rad."""
    side = 1.0 if velocity >= 0.0 else -1.0
    velocity = abs(velocity)
    distance: float = 0.0
    for _ in range(_MAX_BRAKING_PERIODS):  # a joint that needs longer cannot be stopped
        if not velocity > joint.last_stop_speed:
            break
        dq, velocity = follow_joint(
            0.0,
            velocity,
            -joint.max_command,
            joint.lag,
            joint.max_acceleration,
            joint.period,
            joint.decay,
        )
        distance += dq
    if velocity <= joint.smooth_stop_speed:
        distance += joint.last_distance_per_speed * velocity
    else:
        smooth_distance = joint.last_distance_per_speed * joint.smooth_stop_speed
        share = (velocity - joint.smooth_stop_speed) / (
            joint.last_stop_speed - joint.smooth_stop_speed
        )
        distance += smooth_distance + share * (joint.last_distance - smooth_distance)
    return side * distance


@inlined
def _overrun(u: float, angle_error: float, v: float, a: float, trusted: JointTiming) -> float:
    """Compute how far beyond the goal the joint stops after a period of command u, rad."""
    q, after = follow_joint(0.0, v, u, trusted.lag, a, trusted.period, trusted.decay)
    return q + signed_stopping_distance(after, trusted) - angle_error


@inlined
def time_optimal_command(
    angle_error: float,
    velocity: float,
    present_max_acceleration: float,
    braking_timing: JointTiming,
) -> float:
    """Compute this period's command of the time-optimal motion.

    Args:
        angle_error: angle to the goal, rad.
        velocity: velocity, rad/s.
        present_max_acceleration: acceleration limit in this period, rad/s^2, at least that of
            `braking_timing`.
        braking_timing: timing from `joint_timing`, with the acceleration that is trusted for later
            braking.

    Returns:
        The command, rad/s.
    """
    e, u_max, period = braking_timing.decay, braking_timing.max_command, braking_timing.period
    u = (angle_error - braking_timing.lag * velocity + velocity * period * e * e / (1.0 - e)) / (
        period * (1.0 - e)
    )
    calm = (
        abs(u - velocity) <= braking_timing.max_acceleration * braking_timing.lag
        and abs(u + (velocity - u) * e) <= braking_timing.smooth_stop_speed
    )
    if abs(u) <= u_max and calm:
        return u
    below = _overrun(-u_max, angle_error, velocity, present_max_acceleration, braking_timing)
    if below >= 0.0:
        return -u_max
    above = _overrun(u_max, angle_error, velocity, present_max_acceleration, braking_timing)
    if above <= 0.0:
        return u_max
    # beyond these the acceleration limit holds all period, and u changes nothing
    widest = present_max_acceleration * (braking_timing.lag + period)
    low, high = max(-u_max, velocity - widest), min(u_max, velocity + widest)
    # regula falsi, Illinois variant
    kept = 0
    for _ in range(_MAX_ROOT_ITERATIONS):
        if not above > below:  # converged to rounding
            break
        u = (low * above - high * below) / (above - below)
        overrun = _overrun(u, angle_error, velocity, present_max_acceleration, braking_timing)
        if abs(overrun) < _TOLERANCE_RAD:
            break
        if overrun > 0.0:
            high, above = u, overrun
            if kept == 1:
                below *= 0.5
            kept = 1
        else:
            low, below = u, overrun
            if kept == -1:
                above *= 0.5
            kept = -1
    return u
