r"""Least time in which an actuator at rest can enter a band of angles and stay there.

    dv/dt = clip((u - v) / lag, -a, a),   dq/dt = v,   |u| <= u_max

The fastest motion is bang-bang: full command until a switch, full reverse after it, with the latest
switch that still stops the actuator before the far edge of the band. The actuator has entered when
it crosses the near edge.
"""

from math import inf, log
from typing import Final, NamedTuple

from vergence.kernels import compiled, inlined
from vergence.models.motion import follow_joint, follow_torque_limited_joint, lag_decay

_BISECTIONS: Final = 60
"""Steps of each bisection; they exhaust double precision (numerical)."""


@compiled
def least_entry_time(
    near: float, far: float, lag: float, acceleration: float, speed: float, torque_falloff: float
) -> float:
    """Least time in which a joint at rest can pass `near` and still stop before `far`.

    Args:
        near: distance to the near edge of the band, rad.
        far: distance to its far edge, rad; inf for a joint that need not stop.
        lag: time constant of the joint's response, s.
        acceleration: greatest acceleration, rad/s^2, inf for none.
        speed: greatest velocity command, rad/s.
        torque_falloff: loss of acceleration with speed, as a fraction per rad/s, see
            `motion`.

    Returns:
        Seconds; 0 if `near` is not above zero.
    """
    if near <= 0.0:
        return 0.0
    joint = _Joint(lag, acceleration, speed, torque_falloff if acceleration < inf else 0.0)
    switch = inf
    if far < inf:
        low, high = 0.0, _time_to_pass(far, joint)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if _stopping_angle(middle, joint) <= far:
                low = middle
            else:
                high = middle
        switch = low
    low, high = 0.0, _time_to_pass(near, joint)
    if switch < inf:
        # a joint that stops at the far edge has passed the near one
        high = min(high, switch) + _stop_time(switch, joint)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _bang_bang_state(middle, switch, joint)[0] < near:
            low = middle
        else:
            high = middle
    return high


class _Joint(NamedTuple):
    """A joint's response: lag, s; greatest acceleration and command; loss of acceleration."""

    lag: float
    acceleration: float
    speed: float
    torque_falloff: float


@inlined
def _joint_after(
    q: float, v: float, command: float, time: float, joint: _Joint
) -> tuple[float, float]:
    if joint.torque_falloff > 0.0:
        return follow_torque_limited_joint(
            q, v, command, joint.lag, joint.acceleration, joint.torque_falloff, time
        )
    decay = lag_decay(time, joint.lag)
    return follow_joint(q, v, command, joint.lag, joint.acceleration, time, decay)


@inlined
def _bang_bang_state(time: float, switch: float, joint: _Joint) -> tuple[float, float]:
    """Angle and velocity at a time, under full command until the switch, then full reverse."""
    q, v = _joint_after(0.0, 0.0, joint.speed, min(time, switch), joint)
    if time > switch:
        q, v = _joint_after(q, v, -joint.speed, time - switch, joint)
    return q, v


@inlined
def _stop_time(switch: float, joint: _Joint) -> float:
    """Time from the switch until full reverse has stopped the joint, s."""
    _q, v = _bang_bang_state(switch, switch, joint)
    time = 0.0
    # the deceleration stays at its limit down to this velocity; then the lag reduces it
    least = inf
    if joint.acceleration < inf:
        least = max(joint.acceleration * joint.lag - joint.speed, 0.0)
    if v > least:
        time = (v - least) / joint.acceleration
        v = least
    if v > 0.0 and joint.lag > 0.0:
        time += joint.lag * log((v + joint.speed) / joint.speed)
    return time


@inlined
def _stopping_angle(switch: float, joint: _Joint) -> float:
    """Angle at which the joint stops if it reverses at the switch, rad."""
    return _bang_bang_state(switch + _stop_time(switch, joint), switch, joint)[0]


@inlined
def _time_to_pass(distance: float, joint: _Joint) -> float:
    """An upper bound on the time in which full command carries a joint beyond a distance, s."""
    time = distance / joint.speed + joint.lag + 1e-6
    while _bang_bang_state(time, inf, joint)[0] <= distance:
        time *= 2.0
    return time
