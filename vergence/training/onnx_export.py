"""From a learner to a network of a bundle: an ONNX graph, checked against torch."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from vergence.controllers.networks.onnx_graph import Network, read_network
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError
from vergence.training.actor import Normalised, Uniform, actor_of, outputs_of

CHECKED: Final = 10_000
"""Random inputs on which ONNX and torch must agree."""
TOLERANCE: Final = 1e-5
"""By how much they may differ: 30 roundings of a float32 near 1."""


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
        ConfigurationError: it is no PPO or SAC on actions from -1 to 1.
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
