r"""Linear state feedback on the prediction: the simplest law for a known present state.

With e the angle that an actuator still has to turn when the command begins to act, v its
velocity at that time and g its ratio of velocity to command, all of them predicted
(`vergence.controllers.prediction.predictor`),

    u = k (e - c lag v) / g

An actuator that follows its command with a lag is a second-order system; the constants k (1/s) and
c place its two poles. With c = 1 one of them cancels the lag, and the other one is at the rate k. k
is reduced if the eyes oscillate nevertheless (`vergence.controllers.prediction.oscillation`). An
actuator whose lag builds up, such as a servo that overshoots, has one more pole, see
`vergence.controllers.pole_placement`.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.least_command import compensate_dead_zone
from vergence.controllers.pole_placement import pole_placement_command
from vergence.controllers.prediction.joints import (
    PREDICTOR_PARAMETERS,
    PREDICTOR_PARAMETERS_SIZE,
    PredictorParameters,
)
from vergence.controllers.prediction.oscillation import oscillation_reduced_rate
from vergence.controllers.prediction.predictor import Prediction
from vergence.controllers.predictive import PredictiveController
from vergence.controllers.rows import record_view
from vergence.envs.observation import Observation, ObservationLayout
from vergence.envs.reading import check_above_zero, check_at_least_zero
from vergence.kernels import kernel
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

DEFAULT_LAW: Final = (20.0, 1.0)
"""Default options: `gain` k, 1/s, and `damping` c (chosen)."""


class StateFeedback(PredictiveController):
    """Linear feedback of the predicted angle and velocity of each actuator.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, 1/s.
        damping: c, fraction of the coasting distance lag*v subtracted from the error.
        delay: `estimated` on line or `nominal`, see `SmithPredictor`.
        lag: `estimated` on line or `nominal` response of the actuators, see `SmithPredictor`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        gain: float = DEFAULT_LAW[0],
        damping: float = DEFAULT_LAW[1],
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout, delay=delay, lag=lag)
        check_above_zero("gain", gain)
        check_at_least_zero("damping", damping)
        self._law = np.array([gain, damping])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        return linear_command(self.predictor.update(seen, state), self.predictor.params, self._law)


def linear_command(prediction: Prediction, params_row: FloatArray, law: ArrayLike) -> FloatArray:
    """Compute the law's commands.

    Args:
        prediction: the prediction.
        params_row: the head's packed `vergence.controllers.prediction.joints.PredictorParameters`.
        law: (2,) the options `gain` and `damping`.

    Returns:
        (..., 4) by actuator, rad/s.
    """
    lag_values = np.stack([prediction.lag_s, prediction.build_up], axis=-1)
    command = feedback_command(
        prediction.angle_error, prediction.velocities, prediction.accelerations, prediction.known,
        lag_values, prediction.speed_gain, prediction.half_swing_count, params_row, law,
    )  # fmt: skip
    return np.asarray(command)


@kernel(
    ["(f8[:],f8[:],f8[:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(4),(4),(4),(2),(2),(4),(),({PREDICTOR_PARAMETERS_SIZE}),(2)->(4)",
)
def feedback_command(
    angle_error: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    known: NDArray[np.bool_],
    lag_and_build_up: FloatArray,
    gain: FloatArray,
    half_swing_count: FloatArray,
    params_row: FloatArray,
    law: FloatArray,
    out: FloatArray,
) -> None:
    """Compute the actuators' commands of one period, rad/s.

    Args:
        angle_error: (4,) angles to the goals, rad.
        velocity: (4,) velocities of the actuators, rad/s.
        acceleration: (4,) accelerations of the actuators, rad/s^2.
        known: (2,) True if an eye has a goal; an actuator that moves no such eye is held still.
        lag_and_build_up: (2,) lag in the head's timing, s, and its build-up.
        gain: (4,) ratios of velocity to command.
        half_swing_count: () decayed count of half swings of oscillation.
        params_row: a row of `vergence.controllers.prediction.joints.PredictorParameters`.
        law: the options `gain` and `damping`.
        out: (4,) result: the commands, rad/s.
    """
    params: PredictorParameters = record_view(params_row, PREDICTOR_PARAMETERS)
    k = oscillation_reduced_rate(law[0], half_swing_count[0])
    for j in range(4):
        out[j] = 0.0
        if not (
            (known[0] and params.moves_eye[j, 0] > 0.5)
            or (known[1] and params.moves_eye[j, 1] > 0.5)
        ):
            continue
        v, w, lag = velocity[j], acceleration[j], params.lag_ratio[j] * lag_and_build_up[0]
        limit = gain[j] * params.speed_limit[j]
        damping = law[1] if lag_and_build_up[1] == 0.0 else 1.0
        u = pole_placement_command(angle_error[j], v, w, k, damping * lag, lag_and_build_up[1])
        u = min(max(u, -limit), limit)
        resting_error = angle_error[j] - lag * (v + lag_and_build_up[1] * lag * w)
        out[j] = compensate_dead_zone(u / gain[j], resting_error, params, gain[j])
