r"""Effect of backlash between motors and eyes on the goals.

An encoder on the motor's side does not show which end of the backlash (play) the eye is at. When a
motor reverses and has crossed its backlash, the motor angles that fixate a resting target differ by
the backlash. An eye that turns to each new goal lags by the images' delay every time and never
comes to rest. Therefore goals get a larger variance when a motor reverses. Goals that jump to and
fro as their motors reverse reveal the backlash; a mean of both lies within it, and there the eye
keeps its direction.
"""

from typing import Final

from vergence._jit import inlined
from vergence.controllers.prediction.joints import PredictorModel
from vergence.controllers.prediction.memory import PredictorState
from vergence.controllers.prediction.moving import MODELS, Motions
from vergence.models.packed import PackedHead, joint_per_actuator
from vergence.models.parts import FloatArray

_BACKLASH_RAD: Final = 0.0006
"""Shift of a goal while a motor crosses its backlash, standard deviation, rad (chosen)."""
_MOST_RAD: Final = 0.012
"""Largest shift that is taken for backlash, rad (chosen)."""
_LEAST_RAD: Final = 0.0012
"""Smallest shift that is taken for backlash, rad (chosen)."""
_CLEAR: Final = 16.0
"""Squared shift of a goal, relative to the detection variance, above which it is no noise (chosen:
4 sigma)."""
_TURNS_RAD_S: Final = 0.01
"""Command below which a motor does not reverse, rad/s (chosen)."""
_LATELY_S: Final = 0.25
"""Time after a reversal for which an eye may be at either end of the backlash, s (chosen)."""
_FORGET: Final = 0.98
"""Per-image decay of the backlash variance that has been found (chosen)."""


@inlined
def cross_backlash(memory: PredictorState, p: PackedHead, command: FloatArray) -> None:
    """Increase the variance of goals whose motors are about to reverse and cross their backlash.

    Args:
        memory: changed in place.
        p: a packed head.
        command: (4,) commands of the actuators, rad/s.
    """
    for k in range(4):
        if abs(command[k]) < _TURNS_RAD_S:
            continue
        side = 1.0 if command[k] > 0.0 else -1.0
        if memory.last_direction[k] == side:
            continue
        memory.last_direction[k] = side
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            if share == 0.0:
                continue
            eye, joint, backlash = j // 2, j % 2, _BACKLASH_RAD * share
            memory.filter_variance[eye, joint] += backlash * backlash
            memory.reversed_at[eye, joint] = memory.periods
            motions: Motions = memory.motions[eye]
            for m in range(MODELS):  # half, as the covariance is common to both joints
                motions[m].covariance[0] += 0.5 * backlash * backlash


@inlined
def backlash_variance(
    memory: PredictorState,
    rig: PredictorModel,
    exposed: float,
    eye: int,
    joint: int,
    goal: float,
    at_rest: bool,
) -> float:
    """Update the backlash estimate with a measured goal; return its contribution to the variance.

    Args:
        memory: the predictor's state; its backlash estimate is updated in place.
        rig: the head's parameters.
        exposed: exposure time of the image, in periods.
        eye: index of the eye.
        joint: index of its joint.
        goal: the measured goal, rad.
        at_rest: True if the target is taken to rest.

    Returns:
        The variance, rad^2; 0 if the motor has not reversed recently.
    """
    memory.backlash_variance[eye, joint] *= _FORGET
    since_s = (exposed - memory.reversed_at[eye, joint]) * rig.period_s
    if since_s > _LATELY_S:
        return 0.0
    off = goal - memory.goals[eye, joint]
    clear = off * off > max(_CLEAR * memory.detection_variance, _LEAST_RAD * _LEAST_RAD)
    if at_rest and clear and abs(off) < _MOST_RAD:
        half = 0.5 * off
        if memory.jump_sign[eye, joint] * off < 0.0:
            memory.backlash_variance[eye, joint] = max(
                memory.backlash_variance[eye, joint], half * half
            )
        memory.jump_sign[eye, joint] = 1.0 if off > 0.0 else -1.0
    found: float = memory.backlash_variance[eye, joint]
    return found
