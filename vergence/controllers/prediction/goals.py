"""Goals of the eye joints: measured in images, gated against outliers, filtered over images.

The goals of an image are the joint angles that put its target on the optical axes; the target is
triangulated from the pixels and the joint angles at the exposure. A scalar Kalman filter tracks
each joint's goal under each delay hypothesis that is not ruled out
(`vergence.controllers.prediction.delay`). The variance of a measurement is the sum of several
terms: detection noise, estimated from the scatter about the goals; encoder quantisation and frame
jitter while the joint moves; model error, a fraction of the angle to turn; and the variance across
the likely delays. So a resting eye averages noise, and an image exposed during motion counts for
little until its delay is known.

An innovation far outside its variance means an outlier of the detector or a jump of the target. If
both eyes see the target at one place in space, far from the old one, it has jumped. Any other
displaced detection has to stay at its place for some time, see
`vergence.controllers.prediction.measurement.has_jumped`.

From the measured goals of an image it is decided whether each eye's target rests or moves. The
likelihood of rest comes from the filtered goals, marginalised over the delay hypotheses; the
likelihood of motion comes from the motion models.
"""

from math import inf, isfinite, log, nan, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.prediction.delay import (
    HYPOTHESES,
    active_delay_range,
    add_bounded_delay_cost,
    decay_and_add_costs,
    delay_posterior,
    forget_delay_evidence,
    marginal_nll,
)
from vergence.controllers.prediction.measurement import (
    DISPLACED_GATE,
    INFORMATIVE_RATIO,
    MODEL_ERROR_SD_RAD,
    UNMOVED_GATE,
    add_moving_target_costs,
    average_over_delays,
    goal_variance,
    has_jumped,
    measure_goals,
    moving_goal_variances,
    predict_to_exposure,
    squared_mahalanobis,
    update_backlash_variance,
)
from vergence.controllers.prediction.motion_models import (
    MODES,
    Motions,
    TargetMotion,
    add_bounded_nll,
    begin_modes,
    begin_motion,
    passes_any_gate,
    update_from_other_eye,
    update_models,
    update_modes,
)
from vergence.controllers.prediction.oscillation import reduce_count_at_jump
from vergence.controllers.prediction.parameters import RING_LENGTH, PredictorParameters
from vergence.controllers.prediction.state import PredictorState, angle_at
from vergence.kernels import inlined
from vergence.models.kinematics import PackedHead
from vergence.models.parts import FloatArray

_FRICTION_SD_RAD: Final = 0.0004
"""Standard deviation that backlash and friction add to the goal of a resting target, rad
(chosen)."""
_REST_SD_STEPS: Final = 0.5
"""Standard deviation that encoder quantisation adds to it, as a fraction of the resolution
(chosen)."""


@inlined
def predict_goal_variances(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    goals: FloatArray,
    directly_tracked: NDArray[np.bool_],
    variance: FloatArray,
    delay_variance: FloatArray,
    moving_variance: FloatArray,
    backlash_variance: FloatArray,
) -> None:
    """Predict the motion models to an image, and compute the variances of its goals.

    Args:
        state: changed in place.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        goals: (2, 2) goals of the image, rad.
        directly_tracked: (2,) True for an eye that sees its target now and whose target was known
            before.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        moving_variance: (2, 2) result: variances of the goals for a moving target, rad^2.
        backlash_variance: (2, 2) result: variances that backlash adds for a resting target, rad^2.
    """
    at_rest = state.motion.probabilities[0] >= 0.5
    predict_to_exposure(state, params, exposure_tick)
    moving_goal_variances(state, params, exposure_tick, variance, delay_variance, moving_variance)
    for eye in range(2):
        for joint in range(2 if directly_tracked[eye] else 0):
            goal = goals[eye, joint]
            backlash_variance[eye, joint] = update_backlash_variance(
                state, params, exposure_tick, eye, joint, goal, at_rest
            )


@inlined
def classify_innovations(
    state: PredictorState,
    params: PredictorParameters,
    goals: FloatArray,
    directly_tracked: NDArray[np.bool_],
    variance: FloatArray,
    delay_variance: FloatArray,
    moving_variance: FloatArray,
    eyes_agree: bool,
    displaced_from_rest: NDArray[np.bool_],
    matches_motion: NDArray[np.bool_],
) -> int:
    """Test each eye's goal in an image for displacement from rest and for agreement with motion.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        goals: (2, 2) goals of the image, rad.
        directly_tracked: (2,) True for an eye that sees its target now and whose target was known
            before.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        moving_variance: (2, 2) variances of the goals for a moving target, rad^2.
        eyes_agree: True if both eyes see the target at one place in space.
        displaced_from_rest: (2,) result: True if the goal is displaced from that of rest, an
            outlier of that model.
        matches_motion: (2,) result: True if the goal passes the gate of a motion model.

    Returns:
        Number of eyes whose goal fits neither rest nor motion.
    """
    targets_move, stays, outliers = params.targets_move > 0.5, False, 0
    moves = targets_move and state.motion.probabilities[0] < 0.5
    for eye in range(2):
        if directly_tracked[eye]:
            off = squared_mahalanobis(state, eye, goals, variance, delay_variance)
            displaced_from_rest[eye] = off > DISPLACED_GATE
            stays = stays or off < UNMOVED_GATE
    for eye in range(2):
        if not directly_tracked[eye]:
            continue
        if targets_move:
            matches = passes_any_gate(
                state.motion.models[eye],
                state.motion.probabilities,
                goals[eye],
                moving_variance[eye],
            )
            # a resting target displaced in one eye only may be an outlier
            matches_motion[eye] = matches and (
                not displaced_from_rest[eye] or moves or (eyes_agree and not stays)
            )
        if displaced_from_rest[eye] and not matches_motion[eye]:
            outliers += 1
    return outliers


@inlined
def likely_model(state: PredictorState) -> int:
    """Index of the motion model with the largest probability."""
    likely = 1
    for m in range(2, MODES):
        likely = m if state.motion.probabilities[m] > state.motion.probabilities[likely] else likely
    return likely - 1


@inlined
def update_motion_models(
    state: PredictorState,
    params: PredictorParameters,
    eye: int,
    first_active: int,
    end_active: int,
    angles_at_exposure: FloatArray,
    angles_by_delay: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    moving_variance: FloatArray,
    backlash_variance: FloatArray,
    likely_model_index: int,
    nll: FloatArray,
) -> float:
    """Update an eye's motion models with its goal; add the negative log-likelihoods of all modes.

    Args:
        state: changed in place.
        params: the head's parameters.
        eye: index of the eye.
        first_active: index of the first delay hypothesis that is not ruled out.
        end_active: index one past the last of them.
        angles_at_exposure: (2, 2) joint angles at the exposure, from which the goals were computed,
            rad.
        angles_by_delay: (HYPOTHESES, 2, 2) joint angles at the exposure under each delay, rad.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a resting target and a known delay, rad^2.
        moving_variance: (2, 2) variances of the goals for a moving target, rad^2.
        backlash_variance: (2, 2) variances that backlash adds for a resting target, rad^2.
        likely_model_index: index of the likeliest motion model.
        nll: (MODES,) negative log-likelihoods of rest and each model, added to in place.

    Returns:
        Detection variance estimated from the deviation from the likeliest model, summed over both
        joints, rad^2.
    """
    motions: Motions = state.motion.models[eye]
    costs, own, exact = np.zeros(HYPOTHESES), np.zeros(MODES), np.zeros(2)
    scatter = 0.0
    for joint in range(2):
        step = _REST_SD_STEPS * params.joint_step[eye, joint]
        exact[joint] = _FRICTION_SD_RAD * _FRICTION_SD_RAD + step * step
        known = state.target.filter_variance[eye, joint] + variance[eye, joint] + exact[joint]
        crossed = known + backlash_variance[eye, joint]
        log_ratio = log(crossed / known)
        own[0] += 0.5 * log(known)
        for i in range(first_active, end_active):
            off = goals[eye, joint] - angles_at_exposure[eye, joint]
            off = off + angles_by_delay[i, eye, joint]
            square = (off - state.target.goals_by_delay[i, eye, joint]) ** 2
            add_bounded_delay_cost(costs, min(square / known, square / crossed + log_ratio), i)
        motion: TargetMotion = motions[likely_model_index]
        off = goals[eye, joint] - motion.angle[joint]
        # expectation-maximisation estimate of the detection variance
        share = state.target.detection_variance / (
            motion.covariance[0] + moving_variance[eye, joint]
        )
        scatter += (share * off) ** 2 + (1.0 - share) * state.target.detection_variance
    update_models(motions, goals[eye], moving_variance[eye], exact, own)
    own[0] += marginal_nll(state.delays.cost, first_active, end_active, costs)
    add_bounded_nll(nll, own)
    return scatter


@inlined
def mark_directly_tracked_eyes(
    state: PredictorState,
    goals: FloatArray,
    inferred: NDArray[np.bool_],
    directly_tracked: NDArray[np.bool_],
) -> None:
    """Set `directly_tracked` (2,): True for an eye with a known target and a goal of its own."""
    for eye in range(2):
        sees = isfinite(goals[eye, 0]) and not inferred[eye]
        directly_tracked[eye] = sees and state.target.known[eye] > 0.5


_PROCESS_NOISE_FRACTION: Final = 0.02
"""Process noise of a goal per image, as a fraction of the detection variance (chosen: noise against
tracking)."""
_MIN_INFORMATIVE_RAD: Final = 0.012
"""Eye motions below this carry no evidence on the delay, rad (chosen): catching up with a slowly
creeping target looks like another delay."""
_SWITCH_COUNT_DECAY: Final = 0.98
"""Per-image decay of the rest/motion switch counter (chosen)."""
_DOUBT_SWITCH_COUNT: Final = 2.5
"""Value of that counter above which the delay is doubted (chosen)."""
_NOISE_WEIGHT: Final = 0.08
"""Weight of a new image in the estimate of the detection variance (chosen: noise against
adaptation)."""
_LEAST_NOISE_PX: Final = 0.02
"""Lower bound of the estimated detection noise, px (chosen)."""
_MOST_NOISE_PX: Final = 3.0
"""Upper bound of the estimated detection noise, px (chosen)."""


@inlined
def _average_goals(state: PredictorState, low: int, high: int, weights: FloatArray) -> None:
    """Compute the mean and the variance of the goals over the delay hypotheses."""
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            first = state.target.goals_by_delay[low, eye, joint]
            for i in range(low, high):
                off = state.target.goals_by_delay[i, eye, joint] - first
                mean += weights[i] * off
                square += weights[i] * off * off
            state.target.goals[eye, joint] = first + mean
            state.target.variance_over_delays[eye, joint] = max(square - mean * mean, 0.0)


@inlined
def _readmit_delays(state: PredictorState, low: int, high: int) -> None:
    """Initialise the goals of delays that are considered again with the current mean goals."""
    for i in range(low, high):
        if state.delays.first_active <= i < state.delays.end_active:
            continue
        for eye in range(2):
            for joint in range(2):
                state.target.goals_by_delay[i, eye, joint] = state.target.goals[eye, joint]
    state.delays.first_active, state.delays.end_active = low, high


@inlined
def update_with_image(
    state: PredictorState,
    params: PredictorParameters,
    error: FloatArray,
    p: PackedHead,
    learn: bool,
) -> None:
    """Update the goals with a new image.

    Args:
        state: the predictor's state, changed in place; `image_age_s` is the age of the image.
        params: the head's parameters.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan where not visible.
        p: a packed head.
        learn: True to estimate the delay on line.
    """
    weights, delay_variance = np.zeros(HYPOTHESES), np.zeros((2, 2))
    angles_at_exposure, angles_by_delay = np.zeros((2, 2)), np.zeros((HYPOTHESES, 2, 2))
    goals = np.zeros((2, 2))
    inferred = np.zeros(2, dtype=np.bool_)
    arrived = state.periods - (state.image_age_s - params.image_latency_s) / params.period_s
    low, high = active_delay_range(state.delays.cost)
    _readmit_delays(state, low, high)
    delay_posterior(state.delays.cost, low, high, weights)
    # eyes at rest for longer than the longest delay: every delay gives the present angles
    still = state.joints.still_periods > (RING_LENGTH - 4.0) * params.sample_periods
    if still:
        exposed = arrived - state.delays.mean_s / params.period_s
        for eye in range(2):
            for joint in range(2):
                angles_at_exposure[eye, joint] = angle_at(
                    state, params.sample_periods, exposed, eye, joint
                )
                for i in range(low, high):
                    angles_by_delay[i, eye, joint] = angles_at_exposure[eye, joint]
    else:
        state.delays.mean_s = average_over_delays(
            state, params, arrived, low, high, weights, angles_by_delay, angles_at_exposure,
            delay_variance,
        )  # fmt: skip
        exposed = arrived - state.delays.mean_s / params.period_s
    depth = (state.target.depth[0], state.target.depth[1])
    most = params.max_miss_ratio + 4.0 * sqrt(2.0 * state.target.detection_variance)
    agree = measure_goals(state, p, angles_at_exposure, error, most, goals) < most
    for eye in range(2):
        inferred[eye] = not isfinite(error[eye, 0] + error[eye, 1])
    learn = learn and not still
    _filter(
        state, params, arrived, exposed, low, high, angles_at_exposure, delay_variance,
        angles_by_delay, goals, inferred, depth, agree, learn,
    )  # fmt: skip
    _average_goals(state, low, high, weights)


@inlined
def _begin_goals(
    state: PredictorState,
    eye: int,
    low: int,
    high: int,
    goals: FloatArray,
    angles_at_exposure: FloatArray,
    angles_by_delay: FloatArray,
    variance: FloatArray,
    agree: bool,
) -> None:
    """Initialise an eye's goals with an image."""
    state.target.known[eye], state.target.confirmations[eye] = 1.0, 1.0 if agree else 0.0
    for joint in range(2):
        state.target.filter_variance[eye, joint] = variance[eye, joint]
        for i in range(low, high):
            off = angles_by_delay[i, eye, joint] - angles_at_exposure[eye, joint]
            state.target.goals_by_delay[i, eye, joint] = goals[eye, joint] + off


@inlined
def _store_image(
    state: PredictorState, arrived: float, goals: FloatArray, angles_at_exposure: FloatArray
) -> None:
    """Store an image as the last one."""
    state.motion.images[1] = state.motion.images[0]
    image = state.motion.images[0]
    image.arrival_tick = arrived
    for eye in range(2):
        for joint in range(2):
            image.goals[eye, joint] = goals[eye, joint]
            image.angles_at_exposure[eye, joint] = angles_at_exposure[eye, joint]


@inlined
def _learn_noise(
    state: PredictorState, params: PredictorParameters, scatter: float, count: int
) -> None:
    """Update the detection variance with an image's squared deviations: their sum and number."""
    least, most = _LEAST_NOISE_PX * params.pixel_rad, _MOST_NOISE_PX * params.pixel_rad
    found = min(scatter / count, 9.0 * state.target.detection_variance)
    noise = state.target.detection_variance + 0.25 * count * _NOISE_WEIGHT * (
        found - state.target.detection_variance
    )
    state.target.detection_variance = min(max(noise, least * least), most * most)


@inlined
def _filter_joint(
    state: PredictorState,
    eye: int,
    joint: int,
    low: int,
    high: int,
    angles_at_exposure: FloatArray,
    angles_by_delay: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    delay_variance: FloatArray,
    moves: bool,
    added: FloatArray,
) -> float:
    """Update one joint's filtered goals, and the costs of the delays.

    Returns:
        Squared deviation due to detection noise, rad^2; negative if other terms hide it.
    """
    before = (
        state.target.filter_variance[eye, joint]
        + _PROCESS_NOISE_FRACTION * state.target.detection_variance
    )
    own = variance[eye, joint]
    gain = before / (before + own + delay_variance[eye, joint])
    least, most = inf, -inf
    for i in range(low, high):
        angle = angles_by_delay[i, eye, joint]
        least, most = min(least, angle), max(most, angle)
    expected = before + own + MODEL_ERROR_SD_RAD**2
    bound = max(INFORMATIVE_RATIO * expected, _MIN_INFORMATIVE_RAD**2)
    informative = not moves and (most - least) ** 2 > bound
    for i in range(low, high):
        off = angles_by_delay[i, eye, joint] - angles_at_exposure[eye, joint]
        innovation = goals[eye, joint] + off - state.target.goals_by_delay[i, eye, joint]
        if informative:
            add_bounded_delay_cost(added, innovation * innovation / expected, i)
        state.target.goals_by_delay[i, eye, joint] += gain * innovation
    state.target.filter_variance[eye, joint] = (1.0 - gain) * before
    calm = (
        delay_variance[eye, joint] < 0.1 * state.target.detection_variance
        and own < 1.1 * state.target.detection_variance
    )
    if moves or not calm:
        return -1.0
    off = goals[eye, joint] - state.target.goals[eye, joint]
    square: float = off * off / (1.0 + before / state.target.detection_variance)
    return square


@inlined
def _filter(
    state: PredictorState,
    params: PredictorParameters,
    arrived: float,
    exposed: float,
    low: int,
    high: int,
    angles_at_exposure: FloatArray,
    delay_variance: FloatArray,
    angles_by_delay: FloatArray,
    goals: FloatArray,
    inferred: NDArray[np.bool_],
    depth: tuple[float, float],
    agree: bool,
    learn: bool,
) -> None:
    """Update the filtered goals and the costs of the delays with a new image's goals."""
    variance, added = np.zeros((2, 2)), np.zeros(HYPOTHESES)
    outliers = 0.0
    targets_move = params.targets_move > 0.5
    moves = targets_move and state.motion.probabilities[0] < 0.5
    for eye in range(2):
        if not isfinite(goals[eye, 0]):
            continue
        for joint in range(2):
            turn = goals[eye, joint] - angles_at_exposure[eye, joint]
            variance[eye, joint] = goal_variance(state, params, exposed, eye, joint, turn)
    slip, backlash, direct = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2, dtype=np.bool_)
    is_outlier, matches_motion = np.zeros(2, dtype=np.bool_), np.zeros(2, dtype=np.bool_)
    mark_directly_tracked_eyes(state, goals, inferred, direct)
    if targets_move:
        predict_goal_variances(
            state, params, exposed, goals, direct, variance, delay_variance, slip, backlash
        )
    outliers = classify_innovations(
        state, params, goals, direct, variance, delay_variance, slip, agree, is_outlier,
        matches_motion,
    )  # fmt: skip
    if outliers == 1:  # one of the eyes shows an outlier, so the triangulated depth is wrong too
        state.target.depth[0], state.target.depth[1] = depth[0], depth[1]
    scatter, count = 0.0, 0
    nll, likely = np.zeros(MODES), likely_model(state)
    if targets_move and state.target.known[0] + state.target.known[1] == 0.0:
        begin_modes(state.motion.probabilities)
    # an eye whose goals are inferred from the other one is processed second
    first = 1 if inferred[0] else 0
    for number in range(2):
        eye = number ^ first
        if not isfinite(goals[eye, 0]):
            continue
        motions: Motions = state.motion.models[eye]
        if inferred[eye]:
            if moves and state.target.displaced_image_count[1 - eye] < 0.5:
                update_from_other_eye(motions, goals[eye], slip[eye])
            goals[eye, 0] = goals[eye, 1] = nan
            continue
        if is_outlier[eye] and not matches_motion[eye]:
            other = 1 - eye
            alone = direct[other] and not is_outlier[other]
            jumped = (outliers == 2 and agree) or state.target.confirmations[eye] < 0.5
            if not (
                jumped or has_jumped(state, params, eye, goals, variance, delay_variance, alone)
            ):
                continue
        state.target.displaced_image_count[eye] = 0.0
        if matches_motion[eye]:
            own_scatter = update_motion_models(
                state, params, eye, low, high, angles_at_exposure, angles_by_delay, goals, variance,
                slip, backlash, likely, nll,
            )  # fmt: skip
            if moves and not is_outlier[eye]:
                scatter, count = scatter + own_scatter, count + 2
        elif targets_move:
            begin_motion(motions, goals[eye], variance[eye, 0])
        if is_outlier[eye] or state.target.known[eye] < 0.5:
            reduce_count_at_jump(state.oscillation)
            _begin_goals(
                state, eye, low, high, goals, angles_at_exposure, angles_by_delay, variance, agree
                or matches_motion[eye],
            )  # fmt: skip
            continue
        state.target.confirmations[eye] += 1.0
        for joint in range(2):
            square = _filter_joint(
                state, eye, joint, low, high, angles_at_exposure, angles_by_delay, goals, variance,
                delay_variance, moves, added,
            )  # fmt: skip
            if square >= 0.0:
                scatter, count = scatter + square, count + 1
    if targets_move:
        update_modes(state.motion.probabilities, nll)
    if learn and moves:
        add_moving_target_costs(
            state, params, arrived, low, high, angles_at_exposure, angles_by_delay, goals, variance,
            added,
        )  # fmt: skip
    if learn:
        decay_and_add_costs(state.delays.cost, low, high, added)
        # if rest and motion alternate, neither explains the images: the delay may be wrong
        turned = moves != (targets_move and state.motion.probabilities[0] < 0.5)
        state.motion.switches = _SWITCH_COUNT_DECAY * state.motion.switches + (
            1.0 if turned else 0.0
        )
        if turned and state.motion.switches > _DOUBT_SWITCH_COUNT:
            forget_delay_evidence(state.delays.cost)
    _store_image(state, arrived, goals, angles_at_exposure)
    if count > 0:
        _learn_noise(state, params, scatter, count)
