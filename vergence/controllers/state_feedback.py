r"""Linear state feedback on the prediction: the least that a law makes of a known present.

With to_go what an actuator still has to turn when the command begins to act, v its velocity then
and g its speed by command, all of them predicted (`vergence.controllers.prediction.predictor`),

    u = k (to_go - c lag v) / g

Two constants, k in 1/s and c: an actuator that follows its command with a lag is a system of
second order, whose two poles they place. With c = 1 one of them cancels the lag, and what is left
turns at the rate k, which falls where the eyes swing all the same
(`vergence.controllers.prediction.swinging`). An actuator whose lag builds up, as that of a servo
that overshoots, has one pole more, see `vergence.controllers.pole_placement`.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence._jit import kernel
from vergence.controllers.least_command import least_command
from vergence.controllers.pole_placement import placed_command
from vergence.controllers.prediction.joints import RIG, RIG_SIZE, Rig
from vergence.controllers.prediction.predictor import Prediction
from vergence.controllers.prediction.swinging import calm_rate
from vergence.controllers.predictive import PredictiveController
from vergence.controllers.rows import named
from vergence.envs.fields import at_least_zero, finite_above_zero
from vergence.envs.layout import Observation, ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

DEFAULT_LAW: Final = (20.0, 1.0)
"""The options `gain` and `damping` where nothing is said."""


class StateFeedback(PredictiveController):
    """Linear feedback of the predicted angle and velocity of each actuator.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, 1/s.
        damping: c, by which share of the lag's way the velocity counts.
        delay: `estimated` on line or `nominal`, see `Predictor`.
        lag: the same of the actuators' response.

    Raises:
        ConfigurationError: an option has a value that cannot be.
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
        finite_above_zero("gain", gain)
        at_least_zero("damping", damping)
        self._law = np.array([gain, damping])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        return linear_command(self.predictor.update(seen, state), self.predictor.rig, self._law)


def linear_command(now: Prediction, rig: FloatArray, law: ArrayLike) -> FloatArray:
    """The law's commands.

    Args:
        now: what is predicted.
        rig: the row of the head's `vergence.controllers.prediction.joints.Rig`.
        law: (2,) the options `gain` and `damping`.

    Returns:
        (..., 4) by actuator, rad/s.
    """
    follows = np.stack([now.lag_s, now.build_up], axis=-1)
    command = feedback_command(
        now.to_go, now.velocities, now.accelerations, now.known, follows, now.speed_gain,
        now.swings, rig, law,
    )  # fmt: skip
    return np.asarray(command)


@kernel(
    ["(f8[:],f8[:],f8[:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(4),(4),(4),(2),(2),(4),(),({RIG_SIZE}),(2)->(4)",
)
def feedback_command(
    to_go: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    known: NDArray[np.bool_],
    follows: FloatArray,
    gain: FloatArray,
    swings: FloatArray,
    rig_row: FloatArray,
    law: FloatArray,
    out: FloatArray,
) -> None:
    """The commands of one period by actuator, rad/s.

    Args:
        to_go: (4,) angles to the goals, rad.
        velocity: (4,) rad/s.
        acceleration: (4,) rad/s^2.
        known: (2,) whether each eye has a goal; an actuator that moves none with one is held.
        follows: (2,) the lag of the head's timing, s, and its build-up.
        gain: (4,) speeds by commands.
        swings: () half swings that were too many.
        rig_row: a row of `vergence.controllers.prediction.joints.Rig`.
        law: the options `gain` and `damping`.
        out: (4,) the commands.
    """
    rig: Rig = named(rig_row, RIG)
    k = calm_rate(law[0], swings[0])
    for j in range(4):
        out[j] = 0.0
        if not ((known[0] and rig.moves[j, 0] > 0.5) or (known[1] and rig.moves[j, 1] > 0.5)):
            continue
        v, w, lag = velocity[j], acceleration[j], rig.lag_ratio[j] * follows[0]
        limit = gain[j] * rig.speed[j]
        damping = law[1] if follows[1] == 0.0 else 1.0
        u = placed_command(to_go[j], v, w, k, damping * lag, follows[1])
        u = min(max(u, -limit), limit)
        rests = to_go[j] - lag * (v + follows[1] * lag * w)
        out[j] = least_command(u / gain[j], rests, rig, gain[j])
