r"""Singer's model of how a manned target moves: an acceleration that forgets itself.

With the time constant T_a,

    d/dt (theta, w, a) = (w, a, -a / T_a) + white noise on a of variance 2 sigma_a^2 / T_a.

In this model the prediction over a time h is linear (R. A. Singer, Estimating optimal tracking
filter performance for manned maneuvering targets, 1970):

    theta(h) = theta + w h + a T_a^2 (h / T_a - 1 + exp(-h / T_a))
    w(h)     = w + a T_a (1 - exp(-h / T_a)),   a(h) = a exp(-h / T_a)
"""

import numpy as np

from vergence.models.parts import FloatArray


def singer_transition(time_s: float, acceleration_time_s: float) -> FloatArray:
    """How (theta, w, a) goes on by itself.

    Args:
        time_s: h.
        acceleration_time_s: T_a.

    Returns:
        (3, 3) transition matrix.
    """
    t, left = acceleration_time_s, float(np.exp(-time_s / acceleration_time_s))
    return np.array(
        [
            [1.0, time_s, t * t * (time_s / t - 1.0 + left)],
            [0.0, 1.0, t * (1.0 - left)],
            [0.0, 0.0, left],
        ]
    )


def singer_noise(time_s: float, acceleration_time_s: float, sd: float) -> FloatArray:
    """What a time adds to the covariance: its integral by Gauss-Legendre, exact to rounding.

    Args:
        time_s: h.
        acceleration_time_s: T_a.
        sd: sigma_a, rad/s^2.

    Returns:
        (3, 3) covariance of (theta, w, a).
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    noise = np.zeros((3, 3))
    for node, weight in zip(nodes, weights, strict=True):
        column = singer_transition(0.5 * time_s * (1.0 + node), acceleration_time_s)[:, 2]
        share = 0.5 * time_s * weight * 2.0 * sd**2 / acceleration_time_s
        noise += share * np.outer(column, column)
    return noise
