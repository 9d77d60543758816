"""Laws on pixel errors that stand the faults of a robot's loop: outliers, misses, coarse commands.

Such a law is asked for a command of what the outlier gate lets through, and what it commands goes
out in the steps that the actuators take. In a loop without these faults both change nothing.
"""

from abc import abstractmethod

import numpy as np

from vergence.controllers.command_steps import CommandSteps
from vergence.controllers.outlier_gate import OutlierGate, Sight
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import Observation, ObservationLayout
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class ImageLaw(StatefulController):
    """A law on pixel errors behind an `OutlierGate` and before `CommandSteps`.

    The state is the gate's, then the law's own, then what the commands carry over.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        super().__init__(head=head, layout=layout)
        self._gate = OutlierGate(head, self.layout)
        self._steps = CommandSteps(head, self.layout.action_limits)

    def _own_initial(self) -> FloatArray:
        """(S,) what the law itself remembers at a trial's start; nothing unless overridden."""
        return np.zeros(0)

    @abstractmethod
    def _law(self, sight: Sight, own: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; (..., S) `own` changes in place."""

    def _initial(self) -> FloatArray:
        return np.concatenate([self._gate.initial(), self._own_initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        gate, own = state[..., : OutlierGate.size], state[..., OutlierGate.size : -SLOTS]
        command = self._law(self._gate.update(seen, gate), own)
        return self._steps.sent(command, state[..., -SLOTS:])
