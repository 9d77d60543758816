"""A network in training as a controller, to be evaluated like any other."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from vergence.controllers.gain_schedule import ScheduledLaw, gains_of
from vergence.controllers.networks.environments import velocity_action
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.stateful import carried_on

Network = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""(n, size) inputs to (n, 4) actions in [-1, 1]."""


def network_of(model: BaseAlgorithm, normalisation: VecNormalize) -> Network:
    """The deterministic actor of a learner, its normalisation included."""
    policy: Any = model.policy

    def act(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        policy.set_training_mode(False)
        seen: Any = normalisation.normalize_obs(inputs)
        with torch.no_grad():
            action: torch.Tensor = policy._predict(torch.as_tensor(seen), deterministic=True)
        # a squashed action lies within the bounds, which are -1 and 1, already
        return action.clamp(-1.0, 1.0).numpy()

    return act


class ActingNetwork:
    """A controller from a network: a gain schedule or a policy.

    Args:
        kind: `gain-schedule` or `policy`.
        inputs: what the network sees.
        network: the network.
    """

    def __init__(self, kind: str, inputs: Inputs, network: Network) -> None:
        self.inputs = inputs
        self._network = network
        self._law = ScheduledLaw(inputs.head, inputs.layout) if kind == "gain-schedule" else None

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Choose actions, see `vergence.controllers.Controller`."""
        observation = np.asarray(observation)
        shape = observation.shape[:-1]
        memory = carried_on(self.inputs.initial(), shape, state, episode_start)
        seen = self.inputs.update(observation, memory)
        action = self._network(seen.reshape(-1, self.inputs.size)).reshape(*shape, 4)
        if self._law is None:
            return velocity_action(action), (memory,)
        return self._law.action(observation, gains_of(action)), (memory,)
