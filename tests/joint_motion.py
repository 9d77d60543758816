"""Response of joints to their commands, in closed form and for arrays of joints."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def respond(
    q: ArrayLike, v: ArrayLike, u: ArrayLike, lag: ArrayLike, a: ArrayLike, time: ArrayLike
) -> tuple[Array, Array]:
    """Angle and velocity after a time under a command: `dv/dt = clip((u - v) / lag, -a, a)`.

    A lag of 0 s is none, and so is an acceleration of inf.
    """
    q, v, u, lag, a, time = map(np.asarray, (q, v, u, lag, a, time))
    gap = u - v
    limited = np.isfinite(a)
    a = np.where(limited, a, 1.0)
    ramp = np.where(limited, np.clip((np.abs(gap) - a * lag) / a, 0.0, time), 0.0)
    q = q + v * ramp + 0.5 * np.sign(gap) * a * ramp**2
    v = v + np.sign(gap) * a * ramp
    rest = time - ramp
    lags = np.where(lag > 0.0, lag, 1.0)
    left = np.where(lag > 0.0, np.exp(-rest / lags), rest <= 0.0)
    return q + u * rest - (u - v) * lag * (1.0 - left), u - (u - v) * left
