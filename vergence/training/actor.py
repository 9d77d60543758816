"""The actor of a learner as one module: normalise, act, and say it as a bundle's outputs do."""

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from vergence.controllers.gain_schedule import GAIN_LIMIT, gains_of
from vergence.controllers.networks.environments import VELOCITY_POWER, velocity_action
from vergence.controllers.networks.learned import GAIN_ORDER
from vergence.controllers.networks.manifest import POLICY
from vergence.errors import ConfigurationError


class Normalised(nn.Module):
    """A network behind the normalisation of its inputs: clip((x - mean) / std).

    Args:
        network: (n, size) normalised inputs to (n, outputs).
        mean: (size,) means of the inputs.
        std: (size,) their standard deviations.
        clip: where normalised inputs are limited.
    """

    mean: torch.Tensor
    mean_rest: torch.Tensor
    std: torch.Tensor

    def __init__(self, network: nn.Module, mean: ArrayLike, std: ArrayLike, clip: float) -> None:
        super().__init__()
        self.network = network
        exact = torch.as_tensor(np.asarray(mean, dtype=np.float64))
        # an input that hardly varies is divided by next to nothing: the rounding of its mean to
        # float32 would then be seen, so the rest is subtracted as well
        self.register_buffer("mean", exact.float())
        self.register_buffer("mean_rest", (exact - exact.float().double()).float())
        self.register_buffer("std", torch.as_tensor(np.asarray(std, dtype=np.float32)))
        self.clip = clip

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """The network's outputs for inputs as they come."""
        normal = ((inputs - self.mean) - self.mean_rest) / self.std
        return self.network(torch.clip(normal, -self.clip, self.clip))  # type: ignore[no-any-return]


class _OnPolicyActor(nn.Module):
    """The mean of a policy's normal distribution, limited to the bounds of actions."""

    def __init__(self, policy: ActorCriticPolicy) -> None:
        super().__init__()
        self.features = _features(policy.pi_features_extractor)
        # a policy whose own form ONNX has no words for gives one of ordinary layers
        plain = getattr(policy, "plain_actor", None)
        self.action = _OrdinaryActor(policy) if plain is None else plain()
        self.squashed = policy.squash_output

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        action = self.action(self.features(inputs))
        return torch.tanh(action) if self.squashed else torch.clip(action, -1.0, 1.0)


class _OrdinaryActor(nn.Module):
    """The actor of an on-policy learner, before its actions are limited."""

    def __init__(self, policy: ActorCriticPolicy) -> None:
        super().__init__()
        self.hidden = policy.mlp_extractor
        self.action = policy.action_net

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        return self.action(self.hidden.forward_actor(inputs))  # type: ignore[no-any-return]


class _SquashedActor(nn.Module):
    """The mean of a squashed normal distribution before its tanh, and the tanh."""

    def __init__(self, policy: SACPolicy) -> None:
        super().__init__()
        self.features = _features(policy.actor.features_extractor)
        self.hidden = policy.actor.latent_pi
        self.action = policy.actor.mu

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.action(self.hidden(self.features(inputs))))


def _features(extractor: Any) -> nn.Module:
    # rows of numbers are flat as they are
    return nn.Identity() if isinstance(extractor, FlattenExtractor) else extractor


class Uniform(nn.Module):
    """Takes an actor's actions to outputs of which -1 and 1 are the bounds, and all is linear.

    What an action means to a training environment may be another thing (gains grow with its
    square, velocities with its cube): here the graph learns it, so that one who runs a bundle
    need not know it.

    Args:
        actor: (n, size) inputs to (n, 4) actions in [-1, 1].
        kind: `gain-schedule` or `policy`.
    """

    def __init__(self, actor: nn.Module, kind: str) -> None:
        super().__init__()
        self.actor = actor
        self.kind = kind

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """The outputs for an actor's inputs, as `outputs_of` has them."""
        action: torch.Tensor = self.actor(inputs)
        if self.kind == POLICY:
            return torch.pow(action, VELOCITY_POWER)
        share = 0.5 * (1.0 + action)
        return 2.0 * share * share - 1.0


def outputs_of(kind: str, action: NDArray[Any]) -> NDArray[Any]:
    """What a bundle's network puts out for an action of the training environment.

    Args:
        kind: `gain-schedule` or `policy`.
        action: (n, 4) actions in [-1, 1].

    Returns:
        (n, 4) in [-1, 1], linear in gains or velocities.
    """
    if kind == POLICY:
        return velocity_action(action)
    outputs = np.empty(action.shape)
    outputs[:, GAIN_ORDER] = 2.0 / GAIN_LIMIT * gains_of(action).reshape(action.shape) - 1.0
    return outputs


def actor_of(model: BaseAlgorithm) -> nn.Module:
    """The deterministic actor of a learner, from normalised inputs to actions in [-1, 1].

    Args:
        model: a PPO (or another on-policy learner) or a SAC of Stable-Baselines3.

    Returns:
        The module; it shares the learner's weights.

    Raises:
        ConfigurationError: its policy is of another kind, or its actions have other bounds.
    """
    if model.action_space != Box(-1.0, 1.0, (4,), np.float32):
        raise ConfigurationError(
            f"export: expected four actions from -1 to 1, got {model.action_space}"
        )
    if isinstance(model.policy, ActorCriticPolicy):
        return _OnPolicyActor(model.policy)
    if isinstance(model.policy, SACPolicy):
        return _SquashedActor(model.policy)
    raise ConfigurationError(
        f"export: expected a policy of PPO or SAC, got {type(model.policy).__name__}"
    )
