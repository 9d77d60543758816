"""Goals of the eye joints: measured in images, gated against outliers, filtered over images.

The goals of an image are the joint angles that put its target on the optical axes; the target is
triangulated from the pixels and the joint angles at the exposure. A scalar Kalman filter tracks
each joint's goal under each delay hypothesis that is not ruled out. A measurement's variance has
several terms: detection noise, estimated from the scatter about the goals; encoder quantisation and
frame jitter while the joint moves; model error, a fraction of the angle to turn; and the variance
across the likely delays. So a resting eye averages noise, and an image exposed during motion counts
for little until its delay is known.

An innovation far outside its variance means an outlier of the detector or a jump of the target. If
both eyes see the target at one place in space, far from the old one, it has jumped; any other
displaced detection has to stay at its place for some time. Whether a target rests or moves follows
from the likelihoods of the filtered goals, marginalised over the delays, and of the motion models.
"""

from math import inf, isfinite, log, nan, sqrt
from typing import Final

import numpy as np

from vergence.controllers.prediction.delay import (
    DOUBTED_COST_FACTOR,
    HYPOTHESES,
    MAX_IMAGE_COST,
    active_delay_range,
    decay_and_add_costs,
    delay_posterior,
    marginal_nll,
)
from vergence.controllers.prediction.measurement import (
    INFORMATIVE_RATIO,
    MODEL_ERROR_SD_RAD,
    NewImage,
    add_moving_target_costs,
    average_over_delays,
    classify_innovations,
    find_exposure,
    goal_variances,
    has_jumped,
    measure_goals,
    new_image,
    predict_motion,
)
from vergence.controllers.prediction.motion_models import (
    MAX_EYE_LOG_RATIO,
    MODELS,
    MODES,
    PRIOR_REST_PROBABILITY,
    Motions,
    TargetMotion,
    begin_motion,
    update_from_other_eye,
    update_models,
    update_modes,
)
from vergence.controllers.prediction.oscillation import COUNT_KEPT_AT_JUMP
from vergence.controllers.prediction.parameters import RING_LENGTH, PredictorParameters
from vergence.controllers.prediction.state import PredictorState, angle_at
from vergence.kernels import inlined
from vergence.models.kinematics import PackedHead
from vergence.models.parts import FloatArray

_FRICTION_SD_RAD: Final = 0.0004
"""Deviation that backlash and friction add to a resting target's goal, rad (chosen)."""
_REST_SD_STEPS: Final = 0.5
"""Deviation that encoder quantisation adds to it, as a fraction of the resolution (chosen)."""


@inlined
def _update_motion_models(
    state: PredictorState, params: PredictorParameters, eye: int, image: NewImage,
    likely_model: int, nll: FloatArray,
) -> float:  # fmt: skip
    """Update an eye's motion models with its goal; add the negative log-likelihoods of all modes.

    Return the detection variance that the likeliest model shows, summed over both joints, rad^2.
    """
    motions: Motions = state.motion.models[eye]
    motion: TargetMotion = motions[likely_model]
    costs, own, exact = np.zeros(HYPOTHESES), np.zeros(MODES), np.zeros(2)
    noise, scatter = state.target.detection_variance, 0.0
    for joint in range(2):
        goal, step = image.goals[eye, joint], _REST_SD_STEPS * params.joint_step[eye, joint]
        exact[joint] = _FRICTION_SD_RAD * _FRICTION_SD_RAD + step * step
        known = state.target.filter_variance[eye, joint] + image.variance[eye, joint] + exact[joint]
        crossed = known + image.backlash_variance[eye, joint]
        log_ratio = log(crossed / known)
        own[0] += 0.5 * log(known)
        for i in range(image.low, image.high):
            off = goal - image.angles[eye, joint] + image.angles_by_delay[i, eye, joint]
            square = (off - state.target.goals_by_delay[i, eye, joint]) ** 2
            costs[i] += min(square / known, square / crossed + log_ratio, MAX_IMAGE_COST)
        # expectation-maximisation estimate of the detection variance
        share = noise / (motion.covariance[0] + image.moving_variance[eye, joint])
        scatter += (share * (goal - motion.angle[joint])) ** 2 + (1.0 - share) * noise
    update_models(motions, image.goals[eye], image.moving_variance[eye], exact, own)
    own[0] += marginal_nll(state.delays.cost, image.low, image.high, costs)
    least = own.min()
    for m in range(MODES):  # bounded so that no outlier rules out a mode
        nll[m] += min(own[m] - least, MAX_EYE_LOG_RATIO)
    return scatter


_PROCESS_NOISE_FRACTION: Final = 0.02
"""Process noise of a goal in an image per detection variance (chosen: noise against tracking)."""
_MIN_INFORMATIVE_RAD: Final = 0.012
"""Least eye motion that tells of the delay, rad (chosen: catching up a creeping target is less)."""
_SWITCH_COUNT_DECAY: Final = 0.98  # per-image decay of the rest/motion switch counter (chosen)
_DOUBT_SWITCH_COUNT: Final = 2.5  # value of that counter above which the delay is doubted (chosen)
_NOISE_WEIGHT: Final = 0.08
"""Weight of a new image in the detection variance (chosen: noise against adaptation)."""
_NOISE_PX: Final = (0.02, 3.0)  # bounds of the estimated detection noise, px (chosen)


@inlined
def update_with_image(
    state: PredictorState, params: PredictorParameters, error: FloatArray, p: PackedHead,
    learn: bool,
) -> None:  # fmt: skip
    """Update the goals with a new image, and the delay if `learn`.

    `state.image_age_s` is the age of the image; `error` are the undistorted pixel errors (2, 2) by
    eye and image axis, px, nan where not visible.
    """
    delays, target, weights = state.delays, state.target, np.zeros(HYPOTHESES)
    arrived = state.periods - (state.image_age_s - params.image_latency_s) / params.period_s
    low, high = active_delay_range(delays.cost)
    image = new_image(arrived, low, high)
    for i in range(low, high):  # delays that are considered again
        if not delays.first_active <= i < delays.end_active:
            target.goals_by_delay[i, :, :] = target.goals
    delays.first_active, delays.end_active = low, high
    delay_posterior(delays.cost, low, high, weights)
    # eyes at rest for longer than the longest delay: every delay gives the present angles
    still = state.joints.still_periods > (RING_LENGTH - 4.0) * params.sample_periods
    if still:
        exposed = arrived - delays.mean_s / params.period_s
        for eye in range(2):
            for joint in range(2):
                image.angles[eye, joint] = angle_at(state, params, exposed, eye, joint)
                image.angles_by_delay[low:high, eye, joint] = image.angles[eye, joint]
    else:
        delays.mean_s = find_exposure(state, params, image, weights)
        exposed = arrived - delays.mean_s / params.period_s
    depth = (target.depth[0], target.depth[1])
    most = params.max_miss_ratio + 4.0 * sqrt(2.0 * target.detection_variance)
    agree = measure_goals(state, p, image, error, most) < most
    _filter(state, params, exposed, image, depth, agree, learn and not still)
    average_over_delays(
        target.goals_by_delay, weights, low, high, target.goals, target.variance_over_delays
    )


@inlined
def _begin_goals(state: PredictorState, eye: int, image: NewImage, confirmed: bool) -> None:
    """Initialise an eye's goals with an image."""
    state.target.known[eye], state.target.confirmations[eye] = 1.0, 1.0 if confirmed else 0.0
    for joint in range(2):
        state.target.filter_variance[eye, joint] = image.variance[eye, joint]
        for i in range(image.low, image.high):
            off = image.angles_by_delay[i, eye, joint] - image.angles[eye, joint]
            state.target.goals_by_delay[i, eye, joint] = image.goals[eye, joint] + off


@inlined
def _filter_joint(
    state: PredictorState, eye: int, joint: int, image: NewImage, moves: bool, added: FloatArray
) -> float:
    """Update one joint's filtered goals, and the costs of the delays.

    Return the squared deviation due to detection noise, rad^2; negative if other terms hide it.
    """
    target, noise = state.target, state.target.detection_variance
    goal, angle, own = image.goals[eye, joint], image.angles[eye, joint], image.variance[eye, joint]
    before = target.filter_variance[eye, joint] + _PROCESS_NOISE_FRACTION * noise
    gain = before / (before + own + image.delay_variance[eye, joint])
    least, most = inf, -inf
    for i in range(image.low, image.high):
        least = min(least, image.angles_by_delay[i, eye, joint])
        most = max(most, image.angles_by_delay[i, eye, joint])
    expected = before + own + MODEL_ERROR_SD_RAD**2
    bound = max(INFORMATIVE_RATIO * expected, _MIN_INFORMATIVE_RAD**2)
    informative = not moves and (most - least) ** 2 > bound
    for i in range(image.low, image.high):
        off = image.angles_by_delay[i, eye, joint] - angle
        innovation = goal + off - target.goals_by_delay[i, eye, joint]
        if informative:
            added[i] += min(innovation * innovation / expected, MAX_IMAGE_COST)
        target.goals_by_delay[i, eye, joint] += gain * innovation
    target.filter_variance[eye, joint] = (1.0 - gain) * before
    calm = image.delay_variance[eye, joint] < 0.1 * noise and own < 1.1 * noise
    if moves or not calm:
        return -1.0
    off = goal - target.goals[eye, joint]
    square: float = off * off / (1.0 + before / noise)
    return square


@inlined
def _filter(
    state: PredictorState, params: PredictorParameters, exposed: float, image: NewImage,
    depth: tuple[float, float], agree: bool, learn: bool,
) -> None:  # fmt: skip
    """Update the filtered goals and the costs of the delays with a new image's goals."""
    target, motion, added, nll = state.target, state.motion, np.zeros(HYPOTHESES), np.zeros(MODES)
    targets_move = params.targets_move > 0.5
    moves = targets_move and motion.probabilities[0] < 0.5
    goal_variances(state, params, exposed, image)
    for eye in range(2):
        sees = isfinite(image.goals[eye, 0]) and not image.inferred[eye]
        image.tracked[eye] = sees and target.known[eye] > 0.5
    if targets_move:
        predict_motion(state, params, exposed, image, not moves)
    outliers = classify_innovations(
        state, image, targets_move, targets_move and motion.probabilities[0] < 0.5, agree
    )
    if outliers == 1:  # one of the eyes shows an outlier, so the triangulated depth is wrong too
        target.depth[0], target.depth[1] = depth[0], depth[1]
    scatter, count = 0.0, 0
    likely_model = int(np.argmax(motion.probabilities[1:]))
    if targets_move and target.known[0] + target.known[1] == 0.0:
        motion.probabilities[0] = PRIOR_REST_PROBABILITY
        motion.probabilities[1:] = (1.0 - PRIOR_REST_PROBABILITY) / MODELS
    # an eye whose goals are inferred from the other one is processed second
    first = 1 if image.inferred[0] else 0
    for number in range(2):
        eye = number ^ first
        if not isfinite(image.goals[eye, 0]):
            continue
        motions: Motions = motion.models[eye]
        if image.inferred[eye]:
            if moves and target.displaced_image_count[1 - eye] < 0.5:
                update_from_other_eye(motions, image.goals[eye], image.moving_variance[eye])
            image.goals[eye, :] = nan
            continue
        if image.displaced[eye] and not image.matches_motion[eye]:
            other = 1 - eye
            alone = image.tracked[other] and not image.displaced[other]
            jumped = (outliers == 2 and agree) or target.confirmations[eye] < 0.5
            if not (jumped or has_jumped(state, params, eye, image, alone)):
                continue
        target.displaced_image_count[eye] = 0.0
        if image.matches_motion[eye]:
            own_scatter = _update_motion_models(state, params, eye, image, likely_model, nll)
            if moves and not image.displaced[eye]:
                scatter, count = scatter + own_scatter, count + 2
        elif targets_move:
            begin_motion(motions, image.goals[eye], image.variance[eye, 0])
        if image.displaced[eye] or target.known[eye] < 0.5:
            state.oscillation.half_swing_count *= COUNT_KEPT_AT_JUMP
            _begin_goals(state, eye, image, agree or image.matches_motion[eye])
            continue
        target.confirmations[eye] += 1.0
        for joint in range(2):
            square = _filter_joint(state, eye, joint, image, moves, added)
            if square >= 0.0:
                scatter, count = scatter + square, count + 1
    if targets_move:
        update_modes(motion.probabilities, nll)
    if learn and moves:
        add_moving_target_costs(state, params, image, added)
    if learn:
        decay_and_add_costs(state.delays.cost, image.low, image.high, added)
        # if rest and motion alternate, neither explains the images: the delay may be wrong
        turned = moves != (targets_move and motion.probabilities[0] < 0.5)
        motion.switches = _SWITCH_COUNT_DECAY * motion.switches + (1.0 if turned else 0.0)
        if turned and motion.switches > _DOUBT_SWITCH_COUNT:
            for i in range(HYPOTHESES):
                state.delays.cost[i] *= DOUBTED_COST_FACTOR
    motion.images[1] = motion.images[0]
    last = motion.images[0]
    last.arrival_tick = image.arrival_tick
    last.goals[:], last.angles_at_exposure[:] = image.goals, image.angles
    if count > 0:  # the detection variance follows the mean squared deviation
        least, most = _NOISE_PX[0] * params.pixel_rad, _NOISE_PX[1] * params.pixel_rad
        before = target.detection_variance
        found = min(scatter / count, 9.0 * before)
        noise = before + 0.25 * count * _NOISE_WEIGHT * (found - before)
        target.detection_variance = min(max(noise, least * least), most * most)
