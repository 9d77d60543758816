"""Image-based visual servoing on the present error: the article's law behind a Smith predictor."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.ibvs import IBVS
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import Observation, ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

DEFAULT_GAIN = 10.0
"""Only the joints' lag is left in the loop, and it bounds the gain, 1/s."""


class DelayCompensated(StatefulController):
    """The law of `IBVS`, on the pixel errors that the eyes have now.

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

    def _initial(self) -> FloatArray:
        return self.predictor.initial()

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = self.predictor.update(seen, state)
        q = seen.positions.copy()
        q[..., EYES] = present.positions
        return np.asarray(self.law.command(q, present.pixel_error))
