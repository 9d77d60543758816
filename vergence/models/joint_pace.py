r"""How joints follow commands that hold for one given time, prepared once and used for many.

A joint follows its velocity command u by a lag l, which may take time to build up:

    m l^2 dw/dt + l w + v = u,   dv/dt = w,   dq/dt = v,   |w| <= a

Without the build-up m this is `vergence.models.joint_response.follow_joint`; with it, the lag of
second order of `follow_swinging_joint` there, whose time constant is `sqrt(m) l` and whose damping
ratio `1 / (2 sqrt(m))`: from m = 1/4 on it overshoots.
"""

from math import cos, exp, inf, sin, sqrt
from typing import Final, NamedTuple

from vergence._jit import device
from vergence.models.joint_response import follow_joint, share_left

_LEAST: Final = 0.02
"""A build-up below which there is none. Numerical."""
_PART: Final = 0.5
"""The longest part of a time by the time constant, where a limit may hold in it. Numerical."""
_MOST_PARTS: Final = 3
_CRITICAL: Final = 1e-5
"""How close to critical damping it counts as this, by the decay. Numerical."""


class Pace(NamedTuple):
    """How a joint follows a command that holds for a time."""

    lag: float
    """l, s."""
    square: float
    """m l^2, s^2; 0 for none."""
    a: float
    """Greatest acceleration, rad/s^2, inf for none."""
    time: float
    """The time, s, or a whole part of it."""
    parts: int
    """How many such parts."""
    kept: float
    """What a part leaves of the difference between speed and command."""
    pushed: float
    """What the acceleration adds to that, s."""
    builds: float
    """What a part leaves of the acceleration."""
    drawn: float
    """What the difference adds to that, 1/s^2."""


@device
def _shares(lag: float, square: float, t: float) -> tuple[float, float, float, float]:
    """`kept`, `pushed`, `builds` and `drawn` of a time."""
    decay = 0.5 * lag / square
    gap = decay * decay - 1.0 / square
    if gap < 0.0:
        turn, left = sqrt(-gap), exp(-decay * t)
        even, odd = left * cos(turn * t), left * sin(turn * t) / turn
    else:
        turn = max(sqrt(gap), _CRITICAL * decay)
        slow, fast = exp(-t / (square * (decay + turn))), exp(-t * (decay + turn))
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / turn
    return even + decay * odd, odd, even - decay * odd, -odd / square


@device
def pace_of(lag: float, build_up: float, a: float, time: float) -> Pace:
    """Prepare a pace.

    Args:
        lag: l, s, above 0.
        build_up: m.
        a: greatest acceleration, rad/s^2, inf for none.
        time: how long commands hold, s.
    """
    if build_up < _LEAST or time <= 0.0:
        return Pace(lag, 0.0, a, time, 1, share_left(time, lag), 0.0, 0.0, 0.0)
    square, parts = build_up * lag * lag, 1
    if a < inf:
        parts = min(int(time / (_PART * sqrt(square))) + 1, _MOST_PARTS)
    kept, pushed, builds, drawn = _shares(lag, square, time / parts)
    return Pace(lag, square, a, time / parts, parts, kept, pushed, builds, drawn)


@device
def _free(
    q: float, v: float, w: float, u: float, pace: Pace, t: float
) -> tuple[float, float, float]:
    """A joint after any time without a limit."""
    kept, pushed, builds, drawn = _shares(pace.lag, pace.square, t)
    gap = v - u
    after, then = gap * kept + w * pushed, w * builds + gap * drawn
    # the equation of motion, integrated
    q += u * t - pace.square * (then - w) - pace.lag * (after - gap)
    return q, u + after, then


@device
def follow_pace(q: float, v: float, w: float, u: float, pace: Pace) -> tuple[float, float, float]:
    """A joint after its pace's time, without position limits.

    It is exact where the acceleration keeps within its limit; else within half a percent of the
    way, if the time is at most 1.5 time constants.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        w: acceleration, rad/s^2; without a build-up it does not count.
        u: velocity command, rad/s.
        pace: how it follows.

    Returns:
        Angle, velocity and acceleration.
    """
    a = pace.a
    if pace.square == 0.0:
        q, v = follow_joint(q, v, u, pace.lag, a, pace.time, pace.kept)
        return q, v, min(max((u - v) / pace.lag, -a), a)
    for _ in range(pace.parts):
        t = pace.time
        w = min(max(w, -a), a)
        # at the limit, until the rest of the equation takes w back
        held = 0.0
        if abs(w) == a:
            held = min(max((u - v - pace.lag * w) / w, 0.0), t)
            q, v, t = q + (v + 0.5 * w * held) * held, v + w * held, t - held
            if t <= 0.0:
                continue
        gap = v - u
        after, then = gap * pace.kept + w * pace.pushed, w * pace.builds + gap * pace.drawn
        if held > 0.0:
            q, v, w = _free(q, v, w, u, pace, t)
        elif abs(then) <= a:
            q += u * t - pace.square * (then - w) - pace.lag * (after - gap)
            v, w = u + after, then
        else:
            # until the limit is met: along the slope, and one step of the secant
            limit = a if then > 0.0 else -a
            slope = -(gap + pace.lag * w) / pace.square
            meets = min(max((limit - w) / slope, 0.0), t) if slope != 0.0 else 0.0
            came = _free(q, v, w, u, pace, meets)[2]
            if came != w:
                meets = min(max(meets * (limit - w) / (came - w), 0.0), t)
            q, v, w = _free(q, v, w, u, pace, meets)
            w, t = limit, t - meets
            q, v = q + (v + 0.5 * w * t) * t, v + w * t
    return q, v, w
