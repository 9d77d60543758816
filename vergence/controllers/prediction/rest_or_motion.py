"""Whether what an image shows of each eye's target is that of one at rest, or of one that moves.

Both are asked by the likelihood of the measured goals: rest by that of the filtered ones, over all
delays in question, and motion by that of its models.
"""

from math import isfinite, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import device
from vergence.controllers.prediction.dating import HYPOTHESES, add_misfit, unlikely
from vergence.controllers.prediction.following import carry_motions, slip_variances
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.jumps import BESIDE, ELSEWHERE, how_far
from vergence.controllers.prediction.memory import Memory
from vergence.controllers.prediction.moving import (
    WEIGHTS,
    EyeMotion,
    Motions,
    add_surprises,
    fits,
    take_in,
)
from vergence.controllers.prediction.play import play_variance
from vergence.models.parts import FloatArray

_UNEVEN_RAD: Final = 0.0004
"""What play and friction make of a goal at rest, which is no motion."""
_UNEVEN: Final = 0.5
"""The same of an encoder, as a share of its step."""


@device
def expect_motion(
    memory: Memory,
    rig: Rig,
    exposed: float,
    goals: FloatArray,
    direct: NDArray[np.bool_],
    variance: FloatArray,
    spread: FloatArray,
    slip: FloatArray,
    play: FloatArray,
) -> None:
    """Bring the targets' motions to the time of an image, and tell how surely it shows them.

    Args:
        memory: changed in place.
        rig: what is known of the head.
        exposed: when the image was exposed, in periods.
        goals: (2, 2) its goals, rad.
        direct: (2,) whether each eye sees its target, and has before.
        variance: (2, 2) variances of the goals but for the date, rad^2.
        spread: (2, 2) what the date adds while the target rests, rad^2.
        slip: (2, 2) result: variances of the goals of moving targets, rad^2.
        play: (2, 2) result: what the play may make of the goals of resting ones, rad^2.
    """
    rests = memory.ways[0] >= 0.5
    carry_motions(memory, rig, exposed)
    slip_variances(memory, rig, exposed, variance, spread, slip)
    for eye in range(2):
        for joint in range(2 if direct[eye] else 0):
            goal = goals[eye, joint]
            play[eye, joint] = play_variance(memory, rig, exposed, eye, joint, goal, rests)


@device
def tell_apart(
    memory: Memory,
    rig: Rig,
    goals: FloatArray,
    direct: NDArray[np.bool_],
    variance: FloatArray,
    spread: FloatArray,
    slip: FloatArray,
    agree: bool,
    elsewhere: NDArray[np.bool_],
    on_its_way: NDArray[np.bool_],
) -> int:
    """Whether an image shows each eye's target elsewhere, and whether that is on its way.

    Args:
        memory: what is remembered.
        rig: what is known of the head.
        goals: (2, 2) the goals of the image, rad.
        direct: (2,) whether each eye sees its target, and has before.
        variance: (2, 2) variances of the goals but for the date, rad^2.
        spread: (2, 2) what the date adds while the target rests, rad^2.
        slip: (2, 2) variances of the goals of moving targets, rad^2.
        agree: whether both eyes see it at one place in space.
        elsewhere: (2,) result.
        on_its_way: (2,) result.

    Returns:
        How many eyes have it elsewhere than rest and motion do.
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
            # what has rested, and one eye alone sees elsewhere, may also be an outlier
            on_its_way[eye] = fit and (not elsewhere[eye] or moves or (agree and not stays))
        if elsewhere[eye] and not on_its_way[eye]:
            apart += 1
    return apart


@device
def likely_model(memory: Memory) -> int:
    """The model of motion that is likeliest."""
    likely = 1
    for m in range(2, WEIGHTS):
        likely = m if memory.ways[m] > memory.ways[likely] else likely
    return likely - 1


@device
def follow(
    memory: Memory,
    rig: Rig,
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
    """Take what an eye sees of a target on its way into its motions, and weigh these and rest.

    Args:
        memory: changed in place.
        rig: what is known of the head.
        eye: which eye.
        low: the first of the delays in question.
        high: the one after the last.
        then: (2, 2) the joints' angles by which the goals were found, rad.
        angles: (HYPOTHESES, 2, 2) these by each delay, rad.
        goals: (2, 2) the goals of the image, rad.
        variance: (2, 2) their variances while the target rests, but for the date, rad^2.
        slip: (2, 2) their variances while it moves, rad^2.
        play: (2, 2) what the play may make of them while it rests, rad^2.
        likely: the likeliest model of motion.
        surprises: (WEIGHTS,) to which it adds how little rest and each model have expected them.

    Returns:
        What the detection has of the scatter about the likeliest model, for both joints, rad^2.
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
        # expectation and maximization
        share = memory.noise / (motion.covariance[0] + slip[eye, joint])
        scatter += (share * off) ** 2 + (1.0 - share) * memory.noise
    take_in(motions, goals[eye], slip[eye], exact, own)
    own[0] += unlikely(memory.misfit, low, high, explained)
    add_surprises(surprises, own)
    return scatter


@device
def sees_directly(
    memory: Memory, goals: FloatArray, inferred: NDArray[np.bool_], direct: NDArray[np.bool_]
) -> None:
    """Whether each eye sees its target (2,), and has before, from its goals (2, 2)."""
    for eye in range(2):
        sees = isfinite(goals[eye, 0]) and not inferred[eye]
        direct[eye] = sees and memory.known[eye] > 0.5
