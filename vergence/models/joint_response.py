r"""How joints follow velocity commands: by a lag with an acceleration limit.

    dv/dt = clip((u - v) / tau, -a, a),   dq/dt = v

with the command u held for a period. While |u - v| exceeds a tau the joint accelerates at the
limit; then the difference decays exponentially. Both phases have closed forms, so a period is
one step whatever its length. A joint at its position limit stops there.

A motor whose torque falls with its speed accelerates at most by `a (1 - fade |v|)` where it speeds
up, and by a where it brakes:

    dv/dt = clip((u - v) / tau, -a_-(v), a_+(v)),   a_+(v) = a (1 - fade max(v, 0))

whose saturated phase has a closed form too: 1 / fade - v decays with the rate a fade.

A servo whose own loop swings follows by a lag of second order, its acceleration w a state:

    tau^2 dw/dt + 2 zeta tau w + v = u,   dv/dt = w,   |w| <= a

with the damping ratio zeta of its overshoot o after a step, `-ln(o) / sqrt(pi^2 + ln(o)^2)`. At
its limit w stays until the rest of the equation takes it back. With time constants as long, this
begins later than the first-order lag and ends sooner.
"""

from math import cos, exp, expm1, inf, log, pi, sin, sqrt
from typing import Final

from vergence._jit import device, subroutine

_SECANTS: Final = 5
"""Steps of the secant to where an acceleration meets its limit: all digits. Numerical."""


@device
def share_left(time: float, tau: float) -> float:
    """What a time leaves of a difference between command and velocity."""
    return exp(-time / tau) if tau > 0.0 else 0.0


@device
def follow_joint(
    q: float, v: float, u: float, tau: float, a: float, period: float, decay: float
) -> tuple[float, float]:
    """One joint a period later, without position limits; for use inside kernels.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        u: velocity command, rad/s.
        tau: time constant, s; 0 for none.
        a: greatest acceleration, rad/s^2, inf for none.
        period: the period, s.
        decay: `share_left(period, tau)`, which callers compute once for many joints.

    Returns:
        Angle and velocity, rad and rad/s.
    """
    gap = u - v
    side = 1.0 if gap >= 0.0 else -1.0
    # how long the joint accelerates at its limit; without a limit, not at all
    ramp = 0.0
    if a < inf:
        ramp = min(max((side * gap - a * tau) / a, 0.0), period)
    gain = side * a * ramp if ramp > 0.0 else 0.0
    q += v * ramp + 0.5 * gain * ramp
    v += gain
    rest = period - ramp
    if rest > 0.0:
        gap = u - v
        left = decay
        if ramp > 0.0:
            left = share_left(rest, tau)
        q += u * rest - gap * tau * (1.0 - left)
        v = u - gap * left
    return q, v


@device
def time_to_turn(v: float, u: float, tau: float, a: float) -> float:
    """When a joint turns round whose velocity and command have opposite signs, s."""
    elapsed = 0.0
    if abs(u - v) > a * tau:
        if abs(u) >= a * tau:
            return abs(v) / a
        # the limit on acceleration ends before the joint stands still
        after = u + a * tau if v > 0.0 else u - a * tau
        elapsed = abs(v - after) / a
        v = after
    return elapsed + tau * log((u - v) / u)


@subroutine
def follow_fading_joint(
    q: float, v: float, u: float, tau: float, a: float, fade: float, period: float
) -> tuple[float, float]:
    """As `follow_joint`, of a motor whose torque falls with its speed.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        u: velocity command, rad/s.
        tau: time constant, s; 0 for none.
        a: greatest acceleration at rest, rad/s^2.
        fade: what is lost of it per rad/s; fade times any speed is below 1.
        period: the period, s.

    Returns:
        Angle and velocity, rad and rad/s.
    """
    if v * u < 0.0:  # braking first
        turn = time_to_turn(v, u, tau, a)
        if turn >= period:
            return follow_joint(q, v, u, tau, a, period, share_left(period, tau))
        q, _rest = follow_joint(q, v, u, tau, a, turn, share_left(turn, tau))
        v, period = 0.0, period - turn
    if abs(u) < abs(v):
        return follow_joint(q, v, u, tau, a, period, share_left(period, tau))
    side = 1.0 if u >= 0.0 else -1.0
    v, u = side * v, side * u
    way = 0.0
    # saturated until the gap is what the lag alone would take in; where that falls faster with
    # speed than the gap does, it is so from the start
    slope = 1.0 - a * tau * fade
    end = (u - a * tau) / slope if slope > 0.0 else v
    if end > v:
        rate = a * fade
        time = min(log((1.0 - fade * v) / (1.0 - fade * end)) / rate, period)
        missing = 1.0 / fade - v
        way = time / fade + missing * expm1(-rate * time) / rate
        v -= missing * expm1(-rate * time)
        period -= time
    left = share_left(period, tau) if period > 0.0 else 1.0
    way += u * period - (u - v) * tau * (1.0 - left)
    return q + side * way, side * (u - (u - v) * left)


@device
def damping_ratio(overshoot: float) -> float:
    """That of a lag of second order which overshoots a step by a share from above 0 to below 1."""
    decrement = -log(overshoot)
    return decrement / sqrt(pi * pi + decrement * decrement)


@device
def _swing(
    q: float, v: float, w: float, u: float, tau: float, zeta: float, time: float
) -> tuple[float, float, float]:
    """Angle, velocity and acceleration after a time by the lag of second order alone."""
    decay, turn = zeta / tau, sqrt(1.0 - zeta * zeta) / tau
    left, gap = exp(-decay * time), v - u
    along, across = left * cos(turn * time), left * sin(turn * time) / turn
    after = gap * along + (w + decay * gap) * across
    then = w * along - (decay * w + gap / (tau * tau)) * across
    # the equation of motion, integrated
    way = u * time - tau * tau * (then - w) - 2.0 * zeta * tau * (after - gap)
    return q + way, u + after, then


@subroutine
def follow_swinging_joint(
    q: float,
    v: float,
    w: float,
    u: float,
    tau: float,
    zeta: float,
    a: float,
    fade: float,
    period: float,
) -> tuple[float, float, float]:
    """A joint with a lag of second order a short time later, without position limits.

    It is exact but where the limit is only touched and where it falls with speed, which it does not
    within the time: an eighth of tau makes a quarter of a percent of the way.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        w: acceleration, rad/s^2.
        u: velocity command, rad/s.
        tau: time constant, s, above 0.
        zeta: damping ratio, from above 0 to below 1.
        a: greatest acceleration at rest, rad/s^2, inf for none.
        fade: what is lost of it per rad/s where the joint speeds up.
        period: the time, s, short against tau.

    Returns:
        Angle, velocity and acceleration.
    """
    if a == inf:
        return _swing(q, v, w, u, tau, zeta, period)
    middle = v + 0.5 * period * w
    up = a * max(1.0 - fade * max(middle, 0.0), 0.0)
    down = a * max(1.0 - fade * max(-middle, 0.0), 0.0)
    w = min(max(w, -down), up)
    free_q, free_v, free_w = _swing(q, v, w, u, tau, zeta, period)
    within = -down < w < up
    if within and -down <= free_w <= up:
        return free_q, free_v, free_w
    if within:
        # until the limit is met, by the secant
        limit = up if free_w > up else -down
        before, off_before, time, off = 0.0, w - limit, period, free_w - limit
        for _ in range(_SECANTS):
            if off == off_before:
                break
            after = time - off * (time - before) / (off - off_before)
            before, off_before, time = time, off, min(max(after, 0.0), period)
            off = _swing(q, v, w, u, tau, zeta, time)[2] - limit
        q, v, w = _swing(q, v, w, u, tau, zeta, time)
        w, period = limit, period - time
    # at the limit, until the rest of the equation takes w back faster than the limit falls
    falls = a * fade * w if w * middle > 0.0 else 0.0
    most = u + tau * (tau * falls - 2.0 * zeta * w)
    held = min(max((most - v) / w, 0.0), period) if w != 0.0 else 0.0
    q, v = q + (v + 0.5 * w * held) * held, v + w * held
    return _swing(q, v, w, u, tau, zeta, period - held)
