"""Evidence on the image delay from a moving target.

The goals of a moving target change by themselves, so only abrupt motion of the eye carries evidence
on the delay. If the eye has accelerated more than targets do, the second difference of the goals of
three successive images is small under the true delay only.
"""

from math import inf, isfinite
from typing import Final

import numpy as np

from vergence.controllers.prediction.dating import HYPOTHESES, SPACING_S, add_bounded_delay_cost
from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.predictor_state import PredictorState, angle_at
from vergence.kernels import subroutine
from vergence.models.parts import FloatArray

_TARGET_ACCELERATION_SD: Final = 4.0
"""Angular acceleration of a target, standard deviation, rad/s^2 (chosen: larger values make
evidence on the delay rarer, smaller ones take target motion for a delay error)."""
MODEL_ERROR_SD_RAD: Final = 0.0004
"""Standard deviation that an innovation keeps even if everything is known, rad (chosen: model
errors without a term of their own)."""
INFORMATIVE_RATIO: Final = 16.0
"""Squared eye motion between the extreme delays, relative to the variance of a measured goal, above
which an image carries evidence on the delay (chosen: 4 sigma)."""


@subroutine
def add_moving_target_costs(
    state: PredictorState,
    params: PredictorParameters,
    arrival_tick: float,
    first_active: int,
    end_active: int,
    angles_at_exposure: FloatArray,
    angles_by_delay: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    added_costs: FloatArray,
) -> None:
    """Weigh the delay hypotheses on a moving target by the second differences of its goals.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        arrival_tick: arrival of the image (its stamp if the camera stamps exposures), in periods.
        first_active: index of the first delay hypothesis that is not ruled out.
        end_active: index one past the last of them.
        angles_at_exposure: (2, 2) mean joint angles at the exposure, from which the goals were
            computed, rad.
        angles_by_delay: (HYPOTHESES, 2, 2) joint angles at the exposure under each delay, rad.
        goals: (2, 2) measured goals, rad; nan for none.
        variance: (2, 2) variances of the measured goals, rad^2.
        added_costs: (HYPOTHESES,) cost that the image adds to each delay, changed in place.
    """
    one, two = state.images[0], state.images[1]
    first, second = arrival_tick - one.arrival_tick, one.arrival_tick - two.arrival_tick
    if not (0.0 < second < 40.0 and 0.0 < first < 40.0):
        return
    ratio = first / second
    more = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    swing, turns = _TARGET_ACCELERATION_SD * (first * params.period_s) ** 2, np.zeros(HYPOTHESES)
    for eye in range(2):
        if not isfinite(goals[eye, 0] + one.goals[eye, 0] + two.goals[eye, 0]):
            continue
        for joint in range(2):
            innovation_variance = (
                more * variance[eye, joint] + swing * swing + MODEL_ERROR_SD_RAD**2
            )
            rest = goals[eye, joint] - angles_at_exposure[eye, joint]
            rest -= (1.0 + ratio) * (one.goals[eye, joint] - one.angles_at_exposure[eye, joint])
            rest += ratio * (two.goals[eye, joint] - two.angles_at_exposure[eye, joint])
            least, most = inf, -inf
            for i in range(first_active, end_active):
                own = (state.first_delay_s + SPACING_S * i) / params.period_s
                turn = angles_by_delay[i, eye, joint]
                before = angle_at(state, params.sample_periods, one.arrival_tick - own, eye, joint)
                turn -= (1.0 + ratio) * before
                turn += ratio * angle_at(
                    state, params.sample_periods, two.arrival_tick - own, eye, joint
                )
                turns[i], least, most = turn, min(least, turn), max(most, turn)
            # an eye that follows as smoothly as its target moves carries no evidence on the delay
            if (most - least) ** 2 > INFORMATIVE_RATIO * innovation_variance:
                for i in range(first_active, end_active):
                    add_bounded_delay_cost(
                        added_costs, (rest + turns[i]) ** 2 / innovation_variance, i
                    )
