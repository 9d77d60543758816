"""Decision between rest and motion of each eye's target, from the measured goals of an image.

The likelihood of rest comes from the filtered goals, marginalised over the delay hypotheses; the
likelihood of motion comes from the motion models.
"""

from math import isfinite, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.prediction.backlash import update_backlash_variance
from vergence.controllers.prediction.dating import (
    HYPOTHESES,
    add_bounded_delay_cost,
    marginal_nll,
)
from vergence.controllers.prediction.following import moving_goal_variances, predict_to_exposure
from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.jumps import DISPLACED_GATE, UNMOVED_GATE, squared_mahalanobis
from vergence.controllers.prediction.moving import (
    MODES,
    Motions,
    TargetMotion,
    add_bounded_nll,
    passes_any_gate,
    update_models,
)
from vergence.controllers.prediction.predictor_state import PredictorState
from vergence.kernels import inlined
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
    at_rest = state.mode_probabilities[0] >= 0.5
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
    moves = targets_move and state.mode_probabilities[0] < 0.5
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
                state.motions[eye], state.mode_probabilities, goals[eye], moving_variance[eye]
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
        likely = m if state.mode_probabilities[m] > state.mode_probabilities[likely] else likely
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
    motions: Motions = state.motions[eye]
    costs, own, exact = np.zeros(HYPOTHESES), np.zeros(MODES), np.zeros(2)
    scatter = 0.0
    for joint in range(2):
        step = _REST_SD_STEPS * params.joint_step[eye, joint]
        exact[joint] = _FRICTION_SD_RAD * _FRICTION_SD_RAD + step * step
        known = state.filter_variance[eye, joint] + variance[eye, joint] + exact[joint]
        crossed = known + backlash_variance[eye, joint]
        log_ratio = log(crossed / known)
        own[0] += 0.5 * log(known)
        for i in range(first_active, end_active):
            off = goals[eye, joint] - angles_at_exposure[eye, joint]
            off = off + angles_by_delay[i, eye, joint]
            square = (off - state.goals_by_delay[i, eye, joint]) ** 2
            add_bounded_delay_cost(costs, min(square / known, square / crossed + log_ratio), i)
        motion: TargetMotion = motions[likely_model_index]
        off = goals[eye, joint] - motion.angle[joint]
        # expectation-maximisation estimate of the detection variance
        share = state.detection_variance / (motion.covariance[0] + moving_variance[eye, joint])
        scatter += (share * off) ** 2 + (1.0 - share) * state.detection_variance
    update_models(motions, goals[eye], moving_variance[eye], exact, own)
    own[0] += marginal_nll(state.delay_cost, first_active, end_active, costs)
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
        directly_tracked[eye] = sees and state.known[eye] > 0.5
