r"""How far noise moves the prediction of a target at rest, and the motion model that limits it.

The Kalman filter of `vergence.controllers.prediction.target_motion` takes noise for motion in part,
and carries it on over the delay. With F the model's transition over the time between two images, K
the filter's gain in the long run, H = (1, 0, 0) and r the variance of a measurement, the estimate
of a target at rest scatters about the truth with the covariance S that solves

    S = A S A' + K r K',    A = (I - K H) F

and its angle a time h later with c S c', where c is the first row of the transition over h.
"""

from typing import Final

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from vergence.controllers.prediction.singer import singer_noise, singer_transition
from vergence.controllers.prediction.target_motion import measured_variance
from vergence.envs.fields import finite_above_zero
from vergence.models.head import HeadModel

WANDER_PX: Final = 0.65
"""What noise may move the prediction of a target at rest by, px: inside a band of a pixel."""
LEAST_ACCELERATION_SD: Final = 0.02
"""Below this, the errors of any head's model matter more than noise, rad/s^2."""
_STEPS: Final = 12


def resting_wander(
    head: HeadModel,
    *,
    acceleration_sd: float,
    acceleration_time_s: float,
    pixel_sd: float | None = None,
) -> float:
    """The standard deviation of the predicted direction of a target at rest, per image axis.

    Args:
        head: the model of the head; the prediction is to the end of the period in which an image
            is replaced by the next.
        acceleration_sd: sigma_a of the model of motion, rad/s^2.
        acceleration_time_s: T_a, s.
        pixel_sd: noise of a detection, px; None for the head's.

    Returns:
        It in pixels at the principal point of the eye with the shortest focal length.
    """
    frame_s = head.timing.frame_s
    variance = measured_variance(head, pixel_sd)
    # in units of the measurement's noise and of images, in which the equations are well conditioned
    units = frame_s ** np.arange(3.0)
    transition = singer_transition(frame_s, acceleration_time_s) * units[:, None] / units
    noise = singer_noise(frame_s, acceleration_time_s, acceleration_sd) * np.outer(units, units)
    measure = np.array([[1.0], [0.0], [0.0]])
    before = solve_discrete_are(transition.T, measure, noise / variance, np.eye(1))
    gain = before[:, :1] / (before[0, 0] + 1.0)
    closed = (np.eye(3) - gain @ measure.T) @ transition
    scatter = solve_discrete_lyapunov(closed, gain @ gain.T)
    horizon_s = head.timing.latency_s + frame_s
    ahead = singer_transition(horizon_s, acceleration_time_s)[0] / units
    focal = float(head.cameras.focal.min())
    return float(np.sqrt(variance * (ahead @ scatter @ ahead))) * focal


def calm_acceleration_sd(
    head: HeadModel,
    *,
    acceleration_time_s: float,
    pixel_sd: float | None = None,
    most: float,
    wander_px: float = WANDER_PX,
) -> float:
    """The greatest sigma_a with which noise at rest moves the prediction by no more than this.

    Args:
        head: the model of the head.
        acceleration_time_s: T_a, s.
        pixel_sd: noise of a detection, px; None for the head's.
        most: what it is at most, rad/s^2.
        wander_px: the standard deviation that noise may have, px.

    Returns:
        It in rad/s^2, between `LEAST_ACCELERATION_SD` and `most`.

    Raises:
        ConfigurationError: a value cannot be.
    """
    finite_above_zero("acceleration_time_s", acceleration_time_s)

    def wander(sd: float) -> float:
        return resting_wander(
            head,
            acceleration_sd=sd,
            acceleration_time_s=acceleration_time_s,
            pixel_sd=pixel_sd,
        )

    if wander(most) <= wander_px:
        return most
    low, high = np.log(LEAST_ACCELERATION_SD), np.log(most)
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if wander(np.exp(middle)) <= wander_px else (low, middle)
    return float(np.exp(low))
