"""Image-based visual servoing on the predicted error: the article's law behind a Smith predictor.

Commands are quantised to the resolution of the actuators, see `vergence.controllers.command_steps`.
The law needs no outlier gate, because the predictor has its own.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.command_steps import CommandQuantiser
from vergence.controllers.ibvs import IBVS
from vergence.controllers.prediction.oscillation import OSCILLATING_HALF_SWINGS
from vergence.controllers.prediction.predictor import SmithPredictor
from vergence.controllers.stateful import StatefulController
from vergence.envs.observation import Observation, ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, SLOTS, FloatArray

DEFAULT_GAIN: Final = 10.0
"""Default gain, 1/s (chosen): only the joints' lag is left in the loop, and it bounds the gain."""


class DelayCompensatedIBVS(StatefulController):
    """Applies the law of `IBVS` to the predicted present pixel errors.

    The state is the predictor's state, followed by the rounding errors of the commands.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: see `IBVS`.
        depth: see `IBVS`.
        speed_limit: see `IBVS`.
        delay: `estimated` on line or `nominal`, for both the images' delay and the actuators'
            response, see `SmithPredictor`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        gain: ArrayLike = DEFAULT_GAIN,
        depth: Literal["triangulated"] | float = "triangulated",
        speed_limit: float | None = None,
        delay: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        self.law = IBVS(head=head, layout=layout, gain=gain, depth=depth, speed_limit=speed_limit)
        self.predictor = SmithPredictor(head=head, layout=layout, delay=delay, lag=delay)
        self._quantiser = CommandQuantiser(head, self.layout.action_limits)

    def _initial(self) -> FloatArray:
        return np.concatenate([self.predictor.initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = self.predictor.update(seen, state)
        q = seen.positions.copy()
        q[..., EYES] = present.positions
        command = self.law.command(q, present.pixel_error)
        # the law is linear: scaling its command scales its gain
        excess = np.maximum(present.half_swing_count - OSCILLATING_HALF_SWINGS, 0.0)
        command = command * np.exp2(-excess)[..., None]
        return self._quantiser.quantise(command, state[..., -SLOTS:])
