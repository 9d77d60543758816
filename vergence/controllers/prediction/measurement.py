"""Measurements of one image: its exposure time, goals and their variances, evidence on the delay.

A resting target shows the delay by the goals of the hypotheses, see
`vergence.controllers.prediction.delay`. The goals of a moving target change by themselves, so only
abrupt motion of the eye carries evidence on the delay. If the eye has accelerated more than targets
do, the second difference of the goals of three successive images is small under the true delay
only.

Backlash between motors and eyes shifts the goals. An encoder on the motor's side does not show
which end of the backlash (play) the eye is at. When a motor reverses and has crossed its backlash,
the motor angles that fixate a resting target differ by the backlash. An eye that turns to each new
goal lags by the images' delay every time and never comes to rest. Therefore goals get a larger
variance when a motor reverses. Goals that jump to and fro as their motors reverse reveal the
backlash; a mean of both lies within it, and there the eye keeps its direction.
"""

from math import inf, isfinite, nan, sqrt
from typing import Final

import numpy as np

from vergence.controllers.prediction.delay import HYPOTHESES, SPACING_S, add_bounded_delay_cost
from vergence.controllers.prediction.motion_models import (
    MODELS,
    Motions,
    mean_rate,
    mix_models,
    predict_modes,
    predict_motions,
)
from vergence.controllers.prediction.parameters import PredictorParameters
from vergence.controllers.prediction.state import PredictorState, angle_at
from vergence.kernels import inlined, subroutine
from vergence.models.fixation import fixation_newton_step
from vergence.models.kinematics import PackedHead, eye_frames, joint_per_actuator, point_to_local
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors

_RELATIVE_MODEL_SD: Final = 0.004
"""Model error of the head, standard deviation as a fraction of the angle to turn (chosen)."""
_ENCODER_SD_STEPS: Final = 0.3
"""Quantisation error of a moving joint's filtered angle, standard deviation as a fraction of the
resolution (chosen: that of one rounded angle)."""
LATENCY_JITTER_SD_S: Final = 0.006
"""Jitter of the frames' latency, standard deviation, s (chosen)."""
_MOVING_RAD_S: Final = 0.05
"""Joint speed above which encoder quantisation is added to the variance, rad/s (chosen)."""
_MAX_NEWTON_STEPS: Final = 10
"""Iteration limit of Newton's method (numerical)."""


@inlined
def average_over_delays(
    state: PredictorState,
    params: PredictorParameters,
    arrival_tick: float,
    first_active: int,
    end_active: int,
    weights: FloatArray,
    angles_by_delay: FloatArray,
    angles_at_exposure: FloatArray,
    delay_variance: FloatArray,
) -> float:
    """Average the exposure time of an image, and the joint angles then, over the delay hypotheses.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        arrival_tick: arrival of the image (its stamp if the camera stamps exposures), in periods.
        first_active: index of the first delay hypothesis that is not ruled out.
        end_active: index one past the last of them.
        weights: (HYPOTHESES,) weights of the delays.
        angles_by_delay: (HYPOTHESES, 2, 2) result: joint angles at the exposure under each delay,
            rad.
        angles_at_exposure: (2, 2) result: their weighted means, rad.
        delay_variance: (2, 2) result: their weighted variances, rad^2.

    Returns:
        The mean delay, s.
    """
    delay = 0.0
    for i in range(first_active, end_active):
        own = state.delays.first_s + SPACING_S * i
        delay += weights[i] * own
        for eye in range(2):
            for joint in range(2):
                tick = arrival_tick - own / params.period_s
                angles_by_delay[i, eye, joint] = angle_at(
                    state, params.sample_periods, tick, eye, joint
                )
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            for i in range(first_active, end_active):
                off = angles_by_delay[i, eye, joint] - angles_by_delay[first_active, eye, joint]
                mean += weights[i] * off
                square += weights[i] * off * off
            angles_at_exposure[eye, joint] = angles_by_delay[first_active, eye, joint] + mean
            delay_variance[eye, joint] = max(square - mean * mean, 0.0)
    return delay


@inlined
def measure_goals(
    state: PredictorState,
    p: PackedHead,
    angles_at_exposure: FloatArray,
    error: FloatArray,
    max_miss_ratio: float,
    goals: FloatArray,
) -> float:
    """Compute the goals of an image from the joint angles at its exposure.

    An eye that does not see the target gets the goals of the point that the other eye sees, at the
    depth last triangulated by both.

    Args:
        state: the predictor's state; its depths are changed in place.
        p: a packed head.
        angles_at_exposure: (2, 2) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan where not visible.
        max_miss_ratio: largest miss distance of two rays to one target, divided by the target's
            distance.
        goals: (2, 2) result: joint angles that fixate the target, rad; nan for none.

    Returns:
        Miss distance of both eyes' rays, divided by the target's distance; nan unless both eyes see
        it.
    """
    left, right = rays_from_pixel_errors(
        p,
        eye_frames(p, 0, angles_at_exposure[0, 0], angles_at_exposure[0, 1]).camera,
        eye_frames(p, 1, angles_at_exposure[1, 0], angles_at_exposure[1, 1]).camera,
        error,
    )
    depths = depths_on_rays(left, right)
    # one eye alone, or two eyes on different targets, keep the depth last triangulated
    gap = nan
    if depths.valid:
        (ax, ay, az), (bx, by, bz) = left
        (cx, cy, cz), (dx, dy, dz) = right
        x = ax + depths.left * bx - cx - depths.right * dx
        y = ay + depths.left * by - cy - depths.right * dy
        z = az + depths.left * bz - cz - depths.right * dz
        gap = sqrt(x * x + y * y + z * z) / depths.left
        if gap < max_miss_ratio or state.target.known[0] + state.target.known[1] == 0.0:
            state.target.depth[0], state.target.depth[1] = depths.left, depths.right
    for eye in range(2):
        source = eye
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            source = 1 - eye
            if state.target.known[eye] < 0.5 or not isfinite(error[source, 0] + error[source, 1]):
                goals[eye, 0] = goals[eye, 1] = nan
                continue
        z = state.target.depth[source]
        o, d = left if source == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = angles_at_exposure[eye, 0], angles_at_exposure[eye, 1]
        if state.target.known[eye] > 0.5:  # Newton's method from the last goal needs one step
            q1, q2 = state.target.goals[eye, 0], state.target.goals[eye, 1]
        for _ in range(_MAX_NEWTON_STEPS):
            d1, d2 = fixation_newton_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # the error left is the square of this step
                break
        goals[eye, 0], goals[eye, 1] = q1, q2
        if source != eye:
            continue
        frames = eye_frames(p, eye, q1, q2)
        state.target.fixated_depth[eye] = point_to_local(frames.camera, x, y, z)[2]
    return gap


@inlined
def goal_variance(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    eye: int,
    joint: int,
    angle_to_goal: float,
) -> float:
    """Variance of a measured goal for a known delay, rad^2.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        eye: index of the eye.
        joint: index of its joint.
        angle_to_goal: angle from the joint's position at the exposure to the goal, rad.
    """
    after = angle_at(state, params.sample_periods, exposure_tick + 0.5, eye, joint)
    before = angle_at(state, params.sample_periods, exposure_tick - 0.5, eye, joint)
    speed, model = (after - before) / params.period_s, _RELATIVE_MODEL_SD * angle_to_goal
    encoder = (
        _ENCODER_SD_STEPS * params.joint_step[eye, joint] if abs(speed) > _MOVING_RAD_S else 0.0
    )
    jitter = LATENCY_JITTER_SD_S * speed
    return state.target.detection_variance + jitter * jitter + model * model + encoder * encoder


_TARGET_ACCELERATION_SD: Final = 4.0
"""Angular acceleration of a target, standard deviation, rad/s^2 (chosen: larger values make
evidence on the delay rarer, smaller ones take target motion for a delay error)."""
MODEL_ERROR_SD_RAD: Final = 0.0004
"""Standard deviation that an innovation keeps even if everything is known, rad (chosen: model
errors without a term of their own)."""
INFORMATIVE_RATIO: Final = 16.0
"""Squared eye motion between the extreme delays, relative to the variance of a measured goal, above
which an image carries evidence on the delay (chosen: 4 sigma)."""


@subroutine
def add_moving_target_costs(
    state: PredictorState,
    params: PredictorParameters,
    arrival_tick: float,
    first_active: int,
    end_active: int,
    angles_at_exposure: FloatArray,
    angles_by_delay: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    added_costs: FloatArray,
) -> None:
    """Weigh the delay hypotheses on a moving target by the second differences of its goals.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        arrival_tick: arrival of the image (its stamp if the camera stamps exposures), in periods.
        first_active: index of the first delay hypothesis that is not ruled out.
        end_active: index one past the last of them.
        angles_at_exposure: (2, 2) mean joint angles at the exposure, from which the goals were
            computed, rad.
        angles_by_delay: (HYPOTHESES, 2, 2) joint angles at the exposure under each delay, rad.
        goals: (2, 2) measured goals, rad; nan for none.
        variance: (2, 2) variances of the measured goals, rad^2.
        added_costs: (HYPOTHESES,) cost that the image adds to each delay, changed in place.
    """
    one, two = state.motion.images[0], state.motion.images[1]
    first, second = arrival_tick - one.arrival_tick, one.arrival_tick - two.arrival_tick
    if not (0.0 < second < 40.0 and 0.0 < first < 40.0):
        return
    ratio = first / second
    more = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    swing, turns = _TARGET_ACCELERATION_SD * (first * params.period_s) ** 2, np.zeros(HYPOTHESES)
    for eye in range(2):
        if not isfinite(goals[eye, 0] + one.goals[eye, 0] + two.goals[eye, 0]):
            continue
        for joint in range(2):
            innovation_variance = (
                more * variance[eye, joint] + swing * swing + MODEL_ERROR_SD_RAD**2
            )
            rest = goals[eye, joint] - angles_at_exposure[eye, joint]
            rest -= (1.0 + ratio) * (one.goals[eye, joint] - one.angles_at_exposure[eye, joint])
            rest += ratio * (two.goals[eye, joint] - two.angles_at_exposure[eye, joint])
            least, most = inf, -inf
            for i in range(first_active, end_active):
                own = (state.delays.first_s + SPACING_S * i) / params.period_s
                turn = angles_by_delay[i, eye, joint]
                before = angle_at(state, params.sample_periods, one.arrival_tick - own, eye, joint)
                turn -= (1.0 + ratio) * before
                turn += ratio * angle_at(
                    state, params.sample_periods, two.arrival_tick - own, eye, joint
                )
                turns[i], least, most = turn, min(least, turn), max(most, turn)
            # an eye that follows as smoothly as its target moves carries no evidence on the delay
            if (most - least) ** 2 > INFORMATIVE_RATIO * innovation_variance:
                for i in range(first_active, end_active):
                    add_bounded_delay_cost(
                        added_costs, (rest + turns[i]) ** 2 / innovation_variance, i
                    )


DISPLACED_GATE: Final = 36.0
"""Squared Mahalanobis distance of an innovation above which a goal is displaced (chosen: 6
sigma)."""
UNMOVED_GATE: Final = 9.0
"""Squared Mahalanobis distance up to which a goal is where it was (chosen: 3 sigma)."""
_OTHER_UNMOVED_S: Final = 0.25
"""Time for which one eye has to see its target displaced while the other sees it unmoved, s
(chosen: false detections against reaction time)."""
_OTHER_UNSURE_S: Final = 0.1
"""This time if the other eye does not see its target, or sees it at a third place, s (chosen)."""


@inlined
def squared_mahalanobis(
    state: PredictorState,
    eye: int,
    goals: FloatArray,
    variance: FloatArray,
    delay_variance: FloatArray,
) -> float:
    """Squared Mahalanobis distance of an image's goals of one eye from the filtered ones.

    Args:
        state: the predictor's state.
        eye: index of the eye.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds, rad^2.

    Returns:
        Larger distance of the two joints.
    """
    most = 0.0
    for joint in range(2):
        off = goals[eye, joint] - state.target.goals[eye, joint]
        known = (
            state.target.filter_variance[eye, joint] + state.target.variance_over_delays[eye, joint]
        )
        known += variance[eye, joint] + delay_variance[eye, joint]
        most = max(most, off * off / known)
    return most


@inlined
def has_jumped(
    state: PredictorState,
    params: PredictorParameters,
    eye: int,
    goals: FloatArray,
    variance: FloatArray,
    delay_variance: FloatArray,
    other_eye_unmoved: bool,
) -> bool:
    """True if the displaced detection of one eye has stayed long enough to be its target.

    A lamp or a reflection may be taken for the target in several images. So a displaced target has
    to be confirmed in as many images as the old one was, or for `_OTHER_UNSURE_S`, or for
    `_OTHER_UNMOVED_S` if the other eye sees its target unmoved.

    Args:
        state: the predictor's state; its count of images in a row is updated.
        params: the head's parameters.
        eye: index of the eye.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds, rad^2.
        other_eye_unmoved: True if the other eye sees its target where it was.
    """
    again = state.target.displaced_image_count[eye] > 0.5
    for joint in range(2):
        off = goals[eye, joint] - state.target.displaced_goals[eye, joint]
        known = (
            2.0 * (variance[eye, joint] + delay_variance[eye, joint]) + 2.0 * MODEL_ERROR_SD_RAD**2
        )
        again = again and off * off <= DISPLACED_GATE * known
    state.target.displaced_image_count[eye] = (
        state.target.displaced_image_count[eye] + 1.0 if again else 1.0
    )
    for joint in range(2):
        state.target.displaced_goals[eye, joint] = goals[eye, joint]
    most = max(
        round((_OTHER_UNMOVED_S if other_eye_unmoved else _OTHER_UNSURE_S) / params.frame_period_s),
        2,
    )
    return bool(
        state.target.displaced_image_count[eye]
        > min(max(state.target.confirmations[eye], 2.0), most) - 0.5
    )


_MIN_SPEED_RAD_S: Final = 0.02
"""Least joint speed by which the slip of the eye on the target is normalised, rad/s (chosen)."""
_MOVING_ENCODER_SD_STEPS: Final = 0.6
"""Standard deviation that an encoder adds to a moving target's angle, as a fraction of its
resolution.

Twice the standard deviation of one rounded angle, because many images in a row share one rounding
while an eye creeps (measured on targets at 0.005 to 0.1 rad/s: with 0.3 the eyes' speeds vary by a
third more in the loop of scenario `hardware`, by two thirds more with the head `physical`).
"""


@inlined
def predict_to_exposure(
    state: PredictorState, params: PredictorParameters, exposure_tick: float
) -> None:
    """Predict the target motion models to the exposure of an image (IMM mixing and time update).

    Args:
        state: changed in place.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
    """
    time_s = max(exposure_tick - state.motion.tick, 0.0) * params.period_s
    mixed = np.zeros((MODELS, 12))
    for eye in range(2):
        if state.target.known[eye] > 0.5:
            mix_models(state.motion.models[eye], state.motion.probabilities, mixed)
            predict_motions(state.motion.models[eye], time_s)
    predict_modes(state.motion.probabilities)
    state.motion.tick = exposure_tick


@inlined
def moving_goal_variances(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    variance: FloatArray,
    delay_variance: FloatArray,
    moving_variance: FloatArray,
) -> None:
    """Compute the variances of measured angles of moving targets.

    An error of the exposure time moves a measured angle with the eye, but the target has moved too;
    only the velocity of the eye relative to the target (slip) remains.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        moving_variance: (2, 2) result: variances for a moving target, rad^2.
    """
    for eye in range(2):
        for joint in range(2):
            after = angle_at(state, params.sample_periods, exposure_tick + 0.5, eye, joint)
            before = angle_at(state, params.sample_periods, exposure_tick - 0.5, eye, joint)
            speed = (after - before) / params.period_s
            share = speed - mean_rate(state.motion.models[eye], state.motion.probabilities, joint)
            share = min((share / max(abs(speed), _MIN_SPEED_RAD_S)) ** 2, 1.0)
            dating = LATENCY_JITTER_SD_S * LATENCY_JITTER_SD_S * speed * speed
            own = variance[eye, joint] - (1.0 - share) * dating
            step = _MOVING_ENCODER_SD_STEPS * params.joint_step[eye, joint]
            moving_variance[eye, joint] = own + step * step + share * delay_variance[eye, joint]


_CROSSING_SD_RAD: Final = 0.0006
"""Shift of a goal while a motor crosses its backlash, standard deviation, rad (chosen)."""
_MAX_BACKLASH_RAD: Final = 0.012
"""Largest shift that is taken for backlash, rad (chosen)."""
_MIN_BACKLASH_RAD: Final = 0.0012
"""Smallest shift that is taken for backlash, rad (chosen)."""
_MIN_SQUARED_SHIFT: Final = 16.0
"""Squared shift of a goal, relative to the detection variance, above which it is no noise (chosen:
4 sigma)."""
_MIN_REVERSING_COMMAND: Final = 0.01
"""Command below which a motor does not reverse, rad/s (chosen)."""
_RECENT_REVERSAL_S: Final = 0.25
"""Time after a reversal for which an eye may be at either end of the backlash, s (chosen)."""
_VARIANCE_DECAY: Final = 0.98
"""Per-image decay of the backlash variance that has been found (chosen)."""


@inlined
def inflate_variance_at_reversal(state: PredictorState, p: PackedHead, command: FloatArray) -> None:
    """Increase the variance of goals whose motors are about to reverse and cross their backlash.

    Args:
        state: changed in place.
        p: a packed head.
        command: (4,) commands of the actuators, rad/s.
    """
    for k in range(4):
        if abs(command[k]) < _MIN_REVERSING_COMMAND:
            continue
        side = 1.0 if command[k] > 0.0 else -1.0
        if state.backlash.last_direction[k] == side:
            continue
        state.backlash.last_direction[k] = side
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            if share == 0.0:
                continue
            eye, joint, backlash = j // 2, j % 2, _CROSSING_SD_RAD * share
            state.target.filter_variance[eye, joint] += backlash * backlash
            state.backlash.reversal_tick[eye, joint] = state.periods
            motions: Motions = state.motion.models[eye]
            for m in range(MODELS):  # half, as the covariance is common to both joints
                motions[m].covariance[0] += 0.5 * backlash * backlash


@inlined
def update_backlash_variance(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    eye: int,
    joint: int,
    measured_goal: float,
    at_rest: bool,
) -> float:
    """Update the backlash estimate with a measured goal; return its contribution to the variance.

    Args:
        state: the predictor's state; its backlash estimate is updated in place.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        eye: index of the eye.
        joint: index of its joint.
        measured_goal: the measured goal, rad.
        at_rest: True if the target is taken to rest.

    Returns:
        The variance, rad^2; 0 if the motor has not reversed recently.
    """
    state.backlash.variance[eye, joint] *= _VARIANCE_DECAY
    since_s = (exposure_tick - state.backlash.reversal_tick[eye, joint]) * params.period_s
    if since_s > _RECENT_REVERSAL_S:
        return 0.0
    off = measured_goal - state.target.goals[eye, joint]
    clear = off * off > max(
        _MIN_SQUARED_SHIFT * state.target.detection_variance, _MIN_BACKLASH_RAD * _MIN_BACKLASH_RAD
    )
    if at_rest and clear and abs(off) < _MAX_BACKLASH_RAD:
        half = 0.5 * off
        if state.backlash.jump_sign[eye, joint] * off < 0.0:
            state.backlash.variance[eye, joint] = max(
                state.backlash.variance[eye, joint], half * half
            )
        state.backlash.jump_sign[eye, joint] = 1.0 if off > 0.0 else -1.0
    found: float = state.backlash.variance[eye, joint]
    return found
