"""Whether an image shows a target where it was, and where the image before had it."""

from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.comparing import EXACT_RAD
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import Memory
from vergence.models.parts import FloatArray

ELSEWHERE: Final = 36.0
"""Square of the innovation, by its variance, beyond which a goal is elsewhere."""
BESIDE: Final = 9.0
"""The same up to which it is where it was."""
_ALONE_S: Final = 0.25
"""So long one eye alone has to see its target elsewhere."""
_DOUBTED_S: Final = 0.1
"""And so long where the other does not see its own, or sees it elsewhere too but not there."""


@device
def how_far(
    memory: Memory, eye: int, goals: FloatArray, variance: FloatArray, spread: FloatArray
) -> float:
    """How far from where it was an image shows an eye's target: the square, by its variance.

    Args:
        memory: what is remembered.
        eye: which eye.
        goals: (2, 2) those of the image, rad.
        variance: (2, 2) their variances but for the date, rad^2.
        spread: (2, 2) what the date adds, rad^2.

    Returns:
        That of the joint for which it is greater.
    """
    most = 0.0
    for joint in range(2):
        off = goals[eye, joint] - memory.goals[eye, joint]
        known = memory.variance[eye, joint] + memory.doubt[eye, joint]
        known += variance[eye, joint] + spread[eye, joint]
        most = max(most, off * off / known)
    return most


@device
def has_jumped(
    memory: Memory,
    rig: Rig,
    eye: int,
    goals: FloatArray,
    variance: FloatArray,
    spread: FloatArray,
    alone: bool,
) -> bool:
    """Whether what one eye sees elsewhere has stayed there for long enough to be its target.

    A lamp or a reflection may be taken for the target in several images. So it has to be there in
    as many as have confirmed the place before, or for `_DOUBTED_S`, or `_ALONE_S`.

    Args:
        memory: the images in a row are counted in it.
        rig: what is known of the head.
        eye: which eye.
        goals: (2, 2) those of the image, rad.
        variance: (2, 2) their variances but for the date, rad^2.
        spread: (2, 2) what the date adds, rad^2.
        alone: whether the other eye sees its target where it was.
    """
    again = memory.apart[eye] > 0.5
    for joint in range(2):
        off = goals[eye, joint] - memory.elsewhere[eye, joint]
        known = 2.0 * (variance[eye, joint] + spread[eye, joint]) + 2.0 * EXACT_RAD**2
        again = again and off * off <= ELSEWHERE * known
    memory.apart[eye] = memory.apart[eye] + 1.0 if again else 1.0
    for joint in range(2):
        memory.elsewhere[eye, joint] = goals[eye, joint]
    most = max(round((_ALONE_S if alone else _DOUBTED_S) / rig.frame_s), 2)
    return bool(memory.apart[eye] > min(max(memory.sure[eye], 2.0), most) - 0.5)
