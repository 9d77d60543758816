"""The present error from delayed images: a Smith predictor on the head's kinematics.

An image exposed at time t - d gives the joint angles that fixate the target, `g = q(t - d) + a`.
Here a is the angle that the eyes still had to turn at the exposure, from both pixels, their
triangulated point and the eyes' kinematics. The goal g belongs to the target, not to the eyes. It
is constant while the target rests, and the angle left to turn is g minus the joint angles, whatever
the eyes have done since the exposure. A command given now acts after the head's latencies, so the
relevant joint angles are those at that time: the present readings, extrapolated through the
commands still in transit.

If every joint has its own motor, the actuators reach the goals exactly. Where actuators couple
joints, their angles are those with the least sum of squared pixel errors: Gauss-Newton steps,
starting from the linear solution. Each eye's target is a separate point on that eye's own ray, so
the residual is minimal in the images as seen, whatever the errors of the head's model.

All times are on the clock of the joint readings, so only two combinations of latencies matter: the
sum of command and reading latency (`vergence.controllers.prediction.response`), and the difference
of image and reading latency (`vergence.controllers.prediction.delay`), both estimated on line.
"""

from math import exp, isfinite, nan, sqrt
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.gate import is_fresh
from vergence.controllers.prediction.goals import update_with_image
from vergence.controllers.prediction.measurement import inflate_variance_at_reversal
from vergence.controllers.prediction.motion_models import extrapolate_goal, visible_speed_fraction
from vergence.controllers.prediction.oscillation import (
    decay_count,
    error_to_correct,
    update_oscillation,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    PredictorParameters,
    pack_predictor_parameters,
    with_virtual_joints,
)
from vergence.controllers.prediction.response import (
    Rings,
    ring_at,
    selected_model,
    state_at_command_effect,
)
from vergence.controllers.prediction.state import (
    PREDICTOR_STATE,
    PREDICTOR_STATE_SIZE,
    PredictorState,
    initial_predictor_row,
    rings_in,
    update_joints,
)
from vergence.envs.observation import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.kernels import compiled, inlined, record_view, row_layout, row_size
from vergence.models.fixation import actuator_least_squares
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PackedHead,
    camera_of,
    eye_frames,
    eye_jacobian,
    eye_joint_angle,
    has_motor_per_joint,
    pixel_rate,
    point_in_eye,
    point_rate_in_camera,
    point_to_local,
    point_to_outer,
)
from vergence.models.parts import FloatArray

_MAX_ITERATIONS: Final = 12  # iteration limit of Gauss-Newton (numerical)
_MAX_STEP_RAD: Final = 0.5
"""Largest step of one iteration, rad; longer steps are scaled down (numerical)."""
_CONVERGED_STEP_RAD: Final = 1e-6
"""Convergence tolerance: largest actuator step at which iteration stops, rad (numerical)."""


@inlined
def least_squares_actuators(
    p: PackedHead, goals: FloatArray, depth: FloatArray, known: FloatArray,
    present_angles: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Find the actuator angles (4,), rad, with the least squared pixel error about the known goals.

    `depth` (2,) is that of each target on the optical axis, m. Actuators that affect no goal keep
    their present angles (4,); joint limits are not regarded.
    """
    wanted, step, points = np.zeros((2, 2)), np.zeros(4), np.zeros((2, 3))
    jacobian = np.zeros((2, 2, 2))
    left, right = known[0] > 0.5, known[1] > 0.5
    for eye in range(2):
        if not known[eye] > 0.5:
            continue
        frames, camera = eye_frames(p, eye, goals[eye, 0], goals[eye, 1]), camera_of(p, eye)
        x, y, z = point_to_outer(frames.camera, 0.0, 0.0, depth[eye])
        points[eye, 0], points[eye, 1], points[eye, 2] = x, y, z
        u1, u2, v1, v2 = eye_jacobian(p, eye, frames, camera.centre_u, camera.centre_v, depth[eye])
        jacobian[eye, 0, 0], jacobian[eye, 0, 1] = u1, u2
        jacobian[eye, 1, 0], jacobian[eye, 1, 1] = v1, v2
        first = goals[eye, 0] - eye_joint_angle(p, 2 * eye, present_angles)
        second = goals[eye, 1] - eye_joint_angle(p, 2 * eye + 1, present_angles)
        wanted[eye, 0], wanted[eye, 1] = u1 * first + u2 * second, v1 * first + v2 * second
    actuator_least_squares(p, jacobian, wanted, left, right, step)
    for k in range(4):
        out[k] = present_angles[k] + step[k]
    for _ in range(_MAX_ITERATIONS):
        for eye in range(2):
            if not known[eye] > 0.5:
                continue
            q1, q2 = eye_joint_angle(p, 2 * eye, out), eye_joint_angle(p, 2 * eye + 1, out)
            frames, camera = eye_frames(p, eye, q1, q2), camera_of(p, eye)
            x, y, z = points[eye, 0], points[eye, 1], points[eye, 2]
            cx, cy, cz = point_to_local(frames.camera, x, y, z)
            if not cz > 0.0:
                return
            a, b = cx / cz, cy / cz
            wanted[eye, 0], wanted[eye, 1] = -camera.focal_u * a, -camera.focal_v * b
            for joint in range(2):
                axis = frames.after_first_joint if joint == 0 else frames.after_second_joint
                rate = point_rate_in_camera(axis, frames.camera, x, y, z)
                u, v = pixel_rate(camera, a, b, cz, rate)
                jacobian[eye, 0, joint], jacobian[eye, 1, joint] = u, v
        actuator_least_squares(p, jacobian, wanted, left, right, step)
        size = 0.0
        for k in range(4):
            size = max(size, abs(step[k]))
        scale = _MAX_STEP_RAD / max(size, _MAX_STEP_RAD)
        for k in range(4):
            out[k] += scale * step[k]
        if not size > _CONVERGED_STEP_RAD:
            return


_REST_PROBABILITY: Final = 0.9
"""Probability of rest above which a target is treated as resting (chosen)."""
_BLUR_SPEED_FRACTION: Final = 0.5
"""Share of `PredictorParameters.max_slip_rad_s` that an eye may slip (chosen: margin for blur)."""
_LATE_IMAGE_GRACE_S: Final = 0.03
"""Time by which an image may be late before an eye is slowed, s (chosen: tolerates late frames)."""


@inlined
def extrapolate_targets(
    state: PredictorState, params: PredictorParameters, lag_s: float, tick: float
) -> None:
    """Extrapolate the targets to a time in periods, see `EffectState`."""
    target, motion, effect = state.target, state.motion, state.effect
    for eye in range(2):
        for joint in range(2):
            effect.goals[eye, joint] = target.goals[eye, joint]
            effect.rates[eye, joint] = effect.later_rates[eye, joint] = 0.0
    if not (params.targets_move > 0.5 and motion.probabilities[0] < _REST_PROBABILITY):
        return
    time_s, effect_delay_s = (tick - motion.tick) * params.period_s, lag_s + 0.5 * params.period_s
    expected_s = state.delays.mean_s + params.frame_period_s
    expected_s += (tick - state.periods) * params.period_s
    expected_s += _LATE_IMAGE_GRACE_S
    for eye in range(2):
        if target.known[eye] < 0.5:
            continue
        models, probabilities = motion.models[eye], motion.probabilities
        slow = visible_speed_fraction(
            models, probabilities, _BLUR_SPEED_FRACTION * params.max_slip_rad_s
        )
        for joint in range(2):
            resting = target.goals[eye, joint]
            effect.goals[eye, joint], effect.rates[eye, joint] = extrapolate_goal(
                models, probabilities, resting, joint, time_s, expected_s, slow
            )
            effect.later_rates[eye, joint] = extrapolate_goal(
                models, probabilities, resting, joint, time_s + effect_delay_s,
                expected_s + effect_delay_s, slow,
            )[1]  # fmt: skip


@inlined
def predict_pixel_error(
    state: PredictorState, p: PackedHead, eye: int, first_angle: float, second_angle: float
) -> tuple[float, float]:
    """Undistorted error (u, v) of an eye at joint angles, px; nan if unknown or behind it."""
    if state.target.known[eye] < 0.5:
        return nan, nan
    # the point on the optical axis once the eye has turned to its aim
    camera = eye_frames(p, eye, state.effect.goals[eye, 0], state.effect.goals[eye, 1]).camera
    px, py, pz = point_to_outer(camera, 0.0, 0.0, state.target.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first_angle, second_angle, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z


MAX_IMAGE_LATENCY_S: Final = 0.25
"""Longest nominal latency of images that is accepted, s (numerical: the ring buffer of angles)."""
_RATE_DIFFERENCE_S: Final = 0.01
"""Interval of the finite difference for rates of coupled actuators, s (numerical)."""
_LATENCY_MARGIN_SIGMAS: Final = 0.5
"""Standard deviations added to the estimated response latency in predictions (chosen)."""
MAX_UNSEEN_S: Final = 1.0
"""Time for which the goal of an eye that does not see its target is kept, s (chosen)."""


class Prediction:
    """State of the eyes, and angles left to turn, at the time a command given now begins to act.

    A row of a head. Angles left to turn are by actuator of the eyes; an actuator is a joint where
    each of the four eye joints has its own motor.
    """

    angle_error: Annotated[FloatArray, 4]
    """Angles that actuators have yet to turn then, rad; 0 if they move no eye of known target."""
    pixel_error: Annotated[FloatArray, 2, 2]
    """Pixel errors at that time, undistorted, px; nan where not known."""
    known: Annotated[FloatArray, 2]
    """1 if an eye's target is known: visible now or a short while ago; otherwise 0."""
    positions: Annotated[FloatArray, 4]
    """Angles of the eyes' joints at that time, rad."""
    velocities: Annotated[FloatArray, 4]
    """Velocities of the actuators at that time, rad/s."""
    accelerations: Annotated[FloatArray, 4]
    """Accelerations of the actuators at that time, rad/s^2."""
    actuator_angles: Annotated[FloatArray, 4]
    """Angles of the actuators at that time, rad."""
    speed_gain: Annotated[FloatArray, 4]
    """Ratio of steady velocity to command."""
    goal_rates: Annotated[FloatArray, 4]
    """Rates at which `angle_error` grows at rest of the actuators, rad/s; 0 for resting targets."""
    goal_rates_at_effect: Annotated[FloatArray, 4]
    """These rates when a command given now shows in the motion, a lag and half a period later."""
    image_delay_s: float
    """Latency of images minus that of joint readings, s."""
    lag_s: float
    """Lag of velocities behind commands, s, to which each actuator has its own ratio."""
    build_up: float
    """Build-up of the lag, see `vergence.controllers.prediction.response`; 0 if first-order."""
    response_latency_s: float
    """Latency of commands plus that of joint readings, s."""
    response_latency_sd_s: float
    """Its standard deviation, s."""
    acceleration_ratio: float
    """Ratio of the acceleration limits to those of the head's model."""
    acceleration_sd: float
    """Standard deviation of its logarithm."""
    noise_rad: float
    """Detection noise divided by the focal length, standard deviation, rad."""
    response_misfit: float
    """Mean squared normalised residual of the response model; 0 before the first window's end."""
    half_swing_count: float
    """Decayed count of half swings, see `vergence.controllers.prediction.oscillation`."""


PREDICTION: Final = row_layout(Prediction)
PREDICTION_SIZE: Final = row_size(PREDICTION)


def prediction_fields(rows: FloatArray) -> NDArray[np.void]:
    """View predictions (..., PREDICTION_SIZE) by the names of their fields."""
    return rows.view(PREDICTION)[..., 0]


class SmithPredictor:
    """Predicts present errors from delayed images, for any number of heads.

    Args:
        head: the model of the head.
        layout: the layout of observations.
        delay: `nominal` takes the head's own latency of images; `estimated` starts there and
            estimates it on line, see `vergence.controllers.prediction.delay`.
        lag: `nominal` or `estimated` response of the actuators to their commands, see
            `vergence.controllers.prediction.response`.
        targets_move: True if targets may move; False, for targets that only jump, gives better
            estimates of those.

    Raises:
        ConfigurationError: an option has an invalid value, or the head's latency is longer than
            0.25 s.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
        targets_move: bool = True,
    ) -> None:  # fmt: skip
        for name, value in (("delay", delay), ("lag", lag)):
            if value not in ("estimated", "nominal"):
                expected = f"{name}: expected 'estimated' or 'nominal'"
                raise ConfigurationError(f"{expected}, got {value!r}")
        if head.timing.latency_s > MAX_IMAGE_LATENCY_S + 1e-9:
            raise ConfigurationError(
                f"head: expected a latency of at most {MAX_IMAGE_LATENCY_S:g} s, "
                f"got {head.timing.latency_s:g} s"
            )
        self.head, self.layout = head, layout
        self._packed = with_virtual_joints(head)
        self.params = pack_predictor_parameters(head, targets_move)
        self._learn_delay, self._learn_response = delay == "estimated", lag == "estimated"
        self._initial = initial_predictor_row(
            self.params, head.timing.exposure_stamps, self._learn_delay, self._learn_response
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        # an unpickled array is writable, and kernels would be recompiled for that type
        self._packed = with_virtual_joints(self.head)

    @property
    def size(self) -> int:
        """Length of a head's state."""
        return len(self._initial)

    def initial(self) -> FloatArray:
        """(size,) the state before the first observation."""
        return self._initial.copy()

    def update(self, seen: Observation, state: FloatArray) -> FloatArray:
        """Update the prediction with one control period's observation.

        Args:
            seen: observation of one or more heads.
            state: (..., size or more) states of the heads, changed in place; C-contiguous float64.
                Entries after the state in each row belong to the caller and are left unchanged.

        Returns:
            (..., PREDICTION_SIZE) the `Prediction` for a command given now; `prediction_fields`
            names its numbers.
        """
        rows = state.reshape(-1, state.shape[-1])
        present = np.empty((*state.shape[:-1], PREDICTION_SIZE))
        present_rows = present.reshape(-1, PREDICTION_SIZE)
        _update(
            rows,
            np.ascontiguousarray(seen.positions).reshape(-1, 7),
            np.ascontiguousarray(seen.velocities).reshape(-1, 7),
            np.ascontiguousarray(seen.last_command).reshape(-1, 4),
            np.ascontiguousarray(seen.image_age_s).reshape(-1),
            np.ascontiguousarray(seen.pixel_error).reshape(-1, 2, 2),
            self.params, self._packed, self._learn_delay, self._learn_response, present_rows,
        )  # fmt: skip
        if not self.head.actuation.direct:
            _fill_coupled(rows, self.params, self._packed, present_rows)
        return present


@inlined
def _update_goals(
    state: PredictorState, params: PredictorParameters, age_s: float, error: FloatArray,
    p: PackedHead, learn_delay: bool,
) -> None:  # fmt: skip
    """Update with the newest image if it is new; drop goals unseen for `MAX_UNSEEN_S`."""
    target = state.target
    fresh = is_fresh(age_s, state.image_age_s, params.period_s)
    state.image_age_s = age_s
    for eye in range(2):
        target.unseen_periods[eye] += 1.0
        if fresh and isfinite(error[eye, 0]) and isfinite(error[eye, 1]):
            target.unseen_periods[eye] = 0.0
    if target.unseen_periods[0] == 0.0 or target.unseen_periods[1] == 0.0:
        update_with_image(state, params, error, p, learn_delay)
    for eye in range(2):
        unseen = target.unseen_periods[eye]
        # the other eye shows where a moving target is
        if params.targets_move > 0.5 and state.motion.probabilities[0] < 0.5:
            unseen = min(unseen, target.unseen_periods[1 - eye])
        if unseen > round(MAX_UNSEEN_S / params.period_s):
            target.known[eye] = 0.0


@inlined
def _hold_against_friction(
    state: PredictorState, rings: Rings, params: PredictorParameters, present: Prediction
) -> None:
    """Take actuators that friction holds near their goals for at rest on them."""
    response = state.response
    model, tick = selected_model(response), int(state.periods)
    for j in range(4):
        shown_s = model.parameters[0] + 2.0 * params.lag_ratio[j] * exp(model.parameters[2])
        earlier = min(shown_s, params.max_response_latency_s) / params.period_s
        acting = exp(model.log_gain[j]) * ring_at(rings.commands, tick - 1 - int(earlier), j)
        error, moves = present.angle_error[j], present.goal_rates[j] != 0.0
        present.angle_error[j], rests = error_to_correct(
            state.friction, params, state.periods, j, response.angles[j],
            state.observer.last_velocity[j], acting, error, moves, state.delays.mean_s,
        )  # fmt: skip
        if rests:
            present.velocities[j] = present.accelerations[j] = 0.0


@inlined
def _fill_prediction(
    state: PredictorState, rings: Rings, params: PredictorParameters, p: PackedHead,
    present: Prediction,
) -> None:  # fmt: skip
    """Fill in the prediction: the state and the angles left to turn when the next command acts."""
    response, direct = state.response, has_motor_per_joint(p)
    model = selected_model(response)
    sd = sqrt(max(model.variance[0], 0.0))
    latency = min(model.parameters[0] + _LATENCY_MARGIN_SIGMAS * sd, params.max_response_latency_s)
    for j in range(4):
        q, v, w = state_at_command_effect(
            response, rings, params, int(state.periods), j, state.joints.actuator_angles[j],
            state.joints.velocity[j], latency,
        )  # fmt: skip
        present.actuator_angles[j] = min(max(q, params.lower[j]), params.upper[j])
        present.velocities[j], present.accelerations[j] = v, w
        present.speed_gain[j] = exp(model.log_gain[j])
    lag_s, effect = exp(model.parameters[2]), state.effect
    extrapolate_targets(state, params, lag_s, state.periods + latency / params.period_s)
    for j in range(4):
        present.positions[j] = present.actuator_angles[j]
        if not direct:
            present.positions[j] = eye_joint_angle(p, j, present.actuator_angles)
    for eye in range(2):
        present.known[eye] = state.target.known[eye]
        first, second = present.positions[2 * eye], present.positions[2 * eye + 1]
        u, v = predict_pixel_error(state, p, eye, first, second)
        present.pixel_error[eye, 0], present.pixel_error[eye, 1] = u, v
    for j in range(4):
        present.angle_error[j] = present.goal_rates[j] = present.goal_rates_at_effect[j] = 0.0
        # `_fill_coupled` computes this for coupled joints
        if direct and present.known[j // 2] > 0.5:
            aim = effect.goals[j // 2, j % 2]
            goal = min(max(aim, params.lower[j]), params.upper[j])
            present.angle_error[j] = goal - present.actuator_angles[j]
            if goal == aim:
                present.goal_rates[j] = effect.rates[j // 2, j % 2]
                present.goal_rates_at_effect[j] = effect.later_rates[j // 2, j % 2]
    if direct:
        _hold_against_friction(state, rings, params, present)
    present.image_delay_s, present.lag_s = state.delays.mean_s, lag_s
    present.build_up = model.parameters[3]
    present.response_latency_s, present.response_latency_sd_s = model.parameters[0], sd
    present.acceleration_ratio = exp(model.parameters[1])
    present.acceleration_sd = sqrt(max(model.variance[1], 0.0))
    present.noise_rad = sqrt(state.target.detection_variance)
    present.response_misfit = model.misfit if response.windows > 0.5 else 0.0
    present.half_swing_count = state.oscillation.half_swing_count


@compiled
def _update(
    rows: FloatArray, positions: FloatArray, velocities: FloatArray, command: FloatArray,
    age_s: FloatArray, error: FloatArray, params_row: FloatArray, p: PackedHead,
    learn_delay: bool, learn_response: bool, present_rows: FloatArray,
) -> None:  # fmt: skip
    params: PredictorParameters = record_view(params_row, PREDICTOR_PARAMETERS)
    for n in range(rows.shape[0]):
        state: PredictorState = record_view(rows[n][:PREDICTOR_STATE_SIZE], PREDICTOR_STATE)
        rings = rings_in(rows[n], params)
        update_joints(
            state, rings, params, p, positions[n], velocities[n], command[n], learn_response
        )
        _update_goals(state, params, age_s[n], error[n], p, learn_delay)
        inflate_variance_at_reversal(state, p, command[n])
        decay_count(state.oscillation, params.period_s)
        for eye in range(2):
            for joint in range(2 if state.target.known[eye] > 0.5 else 0):
                q = eye_joint_angle(p, 2 * eye + joint, state.joints.actuator_angles)
                aim = state.effect.goals[eye, joint]
                update_oscillation(
                    state.oscillation, params, eye, joint, q, aim, state.target.detection_variance
                )
        _fill_prediction(state, rings, params, p, record_view(present_rows[n], PREDICTION))


@compiled
def _fill_coupled(
    rows: FloatArray, params_row: FloatArray, p: PackedHead, present_rows: FloatArray
) -> None:
    """Compute the angles left to turn where actuators couple the eyes' joints."""
    params: PredictorParameters = record_view(params_row, PREDICTOR_PARAMETERS)
    goals, ahead, shown = np.zeros(4), np.zeros(4), np.zeros(4)
    for n in range(rows.shape[0]):
        state: PredictorState = record_view(rows[n][:PREDICTOR_STATE_SIZE], PREDICTOR_STATE)
        present: Prediction = record_view(present_rows[n], PREDICTION)
        effect, depth, known = state.effect, state.target.fixated_depth, present.known
        if known[0] < 0.5 and known[1] < 0.5:
            continue
        angles = present.actuator_angles
        least_squares_actuators(p, effect.goals, depth, known, angles, goals)
        moves = effect.rates.any()
        if moves:
            later = effect.goals + _RATE_DIFFERENCE_S * effect.rates
            least_squares_actuators(p, later, depth, known, angles, ahead)
            later = effect.goals + _RATE_DIFFERENCE_S * effect.later_rates
            least_squares_actuators(p, later, depth, known, angles, shown)
        for j in range(4):
            if params.moves_eye[j, 0] * known[0] + params.moves_eye[j, 1] * known[1] > 0.0:
                goal = min(max(goals[j], params.lower[j]), params.upper[j])
                present.angle_error[j] = goal - angles[j]
                if moves and goal == goals[j]:
                    present.goal_rates[j] = (ahead[j] - goals[j]) / _RATE_DIFFERENCE_S
                    present.goal_rates_at_effect[j] = (shown[j] - goals[j]) / _RATE_DIFFERENCE_S
        _hold_against_friction(state, rings_in(rows[n], params), params, present)
