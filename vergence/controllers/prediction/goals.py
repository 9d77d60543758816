r"""Goals of the eye joints: measured in images, gated against outliers, filtered over images.

The goals of an image are the joint angles that put its target on the optical axes; the target is
triangulated from the pixels and the joint angles at the exposure. A scalar Kalman filter tracks
each joint's goal under each delay hypothesis that is not ruled out
(`vergence.controllers.prediction.dating`). The variance of a measurement is the sum of several
terms: detection noise, estimated from the scatter about the goals; encoder quantisation and frame
jitter while the joint moves; model error, a fraction of the angle to turn; and the variance across
the likely delays. So a resting eye averages noise, and an image exposed during motion counts for
little until its delay is known.

An innovation far outside its variance means an outlier of the detector or a jump of the target. If
both eyes see the target at one place in space, far from the old one, it has jumped. Any other
displaced detection has to stay at its place for some time, see
`vergence.controllers.prediction.jumps`.
"""

from math import inf, isfinite, nan, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.prediction.comparing import (
    INFORMATIVE_RATIO,
    MODEL_ERROR_SD_RAD,
    add_moving_target_costs,
)
from vergence.controllers.prediction.dating import (
    HYPOTHESES,
    active_delay_range,
    add_bounded_delay_cost,
    decay_and_add_costs,
    delay_posterior,
    forget_delay_evidence,
)
from vergence.controllers.prediction.joints import RING_LENGTH, PredictorParameters
from vergence.controllers.prediction.jumps import has_jumped
from vergence.controllers.prediction.measuring import (
    average_over_delays,
    goal_variance,
    measure_goals,
)
from vergence.controllers.prediction.moving import (
    MODES,
    Motions,
    begin_modes,
    begin_motion,
    update_from_other_eye,
    update_modes,
)
from vergence.controllers.prediction.oscillation import reduce_count_at_jump
from vergence.controllers.prediction.predictor_state import PredictorState, angle_at
from vergence.controllers.prediction.rest_or_motion import (
    classify_innovations,
    likely_model,
    mark_directly_tracked_eyes,
    predict_goal_variances,
    update_motion_models,
)
from vergence.kernels import inlined
from vergence.models.kinematics import PackedHead
from vergence.models.parts import FloatArray

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
            first = state.goals_by_delay[low, eye, joint]
            for i in range(low, high):
                off = state.goals_by_delay[i, eye, joint] - first
                mean += weights[i] * off
                square += weights[i] * off * off
            state.goals[eye, joint] = first + mean
            state.goal_variance_over_delays[eye, joint] = max(square - mean * mean, 0.0)


@inlined
def _readmit_delays(state: PredictorState, low: int, high: int) -> None:
    """Initialise the goals of delays that are considered again with the current mean goals."""
    for i in range(low, high):
        if state.first_active <= i < state.end_active:
            continue
        for eye in range(2):
            for joint in range(2):
                state.goals_by_delay[i, eye, joint] = state.goals[eye, joint]
    state.first_active, state.end_active = low, high


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
    low, high = active_delay_range(state.delay_cost)
    _readmit_delays(state, low, high)
    delay_posterior(state.delay_cost, low, high, weights)
    # eyes at rest for longer than the longest delay: every delay gives the present angles
    still = state.still_periods > (RING_LENGTH - 4.0) * params.sample_periods
    if still:
        exposed = arrived - state.delay_s / params.period_s
        for eye in range(2):
            for joint in range(2):
                angles_at_exposure[eye, joint] = angle_at(
                    state, params.sample_periods, exposed, eye, joint
                )
                for i in range(low, high):
                    angles_by_delay[i, eye, joint] = angles_at_exposure[eye, joint]
    else:
        state.delay_s = average_over_delays(
            state, params, arrived, low, high, weights, angles_by_delay, angles_at_exposure,
            delay_variance,
        )  # fmt: skip
        exposed = arrived - state.delay_s / params.period_s
    depth = (state.depth[0], state.depth[1])
    most = params.max_miss_ratio + 4.0 * sqrt(2.0 * state.detection_variance)
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
    state.known[eye], state.confirmations[eye] = 1.0, 1.0 if agree else 0.0
    for joint in range(2):
        state.filter_variance[eye, joint] = variance[eye, joint]
        for i in range(low, high):
            off = angles_by_delay[i, eye, joint] - angles_at_exposure[eye, joint]
            state.goals_by_delay[i, eye, joint] = goals[eye, joint] + off


@inlined
def _store_image(
    state: PredictorState, arrived: float, goals: FloatArray, angles_at_exposure: FloatArray
) -> None:
    """Store an image as the last one."""
    state.images[1] = state.images[0]
    image = state.images[0]
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
    found = min(scatter / count, 9.0 * state.detection_variance)
    noise = state.detection_variance + 0.25 * count * _NOISE_WEIGHT * (
        found - state.detection_variance
    )
    state.detection_variance = min(max(noise, least * least), most * most)


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
    before = state.filter_variance[eye, joint] + _PROCESS_NOISE_FRACTION * state.detection_variance
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
        innovation = goals[eye, joint] + off - state.goals_by_delay[i, eye, joint]
        if informative:
            add_bounded_delay_cost(added, innovation * innovation / expected, i)
        state.goals_by_delay[i, eye, joint] += gain * innovation
    state.filter_variance[eye, joint] = (1.0 - gain) * before
    calm = (
        delay_variance[eye, joint] < 0.1 * state.detection_variance
        and own < 1.1 * state.detection_variance
    )
    if moves or not calm:
        return -1.0
    off = goals[eye, joint] - state.goals[eye, joint]
    square: float = off * off / (1.0 + before / state.detection_variance)
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
    moves = targets_move and state.mode_probabilities[0] < 0.5
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
        state.depth[0], state.depth[1] = depth[0], depth[1]
    scatter, count = 0.0, 0
    nll, likely = np.zeros(MODES), likely_model(state)
    if targets_move and state.known[0] + state.known[1] == 0.0:
        begin_modes(state.mode_probabilities)
    # an eye whose goals are inferred from the other one is processed second
    first = 1 if inferred[0] else 0
    for number in range(2):
        eye = number ^ first
        if not isfinite(goals[eye, 0]):
            continue
        motions: Motions = state.motions[eye]
        if inferred[eye]:
            if moves and state.displaced_image_count[1 - eye] < 0.5:
                update_from_other_eye(motions, goals[eye], slip[eye])
            goals[eye, 0] = goals[eye, 1] = nan
            continue
        if is_outlier[eye] and not matches_motion[eye]:
            other = 1 - eye
            alone = direct[other] and not is_outlier[other]
            jumped = (outliers == 2 and agree) or state.confirmations[eye] < 0.5
            if not (
                jumped or has_jumped(state, params, eye, goals, variance, delay_variance, alone)
            ):
                continue
        state.displaced_image_count[eye] = 0.0
        if matches_motion[eye]:
            own_scatter = update_motion_models(
                state, params, eye, low, high, angles_at_exposure, angles_by_delay, goals, variance,
                slip, backlash, likely, nll,
            )  # fmt: skip
            if moves and not is_outlier[eye]:
                scatter, count = scatter + own_scatter, count + 2
        elif targets_move:
            begin_motion(motions, goals[eye], variance[eye, 0])
        if is_outlier[eye] or state.known[eye] < 0.5:
            reduce_count_at_jump(state.oscillation)
            _begin_goals(
                state, eye, low, high, goals, angles_at_exposure, angles_by_delay, variance, agree
                or matches_motion[eye],
            )  # fmt: skip
            continue
        state.confirmations[eye] += 1.0
        for joint in range(2):
            square = _filter_joint(
                state, eye, joint, low, high, angles_at_exposure, angles_by_delay, goals, variance,
                delay_variance, moves, added,
            )  # fmt: skip
            if square >= 0.0:
                scatter, count = scatter + square, count + 1
    if targets_move:
        update_modes(state.mode_probabilities, nll)
    if learn and moves:
        add_moving_target_costs(
            state, params, arrived, low, high, angles_at_exposure, angles_by_delay, goals, variance,
            added,
        )  # fmt: skip
    if learn:
        decay_and_add_costs(state.delay_cost, low, high, added)
        # if rest and motion alternate, neither explains the images: the delay may be wrong
        turned = moves != (targets_move and state.mode_probabilities[0] < 0.5)
        state.mode_switches = _SWITCH_COUNT_DECAY * state.mode_switches + (1.0 if turned else 0.0)
        if turned and state.mode_switches > _DOUBT_SWITCH_COUNT:
            forget_delay_evidence(state.delay_cost)
    _store_image(state, arrived, goals, angles_at_exposure)
    if count > 0:
        _learn_noise(state, params, scatter, count)
