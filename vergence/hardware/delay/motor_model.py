"""The model of a motor that is fitted: a velocity PI, its limits, and friction.

With the velocity v, the goal u = g times the command after a latency, and the error e = u - v,

    dv/dt = clip(d - b v, -a, a) - l - friction,   d = clip((e + r I) / lag, -c a, c a),   dI/dt = e

Friction opposes the motion by f; at rest it holds up to s f. The integral stops where the drive is
at its limit c a and e would raise it. With r = b, friction and limits aside, this is a lag, and
friction acts until the integral has made up for it, for 1 / r.
"""

from math import exp
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import compiled
from vergence.models.parts import FloatArray

_STEP_S: Final = 1e-3
"""Integration step, s: a tenth of a short lag, which is exact but at the limits (numerical)."""


class FittedMotor(NamedTuple):
    """Response parameters of an actuator's motor."""

    latency_s: float
    """Latency from a command to its response in the encoder readings, s."""
    lag_s: float
    gain: float
    """Steady-state speed per commanded speed."""
    inverse_acceleration: float
    """Inverse of the greatest acceleration, s^2/rad."""
    friction_rad_s2: float = 0.0
    """Coulomb friction, f, as an acceleration."""
    integral_rate: float = 0.0
    """Rate of the PI's integral, r, 1/s."""
    emf_rate: float = 0.0
    """Rate at which the motor comes to rest without drive, b, 1/s."""
    load_rad_s2: float = 0.0
    """Constant load, l, as an acceleration."""
    static_ratio: float = 1.5
    """Static friction per Coulomb friction, s."""
    drive_ratio: float = 1.5
    """Greatest drive per greatest acceleration, c."""


def simulate_motor(
    motor: FittedMotor, sent_s: FloatArray, commands: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Simulate a motor, at first at rest at angle 0, with its commands.

    Args:
        motor: its parameters.
        sent_s: (n,) times at which the commands were sent, s, increasing.
        commands: (n,) commands, rad/s.
        times: (m,) times of the result, s, increasing.

    Returns:
        (m,) angles, rad, and (m,) speeds, rad/s.
    """
    found = np.empty((2, len(times)))
    _simulate(np.array(motor, dtype=np.float64), sent_s, motor.gain * commands, times, found)
    return found[0], found[1]


@compiled
def _simulate(
    parameters: FloatArray, sent_s: FloatArray, goals: FloatArray, times: FloatArray,
    found: FloatArray,
) -> None:  # fmt: skip
    latency, lag, _, inverse, friction, rate, emf, load, static_ratio, ratio = parameters
    limit, static = 1.0 / inverse, static_ratio * friction
    most, slowing = ratio * limit, 1.0 / lag + emf
    q, v, u, k = 0.0, 0.0, 0.0, 0
    integral = load * lag / rate if rate > 0.0 else 0.0  # which holds the load
    at = min(sent_s[0] + latency, times[0])
    # the steps do not depend on the times of the result: whether a joint sticks may hang on them
    for place in range(len(sent_s) + 1):
        until = sent_s[place] + latency if place < len(sent_s) else times[-1]
        steps = int(max(until - at, 0.0) / _STEP_S) + 1
        step = (until - at) / steps
        slide = (1.0 - exp(-slowing * step)) / slowing
        for _ in range(steps):
            error = u - v
            drive = (error + rate * integral) / lag
            limited = abs(drive) >= most
            if not limited or drive * error < 0.0:
                integral += step * error
            force = min(max(drive, -most), most) - emf * v
            limited |= abs(force) > limit
            force = min(max(force, -limit), limit) - load
            after = v
            if v != 0.0 or abs(force) > static:
                side = 1.0 if (v if v != 0.0 else force) > 0.0 else -1.0
                after += (force - side * friction) * (step if limited else slide)
                if friction > 0.0 and (v * after < 0.0 or (v == 0.0 and side * after < 0.0)):
                    after = 0.0  # it stops where it turns round
            while k < len(times) and times[k] <= at + step:
                since = times[k] - at
                then = v + (after - v) * since / step if step > 0.0 else v
                found[0, k], found[1, k] = q + 0.5 * (v + then) * since, then
                k += 1
            q += 0.5 * (v + after) * step
            v = after
            at += step
        at = until
        u = goals[min(place, len(goals) - 1)]
    found[0, k:], found[1, k:] = q, v  # after rounding
