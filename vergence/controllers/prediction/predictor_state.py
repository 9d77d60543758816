"""The predictor's state of one head, and the update of its part on the joints.

Arrays (2, 2) are by eye and joint (first, second); arrays of four by actuator of the eyes. Times
are on the clock of the joint readings.
"""

from typing import Annotated, Final

import numpy as np

from vergence.controllers.prediction.dating import (
    HYPOTHESES,
    first_hypothesis_delay,
    prior_delay_costs,
)
from vergence.controllers.prediction.fitting import learn_response
from vergence.controllers.prediction.friction import FrictionState
from vergence.controllers.prediction.joints import (
    PREDICTOR_PARAMETERS,
    RING_LENGTH,
    PredictorParameters,
)
from vergence.controllers.prediction.moving import MODELS, MODES, TargetMotion
from vergence.controllers.prediction.observer import (
    ActuatorObserver,
    begin_delay_comparison,
    no_velocity_delay_found,
    update_observer,
)
from vergence.controllers.prediction.oscillation import (
    INITIAL_DECAY_TIME_S,
    OscillationState,
    reset_oscillation,
)
from vergence.controllers.prediction.response import (
    COMMAND_RING_LENGTH,
    SPEED_RING_LENGTH,
    ResponseIdentification,
    initial_response_models,
    quantise_with_dead_zone,
    selected_model,
    simulate_period,
)
from vergence.controllers.rows import make_row, row_layout, row_size
from vergence.envs.observation import AGE_S
from vergence.kernels import inlined
from vergence.models.kinematics import (
    PackedHead,
    eye_actuator_angle,
    eye_actuator_velocity,
    eye_joint_angle,
    has_motor_per_joint,
)
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import DEFAULT_DEPTH_M

_MAX_REST_SPEED: Final = 0.005
"""Actuator speed below which no delay in question moves the image by a pixel, rad/s (chosen)."""
MIN_INITIAL_NOISE_PX: Final = 0.25
"""Least initial detection noise, standard deviation, px (chosen)."""


class PastImage:
    """An earlier image."""

    arrival_tick: float
    """Its arrival (its stamp if the camera stamps exposures), in periods; negative for none."""
    goals: Annotated[FloatArray, 2, 2]
    """Joint angles that fixate its target, rad; nan for an eye that did not see it."""
    angles_at_exposure: Annotated[FloatArray, 2, 2]
    """Joint angles at the exposure, from which the goals were computed, rad."""


class PredictorState:
    """State of the predictor for one head.

    It holds the estimated motion of the actuators, the delay hypotheses, the filtered goals (joint
    angles that fixate the targets), the targets' motion models, and the goals when the next command
    acts.
    """

    periods: float
    """Periods since the first observation of the trial; -1 before it."""
    image_age_s: float
    """Age of the newest image, s; the next period compares it to detect a new image."""
    response: ResponseIdentification
    observer: ActuatorObserver
    oscillation: OscillationState
    friction: FrictionState
    actuator_angles: Annotated[FloatArray, 4]
    """Estimated actuator angles, finer than the encoders' resolution, rad."""
    velocity: Annotated[FloatArray, 4]
    """Estimated actuator velocities, rad/s."""
    still_periods: float
    """Periods since an actuator last moved."""
    last_direction: Annotated[FloatArray, 4]
    """Sign of each actuator's last command to move: 1, -1, or 0 for none yet."""
    reversal_tick: Annotated[FloatArray, 2, 2]
    """Period in which an actuator of each joint last reversed its command."""
    jump_sign: Annotated[FloatArray, 2, 2]
    """Sign of a goal's last jump after such a reversal: 1, -1, or 0."""
    backlash_variance: Annotated[FloatArray, 2, 2]
    """Variance that the backlash found so far adds to a measured goal, rad^2."""
    angles: Annotated[FloatArray, RING_LENGTH, 2, 2]
    """Ring buffer of joint angles, one entry every `PredictorParameters.sample_periods` periods,
    rad; entry k is at index k modulo `RING_LENGTH`."""
    first_delay_s: float
    """Delay of hypothesis 0, s."""
    delay_cost: Annotated[FloatArray, HYPOTHESES]
    """Accumulated cost of each delay hypothesis, see `dating`."""
    first_active: float
    """Index of the first delay hypothesis that is not ruled out."""
    end_active: float
    """Index one past the last of them."""
    delay_s: float
    """Mean delay: latency of images minus that of joint readings, s."""
    goals_by_delay: Annotated[FloatArray, HYPOTHESES, 2, 2]
    """Filtered goals of a resting target under each delay: angles that fixate it, rad."""
    goals: Annotated[FloatArray, 2, 2]
    """Mean of these goals over the delays, rad."""
    goal_variance_over_delays: Annotated[FloatArray, 2, 2]
    """Variance of these goals over the delays, rad^2."""
    filter_variance: Annotated[FloatArray, 2, 2]
    """Variance of the Kalman filter of each goal, common to all delays, rad^2."""
    detection_variance: float
    """Detection variance, divided by the squared focal length, rad^2."""
    known: Annotated[FloatArray, 2]
    """1 if an eye's target is known, otherwise 0."""
    confirmations: Annotated[FloatArray, 2]
    """Number of images that have confirmed it."""
    displaced_image_count: Annotated[FloatArray, 2]
    """Number of successive images, up to the last one, that showed the target at one displaced
    position."""
    displaced_goals: Annotated[FloatArray, 2, 2]
    """Joint angles that fixate that displaced position, rad."""
    motions: Annotated[list[TargetMotion], 2, MODELS]
    """Target motion models, by eye and model."""
    mode_switches: float
    """Switches of the target between rest and motion, counted with decay."""
    images: Annotated[list[PastImage], 2]
    """The last image and the one before it."""
    motion_tick: float
    """Time to which the motion models were predicted: exposure of the last image, in periods."""
    mode_probabilities: Annotated[FloatArray, MODES]
    """Mode probabilities: rest, then each motion model."""
    goals_at_effect: Annotated[FloatArray, 2, 2]
    """Joint angles that fixate the targets at the time the next command acts, rad."""
    goal_rates: Annotated[FloatArray, 2, 2]
    """Rates of change of `goals_at_effect` at that time, rad/s."""
    goal_rates_at_effect: Annotated[FloatArray, 2, 2]
    """Rates of change when that command takes effect, a lag and half a period later,
    rad/s."""
    unseen_periods: Annotated[FloatArray, 2]
    """Periods since an image last showed each eye its target."""
    depth: Annotated[FloatArray, 2]
    """Depth at which each eye last saw its target, m."""
    fixated_depth: Annotated[FloatArray, 2]
    """Depth of each eye's target once it is on the optical axis, m."""


PREDICTOR_STATE: Final = row_layout(PredictorState)
PREDICTOR_STATE_SIZE: Final = row_size(PREDICTOR_STATE)
"""Length of the packed state."""


def initial_predictor_row(
    params_row: FloatArray, stamped: bool, learn_delay: bool, learn_response: bool
) -> FloatArray:
    """(SIZE,) state before the first observation.

    Args:
        params_row: packed `PredictorParameters`, see
            `vergence.controllers.prediction.joints.pack_predictor_parameters`.
        stamped: True if the camera stamps exposures.
        learn_delay: True to estimate the delay of images on line.
        learn_response: True to identify the actuators' response on line.
    """
    params: PredictorParameters = params_row.view(PREDICTOR_PARAMETERS)[0]
    response = np.zeros(1, dtype=PREDICTOR_STATE["response"])
    response["window_begin"] = -1.0
    for name, value in initial_response_models(
        params.response_latency_s, params.lag_s, learn_response
    ).items():
        response["models"][name] = value
    oscillation = np.zeros(1, dtype=PREDICTOR_STATE["oscillation"])
    oscillation["decay_time_s"] = INITIAL_DECAY_TIME_S
    images = np.zeros(2, dtype=PREDICTOR_STATE["images"].base)
    images["arrival_tick"] = -1e9
    return make_row(
        PREDICTOR_STATE,
        periods=-1.0,
        reversal_tick=-1e9,
        image_age_s=AGE_S,
        response=response,
        oscillation=oscillation,
        first_delay_s=first_hypothesis_delay(params.nominal_delay_s),
        delay_cost=prior_delay_costs(params.nominal_delay_s, stamped, learn_delay),
        end_active=HYPOTHESES,
        delay_s=params.nominal_delay_s,
        detection_variance=(max(params.detection_noise_px, MIN_INITIAL_NOISE_PX) * params.pixel_rad)
        ** 2,
        depth=DEFAULT_DEPTH_M,
        images=images,
    )


@inlined
def angle_at(
    state: PredictorState, sample_periods: float, tick: float, eye: int, joint: int
) -> float:
    """Interpolate a joint's angle at a time by the cubic through the four stored angles around it.

    Args:
        state: the predictor's state.
        sample_periods: see `PredictorParameters.sample_periods`.
        tick: the time, in periods.
        eye: index of the eye.
        joint: index of its joint.
    """
    last = np.floor(state.periods / sample_periods)
    tick = min(max(tick / sample_periods, last - (RING_LENGTH - 4.0)), last)
    i = min(int(np.floor(tick)), int(last) - 2)
    s = tick - i
    a = state.angles[np.uintp((i - 1) & (RING_LENGTH - 1)), eye, joint]
    b = state.angles[np.uintp(i & (RING_LENGTH - 1)), eye, joint]
    c = state.angles[np.uintp((i + 1) & (RING_LENGTH - 1)), eye, joint]
    d = state.angles[np.uintp((i + 2) & (RING_LENGTH - 1)), eye, joint]
    near = (s + 1.0) * (s - 2.0)
    angle: float = (s * (s - 1.0) / 6.0) * ((s + 1.0) * d - (s - 2.0) * a)
    angle += 0.5 * near * ((s - 1.0) * b - s * c)
    return angle


@inlined
def update_joints(
    state: PredictorState,
    params: PredictorParameters,
    p: PackedHead,
    positions: FloatArray,
    velocities: FloatArray,
    command: FloatArray,
    learn: bool,
) -> None:
    """Update the angles, the velocities and the response with a period's readings.

    Args:
        state: changed in place.
        params: the head's parameters.
        p: a packed head.
        positions: (7,) measured joint angles, rad.
        velocities: (7,) measured joint velocities, rad/s.
        command: (4,) velocity commands that the actuators received, rad/s.
        learn: True to identify the response.
    """
    state.periods += 1.0
    state.still_periods += 1.0
    tick, direct, begins = int(state.periods), has_motor_per_joint(p), state.periods == 0.0
    response = state.response
    model = selected_model(response)
    prompt = no_velocity_delay_found(state.observer)
    response.prompt_velocities = 1.0 if prompt else 0.0
    before, now = (
        np.uintp((tick - 1) & (COMMAND_RING_LENGTH - 1)),
        np.uintp(tick & (SPEED_RING_LENGTH - 1)),
    )
    for j in range(4):
        angle, rate = positions[3 + j], velocities[3 + j]
        if not direct:
            angle = eye_actuator_angle(p, j, positions[3:])
            rate = eye_actuator_velocity(p, j, velocities[3:])
        if begins:  # at rest
            state.actuator_angles[j], state.velocity[j] = angle, rate
            response.angles[j] = angle
            begin_delay_comparison(state.observer, j, angle, rate)
            continue
        response.commands[before, j] = quantise_with_dead_zone(params, command[j])
        q, v = state.actuator_angles[j], state.velocity[j]
        w = response.accelerations[j]
        ahead_q, ahead_v, w = simulate_period(response, model, params, tick - 1, j, q, v, w)
        response.accelerations[j] = w
        q, v = update_observer(
            state.observer, response, params, tick - 1, j, v, ahead_q, ahead_v, angle, rate
        )
        state.actuator_angles[j], state.velocity[j] = q, v
        response.mean_speeds[now, j] = (angle - response.angles[j]) / params.period_s
        response.angles[j] = angle
        response.speeds[now, j] = rate if prompt else v
        if abs(state.velocity[j]) > _MAX_REST_SPEED:
            state.still_periods = 0.0
    every = int(params.sample_periods)
    slot = np.uintp(tick // every & (RING_LENGTH - 1))
    for j in range(4 if tick % every == 0 else 0):
        q = state.actuator_angles[j] if direct else eye_joint_angle(p, j, state.actuator_angles)
        if begins:
            reset_oscillation(state.oscillation, j // 2, j % 2, q)
            for place in range(RING_LENGTH):
                state.angles[place, j // 2, j % 2] = q
        state.angles[slot, j // 2, j % 2] = q
    if learn and not begins:
        learn_response(response, params, tick)
