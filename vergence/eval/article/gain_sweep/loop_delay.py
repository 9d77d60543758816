r"""Delay and lag of a loop, from the gain at which overshoot begins.

The linear loop with a pure delay D, a velocity lag of time constant T and the gain k,

    s + k exp(-s D) / (1 + s T) = 0,

does not overshoot as long as its two slowest roots are real. They meet at s = -x with

    D T x^2 - (2 T + D) x + 1 = 0,    k = x (1 - x T) exp(-x D),

so that k = 1 / (e D) without a lag and k = 1 / (4 T) without a delay.
"""

from math import exp, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from vergence.models.parts import FloatArray


def critical_gain(delay_s: float, lag_s: float) -> float:
    """Greatest gain without overshoot, 1/s.

    Args:
        delay_s: pure delay of the whole loop, s; must be above 0 if the lag is 0.
        lag_s: lag of the joints' velocity, s.
    """
    middle = 2.0 * lag_s + delay_s
    # smaller root of the quadratic, in a form that also holds if delay or lag is 0
    x = 2.0 / (middle + sqrt(middle**2 - 4.0 * delay_s * lag_s))
    return x * (1.0 - x * lag_s) * exp(-x * delay_s)


def critical_lag(delay_s: float, gain: float) -> float:
    """Lag that with this delay gives a critical gain, s; nan if the delay alone is too long."""
    if delay_s > 0.0 and critical_gain(delay_s, 0.0) < gain:
        return float("nan")
    longest = 1.0 / (4.0 * gain)  # the lag without a delay
    if delay_s == 0.0:
        return longest
    return float(brentq(lambda lag: critical_gain(delay_s, lag) - gain, 0.0, longest, xtol=1e-9))


def first_crossing(at: ArrayLike, values: ArrayLike, level: float) -> float:
    """Argument at which sampled values first rise above a level, by linear interpolation.

    Args:
        at: (n,) rising arguments.
        values: (n,) samples there.
        level: the level.

    Returns:
        The argument; nan if the first value is above the level already, or none is.
    """
    x: FloatArray = np.asarray(at, dtype=np.float64)
    y: FloatArray = np.asarray(values, dtype=np.float64)
    above = y > level
    if not above.any() or above[0]:
        return float("nan")
    i = int(np.argmax(above))
    part = (level - y[i - 1]) / (y[i] - y[i - 1])
    return float(x[i - 1] + part * (x[i] - x[i - 1]))
