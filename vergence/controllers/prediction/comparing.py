"""Which delay explains the images of a target that moves.

Its goals go their own way, so that only the eye's sudden motions tell delays: where the eye has
accelerated more than targets do, the second differences of the goals of three images are small
under the true delay alone.
"""

from math import inf, isfinite
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.controllers.prediction.dating import HYPOTHESES, SPACING_S, add_misfit
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import Memory, angle_at
from vergence.models.parts import FloatArray

_SWING_RAD_S2: Final = 4.0
"""How much a target accelerates."""
EXACT_RAD: Final = 0.0004
"""What remains of an innovation whatever is known."""
TELLS: Final = 16.0
"""Square of the eye's motion in question, by the variance of a measured goal, that tells delays."""


@subroutine
def compare_delays(
    memory: Memory,
    rig: Rig,
    came: float,
    low: int,
    high: int,
    then: FloatArray,
    angles: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    added: FloatArray,
) -> None:
    """Weigh the delays by a target that moves: by the second differences of its goals.

    Args:
        memory: what is remembered.
        rig: what is known of the head.
        came: when the image came, in periods.
        low: the first of the delays in question.
        high: the one after the last.
        then: (2, 2) the joints' angles by which its goals were found, rad.
        angles: (HYPOTHESES, 2, 2) these by each delay, rad.
        goals: (2, 2) its goals, rad; nan where there is none.
        variance: (2, 2) their variances, rad^2.
        added: (HYPOTHESES,) what the image adds to the delays' misfits, changed in place.
    """
    one, two = memory.images[0], memory.images[1]
    first, second = came - one.came, one.came - two.came
    if not (0.0 < second < 40.0 and 0.0 < first < 40.0):
        return
    ratio = first / second
    more = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    swing, turns = _SWING_RAD_S2 * (first * rig.period_s) ** 2, np.zeros(HYPOTHESES)
    for eye in range(2):
        if not isfinite(goals[eye, 0] + one.goals[eye, 0] + two.goals[eye, 0]):
            continue
        for joint in range(2):
            spread = more * variance[eye, joint] + swing * swing + EXACT_RAD**2
            rest = goals[eye, joint] - then[eye, joint]
            rest -= (1.0 + ratio) * (one.goals[eye, joint] - one.then[eye, joint])
            rest += ratio * (two.goals[eye, joint] - two.then[eye, joint])
            least, most = inf, -inf
            for i in range(low, high):
                own = (memory.first_delay_s + SPACING_S * i) / rig.period_s
                turn = angles[i, eye, joint]
                before = angle_at(memory, rig.keep_every, one.came - own, eye, joint)
                turn -= (1.0 + ratio) * before
                turn += ratio * angle_at(memory, rig.keep_every, two.came - own, eye, joint)
                turns[i], least, most = turn, min(least, turn), max(most, turn)
            # eyes that follow as smoothly as their target moves do not tell it from themselves
            if (most - least) ** 2 > TELLS * spread:
                for i in range(low, high):
                    add_misfit(added, (rest + turns[i]) ** 2 / spread, i)
