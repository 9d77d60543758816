"""Base of laws on the prediction: the angles left to turn when the command begins to act."""

from typing import ClassVar, Literal

from vergence.controllers.prediction.predictor import SmithPredictor
from vergence.controllers.stateful import StatefulController
from vergence.envs.observation import ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class PredictiveController(StatefulController):
    """A controller whose state is that of a `SmithPredictor`.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        delay: `estimated` on line or `nominal`, see `SmithPredictor`.
        lag: `estimated` on line or `nominal` response of the actuators, see `SmithPredictor`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    _targets_move: ClassVar[bool] = False
    """True if targets may move other than by jumps."""

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        self.predictor = SmithPredictor(
            head=head, layout=layout, delay=delay, lag=lag, targets_move=self._targets_move
        )

    def _initial(self) -> FloatArray:
        return self.predictor.initial()
