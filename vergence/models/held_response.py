r"""Joint response to commands held for one fixed time, with coefficients prepared once.

A joint follows its velocity command u with a lag l, whose acceleration may take time to build up:

    m l^2 dw/dt + l w + v = u,   dv/dt = w,   dq/dt = v,   |w| <= a

For a build-up m of zero this is `vergence.models.joint_response.follow_joint`. Otherwise it is the
second-order lag of `follow_second_order_joint` there, with the time constant `sqrt(m) l` and the
damping ratio `1 / (2 sqrt(m))`: it overshoots for m above 1/4.
"""

from math import cos, exp, inf, sin, sqrt
from typing import Final, NamedTuple

from vergence._jit import inlined
from vergence.models.joint_response import follow_joint, lag_decay

_MIN_BUILD_UP: Final = 0.02
"""Build-up m below which the response is taken as first-order (numerical)."""
_MAX_PART_LENGTH: Final = 0.5
"""Longest part of the hold time, in time constants, if the acceleration is limited (numerical)."""
_MAX_PARTS: Final = 3
"""Most parts of the hold time (numerical)."""
_MIN_RATE_DIFFERENCE: Final = 1e-5
"""Least half difference of the two decay rates, as a fraction of their mean: avoids a division by
zero at critical damping (numerical)."""


class HeldResponse(NamedTuple):
    """Coefficients of the response to a held command, in equal parts with linear changes."""

    lag_s: float
    """Lag l, s."""
    build_up_s2: float
    """m l^2, s^2; 0 for a first-order lag."""
    max_acceleration: float
    """Greatest acceleration, rad/s^2, inf for none."""
    part_s: float
    """Duration of one part, s."""
    part_count: int
    """Number of parts of the hold time."""
    gap_factor: float
    """Factor from the gap to the gap after a part."""
    gap_from_acceleration: float
    """Factor from the acceleration to the gap after a part, s."""
    acceleration_factor: float
    """Factor from the acceleration to the acceleration after a part."""
    acceleration_from_gap: float
    """Factor from the gap to the acceleration after a part, 1/s."""


@inlined
def _transition(lag: float, square: float, t: float) -> tuple[float, float, float, float]:
    """The four factors of a `HeldResponse`, in the order of its fields, for the time t."""
    decay = 0.5 * lag / square
    gap = decay * decay - 1.0 / square
    if gap < 0.0:
        turn, left = sqrt(-gap), exp(-decay * t)
        even, odd = left * cos(turn * t), left * sin(turn * t) / turn
    else:
        turn = max(sqrt(gap), _MIN_RATE_DIFFERENCE * decay)
        slow, fast = exp(-t / (square * (decay + turn))), exp(-t * (decay + turn))
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / turn
    return even + decay * odd, odd, even - decay * odd, -odd / square


@inlined
def prepare_held_response(
    lag_s: float, build_up_ratio: float, max_acceleration: float, hold_s: float
) -> HeldResponse:
    """Coefficients for lag l above 0, s, build-up m, acceleration limit (or inf), rad/s^2."""
    if build_up_ratio < _MIN_BUILD_UP or hold_s <= 0.0:
        return HeldResponse(
            lag_s, 0.0, max_acceleration, hold_s, 1, lag_decay(hold_s, lag_s), 0.0, 0.0, 0.0
        )
    square, parts = build_up_ratio * lag_s * lag_s, 1
    if max_acceleration < inf:
        parts = min(int(hold_s / (_MAX_PART_LENGTH * sqrt(square))) + 1, _MAX_PARTS)
    gap_gap, gap_w, w_w, w_gap = _transition(lag_s, square, hold_s / parts)
    return HeldResponse(
        lag_s, square, max_acceleration, hold_s / parts, parts, gap_gap, gap_w, w_w, w_gap
    )


@inlined
def _unlimited(
    q: float, v: float, acceleration: float, u: float, response: HeldResponse, t: float
) -> tuple[float, float, float]:
    """State after the time t, without a limit on the acceleration."""
    gap_gap, gap_w, w_w, w_gap = _transition(response.lag_s, response.build_up_s2, t)
    gap = v - u
    after, then = gap * gap_gap + acceleration * gap_w, acceleration * w_w + gap * w_gap
    # integral of the equation of motion
    q += u * t - response.build_up_s2 * (then - acceleration) - response.lag_s * (after - gap)
    return q, u + after, then


@inlined
def follow_held_command(
    q: float, v: float, acceleration: float, u: float, response: HeldResponse
) -> tuple[float, float, float]:
    """Move a joint by the hold time of a response, without position limits.

    The result is exact if the acceleration stays within its limit. Otherwise the error is within
    half a percent of the distance moved, if the hold time is at most 1.5 time constants.

    Args:
        q: angle, rad.
        v: velocity, rad/s.
        acceleration: acceleration, rad/s^2; ignored by a first-order lag.
        u: velocity command, rad/s.
        response: coefficients from `prepare_held_response`.

    Returns:
        Angle, velocity and acceleration; rad, rad/s and rad/s^2.
    """
    a = response.max_acceleration
    if response.build_up_s2 == 0.0:
        q, v = follow_joint(q, v, u, response.lag_s, a, response.part_s, response.gap_factor)
        return q, v, min(max((u - v) / response.lag_s, -a), a)
    for _ in range(response.part_count):
        t = response.part_s
        acceleration = min(max(acceleration, -a), a)
        # at the limit until the equation demands a smaller |w|
        held = 0.0
        if abs(acceleration) == a:
            held = min(max((u - v - response.lag_s * acceleration) / acceleration, 0.0), t)
            q, v, t = q + (v + 0.5 * acceleration * held) * held, v + acceleration * held, t - held
            if t <= 0.0:
                continue
        gap = v - u
        after, then = (
            gap * response.gap_factor + acceleration * response.gap_from_acceleration,
            acceleration * response.acceleration_factor + gap * response.acceleration_from_gap,
        )
        if held > 0.0:
            q, v, acceleration = _unlimited(q, v, acceleration, u, response, t)
        elif abs(then) <= a:
            q += (
                u * t
                - response.build_up_s2 * (then - acceleration)
                - response.lag_s * (after - gap)
            )
            v, acceleration = u + after, then
        else:
            # time until the limit: linear extrapolation, then one secant step
            limit = a if then > 0.0 else -a
            slope = -(gap + response.lag_s * acceleration) / response.build_up_s2
            meets = min(max((limit - acceleration) / slope, 0.0), t) if slope != 0.0 else 0.0
            came = _unlimited(q, v, acceleration, u, response, meets)[2]
            if came != acceleration:
                meets = min(max(meets * (limit - acceleration) / (came - acceleration), 0.0), t)
            q, v, acceleration = _unlimited(q, v, acceleration, u, response, meets)
            acceleration, t = limit, t - meets
            q, v = q + (v + 0.5 * acceleration * t) * t, v + acceleration * t
    return q, v, acceleration
