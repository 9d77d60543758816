"""Fit of an actuator's response to its commands, from its encoder: a lag after a latency.

    dv/dt = clip((g u(t - d) - v) / lag, -a, a),   dq/dt = v

is integrated with the commands as they were sent, and its angle is compared with the encoder's. A
linear drift over each second, as the integral of speeds has one, is removed from the residuals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from vergence.envs.streams import IntArray
from vergence.models.joint_response import follow_joint, lag_decay
from vergence.models.parts import FloatArray

CLUSTER_S: Final = 1.0
"""Length of clusters in which drift is removed and residuals count as dependent, s (chosen)."""
_QUANTISATION_SIGMA: Final = 12.0**-0.5
"""Standard deviation of a quantised number per quantisation step (numerical)."""
_START_LATENCIES_S: Final = (0.0, 0.02, 0.05, 0.1)
"""Start values of the latency, s (numerical)."""
_MIN_DELAY_SPEED_RAD_S: Final = 0.5
"""Speed above which an angle's residual shows the error of its time, rad/s (chosen)."""
_LOSS_SCALE: Final = 3.0
"""Scale of the robust loss, in standard deviations: larger residuals count linearly (chosen)."""
_MAX_RELATIVE_SIGMA: Final = 0.15
"""Greatest relative standard deviation of an acceleration limit that is reported (chosen)."""
_MIN_CHI2_INCREASE: Final = 50.0
"""Least increase of the sum of squared residuals without an acceleration limit, in mean squares,
for which a limit is accepted (chosen)."""
_NO_LIMIT_INVERSE: Final = 1e-4
"""Inverse acceleration that stands for no limit, s^2/rad (numerical)."""

_SMOOTHING_READINGS: Final = (0.25, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 13.0)
"""Widths of smoothing to choose from, in readings: from none to half a second (numerical)."""

_follow = getattr(follow_joint, "py_func", follow_joint)
_lag_decay = getattr(lag_decay, "py_func", lag_decay)


class FittedMotor(NamedTuple):
    """Response parameters of an actuator's motor."""

    latency_s: float
    """Latency from a command to its response in the encoder readings, s."""
    lag_s: float
    gain: float
    """Steady-state speed per commanded speed."""
    inverse_acceleration: float
    """Inverse of the greatest acceleration, s^2/rad."""


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Fitted response of an actuator to its commands."""

    motor: FittedMotor
    sigma: FittedMotor
    """Standard deviations of the parameters."""
    peak_acceleration_rad_s2: float
    """Greatest acceleration of the modelled motion, rad/s^2."""
    residual_rad: float
    """Rms difference of the encoder's angles from the model's, rad."""
    acceleration_limited: bool
    """True if a motor without an acceleration limit would fit clearly worse."""
    latency_lag_correlation: float
    """Correlation of the errors of latency and lag."""

    @property
    def acceleration_rad_s2(self) -> float | None:
        """Acceleration limit of the motor, rad/s^2; None if it was not reached."""
        certain = (
            self.sigma.inverse_acceleration < _MAX_RELATIVE_SIGMA * self.motor.inverse_acceleration
        )
        return (
            1.0 / self.motor.inverse_acceleration if self.acceleration_limited and certain else None
        )

    @property
    def acceleration_sigma(self) -> float:
        """Its standard deviation, rad/s^2."""
        return self.sigma.inverse_acceleration / self.motor.inverse_acceleration**2


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
    greatest = 1.0 / motor.inverse_acceleration
    begins = [*(sent_s + motor.latency_s).tolist(), np.inf]
    commanded = [0.0, *(motor.gain * commands).tolist()]
    found = np.empty((2, len(times)))
    at_s, q, v, place = min(begins[0], float(times[0])), 0.0, 0.0, 0

    def after(until_s: float) -> tuple[float, float]:
        wait_s = until_s - at_s
        decay = _lag_decay(wait_s, motor.lag_s)
        result: tuple[float, float] = _follow(
            q, v, commanded[place], motor.lag_s, greatest, wait_s, decay
        )
        return result

    for k, time_s in enumerate(times.tolist()):
        while begins[place] <= time_s:
            q, v = after(begins[place])
            at_s = begins[place]
            place += 1
        found[:, k] = after(time_s)
    return found[0], found[1]


def fit_joint(
    sent_s: FloatArray,
    commands: FloatArray,
    joints_s: FloatArray,
    angles: FloatArray,
    guess: FittedMotor,
    encoder_step_rad: float,
) -> JointFit:
    """Fit the response of an actuator.

    Args:
        sent_s: (n,) times at which the commands were sent, s.
        commands: (n,) commands, rad/s.
        joints_s: (m,) times at which the encoder was read, s.
        angles: (m,) encoder angles, rad.
        guess: parameters of the head model, the start of the fit.
        encoder_step_rad: quantisation step of the encoder, rad.

    Returns:
        The robust least-squares fit. Its uncertainty counts residuals within a second as dependent.
    """
    clusters = ((joints_s - joints_s[0]) / CLUSTER_S).astype(np.int64)
    detrender = _Detrender(joints_s, clusters)
    rounded = max(_QUANTISATION_SIGMA * encoder_step_rad, 1e-5)
    sigma = np.full(len(angles), rounded)

    def weighted_residual(values: FloatArray) -> FloatArray:
        residual = angles - simulate_motor(FittedMotor(*values), sent_s, commands, joints_s)[0]
        return np.asarray(detrender.detrended(residual) / sigma)

    starts = [np.array(guess._replace(latency_s=latency)) for latency in _START_LATENCIES_S]
    start = min(starts, key=lambda values: float(np.abs(weighted_residual(values)).sum()))
    for _ in range(2):  # again with the estimated timing error of the readings
        found = least_squares(
            weighted_residual,
            start,
            bounds=([-0.05, 1e-3, 0.01, _NO_LIMIT_INVERSE], [0.5, 1.0, 3.0, 10.0]),
            x_scale=[0.01, 0.01, 0.1, 0.01],
            loss="soft_l1",
            f_scale=_LOSS_SCALE,
            jac="3-point",
            diff_step=[1e-4] * 4,
        )
        start, motor = found.x, FittedMotor(*found.x.tolist())
        speed = np.abs(simulate_motor(motor, sent_s, commands, joints_s)[1])
        fast = speed > _MIN_DELAY_SPEED_RAD_S
        late_s = np.abs(sigma * weighted_residual(found.x))[fast] / speed[fast]
        timestamp_sigma_s = 1.4826 * float(np.median(late_s)) if fast.any() else 0.0
        sigma = np.hypot(rounded, timestamp_sigma_s * speed)
    without = weighted_residual(np.array(motor._replace(inverse_acceleration=_NO_LIMIT_INVERSE)))
    square = float(np.mean(weighted_residual(found.x) ** 2))
    worse = (float(np.sum(without**2)) / square - len(without)) > _MIN_CHI2_INCREASE
    covariance = jackknife_covariance(np.asarray(found.jac), found.fun, clusters, _LOSS_SCALE)
    times = np.arange(joints_s[0], joints_s[-1], 0.002)
    speeds = simulate_motor(motor, sent_s, commands, times)[1]
    deviations = np.sqrt(np.diagonal(covariance))
    return JointFit(
        motor=motor,
        sigma=FittedMotor(*deviations.tolist()),
        latency_lag_correlation=float(covariance[0, 1] / (deviations[0] * deviations[1])),
        peak_acceleration_rad_s2=float(np.abs(np.diff(speeds)).max() / 0.002),
        residual_rad=float(np.sqrt(np.mean((sigma * weighted_residual(found.x)) ** 2))),
        acceleration_limited=worse,
    )


class _Detrender:
    """Removes the linear drift of values in each cluster."""

    def __init__(self, times: FloatArray, clusters: IntArray) -> None:
        self._clusters = clusters
        self._counts = np.maximum(np.bincount(clusters), 1)
        self._times = times - self._mean(times)[clusters]
        self._squares = np.maximum(np.bincount(clusters, self._times**2), 1e-12)

    def _mean(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self._clusters, values) / self._counts)

    def detrended(self, values: FloatArray) -> FloatArray:
        """Subtract a fitted straight line from the values of each cluster."""
        slopes = np.bincount(self._clusters, values * self._times) / self._squares
        lines = self._mean(values)[self._clusters] + slopes[self._clusters] * self._times
        return np.asarray(values - lines)


def jackknife_covariance(
    jacobian: FloatArray,
    residual: FloatArray,
    clusters: IntArray,
    loss_scale: float,
    prior_count: int = 0,
) -> FloatArray:
    """Covariance of a least-squares estimate whose residuals depend on their neighbours.

    It is the jackknife over clusters, from the linearised change of the estimate without each of
    them: CR3 of Bell and McCaffrey, Survey Methodology 28, 2002. If a few clusters carry most of
    the information it is less biased than the sandwich estimator.

    Args:
        jacobian: (m, p) Jacobian of `least_squares`, scaled by its loss `soft_l1`.
        residual: (m,) residuals of `least_squares`, not scaled.
        clusters: (m - known,) index of each residual's cluster.
        loss_scale: `f_scale` of the loss.
        prior_count: number of priors with standard deviation 1, which are the last residuals.

    Returns:
        (p, p) covariance.
    """
    whole, measured = jacobian.T @ jacobian, len(residual) - prior_count
    scaled = residual * (1.0 + (residual / loss_scale) ** 2) ** 0.25
    changes = []
    for cluster in np.unique(clusters):
        rows = np.flatnonzero(clusters == cluster)
        part, score = jacobian[rows], jacobian[rows].T @ scaled[rows]
        changes.append(np.linalg.pinv(whole - part.T @ part, hermitian=True) @ score)
    found = (1.0 - 1.0 / len(changes)) * np.transpose(changes) @ np.array(changes)
    before = jacobian[measured:] @ np.linalg.pinv(whole, hermitian=True)
    found += before.T @ before
    # an unobservable parameter has infinite variance, but pinv gives it zero
    blind = np.diagonal(whole) < 1e-6
    found[blind, blind] = np.inf
    return np.asarray(found)


def fitted_angle_path(
    motor: FittedMotor,
    sent_s: FloatArray,
    commands: FloatArray,
    joints_s: FloatArray,
    angles: FloatArray,
) -> Callable[[FloatArray], FloatArray]:
    """Angle of the actuator by time: the model, corrected by the smoothed encoder residuals.

    A poor model is corrected at each reading, a good one over many: the width of the smoothing is
    the one that best predicts each reading from the others.

    Args:
        motor: its fitted parameters.
        sent_s: see `fit_joint`.
        commands: see `fit_joint`.
        joints_s: see `fit_joint`.
        angles: see `fit_joint`.

    Returns:
        A function of increasing times, s, that returns angles, rad.
    """
    residual = angles - simulate_motor(motor, sent_s, commands, joints_s)[0]
    found = []
    for width in _SMOOTHING_READINGS:
        places = np.arange(-np.ceil(4.0 * width), np.ceil(4.0 * width) + 1.0)
        kernel = np.exp(-0.5 * (places / width) ** 2)
        whole = np.convolve(np.ones_like(residual), kernel, "same")
        smooth = np.convolve(residual, kernel, "same") / whole
        found.append((float(np.mean(((residual - smooth) / (1.0 - 1.0 / whole)) ** 2)), smooth))
    smooth = min(found, key=lambda one: one[0])[1]

    def path(times: FloatArray) -> FloatArray:
        angle = simulate_motor(motor, sent_s, commands, times)[0]
        return np.asarray(angle + np.interp(times, joints_s, smooth))

    return path
