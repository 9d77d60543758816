"""Base of laws on pixel errors that tolerate outliers, missed detections and quantised commands.

The law receives the detections that pass the outlier gate, and its commands are quantised to the
resolution of the actuators. In a loop without these faults neither changes anything.
"""

from abc import abstractmethod

import numpy as np

from vergence.controllers.command_steps import CommandQuantiser
from vergence.controllers.outlier_gate import GatedDetections, OutlierGate
from vergence.controllers.stateful import StatefulController
from vergence.envs.observation import Observation, ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.parts import SLOTS, FloatArray


class GatedImageController(StatefulController):
    """Base of controllers with a law on pixel errors.

    Detections pass an `OutlierGate` before the law, and its commands a `CommandQuantiser`.

    The state is that of the gate, then the law's own, then the rounding errors of the commands.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        super().__init__(head=head, layout=layout)
        self._gate = OutlierGate(head, self.layout)
        self._quantiser = CommandQuantiser(head, self.layout.action_limits)

    def _own_initial(self) -> FloatArray:
        """(S,) the law's own state at a trial's start; empty unless overridden."""
        return np.zeros(0)

    @abstractmethod
    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; changes `own` (..., S) in place."""

    def _initial(self) -> FloatArray:
        return np.concatenate([self._gate.initial(), self._own_initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        gate, own = state[..., : OutlierGate.size], state[..., OutlierGate.size : -SLOTS]
        command = self._law(self._gate.update(seen, gate), own)
        return self._quantiser.quantise(command, state[..., -SLOTS:])
