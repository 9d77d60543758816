"""Saccade and trim: the eyes turn to the predicted goal in the shortest time and stay there.

There is no ballistic phase: the goal of `SmithPredictor` is read anew in each period, so an error
of the head's model or its joints is corrected as soon as an image shows it. Close to the goal,
where the time-optimal law would follow the noise of pixels and encoders, a soft law takes over,
`u = k (goal - q - lag v)`, which approaches the goal without overshoot at the rate k.

Late braking requires a well-known motor. The linear law of `vergence.controllers.state_feedback` is
used for the whole turn if the eyes have oscillated about a goal, if the target rests and the
response model does not explain the eyes' motion, or if the lag builds up.

In the time-optimal motion a joint follows its command u, held for a period T, by `dv/dt = clip((u -
v) / lag, -a, a)`. The command is the largest one under which the joint, with full braking
afterwards, stops at the goal and not beyond: with (q', v') its exact state at the period's end and
`S(v)` its shortest stopping distance, u solves

    q'(u) + S(v'(u)) = goal,   |u| <= u_max

The left side increases with u. S counts whole periods of full braking and a last one that ends at
rest. Near the goal this is a deadbeat law of two periods: with e = exp(-T / lag), `q + lag v` moves
by exactly u T, and the last period stops a velocity v within `v (lag - T e / (1 - e))`.

Pursuit is the same law for targets that may move freely. The predictor estimates whether each
target rests or moves and how (`vergence.controllers.prediction.motion_models`), and extrapolates it
over the delay. The law then turns each actuator in the shortest time to the predicted target angle:
a catch-up saccade in the frame of a moving goal. Close to it the soft law feeds its velocity
forward,

    u = k (goal - q - lag (v - w)) + w'

with w the goal's velocity when the command begins to act and w' its velocity when the command
shows, a lag later. For a target that is taken to rest, w = w' = 0, as under `saccade`.
"""

from math import exp, inf
from typing import ClassVar, Final, NamedTuple

import numpy as np

from vergence.controllers.prediction.oscillation import (
    OSCILLATING_HALF_SWINGS,
    oscillation_reduced_rate,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    PREDICTOR_PARAMETERS_SIZE,
    PredictorParameters,
)
from vergence.controllers.prediction.predictor import PREDICTION, PREDICTION_SIZE, Prediction
from vergence.controllers.state_feedback import (
    Estimate,
    PredictiveController,
    compensate_dead_zone,
    pole_placement_command,
)
from vergence.envs.observation import Observation, ObservationLayout
from vergence.envs.reading import check_above_zero, check_at_least_zero, check_finite_number
from vergence.errors import ConfigurationError
from vergence.kernels import inlined, kernel, record_view
from vergence.models.head import HeadModel
from vergence.models.motion import follow_joint
from vergence.models.parts import FloatArray

_LEAST_LAG_S: Final = 1e-4
"""Lower bound of the lag, s (numerical)."""
_MAX_BRAKING_PERIODS: Final = 1000
"""Largest number of braking periods that are simulated (numerical)."""
_MAX_ROOT_ITERATIONS: Final = 20
"""Iteration limit of the root finder (numerical)."""
_TOLERANCE_RAD: Final = 1e-6
"""Convergence tolerance of the stopping angle, rad (numerical)."""


class JointTiming(NamedTuple):
    """Lag, s, limits, rad/s and rad/s^2, and control period, s, of one joint, and how it stops."""

    lag: float
    max_command: float
    max_acceleration: float
    period: float
    decay: float
    """Factor exp(-period / lag) left of a difference between command and velocity."""
    smooth_stop_speed: float
    """Largest speed that a last period can stop within the acceleration limit, rad/s."""
    last_stop_speed: float
    """Largest speed that a last period can stop at all, rad/s."""
    last_distance_per_speed: float
    """Distance moved in a last period per initial speed, up to `smooth_stop_speed`, s."""
    last_distance: float
    """Distance moved in a last period from the speed `last_stop_speed`, rad."""


@inlined
def joint_timing(
    lag: float, max_command: float, max_acceleration: float, period: float
) -> JointTiming:
    """Compute the timing of one joint from its lag, its limits and the control period."""
    lag = max(lag, _LEAST_LAG_S)
    e = exp(-period / lag)
    per_speed = lag - period * e / (1.0 - e)
    smooth_stop_speed = min(
        max_acceleration * lag * (1.0 - e), max_command * (1.0 - e) / e if e > 0.0 else inf
    )
    last_stop_speed, distance = smooth_stop_speed, per_speed * smooth_stop_speed
    if max_acceleration * lag <= max_command and max_acceleration * period > smooth_stop_speed:
        last_stop_speed = max_acceleration * period
        distance = 0.5 * max_acceleration * period * period
    return JointTiming(
        lag, max_command, max_acceleration, period, e,
        smooth_stop_speed, last_stop_speed, per_speed, distance,
    )  # fmt: skip


@inlined
def signed_stopping_distance(velocity: float, joint: JointTiming) -> float:
    """Shortest signed distance that a joint moves until it rests, in the direction of v, rad."""
    side = 1.0 if velocity >= 0.0 else -1.0
    velocity = abs(velocity)
    distance: float = 0.0
    for _ in range(_MAX_BRAKING_PERIODS):  # a joint that needs longer cannot be stopped
        if not velocity > joint.last_stop_speed:
            break
        dq, velocity = follow_joint(
            0.0, velocity, -joint.max_command,
            joint.lag, joint.max_acceleration, joint.period, joint.decay,
        )  # fmt: skip
        distance += dq
    if velocity <= joint.smooth_stop_speed:
        distance += joint.last_distance_per_speed * velocity
    else:
        smooth_distance = joint.last_distance_per_speed * joint.smooth_stop_speed
        share = (velocity - joint.smooth_stop_speed) / (
            joint.last_stop_speed - joint.smooth_stop_speed
        )
        distance += smooth_distance + share * (joint.last_distance - smooth_distance)
    return side * distance


@inlined
def _overrun(u: float, angle_error: float, v: float, a: float, trusted: JointTiming) -> float:
    """Angle beyond the goal at which the joint stops after a period of command u, rad."""
    q, after = follow_joint(0.0, v, u, trusted.lag, a, trusted.period, trusted.decay)
    return q + signed_stopping_distance(after, trusted) - angle_error


@inlined
def time_optimal_command(
    angle_error: float, velocity: float, present_max_acceleration: float,
    braking_timing: JointTiming,
) -> float:  # fmt: skip
    """Compute this period's command of the time-optimal motion, rad/s.

    `braking_timing` has the acceleration, at most the present one, trusted for later braking.
    """
    e, u_max, period = braking_timing.decay, braking_timing.max_command, braking_timing.period
    u = (angle_error - braking_timing.lag * velocity + velocity * period * e * e / (1.0 - e)) / (
        period * (1.0 - e)
    )
    calm = (
        abs(u - velocity) <= braking_timing.max_acceleration * braking_timing.lag
        and abs(u + (velocity - u) * e) <= braking_timing.smooth_stop_speed
    )
    if abs(u) <= u_max and calm:
        return u
    below = _overrun(-u_max, angle_error, velocity, present_max_acceleration, braking_timing)
    if below >= 0.0:
        return -u_max
    above = _overrun(u_max, angle_error, velocity, present_max_acceleration, braking_timing)
    if above <= 0.0:
        return u_max
    # beyond these the acceleration limit holds all period, and u changes nothing
    widest = present_max_acceleration * (braking_timing.lag + period)
    low, high = max(-u_max, velocity - widest), min(u_max, velocity + widest)
    # regula falsi, Illinois variant
    kept = 0
    for _ in range(_MAX_ROOT_ITERATIONS):
        if not above > below:  # converged to rounding
            break
        u = (low * above - high * below) / (above - below)
        overrun = _overrun(u, angle_error, velocity, present_max_acceleration, braking_timing)
        if abs(overrun) < _TOLERANCE_RAD:
            break
        if overrun > 0.0:
            high, above = u, overrun
            if kept == 1:
                below *= 0.5
            kept = 1
        else:
            low, below = u, overrun
            if kept == -1:
                above *= 0.5
            kept = -1
    return u


_ZONE_ANGLES: Final = 2.0
"""Width of the soft law's zone per uncertain angle of a period's acceleration (chosen)."""
_ZONE_SIGMAS: Final = 4.0
"""Width of that zone, in standard deviations of a detection (chosen: 4 sigma)."""
_MOVING_TRIM_FACTOR: Final = 2.0
"""Factor by which `trim_px` is wider for a moving target (chosen)."""
_MAX_RATE_TIMES_LAG: Final = 1.5
"""Upper bound of the soft law's rate, times the lag (chosen: overshoot against speed)."""
_JOINT_BLUR_FRACTION: Final = 0.6
"""Each joint's fraction of the motion-blur speed limit (chosen: margin for two joints)."""
_MAX_BLIND_SACCADE_S: Final = 0.12
"""Approximate longest time for which a catch-up saccade exceeds that speed, s (chosen)."""
_LEAST_TRIM_LAG_S: Final = 0.004
"""Lower bound of the lag in the soft law's rate, s (numerical)."""
_MAX_MISFIT: Final = 4.0
"""Misfit of the response above which only the linear law turns the eyes (chosen)."""
_CALM_RATE: Final = 12.0
"""Rate of the linear law with that misfit or after oscillation, which lowers it, 1/s (chosen)."""
_LINEAR_RATE: Final = 30.0
"""Rate of the linear law if the lag builds up, 1/s (chosen)."""
_MAX_ZONE_ACCELERATION: Final = 1e3
"""Upper bound of the acceleration in the soft law's zone, rad/s^2 (numerical)."""


class Saccade(PredictiveController):
    """Time-optimal turns to the predicted goal of a target that rests between jumps.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        braking: fraction of the estimated acceleration that is used for braking.
        caution: standard deviations of that acceleration subtracted as an additional margin.
        trim_px: least distance from the goal within which the soft law trims, in pixels at the
            principal point; with noisy detections the distance is four standard deviations.
        trim_gain: rate k of the soft law, 1/s.
        delay, lag: images' delay and actuators' response, `estimated` on line or `nominal`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        braking: float = 0.9, caution: float = 1.0, trim_px: float = 1.0, trim_gain: float = 50.0,
        delay: Estimate = "estimated", lag: Estimate = "estimated",
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout, delay=delay, lag=lag)
        if not 0.0 < check_finite_number("braking", braking) <= 1.0:
            raise ConfigurationError(f"braking: expected a share above 0 up to 1, got {braking!r}")
        check_at_least_zero("caution", caution)
        check_at_least_zero("trim_px", trim_px)
        check_above_zero("trim_gain", trim_gain)
        near = trim_px / float(np.mean(head.cameras.focal))
        gain = min(trim_gain, 0.5 / head.timing.period_s)
        self._law = np.array([braking, caution, near, gain])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        now = self.predictor.update(seen, state)
        return np.asarray(saccade_command(now, self.predictor.params, self._law))


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:])"],
    f"({PREDICTION_SIZE}),({PREDICTOR_PARAMETERS_SIZE}),(4)->(4)",
)
def saccade_command(
    prediction: FloatArray, params_row: FloatArray, law_row: FloatArray, out: FloatArray
) -> None:
    """Compute the actuators' commands (4) of one period, rad/s.

    An actuator that moves no eye whose target is known is held still.

    Args:
        prediction: a row of `Prediction`.
        params_row: a row of `PredictorParameters`.
        law_row: options `braking` and `caution`, the angle of a joint below which the soft law
            acts, rad, and its rate, 1/s.
        out: the commands.
    """
    now: Prediction = record_view(prediction, PREDICTION)
    params: PredictorParameters = record_view(params_row, PREDICTOR_PARAMETERS)
    period = params.period_s
    unsure = min(now.acceleration_sd + now.response_latency_sd_s / period, 1.0)
    oscillates = now.half_swing_count > OSCILLATING_HALF_SWINGS
    unexplained, builds_up = now.response_misfit > _MAX_MISFIT, now.build_up > 0.0
    for j in range(4):
        out[j] = 0.0
        if not (
            (now.known[0] > 0.5 and params.moves_eye[j, 0] > 0.5)
            or (now.known[1] > 0.5 and params.moves_eye[j, 1] > 0.5)
        ):
            continue
        # from here on velocities are relative to the goal
        v, lag = now.velocities[j] - now.goal_rates[j], params.lag_ratio[j] * now.lag_s
        speed = max(
            now.speed_gain[j] * params.speed_limit[j] - abs(now.goal_rates[j]),
            0.1 * now.speed_gain[j] * params.speed_limit[j],
        )
        if now.goal_rates[j] != 0.0:  # lose sight only briefly of a target that may reverse
            visible_speed = max(
                _JOINT_BLUR_FRACTION * params.max_slip_rad_s / params.max_joint_per_actuator[j],
                abs(now.angle_error[j]) / _MAX_BLIND_SACCADE_S,
            )
            speed = min(speed, visible_speed)
        a = now.acceleration_ratio * params.acceleration_limit[j]
        # uncertain part of the angle turned in a period at full acceleration
        wide = law_row[2] if now.goal_rates[j] == 0.0 else _MOVING_TRIM_FACTOR * law_row[2]
        soft = max(wide, _ZONE_SIGMAS * now.noise_rad) / params.max_joint_per_actuator[j]
        near = max(soft, _ZONE_ANGLES * min(a, _MAX_ZONE_ACCELERATION) * period**2 * unsure)
        calm = oscillates or (unexplained and now.goal_rates[j] == 0.0)
        if calm or builds_up:
            linear_rate = (
                oscillation_reduced_rate(_CALM_RATE, now.half_swing_count) if calm else _LINEAR_RATE
            )
            u = pole_placement_command(
                now.angle_error[j], v, now.accelerations[j], linear_rate, lag, now.build_up
            )
        elif abs(now.angle_error[j]) < near and abs(v) * lag < 3.0 * near:
            u = min(law_row[3], _MAX_RATE_TIMES_LAG / max(lag, _LEAST_TRIM_LAG_S)) * (
                now.angle_error[j] - lag * v
            )
        else:
            braking = law_row[0] * exp(-min(law_row[1] * now.acceleration_sd, 1.0)) * a
            trusted = joint_timing(lag, speed, braking, period)
            u = time_optimal_command(now.angle_error[j], v, a, trusted)
        u = (min(max(u, -speed), speed) + now.goal_rates_at_effect[j]) / now.speed_gain[j]
        resting_error = now.angle_error[j] - lag * (v + now.build_up * lag * now.accelerations[j])
        out[j] = compensate_dead_zone(u, resting_error, params, now.speed_gain[j])


class Pursuit(Saccade):
    """Time-optimal turns to the predicted goal of a target that may move, followed by pursuit.

    The options are those of `Saccade`.
    """

    _targets_move: ClassVar[bool] = True
