"""Export a learner's actor as the ONNX graph of a bundle, checked against torch.

The graph holds all operations from the network's inputs to the bundle's outputs: normalisation,
actor, squashing and rescaling.
"""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from vergence.controllers.adaptive import GAIN_LIMIT, gain_indices_by_axis, gains_from_action
from vergence.controllers.networks.environments import VELOCITY_POWER, decode_velocity_action
from vergence.controllers.networks.manifest import POLICY
from vergence.controllers.networks.onnx_graph import Network, read_network
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError, ConfigurationError
from vergence.training.networks import JointwisePolicy

CHECK_INPUT_COUNT: Final = 10_000
"""Random inputs on which ONNX and torch must agree (numerical)."""
TOLERANCE: Final = 1e-5
"""Largest difference between their outputs: 84 machine epsilons of float32 (numerical)."""


def learner_network(
    kind: str, model: BaseAlgorithm, normalisation: VecNormalize | None
) -> tuple[Network, float]:
    """Convert a learner to a network of a bundle, and check that both agree.

    Args:
        kind: `gain-schedule` or `policy`.
        model: a learner of Stable-Baselines3.
        normalisation: the running statistics of its inputs; None if it has none.

    Returns:
        The network, and its largest difference from the learner's own outputs on 10,000 random
        inputs.

    Raises:
        BundleError: the learner cannot be exported, or the two differ.
        ConfigurationError: the learner is not a PPO with actions from -1 to 1.
    """
    actor = deterministic_actor(model)
    (size,) = model.observation_space.shape or ()
    if normalisation is not None and normalisation.norm_obs:
        moments: Any = normalisation.obs_rms
        std = np.sqrt(moments.var + normalisation.epsilon)
        actor = NormalisedActor(actor, moments.mean, std, normalisation.clip_obs)
    network = export_network(RescaledActor(actor, kind), size)

    def act(inputs: NDArray[np.float32]) -> NDArray[Any]:
        seen: Any = inputs if normalisation is None else normalisation.normalize_obs(inputs)
        action, _state = model.predict(seen.astype(np.float32), deterministic=True)
        return bundle_outputs(kind, action)

    return network, check_agreement(network, act)


def export_network(actor: nn.Module, size: int) -> Network:
    """Export an actor as an ONNX graph that a bundle can hold.

    Args:
        actor: maps (n, size) inputs to (n, outputs), float32, each row independently.
        size: number of inputs.

    Returns:
        The network, with its weights.

    Raises:
        BundleError: the actor needs operators that a bundle may not contain.
    """
    was_training = actor.training
    actor.eval()
    try:
        with _quiet():
            program: Any = torch.onnx.export(
                actor,
                (torch.zeros(2, size),),
                dynamo=True,
                dynamic_shapes=({0: torch.export.Dim("batch")},),
                input_names=["inputs"],
                output_names=["actions"],
                external_data=False,
                verbose=False,
            )
    except torch.onnx.errors.OnnxExporterError as error:
        raise BundleError(
            f"export: expected an actor that ONNX can say, got: {str(error).splitlines()[0]}"
        ) from error
    finally:
        actor.train(was_training)
    model = program.model_proto
    # drop the names of source files and modules of this machine
    for part in (model, model.graph, *model.graph.node, *model.graph.input, *model.graph.output):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    for tensor in model.graph.initializer:
        tensor.ClearField("metadata_props")
    model.graph.ClearField("value_info")
    return read_network(model.SerializeToString(deterministic=True))


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the exporter's messages about itself and about packages not installed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def check_agreement(
    network: Network, reference: Callable[[NDArray[np.float32]], NDArray[Any]], seed: int = 0
) -> float:
    """Compare an exported network with its original on random inputs over their whole range.

    Args:
        network: the exported network.
        reference: the original; maps (n, inputs) float32 inputs in [-1, 1] to (n, outputs).
        seed: seed of the inputs.

    Returns:
        Largest difference of an output.

    Raises:
        BundleError: the difference exceeds `TOLERANCE`.
    """
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-1.0, 1.0, (CHECK_INPUT_COUNT, network.input_size)).astype(np.float32)
    difference = float(np.abs(Runtime(network)(inputs) - reference(inputs)).max())
    if not difference <= TOLERANCE:
        raise BundleError(
            f"export: expected ONNX and torch to agree to {TOLERANCE:g}, got {difference:.3g}"
        )
    return difference


class _Actor(nn.Module):
    """The mean of a policy's normal distribution, limited to the bounds of actions."""

    def __init__(self, features: nn.Module, action: nn.Module, squashed: bool) -> None:
        super().__init__()
        # rows of inputs are flat already
        self.features = nn.Identity() if isinstance(features, FlattenExtractor) else features
        self.action = action
        self.squashed = squashed

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        action = self.action(self.features(inputs))
        return torch.tanh(action) if self.squashed else torch.clip(action, -1.0, 1.0)


def deterministic_actor(model: BaseAlgorithm) -> nn.Module:
    """Deterministic actor of a learner, from normalised inputs to actions in [-1, 1].

    Args:
        model: a PPO, or another on-policy learner of Stable-Baselines3.

    Returns:
        The module; it shares the learner's weights, except for a `JointwisePolicy`.

    Raises:
        ConfigurationError: the policy is of another kind, or the actions have other bounds.
    """
    shape = model.action_space.shape or ()
    bounded = Box(-1.0, 1.0, shape, np.float32)
    if shape not in ((1,), (2,), (3,), (4,)) or model.action_space != bounded:
        raise ConfigurationError(
            f"export: expected one to four actions from -1 to 1, got {model.action_space}"
        )
    policy = model.policy
    if isinstance(policy, ActorCriticPolicy):
        if isinstance(policy, JointwisePolicy):
            layers = policy.dense_actor()
        else:
            layers = nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
        return _Actor(policy.pi_features_extractor, layers, policy.squash_output)
    raise ConfigurationError(f"export: expected a policy of PPO, got {type(policy).__name__}")


class NormalisedActor(nn.Module):
    """A network preceded by the normalisation of its inputs: clip((x - mean) / std).

    Args:
        network: maps (n, size) normalised inputs to (n, outputs).
        mean: (size,) means of the inputs.
        std: (size,) their standard deviations.
        clip: limit of normalised inputs.
    """

    mean: torch.Tensor
    mean_rest: torch.Tensor
    std: torch.Tensor

    def __init__(self, network: nn.Module, mean: ArrayLike, std: ArrayLike, clip: float) -> None:
        super().__init__()
        self.network = network
        exact = torch.as_tensor(np.asarray(mean, dtype=np.float64))
        # dividing by the tiny standard deviation of an input that hardly varies would magnify the
        # rounding of its mean to float32, so the rounding error is subtracted as well
        self.register_buffer("mean", exact.float())
        self.register_buffer("mean_rest", (exact - exact.float().double()).float())
        self.register_buffer("std", torch.as_tensor(np.asarray(std, dtype=np.float32)))
        self.clip = clip

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map inputs that are not normalised to the network's outputs."""
        normal = ((inputs - self.mean) - self.mean_rest) / self.std
        return self.network(torch.clip(normal, -self.clip, self.clip))  # type: ignore[no-any-return]


class RescaledActor(nn.Module):
    """Maps an actor's actions to outputs in [-1, 1] that are linear in gains or velocities.

    In training, a gain is proportional to the square of the shifted action, and a velocity to the
    cube of the action. The exported graph includes this mapping, so that its outputs are
    proportional to gains or velocities.

    Args:
        actor: maps (n, size) inputs to (n, actions) in [-1, 1].
        kind: `gain-schedule` or `policy`.
    """

    def __init__(self, actor: nn.Module, kind: str) -> None:
        super().__init__()
        self.actor = actor
        self.kind = kind

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map an actor's inputs to outputs, see `bundle_outputs`."""
        action: torch.Tensor = self.actor(inputs)
        if self.kind == POLICY:
            return torch.pow(action, VELOCITY_POWER)
        share = 0.5 * (1.0 + action)
        return 2.0 * share * share - 1.0


def bundle_outputs(kind: str, action: NDArray[Any]) -> NDArray[Any]:
    """Outputs of a bundle's network for actions of the training environment.

    Args:
        kind: `gain-schedule` or `policy`.
        action: (n, actions) in [-1, 1].

    Returns:
        (n, actions) in [-1, 1], linear in gains or velocities.
    """
    if kind == POLICY:
        return decode_velocity_action(action)
    outputs = np.empty(action.shape)
    outputs[:, gain_indices_by_axis()] = (
        2.0 / GAIN_LIMIT * gains_from_action(action).reshape(action.shape) - 1.0
    )
    return outputs
