r"""The predictor's state of one head, and the update of its part on the joints.

Arrays (2, 2) are by eye and joint (first, second); arrays of four by actuator of the eyes. Times
are on the clock of the joint readings.

A Kalman filter on the measured angles estimates the present angle and velocity of each actuator.
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
variance of a velocity grows with the uncertainty of D and with the acceleration. Velocities that
mean nothing have a D that does not explain the readings.
"""

from math import exp, sqrt
from typing import Annotated, Final

import numpy as np

from vergence.controllers.prediction.delay import (
    HYPOTHESES,
    first_hypothesis_delay,
    prior_delay_costs,
)
from vergence.controllers.prediction.motion_models import MODELS, MODES, TargetMotion
from vergence.controllers.prediction.oscillation import (
    INITIAL_DECAY_TIME_S,
    FrictionState,
    OscillationState,
    reset_oscillation,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    RING_LENGTH,
    PredictorParameters,
    clip_to_quantisation,
)
from vergence.controllers.prediction.response import (
    ResponseIdentification,
    Rings,
    initial_response_models,
    learn_response,
    quantise_with_dead_zone,
    ring_at,
    selected_model,
    simulate_period,
)
from vergence.envs.observation import AGE_S
from vergence.kernels import inlined, row_layout, row_size
from vergence.models.kinematics import (
    PackedHead,
    eye_actuator_angle,
    eye_actuator_velocity,
    eye_joint_angle,
    has_motor_per_joint,
)
from vergence.models.motion import lag_decay
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import DEFAULT_DEPTH_M

_ACCELERATION_SHARE: Final = 0.1
"""Relative error of the acceleration predicted by a known response (chosen)."""
_DISTURBANCE_SD_RAD_S: Final = 0.005
"""Change of velocity per period without a command, standard deviation, rad/s (chosen)."""
_QUANTISATION_SD: Final = 0.3
"""Standard deviation of a reading per resolution (chosen: uniform quantisation error)."""
_ANGLE_SD_RAD: Final = 1e-5  # standard deviation of an angle in addition, rad (chosen)
_SPEED_SD_RAD_S: Final = 0.002  # standard deviation of a velocity in addition, rad/s (chosen)
_RELATIVE_SPEED_SD: Final = 0.01
"""Standard deviation of a velocity in addition, as a fraction of it (chosen)."""
_RELATIVE_DELAY_SD: Final = 0.3
"""Deviation of a velocity filter from first order, as a fraction of its delay (chosen)."""
_DELAY_SD_S: Final = 0.02  # prior standard deviation of the velocities' delay, s (chosen)
_MAX_PROMPT_DELAY_S: Final = 0.003  # delay below which velocities count as prompt, s (chosen)
_MAX_EXPLAINED_MISFIT: Final = 10.0  # misfit up to which the delay explains the velocities (chosen)
_MAX_VELOCITY_DELAY_S: Final = 0.2  # longest delay of velocities, s (chosen)
_MAX_COMPARISON_S: Final = 0.25
"""Longest interval over which angles and integrated velocities are compared, s (chosen)."""
_INFORMATIVE_RAD_S: Final = 0.1
"""Changes of velocity below this carry no evidence on the delay, rad/s (chosen)."""
_RELATIVE_TRAVEL_SD: Final = 0.02  # relative error of the integrated velocity (chosen)
_INFORMATION_DECAY: Final = 0.995
"""Per-reading decay of the information on the delay (chosen: noise against adaptation)."""
_MAX_SPEED_RATIO: Final = 3.0
"""Bound of the estimated velocity, as a ratio to the largest command (chosen)."""
_MISFIT_WEIGHT: Final = 0.1  # weight of a reading in the running mean of the misfit (chosen)
_MAX_SQUARED_RESIDUAL: Final = 100.0
"""Bound of a single squared normalised residual in that mean (chosen)."""


class ActuatorObserver:
    """Filter of the actuators' angles and velocities (rad, rad/s), and the velocities' delay."""

    covariance: Annotated[FloatArray, 4, 3]  # angle variance, cross term, velocity variance
    expected_velocity: Annotated[FloatArray, 4]  # that the servo is expected to report, rad/s
    recent_acceleration: Annotated[FloatArray, 4]  # recent magnitude of the acceleration, rad/s^2
    last_velocity: Annotated[FloatArray, 4]  # last measured velocity, rad/s
    first_angle: Annotated[FloatArray, 4]  # measured at the start of the comparison, rad
    first_velocity: Annotated[FloatArray, 4]  # measured at the start of the comparison, rad/s
    integrated_velocity: Annotated[FloatArray, 4]  # integral of measured velocity since then, rad
    compared_periods: Annotated[FloatArray, 4]  # periods since then
    information: float  # Fisher information on the delay of the velocities, 1/s^2
    delay_times_information: float  # information times the delay, 1/s
    delay_s: float  # delay of velocities behind angles, s
    misfit: float  # running mean of the squared normalised residual that the delay leaves


@inlined
def _begin_delay_comparison(observer: ActuatorObserver, j: int, angle: float, rate: float) -> None:
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
    periods, share = observer.compared_periods[j], _RELATIVE_TRAVEL_SD * travel
    steps = 0.4 * params.angle_step[j] + 0.3 * period * params.speed_step[j] * sqrt(periods)
    variance = steps * steps + share * share + _ANGLE_SD_RAD * _ANGLE_SD_RAD
    if abs(change) > _INFORMATIVE_RAD_S:
        weight = 0.25 / variance  # successive readings have correlated errors
        observer.information *= _INFORMATION_DECAY
        observer.information += weight * change * change
        observer.delay_times_information *= _INFORMATION_DECAY
        observer.delay_times_information += weight * change * ahead
    if abs(travel) > 4.0 * (steps + _ANGLE_SD_RAD):
        off = ahead - observer.delay_s * change
        square = min(off * off / variance, _MAX_SQUARED_RESIDUAL)
        observer.misfit += _MISFIT_WEIGHT * (square - observer.misfit)
    delay_s = observer.delay_times_information * _delay_sd(observer) ** 2
    observer.delay_s = min(max(delay_s, 0.0), _MAX_VELOCITY_DELAY_S)
    at_rest = rate == 0.0 and abs(travel - observer.integrated_velocity[j]) <= params.angle_step[j]
    if at_rest or observer.compared_periods[j] * period > _MAX_COMPARISON_S:
        _begin_delay_comparison(observer, j, angle, rate)


@inlined
def _relative_acceleration_sd(response: ResponseIdentification, period: float) -> float:
    """Relative standard deviation of an actuator's predicted acceleration."""
    model = selected_model(response)
    v, square = model.variance, _ACCELERATION_SHARE * _ACCELERATION_SHARE * max(model.misfit, 1.0)
    square += max(v[0], 0.0) / (period * period) + max(v[1], 0.0) + max(v[2], 0.0)
    return min(sqrt(square), 1.0)


@inlined
def _update_covariance(c: FloatArray, i: int, innovation_variance: float) -> tuple[float, float]:
    """Update with a measured angle (i = 0) or velocity (i = 2); return its gain and the other's."""
    gain, other = c[i] / innovation_variance, c[1] / innovation_variance
    c[2 - i] -= other * c[1]
    c[1] *= 1.0 - gain
    c[i] *= 1.0 - gain
    return gain, other


@inlined
def _update_observer(
    observer: ActuatorObserver, response: ResponseIdentification, rings: Rings,
    params: PredictorParameters, tick: int, j: int, velocity_before: float,
    angle: float, velocity: float, measured_angle: float, measured_velocity: float,
) -> tuple[float, float]:  # fmt: skip
    """Correct an actuator's predicted angle and velocity at the end of period `tick`, rad, rad/s.

    The angle returned lies within the resolution about its reading.
    """
    period, c, model = params.period_s, observer.covariance[j], selected_model(response)
    angle_step, speed_step = params.angle_step[j], params.speed_step[j]
    lag = params.lag_ratio[j] * exp(model.parameters[2])
    late_s = model.parameters[0] + 2.0 * sqrt(max(model.variance[0], 0.0))
    asked, gain = 0.0, exp(model.log_gain[j])
    for i in range(int(min(late_s, params.max_response_latency_s) / period) + 2):
        asked = max(asked, abs(gain * ring_at(rings.commands, tick - i, j) - velocity))
    most = exp(model.parameters[1] + sqrt(max(model.variance[1], 0.0)))
    most *= params.acceleration_limit[j]
    sd = _relative_acceleration_sd(response, period) * period * min(most, asked / lag)
    noise = sd * sd + _DISTURBANCE_SD_RAD_S * _DISTURBANCE_SD_RAD_S
    left = lag_decay(period, lag)
    c[0] += period * (2.0 * c[1] + period * (c[2] + noise / 3.0))
    c[1] = left * (c[1] + period * c[2]) + 0.5 * period * noise
    c[2] = left * left * c[2] + noise
    step = _QUANTISATION_SD * angle_step
    innovation_variance = c[0] + step * step + _ANGLE_SD_RAD * _ANGLE_SD_RAD
    innovation = clip_to_quantisation(angle, measured_angle, angle_step) - angle
    gain, other = _update_covariance(c, 0, innovation_variance)
    angle, velocity = angle + gain * innovation, velocity + other * innovation
    _update_delay(observer, params, j, measured_angle, measured_velocity)
    # measurement update with the reported velocity
    expected = observer.expected_velocity[j]
    expected += (1.0 - lag_decay(period, observer.delay_s)) * (velocity - expected)
    acceleration = abs(velocity - velocity_before) / period
    observer.recent_acceleration[j] = max(0.8 * observer.recent_acceleration[j], acceleration)
    delay_sd = _delay_sd(observer) + _RELATIVE_DELAY_SD * observer.delay_s
    speed_sd = _QUANTISATION_SD * speed_step + _SPEED_SD_RAD_S + _RELATIVE_SPEED_SD * abs(velocity)
    speed_sd += observer.recent_acceleration[j] * delay_sd
    innovation_variance = c[2] + speed_sd * speed_sd * max(observer.misfit, 1.0)
    innovation = clip_to_quantisation(expected, measured_velocity, speed_step) - expected
    # Cauchy weight: outliers count for little
    innovation_variance += innovation * innovation / 9.0
    gain, other = _update_covariance(c, 2, innovation_variance)
    angle, velocity = angle + other * innovation, velocity + gain * innovation
    observer.expected_velocity[j] = expected + gain * innovation
    # bound the effect of a corrupted packet
    fastest = _MAX_SPEED_RATIO * params.speed_limit[j]
    angle = clip_to_quantisation(angle, measured_angle, angle_step)
    return angle, min(max(velocity, -fastest), fastest)


_MAX_REST_SPEED: Final = 0.005
"""Actuator speed below which no delay in question moves the image by a pixel, rad/s (chosen)."""
_MIN_INITIAL_NOISE_PX: Final = 0.25
"""Least initial detection noise, standard deviation, px (chosen)."""


class PastImage:
    """An earlier image."""

    arrival_tick: float  # or its stamp if the camera stamps exposures, periods; negative for none
    goals: Annotated[FloatArray, 2, 2]  # that fixate its target, rad; nan where not seen
    angles_at_exposure: Annotated[FloatArray, 2, 2]  # from which the goals were computed, rad


class JointMotion:
    """Estimated motion of the actuators, and the past angles of the joints.

    The ring takes the angles every `sample_periods` periods: entry k at index k modulo its length.
    """

    actuator_angles: Annotated[FloatArray, 4]  # finer than the encoders' resolution, rad
    velocity: Annotated[FloatArray, 4]  # estimated actuator velocities, rad/s
    still_periods: float  # periods since an actuator last moved
    angles: Annotated[FloatArray, RING_LENGTH, 2, 2]  # ring of joint angles, rad


class BacklashState:
    """Backlash (play) found so far, see `inflate_variance_at_reversal`."""

    last_direction: Annotated[FloatArray, 4]  # sign of the last command to move, or 0
    reversal_tick: Annotated[FloatArray, 2, 2]  # period in which its actuator last reversed
    jump_sign: Annotated[FloatArray, 2, 2]  # sign of a goal's last jump after that, or 0
    variance: Annotated[FloatArray, 2, 2]  # variance that it adds to a measured goal, rad^2


class DelayState:
    """Delay of images behind joint readings, see `vergence.controllers.prediction.delay`."""

    first_s: float  # delay of hypothesis 0, s
    cost: Annotated[FloatArray, HYPOTHESES]  # accumulated cost of each delay hypothesis
    first_active: float  # index of the first delay hypothesis that is not ruled out
    end_active: float  # index one past the last of them
    mean_s: float  # mean delay: latency of images minus that of joint readings, s


class TargetState:
    """Where the target of each eye is, as the joint angles that fixate it."""

    goals_by_delay: Annotated[FloatArray, HYPOTHESES, 2, 2]  # goals at rest by delay, rad
    goals: Annotated[FloatArray, 2, 2]  # their mean over the delays, rad
    variance_over_delays: Annotated[FloatArray, 2, 2]  # their variance over the delays, rad^2
    filter_variance: Annotated[FloatArray, 2, 2]  # Kalman filter's, common to all delays, rad^2
    detection_variance: float  # detection variance, divided by the squared focal length, rad^2
    known: Annotated[FloatArray, 2]  # 1 if an eye's target is known, otherwise 0
    confirmations: Annotated[FloatArray, 2]  # number of images that have confirmed it
    displaced_image_count: Annotated[FloatArray, 2]  # last images that showed it at one other place
    displaced_goals: Annotated[FloatArray, 2, 2]  # goals of that displaced place, rad
    unseen_periods: Annotated[FloatArray, 2]  # since an image last showed an eye its target
    depth: Annotated[FloatArray, 2]  # depth at which each eye last saw its target, m
    fixated_depth: Annotated[FloatArray, 2]  # its depth once it is on the optical axis, m


class MotionState:
    """How the targets move, see `vergence.controllers.prediction.motion_models`."""

    models: Annotated[list[TargetMotion], 2, MODELS]  # target motion models, by eye and model
    switches: float  # switches of the target between rest and motion, counted with decay
    images: Annotated[list[PastImage], 2]  # the last image and the one before it
    tick: float  # time to which the models were predicted: exposure of the last image, in periods
    probabilities: Annotated[FloatArray, MODES]  # mode probabilities: rest, then each motion model


class EffectState:
    """Goals when the next command acts: angles (rad) and rates (rad/s) that fixate the targets."""

    goals: Annotated[FloatArray, 2, 2]  # at the time the next command begins to act
    rates: Annotated[FloatArray, 2, 2]  # rates of change at that time
    later_rates: Annotated[FloatArray, 2, 2]  # when it shows, a lag and half a period later


class PredictorState:
    """State of the predictor for one head, by what owns it."""

    periods: float  # periods since the first observation of the trial; -1 before it
    image_age_s: float  # age of the newest image, s, by which the next one is told
    response: ResponseIdentification
    observer: ActuatorObserver
    oscillation: OscillationState
    friction: FrictionState
    joints: JointMotion
    backlash: BacklashState
    delays: DelayState
    target: TargetState
    motion: MotionState
    effect: EffectState


PREDICTOR_STATE: Final = row_layout(PredictorState)
PREDICTOR_STATE_SIZE: Final = row_size(PREDICTOR_STATE)
"""Length of the packed state, before the `Rings`."""


def initial_predictor_row(
    params_row: FloatArray, stamped: bool, learn_delay: bool, learn_response: bool
) -> FloatArray:
    """A head's state before the first observation: `PREDICTOR_STATE`, then its rings."""
    params: PredictorParameters = params_row.view(PREDICTOR_PARAMETERS)[0]
    state = np.zeros(1, dtype=PREDICTOR_STATE)
    state["periods"] = state["response"]["window_begin"] = -1.0
    state["image_age_s"] = AGE_S
    models = initial_response_models(params.response_latency_s, params.lag_s, learn_response)
    for name, value in models.items():
        state["response"]["models"][name] = value
    state["oscillation"]["decay_time_s"] = INITIAL_DECAY_TIME_S
    state["motion"]["images"]["arrival_tick"] = state["backlash"]["reversal_tick"] = -1e9
    delays = state["delays"]
    delays["first_s"] = first_hypothesis_delay(params.nominal_delay_s)
    delays["cost"] = prior_delay_costs(params.nominal_delay_s, stamped, learn_delay)
    delays["end_active"] = HYPOTHESES
    delays["mean_s"] = params.nominal_delay_s
    noise_px = max(params.detection_noise_px, _MIN_INITIAL_NOISE_PX)
    state["target"]["detection_variance"] = (noise_px * params.pixel_rad) ** 2
    state["target"]["depth"] = DEFAULT_DEPTH_M
    rings = np.zeros(4 * int(params.command_ring + 2 * params.speed_ring))
    return np.concatenate([state.view(np.float64), rings])


@inlined
def rings_in(row: FloatArray, params: PredictorParameters) -> Rings:
    """Return the ring buffers behind the state in a head's row."""
    commands, speeds = int(params.command_ring), int(params.speed_ring)
    first = PREDICTOR_STATE_SIZE + 4 * commands
    between, last = first + 4 * speeds, first + 8 * speeds
    return Rings(
        row[PREDICTOR_STATE_SIZE:first].reshape(commands, 4),
        row[first:between].reshape(speeds, 4),
        row[between:last].reshape(speeds, 4),
    )


@inlined
def angle_at(
    state: PredictorState, params: PredictorParameters, tick: float, eye: int, joint: int
) -> float:
    """A joint's angle at a time in periods, by the cubic through the four stored ones about it."""
    angles, last = state.joints.angles, np.floor(state.periods / params.sample_periods)
    tick = min(max(tick / params.sample_periods, last - (RING_LENGTH - 4.0)), last)
    i = min(int(np.floor(tick)), int(last) - 2)
    s = tick - i
    a = angles[np.uintp((i - 1) & (RING_LENGTH - 1)), eye, joint]
    b = angles[np.uintp(i & (RING_LENGTH - 1)), eye, joint]
    c = angles[np.uintp((i + 1) & (RING_LENGTH - 1)), eye, joint]
    d = angles[np.uintp((i + 2) & (RING_LENGTH - 1)), eye, joint]
    near = (s + 1.0) * (s - 2.0)
    angle: float = (s * (s - 1.0) / 6.0) * ((s + 1.0) * d - (s - 2.0) * a)
    angle += 0.5 * near * ((s - 1.0) * b - s * c)
    return angle


@inlined
def update_joints(
    state: PredictorState, rings: Rings, params: PredictorParameters, p: PackedHead,
    positions: FloatArray, velocities: FloatArray, command: FloatArray, learn: bool,
) -> None:  # fmt: skip
    """Update the angles and the velocities with a period's readings, and the response if `learn`.

    Readings (7,) are by joint, rad and rad/s; commands (4,) what the actuators received, rad/s.
    """
    joints, response = state.joints, state.response
    state.periods += 1.0
    joints.still_periods += 1.0
    tick, direct, begins = int(state.periods), has_motor_per_joint(p), state.periods == 0.0
    model, observer = selected_model(response), state.observer
    prompt = observer.delay_s < _MAX_PROMPT_DELAY_S and observer.misfit < _MAX_EXPLAINED_MISFIT
    response.prompt_velocities = 1.0 if prompt else 0.0
    before = np.uintp((tick - 1) & (len(rings.commands) - 1))
    now = np.uintp(tick & (len(rings.speeds) - 1))
    for j in range(4):
        angle, rate = positions[3 + j], velocities[3 + j]
        if not direct:
            angle = eye_actuator_angle(p, j, positions[3:])
            rate = eye_actuator_velocity(p, j, velocities[3:])
        if begins:  # at rest
            joints.actuator_angles[j], joints.velocity[j] = angle, rate
            response.angles[j] = angle
            _begin_delay_comparison(observer, j, angle, rate)
            continue
        rings.commands[before, j] = quantise_with_dead_zone(params, command[j])
        q, v, w = joints.actuator_angles[j], joints.velocity[j], response.accelerations[j]
        ahead_q, ahead_v, w = simulate_period(rings, model, params, tick - 1, j, q, v, w)
        response.accelerations[j] = w
        q, v = _update_observer(
            observer, response, rings, params, tick - 1, j, v, ahead_q, ahead_v, angle, rate
        )
        joints.actuator_angles[j], joints.velocity[j] = q, v
        rings.mean_speeds[now, j] = (angle - response.angles[j]) / params.period_s
        rings.speeds[now, j] = rate if prompt else v
        response.angles[j] = angle
        if abs(v) > _MAX_REST_SPEED:
            joints.still_periods = 0.0
    every = int(params.sample_periods)
    slot = np.uintp(tick // every & (RING_LENGTH - 1))
    for j in range(4 if tick % every == 0 else 0):
        q = joints.actuator_angles[j]
        if not direct:
            q = eye_joint_angle(p, j, joints.actuator_angles)
        if begins:
            reset_oscillation(state.oscillation, j // 2, j % 2, q)
            joints.angles[:, j // 2, j % 2] = q
        joints.angles[slot, j // 2, j % 2] = q
    if learn and not begins:
        learn_response(response, rings, params, tick)
