r"""The gaze task for a network: selected inputs, and gains or velocities as the action.

Both environments are the task of `vergence/Gaze-v0` (same trials for the same seeds, same reward,
same ends) with other spaces. `vergence/GainSchedule-v0` takes the gains of the article's law; the
policy environment takes actuator velocities, decoded by

    velocity = limit sign(action) |action|^3

so that the noise of an exploring policy hardly moves a resting eye, and velocities near zero have a
fine resolution. The stages between action and command are those of the deployed controllers, see
`vergence.controllers.networks.learned`.
"""

from typing import Any, ClassVar, Final

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from vergence.controllers.adaptive import gains_from_action
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.learned import NetworkLoop
from vergence.envs import MAX_EPISODE_STEPS
from vergence.envs.gaze import GazeEnv, GazeVectorEnv
from vergence.envs.streams import Arrays, IntArray, join_parts
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, UnknownNameError

DEFAULT_INPUTS: Final = {"gain-schedule": "predicted", "policy": "to_go"}
"""Default kind of inputs of each kind of network."""


class NetworkTask(GazeTask):
    """The gaze task with the inputs of a network as its observation.

    Args:
        num: number of heads.
        inputs: the kind of inputs, `predicted` or `to_go`.
        **options: see `GazeTask`.
    """

    outputs_gains: ClassVar[bool]
    """True if the network chooses gains, False for velocities."""

    def __init__(self, num: int = 1, *, inputs: str, **options: Any) -> None:
        super().__init__(num, **options)
        try:
            self.inputs = Inputs(inputs, self.head, self.layout)
        except BaseException:
            self.close()
            raise
        self._loop = NetworkLoop(self.inputs, self.outputs_gains)
        self._memory = np.tile(self._loop.initial(), (num, 1))
        self.observation = np.zeros((num, self.inputs.size), dtype=np.float32)

    def spaces(self) -> tuple[Box, Box]:
        """See `GazeTask.spaces`."""
        action = Box(-1.0, 1.0, (len(self.action_names),), np.float32)
        return Box(-1.0, 1.0, (self.inputs.size,), np.float32), action

    def begin(self, ids: IntArray, seeds: NDArray[np.uint64], trials: NDArray[np.uint64]) -> None:
        """See `GazeTask.begin`."""
        super().begin(ids, seeds, trials)
        memory = np.tile(self._loop.initial(), (len(ids), 1))
        seen = self.layout.decode(self.encoded[ids])
        self.observation[ids] = self._loop.network_inputs(seen, memory)
        self._memory[ids] = memory

    def step(self, action: NDArray[Any]) -> None:
        """See `GazeTask.step`; the action belongs to the network's action space."""
        if np.isnan(action).any():
            # quantised commands, or a law without a visible target, would hide it
            raise ConfigurationError("action: expected numbers, got nan")
        seen = self.layout.decode(self.encoded) if self.outputs_gains else None
        command = self._loop.command(seen, self.observation, action, self._memory)
        super().step(self.layout.action(command))
        seen = self.layout.decode(self.encoded)
        self.observation[:] = self._loop.network_inputs(seen, self._memory)

    def _arrays(self) -> Arrays:
        own: Arrays = {"memory": self._memory, "observation": self.observation}
        return {**super()._arrays(), **join_parts(network=own)}


class PolicyTask(NetworkTask):
    """A network that commands the actuators' velocities."""

    outputs_gains = False

    def __init__(
        self, num: int = 1, *, inputs: str = DEFAULT_INPUTS["policy"], **options: Any
    ) -> None:
        super().__init__(num, inputs=inputs, **options)


class GainScheduleTask(NetworkTask):
    """A network that chooses the gains of the article's law."""

    outputs_gains = True

    def __init__(
        self, num: int = 1, *, inputs: str = DEFAULT_INPUTS["gain-schedule"], **options: Any
    ) -> None:
        super().__init__(num, inputs=inputs, **options)
        self._gains = np.zeros((num, 2, 2))

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the gains, whatever the actuators."""
        assert self._loop.gain_names is not None
        return self._loop.gain_names

    def begin(self, ids: IntArray, seeds: NDArray[np.uint64], trials: NDArray[np.uint64]) -> None:
        """See `GazeTask.begin`."""
        super().begin(ids, seeds, trials)
        self._gains[ids] = 0.0

    def step(self, action: NDArray[Any]) -> None:
        """See `NetworkTask.step`."""
        super().step(action)
        self._gains[:] = gains_from_action(action, self.action_names)

    def _arrays(self) -> Arrays:
        return {**super()._arrays(), **join_parts(law={"gains": self._gains})}

    def info(self) -> dict[str, Any]:
        """See `GazeTask.info`; `gains` are those of the last step, (num, 2, 2) in 1/s."""
        return {**super().info(), "gains": self._gains.copy()}

    def single_info(self) -> dict[str, Any]:
        """See `GazeTask.single_info`; `gains` are those of the last step, (2, 2) in 1/s."""
        return {**super().single_info(), "gains": self._gains[0].copy()}


class GainScheduleEnv(GazeEnv):
    """The gaze task where the action is the gains of the article's law.

    ## Description
    Image-based visual servoing turns the eyes, `theta_dot = J^-1 K (p* - p)`, and the agent
    chooses K at every step. A constant gain must be small, as the image is old; a gain that
    depends on how far the joints have turned since the exposure can be large and brake in time.

    ## Action space
    `Box(-1, 1, (4,), float32)`: the gains of left v, left u, right v, right u (a tilt moves v, a
    pan moves u), `gain = 5 (1 + action)^2` per second, from 0 to 20. Four for every head; where the
    eyes pan first, u comes before v.

    ## Observation space
    `Box` by the argument `inputs`, see `vergence.controllers.networks.inputs`: `predicted`
    (88 numbers) or `to_go` (76); for m actuators 22 m and 19 m.

    ## Rewards, starting state, episode end
    As in `vergence/Gaze-v0`, trial by trial: equal seeds give equal trials.

    ## Info
    As in `vergence/Gaze-v0`, and `gains`: the gains of the last step by eye and image axis, 1/s.

    ## Arguments
    `inputs`, and the arguments of `vergence/Gaze-v0`.

    ## Version history
    * v0: the first.
    """

    task_type: ClassVar[type[GazeTask]] = GainScheduleTask


class GainScheduleVectorEnv(GazeVectorEnv):
    """The task of `GainScheduleEnv` for many heads at once, see `GazeVectorEnv`."""

    task_type: ClassVar[type[GazeTask]] = GainScheduleTask


class PolicyEnv(GazeEnv):
    """The gaze task with a network's inputs; actions go through `decode_velocity_action`."""

    task_type: ClassVar[type[GazeTask]] = PolicyTask


class PolicyVectorEnv(GazeVectorEnv):
    """The task of `PolicyEnv` for many heads at once."""

    task_type: ClassVar[type[GazeTask]] = PolicyTask


VECTORS: Final[dict[str, type[GazeVectorEnv]]] = {
    "gain-schedule": GainScheduleVectorEnv,
    "policy": PolicyVectorEnv,
}
"""Vector environments by kind of network."""


def training_env(
    kind: str,
    num_envs: int,
    inputs: str | None = None,
    *,
    max_episode_steps: int = MAX_EPISODE_STEPS,
    **options: Any,
) -> GazeVectorEnv:
    """Make the vector environment in which a network of a kind is trained.

    It resets ended episodes within the step. Its first episodes end at staggered times, so that a
    batch of steps contains all phases of a trial.

    Args:
        kind: `gain-schedule` or `policy`.
        num_envs: number of heads.
        inputs: the kind of inputs; None for the kind's default.
        max_episode_steps: steps of an episode.
        **options: see `vergence.envs.task.GazeTask`.

    Raises:
        UnknownNameError: there is no such kind.
        VergenceError: an option is invalid.
    """
    if kind not in VECTORS:
        raise UnknownNameError("kind of training", kind, sorted(VECTORS))
    envs = VECTORS[kind](
        num_envs,
        max_episode_steps=max_episode_steps,
        autoreset_mode=AutoresetMode.SAME_STEP,
        inputs=DEFAULT_INPUTS[kind] if inputs is None else inputs,
        **options,
    )
    envs.stagger()
    return envs
