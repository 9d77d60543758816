r"""Present angle and velocity of each actuator: a Kalman filter on the measured angles.

Between two readings the filter predicts an actuator's motion from its commands
(`vergence.controllers.prediction.response`); the process noise is a fraction of the acceleration
that the commands in transit demand. A measured angle is exact except for encoder quantisation: an
innovation within the resolution counts as zero. The velocity that a servo reports is a soft
measurement, because servos low-pass filter it and drivers take differences of angles, so that it is
older than the angle in the same reading. Its delay D is found on line. After a motion has started,
the angle is ahead of the integrated velocity by D times the velocity,

    q(t) - q(t_0) - \int_{t_0}^{t} w dt' = D (w(t) - w(t_0)),

exactly for a first-order filter with the time constant D, whatever the motion, and for any other
filter of that mean delay once the acceleration has been constant for a while. The measurement
variance of a velocity grows with the uncertainty of D and with the acceleration. A head whose
velocities are differences of angles has a long D; one whose velocities mean nothing has a D that
does not explain the readings.
"""

from math import exp, sqrt
from typing import Annotated, Final

from vergence.controllers.prediction.joints import PredictorParameters, clip_to_quantisation
from vergence.controllers.prediction.response import (
    ResponseIdentification,
    command_at,
    max_response_latency,
    selected_model,
)
from vergence.kernels import inlined
from vergence.models.motion import lag_decay
from vergence.models.parts import FloatArray

_ACCELERATION_SHARE: Final = 0.1
"""Relative error of the acceleration predicted by a known response (chosen)."""
_DISTURBANCE_SD_RAD_S: Final = 0.005
"""Change of velocity per period without a command, standard deviation, rad/s (chosen)."""
_ANGLE_SD_STEPS: Final = 0.3
"""Standard deviation of an angle, as a fraction of the encoder's resolution (chosen: uniform
quantisation error)."""
_ANGLE_SD_RAD: Final = 1e-5
"""Standard deviation of an angle in addition, rad (chosen)."""
_SPEED_SD_STEPS: Final = 0.3
"""Standard deviation of a velocity, as a fraction of its resolution (chosen: uniform quantisation
error)."""
_SPEED_SD_RAD_S: Final = 0.002
"""Standard deviation of a velocity in addition, rad/s (chosen)."""
_RELATIVE_SPEED_SD: Final = 0.01
"""Standard deviation of a velocity in addition, as a fraction of it (chosen)."""
_RELATIVE_DELAY_SD: Final = 0.3
"""Deviation of a velocity filter from first order, as a fraction of its delay (chosen)."""
_DELAY_SD_S: Final = 0.02
"""Prior standard deviation of the velocities' delay, s (chosen)."""
_MAX_PROMPT_DELAY_S: Final = 0.003
"""Delay below which velocities count as prompt, s (chosen)."""
_MAX_EXPLAINED_MISFIT: Final = 10.0
"""Misfit up to which the delay explains the velocities (chosen)."""
_MAX_VELOCITY_DELAY_S: Final = 0.2
"""Longest delay of velocities, s (chosen)."""
_MAX_COMPARISON_S: Final = 0.25
"""Longest interval over which angles and integrated velocities are compared, s (chosen)."""
_INFORMATIVE_RAD_S: Final = 0.1
"""Changes of velocity below this carry no evidence on the delay, rad/s (chosen)."""
_RELATIVE_TRAVEL_SD: Final = 0.02
"""Relative error of the integrated velocity (chosen)."""
_INFORMATION_DECAY: Final = 0.995
"""Per-reading decay of the information on the delay (chosen: noise against adaptation)."""
_MAX_SPEED_RATIO: Final = 3.0
"""Bound of the estimated velocity, as a ratio to the largest command (chosen)."""
_MISFIT_WEIGHT: Final = 0.1
"""Weight of a reading in the running mean of the misfit (chosen)."""
_MAX_SQUARED_RESIDUAL: Final = 100.0
"""Bound of a single squared normalised residual in that mean (chosen)."""


class ActuatorObserver:
    """State of the filter: covariances of the actuators, and the delay of their velocities."""

    covariance: Annotated[FloatArray, 4, 3]
    """Covariance of an actuator's angle and velocity: angle variance, cross term, velocity
    variance."""
    expected_velocity: Annotated[FloatArray, 4]
    """Velocity that the servo is expected to report, rad/s."""
    recent_acceleration: Annotated[FloatArray, 4]
    """Recent magnitude of the acceleration, rad/s^2."""
    last_velocity: Annotated[FloatArray, 4]
    """Last measured velocity, rad/s."""
    first_angle: Annotated[FloatArray, 4]
    """Measured angle at the start of the comparison, rad."""
    first_velocity: Annotated[FloatArray, 4]
    """Measured velocity at the start of the comparison, rad/s."""
    integrated_velocity: Annotated[FloatArray, 4]
    """Integral of the measured velocity since then, rad."""
    compared_periods: Annotated[FloatArray, 4]
    """Periods since then."""
    information: float
    """Fisher information on the delay of the velocities, 1/s^2."""
    delay_times_information: float
    """Information times the delay, 1/s."""
    delay_s: float
    """Delay of velocities behind angles, s."""
    misfit: float
    """Running mean of the squared normalised residual that the delay leaves."""


@inlined
def begin_delay_comparison(observer: ActuatorObserver, j: int, angle: float, rate: float) -> None:
    """Start comparing the angles and the velocities of an actuator."""
    observer.first_angle[j], observer.first_velocity[j] = angle, rate
    observer.integrated_velocity[j] = observer.compared_periods[j] = 0.0
    observer.last_velocity[j] = rate


@inlined
def _delay_sd(observer: ActuatorObserver) -> float:
    return sqrt(1.0 / (observer.information + 1.0 / _DELAY_SD_S**2))


@inlined
def _update_delay(
    observer: ActuatorObserver, params: PredictorParameters, j: int, angle: float, rate: float
) -> None:
    """Update the delay of the velocities with a reading."""
    period = params.period_s
    observer.integrated_velocity[j] += 0.5 * period * (rate + observer.last_velocity[j])
    observer.compared_periods[j] += 1.0
    observer.last_velocity[j] = rate
    travel = angle - observer.first_angle[j]
    change = rate - observer.first_velocity[j]
    ahead = travel - observer.integrated_velocity[j]
    steps = 0.4 * params.angle_step[j] + 0.3 * period * params.speed_step[j] * sqrt(
        observer.compared_periods[j]
    )
    share = _RELATIVE_TRAVEL_SD * travel
    variance = steps * steps + share * share + _ANGLE_SD_RAD * _ANGLE_SD_RAD
    if abs(change) > _INFORMATIVE_RAD_S:
        weight = 0.25 / variance  # successive readings have correlated errors
        observer.information = _INFORMATION_DECAY * observer.information + weight * change * change
        observer.delay_times_information = (
            _INFORMATION_DECAY * observer.delay_times_information + weight * change * ahead
        )
    if abs(travel) > 4.0 * (steps + _ANGLE_SD_RAD):
        off = ahead - observer.delay_s * change
        square = min(off * off / variance, _MAX_SQUARED_RESIDUAL)
        observer.misfit += _MISFIT_WEIGHT * (square - observer.misfit)
    delay_s = observer.delay_times_information * _delay_sd(observer) ** 2
    observer.delay_s = min(max(delay_s, 0.0), _MAX_VELOCITY_DELAY_S)
    at_rest = rate == 0.0 and abs(travel - observer.integrated_velocity[j]) <= params.angle_step[j]
    if at_rest or observer.compared_periods[j] * period > _MAX_COMPARISON_S:
        begin_delay_comparison(observer, j, angle, rate)


@inlined
def no_velocity_delay_found(observer: ActuatorObserver) -> bool:
    """True if no evidence says that velocities are read with a delay."""
    return observer.delay_s < _MAX_PROMPT_DELAY_S and observer.misfit < _MAX_EXPLAINED_MISFIT


@inlined
def _relative_acceleration_sd(response: ResponseIdentification, period: float) -> float:
    """Relative standard deviation of an actuator's predicted acceleration."""
    model = selected_model(response)
    v = model.variance
    square = _ACCELERATION_SHARE * _ACCELERATION_SHARE * max(model.misfit, 1.0)
    square += max(v[0], 0.0) / (period * period) + max(v[1], 0.0) + max(v[2], 0.0)
    return min(sqrt(square), 1.0)


@inlined
def update_observer(
    observer: ActuatorObserver,
    response: ResponseIdentification,
    params: PredictorParameters,
    tick: int,
    j: int,
    velocity_before: float,
    predicted_angle: float,
    predicted_velocity: float,
    measured_angle: float,
    measured_velocity: float,
) -> tuple[float, float]:
    """Update the angle and velocity of an actuator with its reading.

    Args:
        observer: changed in place.
        response: model of the actuators' response.
        params: the head's parameters.
        tick: the period that has ended.
        j: index of the actuator.
        velocity_before: its velocity at the start of the period, rad/s.
        predicted_angle: its angle predicted from the commands, rad.
        predicted_velocity: its velocity predicted from the commands, rad/s.
        measured_angle: the measured angle, rad.
        measured_velocity: the measured velocity, rad/s.

    Returns:
        The angle, within the resolution about the reading, rad, and the velocity, rad/s.
    """
    period, c, model = params.period_s, observer.covariance[j], selected_model(response)
    lag = params.lag_ratio[j] * exp(model.parameters[2])
    late_s = model.parameters[0] + 2.0 * sqrt(max(model.variance[0], 0.0))
    asked, gain = 0.0, exp(model.log_gain[j])
    for i in range(int(min(late_s, max_response_latency(params)) / period) + 2):
        asked = max(asked, abs(gain * command_at(response, tick - i, j) - predicted_velocity))
    most = params.acceleration_limit[j] * exp(
        model.parameters[1] + sqrt(max(model.variance[1], 0.0))
    )
    sd = _relative_acceleration_sd(response, period) * period * min(most, asked / lag)
    noise = sd * sd + _DISTURBANCE_SD_RAD_S * _DISTURBANCE_SD_RAD_S
    left = lag_decay(period, lag)
    c[0] += period * (2.0 * c[1] + period * (c[2] + noise / 3.0))
    c[1] = left * (c[1] + period * c[2]) + 0.5 * period * noise
    c[2] = left * left * c[2] + noise
    step = _ANGLE_SD_STEPS * params.angle_step[j]
    innovation_variance = c[0] + step * step + _ANGLE_SD_RAD * _ANGLE_SD_RAD
    innovation = (
        clip_to_quantisation(predicted_angle, measured_angle, params.angle_step[j])
        - predicted_angle
    )
    k, kv = c[0] / innovation_variance, c[1] / innovation_variance
    predicted_angle, predicted_velocity = (
        predicted_angle + k * innovation,
        predicted_velocity + kv * innovation,
    )
    c[2] -= kv * c[1]
    c[1] *= 1.0 - k
    c[0] *= 1.0 - k
    _update_delay(observer, params, j, measured_angle, measured_velocity)
    # measurement update with the reported velocity
    delay = observer.delay_s
    taken = 1.0 - lag_decay(period, delay)
    expected = observer.expected_velocity[j] + taken * (
        predicted_velocity - observer.expected_velocity[j]
    )
    acceleration = abs(predicted_velocity - velocity_before) / period
    observer.recent_acceleration[j] = max(0.8 * observer.recent_acceleration[j], acceleration)
    delay_sd = _delay_sd(observer) + _RELATIVE_DELAY_SD * delay
    speed_sd = (
        _SPEED_SD_STEPS * params.speed_step[j]
        + _SPEED_SD_RAD_S
        + _RELATIVE_SPEED_SD * abs(predicted_velocity)
    )
    speed_sd += observer.recent_acceleration[j] * delay_sd
    innovation_variance = c[2] + speed_sd * speed_sd * max(observer.misfit, 1.0)
    innovation = clip_to_quantisation(expected, measured_velocity, params.speed_step[j]) - expected
    # Cauchy weight: outliers count for little
    innovation_variance += innovation * innovation / 9.0
    k, kv = c[1] / innovation_variance, c[2] / innovation_variance
    predicted_angle, predicted_velocity = (
        predicted_angle + k * innovation,
        predicted_velocity + kv * innovation,
    )
    c[0] -= k * c[1]
    c[1] *= 1.0 - kv
    c[2] *= 1.0 - kv
    observer.expected_velocity[j] = expected + kv * innovation
    # bound the effect of a corrupted packet
    fastest = _MAX_SPEED_RATIO * params.speed_limit[j]
    return clip_to_quantisation(predicted_angle, measured_angle, params.angle_step[j]), min(
        max(predicted_velocity, -fastest), fastest
    )
