"""A network in the loop of a head: from observations to what it sees, from its output to actions.

Between the output and the command stands what the fixed laws have there, see
`vergence.controllers.image_law`: commands go out in the steps that the actuators take, and the law
of a gain schedule acts on the images that the outlier gate lets through. On a head without steps
and in a loop without outliers both change nothing. A policy has no gate here: it acts on what it
sees, and `Inputs` holds outliers back. An actuator of a policy that has no target to turn to is
held: a network's nothing is not quite zero, and eyes that creep while they wait lose sight of what
is to appear.

A network that swings gives way. Where the eyes have swung about their goals too often, or the
servos' own loop overshoots, which no channel tells, the linear law of `state-feedback` turns them.
This holds for networks that see a prediction: only that tells. Its commands pass no `CommandSteps`:
on a target at rest they move the motors as they are.

Training environments and deployed controllers run this same code.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.command_steps import CommandSteps
from vergence.controllers.gain_schedule import ScheduledLaw
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.outlier_gate import OutlierGate
from vergence.controllers.prediction.predictor import Prediction
from vergence.controllers.prediction.swinging import MANY
from vergence.controllers.state_feedback import DEFAULT_LAW, linear_command
from vergence.models.actuation import SLOTS
from vergence.models.parts import FloatArray


class Acting:
    """Both ends of a network in a loop; what they remember is one row of numbers a head.

    The row is that of the inputs, then the gate's of a schedule, the linear law's commands where
    there is a prediction, then what commands carry over.

    Args:
        inputs: what the network sees; they know the head and the layout.
        schedule: whether it chooses gains, and not velocities.
    """

    def __init__(self, inputs: Inputs, schedule: bool) -> None:
        self.inputs = inputs
        self._layout = layout = inputs.layout
        self._law = ScheduledLaw(inputs.head, layout) if schedule else None
        self._gate = OutlierGate(inputs.head, layout) if schedule else None
        self._steps = CommandSteps(inputs.head, layout.action_limits)
        rows = [inputs.initial()]
        if self._gate is not None:
            rows.append(self._gate.initial())
        self._of_calm = slice(0, 0)
        if inputs.predictor is not None:
            first = sum(map(len, rows))
            self._of_calm = slice(first, first + SLOTS)
            rows.append(np.full(SLOTS, np.nan))
        if self._steps.step_rad_s > 0.0:
            rows.append(np.zeros(SLOTS))
        self._initial = np.concatenate(rows)
        self._known = inputs.tells_known
        self._of_gate = slice(rows[0].size, rows[0].size + OutlierGate.size)

    def initial(self) -> FloatArray:
        """(S,) what is remembered when a trial begins."""
        return self._initial.copy()

    def see(self, observation: ArrayLike, state: FloatArray) -> NDArray[np.float32]:
        """What the network sees now, see `Inputs.look`.

        Args:
            observation: (..., n) observations of the gaze task, each once.
            state: (..., S) brought up to date in place; C-contiguous.

        Returns:
            (..., size) inputs.
        """
        seen, now = self.inputs.look(observation, state)
        if now is not None:
            state[..., self._of_calm] = self._calm(now)
        return seen

    def _calm(self, now: Prediction) -> FloatArray:
        """(..., 4) what the linear law commands, rad/s; nan where the network turns the eyes."""
        assert self.inputs.predictor is not None
        against = now._replace(velocities=now.velocities - now.rates)
        command = linear_command(against, self.inputs.predictor.rig, DEFAULT_LAW)
        calm = (now.swings > MANY) | (now.build_up > 0.0)
        return np.where(calm[..., None], command + now.later_rates / now.speed_gain, np.nan)

    def turn(
        self, seen: NDArray[np.float32], share: NDArray[np.float32], state: FloatArray
    ) -> NDArray[np.float32]:
        """The action of a policy.

        Args:
            seen: (..., size) what the network saw, see `see`.
            share: (..., m) velocities of the actuators by their limits, -1 to 1.
            state: (..., S) brought up to date in place.

        Returns:
            (..., m) the gaze task's action.
        """
        if self._known is not None:
            known = (seen[..., self._known] > 0.5).any(axis=-2)
            share = np.where(known, share, np.float32(0.0))
        command = np.zeros((*share.shape[:-1], SLOTS))
        command[..., : self._layout.count] = share
        return self._sent(command * self._layout.action_limits, state)

    def servo(
        self, observation: ArrayLike, gains: ArrayLike, state: FloatArray
    ) -> NDArray[np.float32]:
        """The action of the article's law under a schedule's gains.

        Args:
            observation: (..., n) the observations that were last seen, each once.
            gains: (..., 2, 2) by eye and image axis, 1/s.
            state: (..., S) brought up to date in place.

        Returns:
            (..., m) the gaze task's action.
        """
        assert self._law is not None
        assert self._gate is not None
        seen = self._layout.decode(observation)
        sight = self._gate.update(seen, state[..., self._of_gate])
        guarded = seen._replace(
            pixel_error=sight.pixel_error, positions_at_exposure=sight.positions_at_exposure
        )
        return self._sent(self._law.command(guarded, gains), state)

    def _sent(self, command: FloatArray, state: FloatArray) -> NDArray[np.float32]:
        if self._steps.step_rad_s > 0.0:
            command = self._steps.sent(command, state[..., -SLOTS:])
        calm = state[..., self._of_calm]
        if calm.size:
            command = np.where(np.isnan(calm), command, calm)
        return self._layout.action(command)
