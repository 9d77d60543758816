"""Decision between rest and motion of each eye's target, from the measured goals of an image.

The likelihood of rest comes from the filtered goals, marginalised over the delay hypotheses; the
likelihood of motion comes from the motion models.
"""

from math import isfinite, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import inlined
from vergence.controllers.prediction.backlash import play_variance
from vergence.controllers.prediction.dating import HYPOTHESES, add_misfit, unlikely
from vergence.controllers.prediction.following import carry_motions, slip_variances
from vergence.controllers.prediction.joints import PredictorModel
from vergence.controllers.prediction.jumps import BESIDE, ELSEWHERE, how_far
from vergence.controllers.prediction.memory import PredictorState
from vergence.controllers.prediction.moving import (
    WEIGHTS,
    EyeMotion,
    Motions,
    add_surprises,
    fits,
    take_in,
)
from vergence.models.parts import FloatArray

_UNEVEN_RAD: Final = 0.0004
"""Standard deviation that backlash and friction add to the goal of a resting target, rad
(chosen)."""
_UNEVEN: Final = 0.5
"""Standard deviation that encoder quantisation adds to it, as a fraction of the resolution
(chosen)."""


@inlined
def expect_motion(
    memory: PredictorState,
    rig: PredictorModel,
    exposed: float,
    goals: FloatArray,
    direct: NDArray[np.bool_],
    variance: FloatArray,
    spread: FloatArray,
    slip: FloatArray,
    play: FloatArray,
) -> None:
    """Predict the motion models to an image, and compute the variances of its goals.

    Args:
        memory: changed in place.
        rig: the head's parameters.
        exposed: exposure time of the image, in periods.
        goals: (2, 2) goals of the image, rad.
        direct: (2,) True for an eye that sees its target now and whose target was known before.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        spread: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        slip: (2, 2) result: variances of the goals for a moving target, rad^2.
        play: (2, 2) result: variances that backlash adds for a resting target, rad^2.
    """
    rests = memory.ways[0] >= 0.5
    carry_motions(memory, rig, exposed)
    slip_variances(memory, rig, exposed, variance, spread, slip)
    for eye in range(2):
        for joint in range(2 if direct[eye] else 0):
            goal = goals[eye, joint]
            play[eye, joint] = play_variance(memory, rig, exposed, eye, joint, goal, rests)


@inlined
def tell_apart(
    memory: PredictorState,
    rig: PredictorModel,
    goals: FloatArray,
    direct: NDArray[np.bool_],
    variance: FloatArray,
    spread: FloatArray,
    slip: FloatArray,
    agree: bool,
    elsewhere: NDArray[np.bool_],
    on_its_way: NDArray[np.bool_],
) -> int:
    """Test each eye's goal in an image for displacement from rest and for agreement with motion.

    Args:
        memory: the predictor's state.
        rig: the head's parameters.
        goals: (2, 2) goals of the image, rad.
        direct: (2,) True for an eye that sees its target now and whose target was known before.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        spread: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        slip: (2, 2) variances of the goals for a moving target, rad^2.
        agree: True if both eyes see the target at one place in space.
        elsewhere: (2,) result: True if the goal is displaced from that of rest.
        on_its_way: (2,) result: True if the goal fits the motion models.

    Returns:
        Number of eyes whose goal fits neither rest nor motion.
    """
    follows, stays, apart = rig.follows > 0.5, False, 0
    moves = follows and memory.ways[0] < 0.5
    for eye in range(2):
        if direct[eye]:
            off = how_far(memory, eye, goals, variance, spread)
            elsewhere[eye] = off > ELSEWHERE
            stays = stays or off < BESIDE
    for eye in range(2):
        if not direct[eye]:
            continue
        if follows:
            fit = fits(memory.motions[eye], memory.ways, goals[eye], slip[eye])
            # a resting target displaced in one eye only may be an outlier
            on_its_way[eye] = fit and (not elsewhere[eye] or moves or (agree and not stays))
        if elsewhere[eye] and not on_its_way[eye]:
            apart += 1
    return apart


@inlined
def likely_model(memory: PredictorState) -> int:
    """Index of the motion model with the largest probability."""
    likely = 1
    for m in range(2, WEIGHTS):
        likely = m if memory.ways[m] > memory.ways[likely] else likely
    return likely - 1


@inlined
def follow(
    memory: PredictorState,
    rig: PredictorModel,
    eye: int,
    low: int,
    high: int,
    then: FloatArray,
    angles: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    slip: FloatArray,
    play: FloatArray,
    likely: int,
    surprises: FloatArray,
) -> float:
    """Update an eye's motion models with its goal; add the negative log-likelihoods of all modes.

    Args:
        memory: changed in place.
        rig: the head's parameters.
        eye: index of the eye.
        low: index of the first delay hypothesis that is not ruled out.
        high: index one past the last of them.
        then: (2, 2) joint angles at the exposure, from which the goals were computed, rad.
        angles: (HYPOTHESES, 2, 2) joint angles at the exposure under each delay, rad.
        goals: (2, 2) goals of the image, rad.
        variance: (2, 2) variances of the goals for a resting target and a known delay, rad^2.
        slip: (2, 2) variances of the goals for a moving target, rad^2.
        play: (2, 2) variances that backlash adds for a resting target, rad^2.
        likely: index of the likeliest motion model.
        surprises: (WEIGHTS,) negative log-likelihoods of rest and each model, added to in place.

    Returns:
        Detection variance estimated from the deviation from the likeliest model, summed over both
        joints, rad^2.
    """
    motions: Motions = memory.motions[eye]
    explained, own, exact = np.zeros(HYPOTHESES), np.zeros(WEIGHTS), np.zeros(2)
    scatter = 0.0
    for joint in range(2):
        step = _UNEVEN * rig.joint_step[eye, joint]
        exact[joint] = _UNEVEN_RAD * _UNEVEN_RAD + step * step
        known = memory.variance[eye, joint] + variance[eye, joint] + exact[joint]
        crossed = known + play[eye, joint]
        rarely = log(crossed / known)
        own[0] += 0.5 * log(known)
        for i in range(low, high):
            off = goals[eye, joint] - then[eye, joint] + angles[i, eye, joint]
            square = (off - memory.goals_by_delay[i, eye, joint]) ** 2
            add_misfit(explained, min(square / known, square / crossed + rarely), i)
        motion: EyeMotion = motions[likely]
        off = goals[eye, joint] - motion.angle[joint]
        # expectation-maximisation estimate of the detection variance
        share = memory.noise / (motion.covariance[0] + slip[eye, joint])
        scatter += (share * off) ** 2 + (1.0 - share) * memory.noise
    take_in(motions, goals[eye], slip[eye], exact, own)
    own[0] += unlikely(memory.misfit, low, high, explained)
    add_surprises(surprises, own)
    return scatter


@inlined
def sees_directly(
    memory: PredictorState,
    goals: FloatArray,
    inferred: NDArray[np.bool_],
    direct: NDArray[np.bool_],
) -> None:
    """Set `direct` (2,): True for an eye with a goal (2, 2) of its own and a known target."""
    for eye in range(2):
        sees = isfinite(goals[eye, 0]) and not inferred[eye]
        direct[eye] = sees and memory.known[eye] > 0.5
