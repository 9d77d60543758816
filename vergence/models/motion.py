"""How a joint follows its velocity command: latency, lag, acceleration limit, held commands."""

from math import cos, exp, expm1, inf, log, pi, sin, sqrt
from typing import Final, NamedTuple

from vergence.kernels import inlined, subroutine

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
    """Angle, velocity and acceleration after a time short against tau, by a second-order lag.

    Exact but where the limit falls with speed, as it is held constant, or is exceeded only between
    start and end: a quarter of a percent of the way for an eighth of tau.
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


_MIN_BUILD_UP: Final = 0.02
"""Build-up m below which the response is taken as first-order (numerical)."""
_MAX_PART_LENGTH: Final = 0.5
"""Longest part of the hold time, in time constants, if the acceleration is limited (numerical)."""
_MAX_PARTS: Final = 3  # most parts of the hold time (numerical)
_MIN_RATE_DIFFERENCE: Final = 1e-5
"""Least half difference of the two decay rates, as a fraction of their mean: avoids a division by
zero at critical damping (numerical)."""


class HeldResponse(NamedTuple):
    """Coefficients of the response to a held command, in equal parts with linear changes."""

    lag_s: float  # lag l, s
    build_up_s2: float  # m l^2, s^2; 0 for a first-order lag
    max_acceleration: float  # greatest acceleration, rad/s^2, inf for none
    part_s: float  # duration of one part, s
    part_count: int  # number of parts of the hold time
    gap_factor: float  # factor from the gap to the gap after a part
    gap_from_acceleration: float  # factor from the acceleration to the gap after a part, s
    acceleration_factor: float  # factor from the acceleration to the acceleration after a part
    acceleration_from_gap: float  # factor from the gap to the acceleration after a part, 1/s


@inlined
def _part(lag: float, square: float, max_acceleration: float, t: float, count: int) -> HeldResponse:
    """The response in parts of the time t, by a lag l and m l^2 above 0."""
    decay = 0.5 * lag / square
    gap = decay * decay - 1.0 / square
    if gap < 0.0:
        turn, left = sqrt(-gap), exp(-decay * t)
        even, odd = left * cos(turn * t), left * sin(turn * t) / turn
    else:
        turn = max(sqrt(gap), _MIN_RATE_DIFFERENCE * decay)
        slow, fast = exp(-t / (square * (decay + turn))), exp(-t * (decay + turn))
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / turn
    factors = even + decay * odd, odd, even - decay * odd, -odd / square
    return HeldResponse(lag, square, max_acceleration, t, count, *factors)


@inlined
def prepare_held_response(
    lag_s: float, build_up_ratio: float, max_acceleration: float, hold_s: float
) -> HeldResponse:
    """Coefficients for lag l above 0, s, build-up m, acceleration limit (or inf), rad/s^2."""
    if build_up_ratio < _MIN_BUILD_UP or hold_s <= 0.0:
        left = lag_decay(hold_s, lag_s)
        return HeldResponse(lag_s, 0.0, max_acceleration, hold_s, 1, left, 0.0, 0.0, 0.0)
    square, parts = build_up_ratio * lag_s * lag_s, 1
    if max_acceleration < inf:
        parts = min(int(hold_s / (_MAX_PART_LENGTH * sqrt(square))) + 1, _MAX_PARTS)
    return _part(lag_s, square, max_acceleration, hold_s / parts, parts)


@inlined
def _unlimited(
    q: float, v: float, acceleration: float, u: float, part: HeldResponse
) -> tuple[float, float, float]:
    """State after one part, without a limit on the acceleration."""
    gap = v - u
    after = gap * part.gap_factor + acceleration * part.gap_from_acceleration
    then = acceleration * part.acceleration_factor + gap * part.acceleration_from_gap
    # integral of the equation of motion
    q += u * part.part_s - part.build_up_s2 * (then - acceleration) - part.lag_s * (after - gap)
    return q, u + after, then


@inlined
def follow_held_command(
    q: float, v: float, acceleration: float, u: float, response: HeldResponse
) -> tuple[float, float, float]:
    """Angle, velocity and acceleration after the hold time of a response.

    Exact within the limit on acceleration, else within half a percent of the way for a hold time of
    up to 1.5 time constants.
    """
    lag, square, a = response.lag_s, response.build_up_s2, response.max_acceleration
    if square == 0.0:
        q, v = follow_joint(q, v, u, lag, a, response.part_s, response.gap_factor)
        return q, v, min(max((u - v) / lag, -a), a)
    for _ in range(response.part_count):
        t = response.part_s
        acceleration = min(max(acceleration, -a), a)
        # at the limit until the equation demands a smaller |w|
        held = 0.0
        if abs(acceleration) == a:
            held = min(max((u - v - lag * acceleration) / acceleration, 0.0), t)
            q, v, t = q + (v + 0.5 * acceleration * held) * held, v + acceleration * held, t - held
            if t <= 0.0:
                continue
        part = _part(lag, square, a, t, 1) if held > 0.0 else response
        end = _unlimited(q, v, acceleration, u, part)
        if held > 0.0 or abs(end[2]) <= a:
            q, v, acceleration = end
        else:
            # time until the limit: linear extrapolation, then one secant step
            limit = a if end[2] > 0.0 else -a
            slope = -(v - u + lag * acceleration) / square
            meets = min(max((limit - acceleration) / slope, 0.0), t) if slope != 0.0 else 0.0
            came = _unlimited(q, v, acceleration, u, _part(lag, square, a, meets, 1))[2]
            if came != acceleration:
                meets = min(max(meets * (limit - acceleration) / (came - acceleration), 0.0), t)
            part = _part(lag, square, a, meets, 1)
            q, v, acceleration = _unlimited(q, v, acceleration, u, part)
            acceleration, t = limit, t - meets
            q, v = q + (v + 0.5 * acceleration * t) * t, v + acceleration * t
    return q, v, acceleration
