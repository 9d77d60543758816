r"""Response of joints to velocity commands: a lag with an acceleration limit.

    dv/dt = clip((u - v) / tau, -a, a),   dq/dt = v

with the command u held for a period. While |u - v| exceeds a tau, the joint accelerates at the
limit; then the difference decays exponentially. Both phases have closed forms, so a period of any
length is one step. A joint at its position limit stops there.

A motor whose torque falls with its speed, by `torque_falloff` f per rad/s, accelerates by at most
`a (1 - f |v|)` while it speeds up, and by at most a while it brakes:

    dv/dt = clip((u - v) / tau, -a_-(v), a_+(v)),   a_+(v) = a (1 - f max(v, 0))

This saturated phase has a closed form too: 1 / f - v decays with the rate a f.

A servo whose own loop oscillates has a second-order lag; its acceleration w is a state:

    tau^2 dw/dt + 2 zeta tau w + v = u,   dv/dt = w,   |w| <= a

An overshoot o of the step response gives the damping ratio `zeta = -ln(o) / sqrt(pi^2 + ln(o)^2)`.
At its limit, w stays constant until the equation demands a smaller |w|. With an equal time
constant, this response starts later than the first-order lag and settles sooner. In the functions,
a is `max_acceleration` and w is `acceleration`.
"""

from math import cos, exp, expm1, inf, log, pi, sin, sqrt
from typing import Final

from vergence._jit import inlined, subroutine

_SECANT_STEPS: Final = 5
"""Secant steps to the time at which the acceleration meets its limit; exact to rounding
(numerical)."""


@inlined
def lag_decay(time: float, tau: float) -> float:
    """Fraction of the difference between command and velocity that remains after a time."""
    return exp(-time / tau) if tau > 0.0 else 0.0


@inlined
def follow_joint(
    q: float, v: float, u: float, tau: float, max_acceleration: float, period: float, decay: float
) -> tuple[float, float]:
    """Angle and velocity a period later, without position limits; `decay` is `lag_decay`'s."""
    gap = u - v
    side = 1.0 if gap >= 0.0 else -1.0
    # duration of the acceleration at its limit; 0 without a limit
    ramp = 0.0
    if max_acceleration < inf:
        ramp = min(max((side * gap - max_acceleration * tau) / max_acceleration, 0.0), period)
    gain = side * max_acceleration * ramp if ramp > 0.0 else 0.0
    q += v * ramp + 0.5 * gain * ramp
    v += gain
    rest = period - ramp
    if rest > 0.0:
        gap = u - v
        left = decay
        if ramp > 0.0:
            left = lag_decay(rest, tau)
        q += u * rest - gap * tau * (1.0 - left)
        v = u - gap * left
    return q, v


@inlined
def time_to_reversal(v: float, u: float, tau: float, max_acceleration: float) -> float:
    """Time until a joint reverses, s, if its velocity and command have opposite signs."""
    elapsed = 0.0
    if abs(u - v) > max_acceleration * tau:
        if abs(u) >= max_acceleration * tau:
            return abs(v) / max_acceleration
        # the limit on acceleration ends before the joint stands still
        after = u + max_acceleration * tau if v > 0.0 else u - max_acceleration * tau
        elapsed = abs(v - after) / max_acceleration
        v = after
    return elapsed + tau * log((u - v) / u)


@subroutine
def follow_torque_limited_joint(
    q: float,
    v: float,
    u: float,
    tau: float,
    max_acceleration: float,
    torque_falloff: float,
    period: float,
) -> tuple[float, float]:
    """`follow_joint` for a torque that falls with speed, by `torque_falloff` per rad/s."""
    if v * u < 0.0:  # braking first
        turn = time_to_reversal(v, u, tau, max_acceleration)
        if turn >= period:
            return follow_joint(q, v, u, tau, max_acceleration, period, lag_decay(period, tau))
        q, _rest = follow_joint(q, v, u, tau, max_acceleration, turn, lag_decay(turn, tau))
        v, period = 0.0, period - turn
    if abs(u) < abs(v):
        return follow_joint(q, v, u, tau, max_acceleration, period, lag_decay(period, tau))
    side = 1.0 if u >= 0.0 else -1.0
    v, u = side * v, side * u
    way = 0.0
    # saturated until the lag alone demands no more than the limit; if the limit falls faster with
    # speed than that demand, saturated for good
    slope = 1.0 - max_acceleration * tau * torque_falloff
    end = (u - max_acceleration * tau) / slope if slope > 0.0 else v
    if end > v:
        rate = max_acceleration * torque_falloff
        time = min(log((1.0 - torque_falloff * v) / (1.0 - torque_falloff * end)) / rate, period)
        missing = 1.0 / torque_falloff - v
        way = time / torque_falloff + missing * expm1(-rate * time) / rate
        v -= missing * expm1(-rate * time)
        period -= time
    left = lag_decay(period, tau) if period > 0.0 else 1.0
    way += u * period - (u - v) * tau * (1.0 - left)
    return q + side * way, side * (u - (u - v) * left)


@inlined
def damping_ratio(overshoot: float) -> float:
    """Damping ratio of a second-order lag with a given overshoot, a fraction in (0, 1)."""
    decrement = -log(overshoot)
    return decrement / sqrt(pi * pi + decrement * decrement)


@inlined
def _swing(
    q: float, v: float, acceleration: float, u: float, tau: float, zeta: float, time: float
) -> tuple[float, float, float]:
    """Angle, velocity and acceleration after a time, by the second-order lag without a limit."""
    decay, turn = zeta / tau, sqrt(1.0 - zeta * zeta) / tau
    left, gap = exp(-decay * time), v - u
    along, across = left * cos(turn * time), left * sin(turn * time) / turn
    after = gap * along + (acceleration + decay * gap) * across
    then = acceleration * along - (decay * acceleration + gap / (tau * tau)) * across
    # integral of the equation of motion
    way = u * time - tau * tau * (then - acceleration) - 2.0 * zeta * tau * (after - gap)
    return q + way, u + after, then


@subroutine
def follow_second_order_joint(
    q: float,
    v: float,
    acceleration: float,
    u: float,
    tau: float,
    zeta: float,
    max_acceleration: float,
    torque_falloff: float,
    period: float,
) -> tuple[float, float, float]:
    """Move a joint with a second-order lag by a short time, without position limits.

    The result is exact, with two exceptions: the acceleration exceeds its limit only between the
    start and the end of the time, or the limit falls with speed, as it is held constant. A time of
    an eighth of tau gives an error of a quarter of a percent of the distance moved.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        acceleration: acceleration, rad/s^2.
        u: velocity command, rad/s.
        tau: time constant, s, above 0.
        zeta: damping ratio, from above 0 to below 1.
        max_acceleration: greatest acceleration at rest, rad/s^2; inf for no limit.
        torque_falloff: fraction of `max_acceleration` lost per rad/s of speed while the joint
            speeds up.
        period: the time, s, short against tau.

    Returns:
        Angle, velocity and acceleration; rad, rad/s and rad/s^2.
    """
    if max_acceleration == inf:
        return _swing(q, v, acceleration, u, tau, zeta, period)
    middle = v + 0.5 * period * acceleration
    up = max_acceleration * max(1.0 - torque_falloff * max(middle, 0.0), 0.0)
    down = max_acceleration * max(1.0 - torque_falloff * max(-middle, 0.0), 0.0)
    acceleration = min(max(acceleration, -down), up)
    free_q, free_v, free_w = _swing(q, v, acceleration, u, tau, zeta, period)
    within = -down < acceleration < up
    if within and -down <= free_w <= up:
        return free_q, free_v, free_w
    if within:
        # time until the limit, by the secant method
        limit = up if free_w > up else -down
        before, off_before, time, off = 0.0, acceleration - limit, period, free_w - limit
        for _ in range(_SECANT_STEPS):
            if off == off_before:
                break
            after = time - off * (time - before) / (off - off_before)
            before, off_before, time = time, off, min(max(after, 0.0), period)
            off = _swing(q, v, acceleration, u, tau, zeta, time)[2] - limit
        q, v, acceleration = _swing(q, v, acceleration, u, tau, zeta, time)
        acceleration, period = limit, period - time
    # at the limit until the equation lowers w faster than the limit falls
    falls = max_acceleration * torque_falloff * acceleration if acceleration * middle > 0.0 else 0.0
    most = u + tau * (tau * falls - 2.0 * zeta * acceleration)
    held = min(max((most - v) / acceleration, 0.0), period) if acceleration != 0.0 else 0.0
    q, v = q + (v + 0.5 * acceleration * held) * held, v + acceleration * held
    return _swing(q, v, acceleration, u, tau, zeta, period - held)
