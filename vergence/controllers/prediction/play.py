r"""What play between motors and eyes makes of the goals.

An encoder on the motor's side does not see which end of the play the eye is at. When a motor turns
round and has crossed its play, the angles that fixate a target at rest are others, by the play. An
eye that hurries from one to the other is late by the images' delay each time, and never rests.
So goals are less sure where a motor turns round. Those that jump to and fro as their motors turn
tell the play; a mean of both lies within it, and there the eye stays where it looks.
"""

from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import Memory
from vergence.controllers.prediction.moving import MODELS, Motions
from vergence.models.packed import PackedHead, joint_per_actuator
from vergence.models.parts import FloatArray

_PLAY_RAD: Final = 0.0006
"""By how much a goal moves as a motor crosses its play, standard deviation."""
_MOST_RAD: Final = 0.012
"""The greatest play in question."""
_LEAST_RAD: Final = 0.0012
_CLEAR: Final = 16.0
"""Square of what a goal jumps by, by a detection's variance, that is no noise."""
_TURNS_RAD_S: Final = 0.01
"""A command below which a motor does not turn round."""
_LATELY_S: Final = 0.25
"""So long after a motor has turned round its eye may be at either end of the play."""
_FORGET: Final = 0.98
"""What is left, from image to image, of the play that has been found."""


@device
def cross_play(memory: Memory, p: PackedHead, command: FloatArray) -> None:
    """Let the goals be less sure where a motor is about to turn round, and cross its play.

    Args:
        memory: changed in place.
        p: a packed head.
        command: (4,) the actuators' commands, rad/s.
    """
    for k in range(4):
        if abs(command[k]) < _TURNS_RAD_S:
            continue
        side = 1.0 if command[k] > 0.0 else -1.0
        if memory.direction[k] == side:
            continue
        memory.direction[k] = side
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            if share == 0.0:
                continue
            eye, joint, play = j // 2, j % 2, _PLAY_RAD * share
            memory.variance[eye, joint] += play * play
            memory.turned[eye, joint] = memory.count
            motions: Motions = memory.motions[eye]
            for m in range(MODELS):  # of the covariance that both joints have in common
                motions[m].covariance[0] += 0.5 * play * play


@device
def play_variance(
    memory: Memory, rig: Rig, exposed: float, eye: int, joint: int, goal: float, rests: bool
) -> float:
    """What the play makes of a measured goal, and what the goal tells of it.

    Args:
        memory: the play that was found is brought up to date in place.
        rig: what is known of the head.
        exposed: when the image was exposed, in periods.
        eye: which eye.
        joint: which of its joints.
        goal: the measured goal, rad.
        rests: whether the target is taken to rest.

    Returns:
        The variance, rad^2.
    """
    memory.play[eye, joint] *= _FORGET
    since_s = (exposed - memory.turned[eye, joint]) * rig.period_s
    if since_s > _LATELY_S:
        return 0.0
    off = goal - memory.goals[eye, joint]
    clear = off * off > max(_CLEAR * memory.noise, _LEAST_RAD * _LEAST_RAD)
    if rests and clear and abs(off) < _MOST_RAD:
        half = 0.5 * off
        if memory.flip[eye, joint] * off < 0.0:
            memory.play[eye, joint] = max(memory.play[eye, joint], half * half)
        memory.flip[eye, joint] = 1.0 if off > 0.0 else -1.0
    found: float = memory.play[eye, joint]
    return found
