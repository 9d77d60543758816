"""The article's law as a robot would run it: the best fixed gain, with outliers held back."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.ibvs import IBVS
from vergence.controllers.image_law import GatedImageController
from vergence.controllers.outlier_gate import GatedDetections
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for, shipped_table
from vergence.envs.observation import ObservationLayout
from vergence.errors import UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class TunedIBVS(GatedImageController):
    """The law of `IBVS` with the best fixed gain of a scenario, as an `GatedImageController`.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        scenario: scenario for which the gain was found.
        gain: see `IBVS`; None for the gain found for this head in the scenario, or, if there is
            none, for the scenario's own head.
        depth: see `IBVS`.
        speed_limit: see `IBVS`.

    Attributes:
        tuned: True if the gain was found for this head; False also for a given gain.

    Raises:
        UnknownNameError: no gain has been found for this scenario.
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        scenario: str = "workspace",
        gain: ArrayLike | None = None,
        depth: Literal["triangulated"] | float = "triangulated",
        speed_limit: float | None = None,
    ) -> None:
        super().__init__(head=head, layout=layout)
        self.scenario = scenario
        self.tuned = False
        if gain is None:
            entry = find_tuned_or_fallback("ibvs-tuned", scenario, head)
            if entry is None:
                known = {key.scenario for key in shipped_table() if key.controller == "ibvs"}
                raise UnknownNameError("scenario", scenario, sorted(known))
            self.tuned = is_tuned_for(entry, head)
            gain = entry.options.get("gain", np.nan)
        self.law = IBVS(head=head, layout=layout, gain=gain, depth=depth, speed_limit=speed_limit)

    @property
    def gain(self) -> FloatArray:
        """(2, 2) gains by eye and image axis, 1/s."""
        return self.law.gain

    def command(self, q: ArrayLike, pixel_error: ArrayLike) -> FloatArray:
        """Compute the law's velocities, see `IBVS.command`."""
        return self.law.command(q, pixel_error)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        return self.law.command(detections.positions_at_exposure, detections.pixel_error)
