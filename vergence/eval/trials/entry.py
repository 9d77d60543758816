r"""The least time in which an actuator at rest can enter a band of angles to stay.

    dv/dt = clip((u - v) / lag, -a, a),   dq/dt = v,   |u| <= u_max

Full command until a switch and full reverse after it is the fastest, the switch being the latest
that still stops it within the far edge of the band. It is in when it crosses the near edge.
"""

from math import inf, log
from typing import Final, NamedTuple

from vergence._jit import compiled, device
from vergence.models.joint_response import follow_fading_joint, follow_joint, share_left

_HALVINGS: Final = 60


@compiled
def fastest_entry(
    near: float, far: float, lag: float, acceleration: float, speed: float, fade: float
) -> float:
    """The least time in which a joint at rest can pass `near` and still stop within `far`.

    Args:
        near: distance to the near edge of the band, rad.
        far: distance to its far edge, rad; inf for a joint that need not stop.
        lag: time constant of the joint's response, s.
        acceleration: greatest acceleration, rad/s^2, inf for none.
        speed: greatest command, rad/s.
        fade: what its speed takes of the acceleration, per rad/s, see `joint_response`.

    Returns:
        Seconds; 0 where `near` is no distance.
    """
    if near <= 0.0:
        return 0.0
    joint = _Joint(lag, acceleration, speed, fade if acceleration < inf else 0.0)
    switch = inf
    if far < inf:
        low, high = 0.0, _until_beyond(far, joint)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if _stop(middle, joint) <= far:
                low = middle
            else:
                high = middle
        switch = low
    low, high = 0.0, _until_beyond(near, joint)
    if switch < inf:
        # stopping at the far edge, the joint has passed the near one
        high = min(high, switch) + _stop_time(switch, joint)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _place(middle, switch, joint)[0] < near:
            low = middle
        else:
            high = middle
    return high


class _Joint(NamedTuple):
    """What moves a joint: its lag, s, its greatest acceleration and command, and their fade."""

    lag: float
    acceleration: float
    speed: float
    fade: float


@device
def _after(q: float, v: float, command: float, time: float, joint: _Joint) -> tuple[float, float]:
    if joint.fade > 0.0:
        return follow_fading_joint(q, v, command, joint.lag, joint.acceleration, joint.fade, time)
    decay = share_left(time, joint.lag)
    return follow_joint(q, v, command, joint.lag, joint.acceleration, time, decay)


@device
def _place(time: float, switch: float, joint: _Joint) -> tuple[float, float]:
    """Angle and velocity at a time, with full command until the switch and full reverse after."""
    q, v = _after(0.0, 0.0, joint.speed, min(time, switch), joint)
    if time > switch:
        q, v = _after(q, v, -joint.speed, time - switch, joint)
    return q, v


@device
def _stop_time(switch: float, joint: _Joint) -> float:
    """How long full reverse takes from the switch on to stop a joint."""
    _q, v = _place(switch, switch, joint)
    time = 0.0
    # the lag allows the greatest deceleration down to this velocity
    least = inf
    if joint.acceleration < inf:
        least = max(joint.acceleration * joint.lag - joint.speed, 0.0)
    if v > least:
        time = (v - least) / joint.acceleration
        v = least
    if v > 0.0 and joint.lag > 0.0:
        time += joint.lag * log((v + joint.speed) / joint.speed)
    return time


@device
def _stop(switch: float, joint: _Joint) -> float:
    """Where a joint stops that is reversed at the switch."""
    return _place(switch + _stop_time(switch, joint), switch, joint)[0]


@device
def _until_beyond(distance: float, joint: _Joint) -> float:
    """Some time after which full command has carried a joint beyond a distance."""
    time = distance / joint.speed + joint.lag + 1e-6
    while _place(time, inf, joint)[0] <= distance:
        time *= 2.0
    return time
