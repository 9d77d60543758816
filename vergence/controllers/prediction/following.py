"""Moving targets in the processing of an image: motion models at its exposure, goal variances."""

from typing import Final

import numpy as np

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.measuring import LATENCY_JITTER_SD_S
from vergence.controllers.prediction.moving import (
    MODELS,
    mean_rate,
    mix_models,
    predict_modes,
    predict_motions,
)
from vergence.controllers.prediction.predictor_state import PredictorState, angle_at
from vergence.kernels import inlined
from vergence.models.parts import FloatArray

_MIN_SPEED_RAD_S: Final = 0.02
"""Least joint speed by which the slip of the eye on the target is normalised, rad/s (chosen)."""
_ENCODER_SD_STEPS: Final = 0.6
"""Standard deviation that an encoder adds to a moving target's angle, as a fraction of its
resolution.

Twice the standard deviation of one rounded angle, because many images in a row share one rounding
while an eye creeps (measured on targets at 0.005 to 0.1 rad/s: with 0.3 the eyes' speeds vary by a
third more in the loop of scenario `hardware`, by two thirds more with the head `physical`).
"""


@inlined
def predict_to_exposure(
    state: PredictorState, params: PredictorParameters, exposure_tick: float
) -> None:
    """Predict the target motion models to the exposure of an image (IMM mixing and time update).

    Args:
        state: changed in place.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
    """
    time_s = max(exposure_tick - state.motion_tick, 0.0) * params.period_s
    mixed = np.zeros((MODELS, 12))
    for eye in range(2):
        if state.known[eye] > 0.5:
            mix_models(state.motions[eye], state.mode_probabilities, mixed)
            predict_motions(state.motions[eye], time_s)
    predict_modes(state.mode_probabilities)
    state.motion_tick = exposure_tick


@inlined
def moving_goal_variances(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    variance: FloatArray,
    delay_variance: FloatArray,
    moving_variance: FloatArray,
) -> None:
    """Compute the variances of measured angles of moving targets.

    An error of the exposure time moves a measured angle with the eye, but the target has moved too;
    only the velocity of the eye relative to the target (slip) remains.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        variance: (2, 2) variances of the goals for a known delay, rad^2.
        delay_variance: (2, 2) variances that the uncertain delay adds for a resting target, rad^2.
        moving_variance: (2, 2) result: variances for a moving target, rad^2.
    """
    for eye in range(2):
        for joint in range(2):
            after = angle_at(state, params.sample_periods, exposure_tick + 0.5, eye, joint)
            before = angle_at(state, params.sample_periods, exposure_tick - 0.5, eye, joint)
            speed = (after - before) / params.period_s
            share = speed - mean_rate(state.motions[eye], state.mode_probabilities, joint)
            share = min((share / max(abs(speed), _MIN_SPEED_RAD_S)) ** 2, 1.0)
            dating = LATENCY_JITTER_SD_S * LATENCY_JITTER_SD_S * speed * speed
            own = variance[eye, joint] - (1.0 - share) * dating
            step = _ENCODER_SD_STEPS * params.joint_step[eye, joint]
            moving_variance[eye, joint] = own + step * step + share * delay_variance[eye, joint]
