"""From a learner to a network of a bundle: its actor as an ONNX graph, checked against torch.

The graph has all that stands between what a network sees and what a bundle's outputs mean:
normalisation, actor, squashing and rescaling.
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

from vergence.controllers.gain_schedule import GAIN_LIMIT, gain_order, gains_of
from vergence.controllers.networks.environments import VELOCITY_POWER, velocity_action
from vergence.controllers.networks.manifest import POLICY
from vergence.controllers.networks.onnx_graph import Network, read_network
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError, ConfigurationError
from vergence.training.networks import JointPolicy

CHECKED: Final = 10_000
"""Random inputs on which ONNX and torch must agree."""
TOLERANCE: Final = 1e-5
"""By how much they may differ: 30 roundings of a float32 near 1."""


def network_of(
    kind: str, model: BaseAlgorithm, normalisation: VecNormalize | None
) -> tuple[Network, float]:
    """A learner as a network of a bundle: normalise, act, squash, rescale; checked against it.

    Args:
        kind: `gain-schedule` or `policy`.
        model: a learner of Stable-Baselines3.
        normalisation: the running statistics of its inputs; None where it has none.

    Returns:
        The network, and the greatest difference to the learner's own actions on 10,000 random
        inputs.

    Raises:
        BundleError: it cannot be exported, or the two differ.
        ConfigurationError: it is no PPO on actions from -1 to 1.
    """
    actor = actor_of(model)
    (size,) = model.observation_space.shape or ()
    if normalisation is not None and normalisation.norm_obs:
        moments: Any = normalisation.obs_rms
        std = np.sqrt(moments.var + normalisation.epsilon)
        actor = Normalised(actor, moments.mean, std, normalisation.clip_obs)
    network = export_network(Uniform(actor, kind), size)

    def act(inputs: NDArray[np.float32]) -> NDArray[Any]:
        seen: Any = inputs if normalisation is None else normalisation.normalize_obs(inputs)
        action, _state = model.predict(seen.astype(np.float32), deterministic=True)
        return outputs_of(kind, action)

    return network, check_agreement(network, act)


def export_network(actor: nn.Module, size: int) -> Network:
    """An actor as an ONNX graph that a bundle may hold.

    Args:
        actor: (n, size) inputs to (n, outputs), float32; every row by itself.
        size: length of the inputs.

    Returns:
        The network; its weights are in it.

    Raises:
        BundleError: it needs operators that a bundle may not have.
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
    # names of source files and modules of the machine that exported it
    for part in (model, model.graph, *model.graph.node, *model.graph.input, *model.graph.output):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    for tensor in model.graph.initializer:
        tensor.ClearField("metadata_props")
    model.graph.ClearField("value_info")
    return read_network(model.SerializeToString(deterministic=True))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what the exporter says about packages that are not installed, and about itself."""
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
    """Compare a network with what it was made from, on random inputs over their whole range.

    Args:
        network: the exported network.
        reference: (n, inputs) float32 inputs in [-1, 1] to (n, outputs).
        seed: seed of the inputs.

    Returns:
        The greatest difference of an output.

    Raises:
        BundleError: it is more than `TOLERANCE`.
    """
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-1.0, 1.0, (CHECKED, network.inputs)).astype(np.float32)
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
        # rows of numbers are flat as they are
        self.features = nn.Identity() if isinstance(features, FlattenExtractor) else features
        self.action = action
        self.squashed = squashed

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        action = self.action(self.features(inputs))
        return torch.tanh(action) if self.squashed else torch.clip(action, -1.0, 1.0)


def actor_of(model: BaseAlgorithm) -> nn.Module:
    """The deterministic actor of a learner, from normalised inputs to actions in [-1, 1].

    Args:
        model: a PPO, or another on-policy learner of Stable-Baselines3.

    Returns:
        The module; but for a `JointPolicy` it shares the learner's weights.

    Raises:
        ConfigurationError: its policy is of another kind, or its actions have other bounds.
    """
    shape = model.action_space.shape or ()
    bounded = Box(-1.0, 1.0, shape, np.float32)
    if shape not in ((1,), (2,), (3,), (4,)) or model.action_space != bounded:
        raise ConfigurationError(
            f"export: expected one to four actions from -1 to 1, got {model.action_space}"
        )
    policy = model.policy
    if isinstance(policy, ActorCriticPolicy):
        if isinstance(policy, JointPolicy):
            layers = policy.plain_actor()
        else:
            layers = nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
        return _Actor(policy.pi_features_extractor, layers, policy.squash_output)
    raise ConfigurationError(f"export: expected a policy of PPO, got {type(policy).__name__}")


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


class Uniform(nn.Module):
    """Takes an actor's actions to outputs of which -1 and 1 are the bounds, and all is linear.

    What an action means to a training environment may be another thing (gains grow with its
    square, velocities with its cube): here the graph learns it, so that one who runs a bundle
    need not know it.

    Args:
        actor: (n, size) inputs to (n, actions) in [-1, 1].
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
        action: (n, actions) in [-1, 1].

    Returns:
        (n, actions) in [-1, 1], linear in gains or velocities.
    """
    if kind == POLICY:
        return velocity_action(action)
    outputs = np.empty(action.shape)
    outputs[:, gain_order()] = 2.0 / GAIN_LIMIT * gains_of(action).reshape(action.shape) - 1.0
    return outputs
