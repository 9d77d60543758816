r"""How joints follow velocity commands: a first-order lag with an acceleration limit, exactly.

    dv/dt = clip((u - v) / tau, -a, a),   dq/dt = v

with the command u held for a period. While |u - v| exceeds a tau the joint accelerates at the
limit; then the difference decays exponentially. Both phases have closed forms, so a period is
one step whatever its length. A joint at its position limit stops there.

A motor whose torque falls with its speed accelerates at most by `a (1 - fade |v|)` where it speeds
up, and by a where it brakes:

    dv/dt = clip((u - v) / tau, -a_-(v), a_+(v)),   a_+(v) = a (1 - fade max(v, 0))

whose saturated phase has a closed form too: 1 / fade - v decays with the rate a fade.
"""

from math import exp, expm1, inf, log

from vergence._jit import device, subroutine


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
