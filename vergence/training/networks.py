"""Policies in which the four eye joints share one small network.

The eyes' joints differ in geometry, but the inputs already account for it. The task that remains is
identical for all four: distance to go, velocity, past commands. One network, whose input is the
channels of a single joint, learns from all four joints at once. The critic gets all inputs.
"""

from collections.abc import Sequence
from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn


class JointwiseExtractor(nn.Module):
    """Hidden layers of an actor shared by the joints, and of a critic with all inputs.

    Args:
        by_joint: (4, channels) indices of each joint's own channels among the inputs.
        size: number of inputs.
        widths: widths of the actor's hidden layers.
        critic: widths of the critic's hidden layers.
        activation: activation after each layer.
    """

    def __init__(
        self,
        by_joint: Sequence[Sequence[int]],
        size: int,
        widths: Sequence[int],
        critic: Sequence[int],
        activation: type[nn.Module],
    ) -> None:
        super().__init__()
        self.register_buffer("by_joint", torch.tensor(by_joint), persistent=False)
        self.latent_dim_pi = len(by_joint) * widths[-1]
        self.latent_dim_vf = critic[-1]
        self.actor = _layers(len(by_joint[0]), widths, activation)
        self.critic = _layers(size, critic, activation)

    def forward(self, inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Map (n, size) inputs to the latent values of actor and critic."""
        return self.forward_actor(inputs), self.forward_critic(inputs)

    def forward_actor(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map (n, size) inputs to (n, 4 width), joint by joint."""
        own = inputs[:, self.by_joint]  # type: ignore[index]
        return self.actor(own).flatten(1)  # type: ignore[no-any-return]

    def forward_critic(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map (n, size) inputs to the critic's latent values."""
        return self.critic(inputs)  # type: ignore[no-any-return]


class JointwiseOutputLayer(nn.Module):
    """The last layer of the actor, (n, 4 width) to (n, 4), shared by the joints."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width
        self.out = nn.Linear(width, 1)
        # the actions of an untrained policy are near zero, as in Stable-Baselines3
        nn.init.orthogonal_(self.out.weight, gain=0.01)
        nn.init.zeros_(self.out.bias)

    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        """Map latent values to actions that are not yet limited."""
        return self.out(latent.reshape(len(latent), -1, self.width)).squeeze(-1)  # type: ignore[no-any-return]


class JointwisePolicy(ActorCriticPolicy):
    """A policy for PPO whose actor is one network shared by the joints.

    Args:
        *args: see `ActorCriticPolicy`.
        by_joint: see `JointwiseExtractor`.
        critic: widths of the critic's hidden layers.
        **kwargs: see `ActorCriticPolicy`; `net_arch` holds the widths of the actor's hidden layers.
    """

    def __init__(
        self,
        *args: Any,
        by_joint: Sequence[Sequence[int]],
        critic: Sequence[int] = (64, 64),
        **kwargs: Any,
    ) -> None:
        self._by_joint = [[int(i) for i in row] for row in by_joint]
        self._critic = tuple(critic)
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        widths: Any = self.net_arch
        self.mlp_extractor: Any = JointwiseExtractor(
            self._by_joint, self.features_dim, widths, self._critic, self.activation_fn
        )

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        widths: Any = self.net_arch
        self.action_net = JointwiseOutputLayer(widths[-1])
        make: Any = self.optimizer_class
        self.optimizer = make(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            **super()._get_constructor_parameters(),
            "by_joint": self._by_joint,
            "critic": self._critic,
        }


def _layers(size: int, widths: Sequence[int], activation: type[nn.Module]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in widths:
        linear = nn.Linear(size, width)
        nn.init.orthogonal_(linear.weight, gain=2.0**0.5)
        nn.init.zeros_(linear.bias)
        layers += [linear, activation()]
        size = width
    return nn.Sequential(*layers)
