"""How an actuator follows its commands, from its encoder: a lag behind a latency.

    dv/dt = clip((g u(t - d) - v) / lag, -a, a),   dq/dt = v

is carried along the commands as they were sent, and its angle compared with the encoder's. A
steady drift over a second, as any sum of speeds has, counts for nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from vergence.envs.streams import IntArray
from vergence.models.joint_response import follow_joint, lag_decay
from vergence.models.parts import FloatArray

STRETCH_S: Final = 1.0
"""Time over which a drift counts for nothing, and residuals are taken for dependent, s."""
_ROUNDED: Final = 12.0**-0.5
"""Standard deviation of a rounded number by its step."""
_LATENCIES_S: Final = (0.0, 0.02, 0.05, 0.1)
"""Latencies with which the search begins, s."""
_FAST_RAD_S: Final = 0.5
"""Speed from which on an angle tells how well it is dated, rad/s."""
_SOFT: Final = 3.0
"""Residual from which on one counts by its size, not its square."""
_SEEN: Final = 0.15
"""Relative uncertainty of an acceleration up to which it was seen."""
_WORSE: Final = 50.0
"""How much worse, by the mean square of a residual, no limit of the acceleration has to fit."""
_NO_LIMIT: Final = 1e-4
"""One by an acceleration that stands for none, s^2/rad."""

_follow = getattr(follow_joint, "py_func", follow_joint)
_left = getattr(lag_decay, "py_func", lag_decay)


class Motor(NamedTuple):
    """What moves an actuator."""

    latency_s: float
    """From a command to its response as the encoder tells it, s."""
    lag_s: float
    gain: float
    """Speed at rest by command."""
    per_acceleration: float
    """One by the greatest acceleration, s^2/rad."""


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """How an actuator follows its commands."""

    motor: Motor
    sigma: Motor
    """Standard deviations."""
    greatest_rad_s2: float
    """Greatest acceleration that the motor has had, rad/s^2."""
    residual_rad: float
    """Rms of the encoder's angles beside the model's, rad."""
    limited: bool
    """Whether a motor without a greatest acceleration would fit worse."""
    correlation: float
    """Of the latency's error with the lag's."""

    @property
    def acceleration_rad_s2(self) -> float | None:
        """The greatest that the motor can have, rad/s^2; None where it was not reached."""
        certain = self.sigma.per_acceleration < _SEEN * self.motor.per_acceleration
        return 1.0 / self.motor.per_acceleration if self.limited and certain else None

    @property
    def acceleration_sigma(self) -> float:
        """Its standard deviation, rad/s^2."""
        return self.sigma.per_acceleration / self.motor.per_acceleration**2


def respond(
    motor: Motor, sent_s: FloatArray, sent: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Carry a motor that rests at angle 0 along its commands.

    Args:
        motor: what moves it.
        sent_s: (n,) when the commands went out, s, growing.
        sent: (n,) commands, rad/s.
        times: (m,) s, growing.

    Returns:
        (m,) angles, rad, and (m,) speeds, rad/s.
    """
    greatest = 1.0 / motor.per_acceleration
    begins = [*(sent_s + motor.latency_s).tolist(), np.inf]
    told = [0.0, *(motor.gain * sent).tolist()]
    found = np.empty((2, len(times)))
    at_s, q, v, place = min(begins[0], float(times[0])), 0.0, 0.0, 0

    def after(until_s: float) -> tuple[float, float]:
        wait_s = until_s - at_s
        decay = _left(wait_s, motor.lag_s)
        result: tuple[float, float] = _follow(
            q, v, told[place], motor.lag_s, greatest, wait_s, decay
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
    sent: FloatArray,
    joints_s: FloatArray,
    angles: FloatArray,
    guess: Motor,
    step_rad: float,
) -> JointFit:
    """Find what moves an actuator.

    Args:
        sent_s: (n,) when commands went out, s.
        sent: (n,) rad/s.
        joints_s: (m,) when the encoder was read, s.
        angles: (m,) as read, rad.
        guess: what the model says.
        step_rad: the encoder's step, rad.

    Returns:
        The best by least squares. Residuals within a second count as dependent in its uncertainty.
    """
    stretches = ((joints_s - joints_s[0]) / STRETCH_S).astype(np.int64)
    straight = _Straight(joints_s, stretches)
    rounded = max(_ROUNDED * step_rad, 1e-5)
    sigma = np.full(len(angles), rounded)

    def residual(values: FloatArray) -> FloatArray:
        gap = angles - respond(Motor(*values), sent_s, sent, joints_s)[0]
        return np.asarray(straight.without(gap) / sigma)

    starts = [np.array(guess._replace(latency_s=latency)) for latency in _LATENCIES_S]
    start = min(starts, key=lambda values: float(np.abs(residual(values)).sum()))
    for _ in range(2):  # again, with what the readings' dates are worth
        found = least_squares(
            residual,
            start,
            bounds=([-0.05, 1e-3, 0.01, _NO_LIMIT], [0.5, 1.0, 3.0, 10.0]),
            x_scale=[0.01, 0.01, 0.1, 0.01],
            loss="soft_l1",
            f_scale=_SOFT,
            jac="3-point",
            diff_step=[1e-4] * 4,
        )
        start, motor = found.x, Motor(*found.x.tolist())
        speed = np.abs(respond(motor, sent_s, sent, joints_s)[1])
        fast = speed > _FAST_RAD_S
        late_s = np.abs(sigma * residual(found.x))[fast] / speed[fast]
        dated_s = 1.4826 * float(np.median(late_s)) if fast.any() else 0.0
        sigma = np.hypot(rounded, dated_s * speed)
    without = residual(np.array(motor._replace(per_acceleration=_NO_LIMIT)))
    square = float(np.mean(residual(found.x) ** 2))
    worse = (float(np.sum(without**2)) / square - len(without)) > _WORSE
    covariance = clustered(np.asarray(found.jac), found.fun, stretches, _SOFT)
    times = np.arange(joints_s[0], joints_s[-1], 0.002)
    speeds = respond(motor, sent_s, sent, times)[1]
    deviations = np.sqrt(np.diagonal(covariance))
    return JointFit(
        motor=motor,
        sigma=Motor(*deviations.tolist()),
        correlation=float(covariance[0, 1] / (deviations[0] * deviations[1])),
        greatest_rad_s2=float(np.abs(np.diff(speeds)).max() / 0.002),
        residual_rad=float(np.sqrt(np.mean((sigma * residual(found.x)) ** 2))),
        limited=worse,
    )


class _Straight:
    """Straight lines through each stretch of some values, which a drift makes."""

    def __init__(self, times: FloatArray, stretches: IntArray) -> None:
        self._stretches = stretches
        self._counts = np.maximum(np.bincount(stretches), 1)
        self._times = times - self._mean(times)[stretches]
        self._squares = np.maximum(np.bincount(stretches, self._times**2), 1e-12)

    def _mean(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self._stretches, values) / self._counts)

    def without(self, values: FloatArray) -> FloatArray:
        """Values without their lines."""
        slopes = np.bincount(self._stretches, values * self._times) / self._squares
        lines = self._mean(values)[self._stretches] + slopes[self._stretches] * self._times
        return np.asarray(values - lines)


def clustered(
    jacobian: FloatArray, residual: FloatArray, stretches: IntArray, soft: float, known: int = 0
) -> FloatArray:
    """The covariance of a least-squares estimate whose residuals depend on their neighbours.

    The jackknife over stretches, from the estimate's linear change without each of them: CR3 of
    Bell and McCaffrey, Survey Methodology 28, 2002, which a few telling stretches bias less than
    the sandwich estimator.

    Args:
        jacobian: (m, p) of `least_squares` with the loss `soft_l1`, which has scaled it.
        residual: (m,) of the same, which it has not.
        stretches: (m - known,) whole numbers.
        soft: its `f_scale`.
        known: how many residuals, the last ones, are what was known before, of deviation 1.

    Returns:
        (p, p).
    """
    whole, measured = jacobian.T @ jacobian, len(residual) - known
    scaled = residual * (1.0 + (residual / soft) ** 2) ** 0.25
    changes = []
    for stretch in np.unique(stretches):
        rows = np.flatnonzero(stretches == stretch)
        part, score = jacobian[rows], jacobian[rows].T @ scaled[rows]
        changes.append(np.linalg.pinv(whole - part.T @ part, hermitian=True) @ score)
    found = (1.0 - 1.0 / len(changes)) * np.transpose(changes) @ np.array(changes)
    before = jacobian[measured:] @ np.linalg.pinv(whole, hermitian=True)
    found += before.T @ before
    # a direction that nothing depends on is not known, and pinv has it known exactly
    blind = np.diagonal(whole) < 1e-6
    found[blind, blind] = np.inf
    return np.asarray(found)


def path_of(
    motor: Motor,
    sent_s: FloatArray,
    sent: FloatArray,
    joints_s: FloatArray,
    angles: FloatArray,
) -> Callable[[FloatArray], FloatArray]:
    """The actuator's way as the encoder tells it, between its readings too.

    Args:
        motor: what moves it.
        sent_s: see `fit_joint`, as for the following.
        sent: rad/s.
        joints_s: s.
        angles: rad.

    Returns:
        Gives angles, rad, at growing times, s.
    """
    gap = angles - respond(motor, sent_s, sent, joints_s)[0]
    rate_hz = (len(joints_s) - 1) / (joints_s[-1] - joints_s[0])
    width = max(3, round(0.5 * STRETCH_S * rate_hz))
    kernel = np.ones(width)
    smooth = np.convolve(gap, kernel, "same") / np.convolve(np.ones_like(gap), kernel, "same")

    def path(times: FloatArray) -> FloatArray:
        angle = respond(motor, sent_s, sent, times)[0]
        return np.asarray(angle + np.interp(times, joints_s, smooth))

    return path
