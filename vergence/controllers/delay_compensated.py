"""Image-based visual servoing on the present error: the article's law behind a Smith predictor.

What it commands goes out in the steps that the actuators take, see
`vergence.controllers.command_steps`. It needs no outlier gate: the predictor has its own.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.command_steps import CommandSteps
from vergence.controllers.ibvs import IBVS
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.prediction.swinging import MANY
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import Observation, ObservationLayout
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

DEFAULT_GAIN = 10.0
"""Only the joints' lag is left in the loop, and it bounds the gain, 1/s."""


class DelayCompensated(StatefulController):
    """The law of `IBVS`, on the pixel errors that the eyes have now.

    The state is the predictor's, then what the commands carry over.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: see `IBVS`.
        depth: see `IBVS`.
        speed_limit: see `IBVS`.
        delay: `estimated` on line or `nominal`, that of images and the actuators' response, see
            `Predictor`.

    Raises:
        ConfigurationError: an option has a value that cannot be.
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
        self.predictor = Predictor(head=head, layout=layout, delay=delay, lag=delay)
        self._steps = CommandSteps(head, self.layout.action_limits)

    def _initial(self) -> FloatArray:
        return np.concatenate([self.predictor.initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = self.predictor.update(seen, state)
        q = seen.positions.copy()
        q[..., EYES] = present.positions
        command = self.law.command(q, present.pixel_error)
        # the law is linear: half its gain is half its command
        command = command * np.exp2(-np.maximum(present.swings - MANY, 0.0))[..., None]
        return self._steps.sent(command, state[..., -SLOTS:])
