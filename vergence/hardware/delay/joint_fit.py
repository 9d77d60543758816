"""Fit of an actuator's response to its commands, from its encoder: a lag after a latency.

    dv/dt = clip((g u(t - d) - v) / lag, -a, a),   dq/dt = v

is integrated with the commands as they were sent, and its angle is compared with the encoder's. A
linear drift over each second, as the integral of speeds has one, is removed from the residuals.
Where a motor with friction, see `FittedMotor`, fits clearly better, its values are taken.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from vergence.envs.streams import IntArray
from vergence.kernels import compiled
from vergence.models.parts import FloatArray

_STEP_S: Final = 1e-3
"""Integration step, s: a tenth of a short lag, which is exact but at the limits (numerical)."""


class FittedMotor(NamedTuple):
    """The model of a motor that is fitted: a velocity PI, its limits, and friction.

    With the velocity v, the goal u = g times the command after a latency, and the error e = u - v,

        dv/dt = clip(d - b v, -a, a) - l - friction
        d = clip((e + r I) / lag, -c a, c a),   dI/dt = e

    Friction opposes the motion by f; at rest it holds up to s f. The integral stops where the drive
    is at its limit c a and e would raise it. With r = b, friction and limits aside, this is a lag,
    and friction acts until the integral has made up for it, for 1 / r.
    """

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
    """(m,) angles, rad, and speeds, rad/s, at increasing times, of a motor at rest at first."""
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


CLUSTER_S: Final = 1.0
"""Length of clusters in which drift is removed and residuals count as dependent, s (chosen)."""
_QUANTISATION_SIGMA: Final = 12.0**-0.5
"""Standard deviation of a quantised number per quantisation step (numerical)."""
_START_LATENCIES_S: Final = (0.0, 0.02, 0.05, 0.1)
"""Start values of the latency, s (numerical)."""
_ROUGH: Final = np.array([-0.5, 1.0, -0.5])
"""Difference of a residual from its neighbours' mean (numerical)."""
_MIN_DELAY_SPEED_RAD_S: Final = 0.5
"""Speed above which an angle's residual shows the error of its time, rad/s (chosen)."""
_LOSS_SCALE: Final = 3.0
"""Scale of the robust loss, in standard deviations: larger residuals count linearly (chosen)."""
_MAX_RELATIVE_SIGMA: Final = 0.15
"""Greatest relative standard deviation of a reported friction or acceleration limit (chosen)."""
_MIN_CHI2_INCREASE: Final = 50.0
"""Least increase of the sum of squared residuals without an acceleration limit, in mean squares,
for which a limit is accepted (chosen)."""
_LAG: Final = (0, 1, 2, 3)
"""Parameters of a lag with an acceleration limit (numerical)."""
_MOTOR: Final = tuple(range(len(FittedMotor._fields)))
"""Parameters of a motor with friction (numerical)."""
_BOUNDS: Final = (
    (-0.05, 0.5, 0.003), (1e-3, 1.0, 0.003), (0.01, 3.0, 0.02), (1e-4, 10.0, 0.003),
    (0.0, 100.0, 0.5), (0.0, 100.0, 3.0), (0.0, 100.0, 3.0), (-30.0, 30.0, 1.0),
    (1.0, 3.0, 0.15), (1.0, 5.0, 0.2),
)  # fmt: skip
"""Least and greatest value, and typical change, of each parameter (numerical)."""
_PRIORS: Final = ((7, 0.0, 5.0), (8, 1.5, 0.3), (9, 1.5, 0.5))
"""Parameters that some motions do not show: index, plausible value, standard deviation (chosen)."""
_EMF_PRIOR_SIGMA: Final = 30.0
"""Standard deviation of the difference of the integral's and the motor's rate, 1/s (chosen)."""
_OFFSET: Final = 100.0
"""Offset of the fit's variables, whose differences are relative to them (numerical)."""
_SEARCHED: Final = (
    (1e-3, 0.05), (0.008, 0.08), (0.85, 1.15), (1 / 180, 1 / 20), (0.1, 12.0), (4.0, 50.0),
    (4.0, 50.0), (0.01, 0.02), (1.0, 2.0), (1.0, 2.0),
)  # fmt: skip
"""Least and greatest start value of each parameter (chosen: of plausible servos)."""
_DRAWN: Final = 300
_DRAWN_AGAIN: Final = 150
_KEPT: Final = 25
_SEARCH_ROUNDS: Final = 6
_SEARCHES: Final = 4
"""Numbers of first draws of a search, of draws in each further round and of the best draws about
which they are, of these rounds, and of searches, of which the best counts (numerical)."""
_ALIKE: Final = 1.15
"""Misfit per the least one with which a search's end is as good as the best (chosen)."""
_FEW_EVALUATIONS: Final = 12
"""Evaluations of the improvement of one search (numerical)."""
_EVALUATIONS: Final = 30
"""Evaluations of a fit at most (numerical)."""
_MISFIT_FREEDOM: Final = 10.0
"""Number of independent motions of which a misfit is taken to consist (measured:
benchmarks.delay)."""
_MOST_SQUARE: Final = 100.0
"""Squared residual, in variances, that counts at most in a misfit: a pause of the machine is none
(chosen)."""
_CHANCE: Final = 9.0
"""Part of a misfit that a parameter may explain by chance, in such motions: three standard
deviations (chosen)."""
_MOST_MISFIT_RAD: Final = 0.015
"""Residual that counts at most, where starts are compared, rad (numerical)."""
_NO_LIMIT_INVERSE: Final = 1e-4
"""Inverse acceleration that stands for no limit, s^2/rad (numerical)."""

_SMOOTHING_READINGS: Final = (0.25, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 13.0)
"""Widths of smoothing to choose from, in readings: from none to half a second (numerical)."""


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Fitted response of an actuator to its commands."""

    motor: FittedMotor
    sigma: FittedMotor
    """Standard deviations of the parameters."""
    peak_acceleration_rad_s2: float
    """Greatest acceleration of the modelled motion, rad/s^2."""
    lag_s: float
    """Lag of the response without friction: of the nearest lag behind the latency, s."""
    lag_sigma_s: float
    """Its standard deviation, with its difference from the motor's own, s."""
    misfit_rad: float
    """Rms difference of the encoder's angles from the model's, and of that without friction and
    limits from the nearest lag's, rad."""
    acceleration_limited: bool
    """True if a motor without an acceleration limit would fit clearly worse."""
    latency_lag_correlation: float
    """Correlation of the errors of latency and lag."""

    @property
    def acceleration_rad_s2(self) -> float | None:
        """Acceleration limit of the motor, rad/s^2; None if it was not reached."""
        inverse, sigma = self.motor.inverse_acceleration, self.sigma.inverse_acceleration
        certain = self.acceleration_limited and sigma < _MAX_RELATIVE_SIGMA * inverse
        return 1.0 / inverse if certain else None

    @property
    def friction_ratio(self) -> float | None:
        """Coulomb friction per greatest torque; None if one of them is uncertain or none."""
        friction, sigma = self.motor.friction_rad_s2, self.sigma.friction_rad_s2
        certain = friction > 0.0 and sigma < _MAX_RELATIVE_SIGMA * friction
        return friction / self.acceleration_rad_s2 if certain and self.acceleration_rad_s2 else None

    @property
    def acceleration_sigma(self) -> float:
        """Standard deviation of the acceleration limit, rad/s^2."""
        return self.sigma.inverse_acceleration / self.motor.inverse_acceleration**2


def fit_joint(
    sent_s: FloatArray,
    commands: FloatArray,
    joints_s: FloatArray,
    angles: FloatArray,
    guess: FittedMotor,
    encoder_step_rad: float,
) -> JointFit:
    """Fit the response of an actuator by robust least squares.

    Its uncertainty counts residuals within a second as dependent.

    Args:
        sent_s: (n,) times at which the commands were sent, s.
        commands: (n,) commands, rad/s.
        joints_s: (m,) times at which the encoder was read, s.
        angles: (m,) encoder angles, rad.
        guess: parameters of the head model, the start of the fit.
        encoder_step_rad: quantisation step of the encoder, rad.
    """
    data = _Data(sent_s, commands, joints_s, angles, max(encoder_step_rad, 4e-5))
    starts = [guess._replace(latency_s=latency) for latency in _START_LATENCIES_S]
    fit = data.fit(min(starts, key=data.misfit), _LAG)
    if fit.excess > _MIN_CHI2_INCREASE:
        found = [data.improved(data.search(seed)) for seed in range(_SEARCHES)]
        misfits = np.array([data.misfit(one) for one in found])
        with_friction = data.fit(found[int(misfits.argmin())], _MOTOR)
        # searches end in different places that fit nearly alike
        alike = np.array(found)[misfits < _ALIKE * misfits.min()]
        spread = np.sqrt(np.mean((alike - with_friction.motor) ** 2, axis=0))
        with_friction = with_friction._replace(sigma=np.hypot(with_friction.sigma, spread))
        fit = with_friction if with_friction.explains(fit.motor) else fit
    motor = fit.motor
    lag_s, beside_rad = data.nearest_lag(motor)
    times = np.arange(joints_s[0], joints_s[-1], 0.002)
    speeds = simulate_motor(motor, sent_s, commands, times)[1]
    return JointFit(
        motor=motor,
        sigma=FittedMotor(*fit.sigma.tolist()),
        latency_lag_correlation=fit.correlation,
        peak_acceleration_rad_s2=float(np.abs(np.diff(speeds)).max() / 0.002),
        lag_s=lag_s,
        lag_sigma_s=float(np.hypot(fit.sigma[1], lag_s - motor.lag_s)),
        misfit_rad=float(np.hypot(np.sqrt(np.mean(data.residual(motor) ** 2)), beside_rad)),
        acceleration_limited=fit.explains(motor._replace(inverse_acceleration=_NO_LIMIT_INVERSE)),
    )


class _Fit(NamedTuple):
    data: "_Data"
    motor: FittedMotor
    sigma: FloatArray
    correlation: float
    weights: FloatArray
    excess: float
    """Sum of squared weighted residuals beside that of rounding and timing errors."""

    def explains(self, other: FittedMotor) -> bool:
        """True if the other motor fits clearly worse."""
        own, others = (
            np.sum((self.weights * self.data.residual(motor)) ** 2) for motor in (self.motor, other)
        )
        by_chance = _CHANCE * max(self.excess, 0.0) / _MISFIT_FREEDOM
        return bool(
            len(self.weights) * (others / own - 1.0) > _MIN_CHI2_INCREASE
            and others - own > by_chance
        )


class _Data:
    """Commands and readings of an actuator, see `fit_joint`."""

    def __init__(
        self, sent_s: FloatArray, commands: FloatArray, joints_s: FloatArray, angles: FloatArray,
        step_rad: float,
    ) -> None:  # fmt: skip
        self._recorded, self._angles = (sent_s, commands, joints_s), angles
        self._clusters = ((joints_s - joints_s[0]) / CLUSTER_S).astype(np.int64)
        self._counts = np.maximum(np.bincount(self._clusters), 1)
        self._own_s = joints_s - self._mean(joints_s)
        self._squares = np.maximum(np.bincount(self._clusters, self._own_s**2), 1e-12)
        self._rounded = _QUANTISATION_SIGMA * step_rad

    def _mean(self, values: FloatArray) -> FloatArray:
        return np.asarray((np.bincount(self._clusters, values) / self._counts)[self._clusters])

    def _detrended(self, values: FloatArray) -> FloatArray:
        """Subtract a fitted straight line from the values of each cluster."""
        slopes = np.bincount(self._clusters, values * self._own_s) / self._squares
        return np.asarray(values - (self._mean(values) + slopes[self._clusters] * self._own_s))

    def residual(self, motor: FittedMotor) -> FloatArray:
        """Angles beside the motor's without their drift, rad."""
        return self._detrended(self._angles - simulate_motor(motor, *self._recorded)[0])

    def misfit(self, motor: FittedMotor) -> float:
        """Robust sum of the residuals."""
        return float(np.minimum(np.abs(self.residual(motor)), _MOST_MISFIT_RAD).sum())

    def nearest_lag(self, motor: FittedMotor) -> tuple[float, float]:
        """Lag nearest to the motor without friction and limits, s, and the rms beside it, rad."""
        if not motor.integral_rate:
            return motor.lag_s, 0.0
        smooth = motor._replace(
            friction_rad_s2=0.0, load_rad_s2=0.0, inverse_acceleration=_NO_LIMIT_INVERSE
        )
        moved = simulate_motor(smooth, *self._recorded)[0]
        plain = FittedMotor(*smooth[: len(_LAG)])

        def beside_rad(lag_s: float) -> float:
            other = simulate_motor(plain._replace(lag_s=lag_s), *self._recorded)[0]
            return float(np.sqrt(np.mean(self._detrended(moved - other) ** 2)))

        found = minimize_scalar(beside_rad, bounds=_BOUNDS[1][:2], method="bounded")
        return float(found.x), float(found.fun)

    def search(self, seed: int) -> FittedMotor:
        """Search for a motor with friction: draw, keep the best, and draw again about them.

        A joint that sticks or does not makes the misfit too rough for derivatives alone.
        """
        rng = np.random.default_rng(seed)
        least, most = np.array(_BOUNDS).T[:2]
        low, high = np.array(_SEARCHED).T
        drawn = np.exp(rng.uniform(np.log(low), np.log(high), (_DRAWN, len(low))))
        drawn[:, 6] = drawn[:, 5]
        kept: list[tuple[float, ...]] = []
        for _ in range(_SEARCH_ROUNDS):
            tried = [(self.misfit(FittedMotor(*one)), *one) for one in drawn.tolist()]
            kept = sorted(kept + tried)[:_KEPT]
            best = np.array(kept)[:, 1:]
            drawn = rng.multivariate_normal(best.mean(axis=0), np.cov(best.T), _DRAWN_AGAIN)
            drawn = np.clip(drawn, least, most)
        return FittedMotor(*kept[0][1:])

    def improved(self, start: FittedMotor) -> FittedMotor:
        """Motor with friction from a start, with a few evaluations."""
        weights = np.full(len(self._angles), 1.0 / self._rounded)
        return self._once(start, _MOTOR, weights, _FEW_EVALUATIONS)[0]

    def fit(self, start: FittedMotor, free: Sequence[int]) -> _Fit:
        """Fit the free parameters."""
        weights, motor = np.full(len(self._angles), 1.0 / self._rounded), start
        for _ in range(2):  # again with the estimated timing error of the readings
            motor, found, columns = self._once(motor, free, weights, _EVALUATIONS)
            used = weights
            speed = np.abs(simulate_motor(motor, *self._recorded)[1])
            fast = speed > _MIN_DELAY_SPEED_RAD_S
            # beside its neighbours': a misfit changes slowly, timing errors do not
            rough = np.convolve(self.residual(motor), _ROUGH, "same") / np.linalg.norm(_ROUGH)
            timestamp_sigma_s = 0.0
            if fast.any():
                square = (1.4826 * float(np.median(np.abs(rough[fast])))) ** 2
                late_rad = float(np.sqrt(max(square - self._rounded**2, 0.0)))
                timestamp_sigma_s = late_rad / float(np.median(speed[fast]))
            weights = 1.0 / np.hypot(self._rounded, timestamp_sigma_s * speed)
        covariance = jackknife_covariance(
            np.asarray(found.jac), found.fun, self._clusters, _LOSS_SCALE, len(_PRIORS) + 1
        )
        # what the model does not have is alike in each second, which the jackknife does not see
        squares = np.minimum((used * self.residual(motor)) ** 2, _MOST_SQUARE)
        excess = float(np.sum(squares)) - len(used)
        alone = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)
        covariance += max(excess, 0.0) / _MISFIT_FREEDOM * alone
        sigma = np.zeros(len(motor))
        sigma[list(free)] = np.sqrt(np.diagonal(covariance)) * columns
        correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
        return _Fit(self, motor, sigma, float(correlation), used, excess)

    def _once(
        self, start: FittedMotor, free: Sequence[int], weights: FloatArray, evaluations: int
    ) -> tuple[FittedMotor, Any, FloatArray]:
        chosen = list(free)
        least, most, unit = np.array(_BOUNDS).T[:, chosen]

        def motor(values: FloatArray) -> FittedMotor:
            whole = np.array(start)
            whole[chosen] = np.clip(unit * (values - _OFFSET), least, most)
            return FittedMotor(*whole.tolist())

        def weighted_residual(values: FloatArray) -> FloatArray:
            found = motor(values)
            before = [(found[k] - value) / sigma for k, value, sigma in _PRIORS]
            before.append((found.emf_rate - found.integral_rate) / _EMF_PRIOR_SIGMA)
            return np.append(weights * self.residual(found), before)

        found = least_squares(
            weighted_residual, _OFFSET + np.clip(np.array(start)[chosen], least, most) / unit,
            bounds=(_OFFSET + least / unit, _OFFSET + most / unit), loss="soft_l1",
            f_scale=_LOSS_SCALE, jac="3-point", diff_step=[0.1 / _OFFSET] * len(unit),
            max_nfev=evaluations,
        )  # fmt: skip
        return motor(found.x), found, unit


def jackknife_covariance(
    jacobian: FloatArray, residual: FloatArray, clusters: IntArray, loss_scale: float,
    prior_count: int,
) -> FloatArray:  # fmt: skip
    """Covariance of a least-squares estimate whose residuals depend on their neighbours.

    It is the jackknife over clusters, from the linearised change of the estimate without each of
    them: CR3 of Bell and McCaffrey, Survey Methodology 28, 2002. If a few clusters carry most of
    the information it is less biased than the sandwich estimator.

    `jacobian`, (m, p), and `residual`, (m,), are those of `least_squares`, the former scaled by its
    loss `soft_l1` with `loss_scale`; the last `prior_count` residuals are priors with standard
    deviation 1, and `clusters` has the index of each other one's cluster.
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
    motor: FittedMotor, sent_s: FloatArray, commands: FloatArray, joints_s: FloatArray,
    angles: FloatArray,
) -> Callable[[FloatArray], FloatArray]:  # fmt: skip
    """Angle of the actuator by increasing times: the model, corrected by smoothed residuals.

    A poor model is corrected at each reading, a good one over many: the width of the smoothing is
    the one that best predicts each reading from the others. For the readings see `fit_joint`.
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
