"""A network in the loop of a head: from observations to its inputs, from its outputs to actions.

Between output and command stand the same elements as in the fixed laws, see
`vergence.controllers.gate`: commands are quantised to the resolution of the actuators, and the
law of a gain schedule acts on the detections that pass the outlier gate. On a head without
quantised commands and in a loop without outliers neither changes anything. A policy has no gate
here: it acts on its inputs, and `Inputs` holds outliers back. An actuator of a policy without a
target to turn to is held still: a network's output for rest is not exactly zero, and eyes that
creep while they wait would move away from where the target will appear.

A linear law can override the network. If the eyes have oscillated about their goals too often, or
the servos' own loop overshoots (no channel shows this), the law of `state-feedback` turns them.
This applies to networks whose inputs contain a prediction, since only the predictor detects both.
These commands bypass `CommandQuantiser`: on a resting target they move the motors as they are.

Training environments and deployed controllers run this same code.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.adaptive import ScheduledIBVS
from vergence.controllers.gate import CommandQuantiser, OutlierGate
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.prediction.oscillation import OSCILLATING_HALF_SWINGS
from vergence.controllers.prediction.predictor import Prediction
from vergence.controllers.state_feedback import DEFAULT_LAW, linear_command
from vergence.models.parts import SLOTS, FloatArray


class NetworkPrePostProcessor:
    """Stages before and after a network in the loop.

    They compute its inputs from observations, and actions from its outputs; the caller runs the
    network. Their state is one packed row per head.

    The row holds the state of the inputs, then that of a schedule's gate, the linear law's commands
    if there is a prediction, then the rounding errors of commands.

    Args:
        inputs: inputs of the network, which include the head and the layout.
        schedule: True if the network chooses gains, False for velocities.
    """

    def __init__(self, inputs: Inputs, schedule: bool) -> None:
        self.inputs = inputs
        self._layout = layout = inputs.layout
        self._law = ScheduledIBVS(inputs.head, layout) if schedule else None
        self._gate = OutlierGate(inputs.head, layout) if schedule else None
        self._quantiser = CommandQuantiser(inputs.head, layout.action_limits)
        rows = [inputs.initial()]
        if self._gate is not None:
            rows.append(self._gate.initial())
        self._of_calm = slice(0, 0)
        if inputs.predictor is not None:
            first = sum(map(len, rows))
            self._of_calm = slice(first, first + SLOTS)
            rows.append(np.full(SLOTS, np.nan))
        if self._quantiser.step_rad_s > 0.0:
            rows.append(np.zeros(SLOTS))
        self._initial = np.concatenate(rows)
        self._known = inputs.known_indices
        self._of_gate = slice(rows[0].size, rows[0].size + OutlierGate.size)

    def initial(self) -> FloatArray:
        """(S,) state at a trial's start."""
        return self._initial.copy()

    def network_inputs(self, observation: ArrayLike, state: FloatArray) -> NDArray[np.float32]:
        """Compute the network's inputs, see `Inputs.inputs_and_prediction`.

        Args:
            observation: (..., n) observations of the gaze task, each passed exactly once.
            state: (..., S) updated in place; C-contiguous.

        Returns:
            (..., size) inputs.
        """
        seen, now = self.inputs.inputs_and_prediction(observation, state)
        if now is not None:
            state[..., self._of_calm] = self._calm(now)
        return seen

    def _calm(self, now: Prediction) -> FloatArray:
        """(..., 4) commands of the linear law, rad/s; nan where the network turns the eyes."""
        assert self.inputs.predictor is not None
        against = now._replace(velocities=now.velocities - now.goal_rates)
        command = linear_command(against, self.inputs.predictor.params, DEFAULT_LAW)
        calm = (now.half_swing_count > OSCILLATING_HALF_SWINGS) | (now.build_up > 0.0)
        return np.where(
            calm[..., None], command + now.goal_rates_at_effect / now.speed_gain, np.nan
        )

    def action_from_velocities(
        self, seen: NDArray[np.float32], fraction: NDArray[np.float32], state: FloatArray
    ) -> NDArray[np.float32]:
        """Compute the action of a policy.

        Args:
            seen: (..., size) inputs of the network, from `network_inputs`.
            fraction: (..., m) actuator velocities as fractions of their limits, -1 to 1.
            state: (..., S) updated in place.

        Returns:
            (..., m) the gaze task's action.
        """
        if self._known is not None:
            known = (seen[..., self._known] > 0.5).any(axis=-2)
            fraction = np.where(known, fraction, np.float32(0.0))
        command = np.zeros((*fraction.shape[:-1], SLOTS))
        command[..., : self._layout.count] = fraction
        return self._action(command * self._layout.action_limits, state)

    def ibvs_action_from_gains(
        self, observation: ArrayLike, gains: ArrayLike, state: FloatArray
    ) -> NDArray[np.float32]:
        """Compute the action of the article's law with a schedule's gains.

        Args:
            observation: (..., n) the observations last passed to `network_inputs`, each exactly
                once.
            gains: (..., 2, 2) by eye and image axis, 1/s.
            state: (..., S) updated in place.

        Returns:
            (..., m) the gaze task's action.
        """
        assert self._law is not None
        assert self._gate is not None
        seen = self._layout.decode(observation)
        detections = self._gate.update(seen, state[..., self._of_gate])
        guarded = seen._replace(
            pixel_error=detections.pixel_error,
            positions_at_exposure=detections.positions_at_exposure,
        )
        return self._action(self._law.command(guarded, gains), state)

    def _action(self, command: FloatArray, state: FloatArray) -> NDArray[np.float32]:
        if self._quantiser.step_rad_s > 0.0:
            command = self._quantiser.quantise(command, state[..., -SLOTS:])
        calm = state[..., self._of_calm]
        if calm.size:
            command = np.where(np.isnan(calm), command, calm)
        return self._layout.action(command)
