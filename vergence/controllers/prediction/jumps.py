"""Whether an image shows a target where it was, and where the image before had it."""

from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.comparing import EXACT_RAD
from vergence.controllers.prediction.memory import Memory
from vergence.models.parts import FloatArray

ELSEWHERE: Final = 36.0
"""Square of the innovation, by its variance, beyond which a goal is elsewhere."""
BESIDE: Final = 9.0
"""The same up to which it is where it was."""


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
def is_again_there(
    memory: Memory, eye: int, goals: FloatArray, variance: FloatArray, spread: FloatArray
) -> bool:
    """Whether it shows it where the last image did, that was not where it had been.

    Args:
        memory: what is remembered.
        eye: which eye.
        goals: (2, 2) those of the image, rad.
        variance: (2, 2) their variances but for the date, rad^2.
        spread: (2, 2) what the date adds, rad^2.
    """
    if memory.apart[eye] < 0.5:
        return False
    for joint in range(2):
        off = goals[eye, joint] - memory.elsewhere[eye, joint]
        known = 2.0 * (variance[eye, joint] + spread[eye, joint]) + 2.0 * EXACT_RAD**2
        if off * off > ELSEWHERE * known:
            return False
    return True
