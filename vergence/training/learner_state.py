"""Save and restore a learner's state, as tensors, numbers and strings."""

import json
import random
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from vergence.errors import ConfigurationError


def learner_state_dict(model: BaseAlgorithm, normalisation: VecNormalize) -> dict[str, Any]:
    """State of a learner: networks, optimisers, statistics and random generators.

    Args:
        model: the learner, between two rollouts.
        normalisation: the running statistics of observations and rewards.
    """
    return {
        "steps": int(model.num_timesteps),
        "updates": int(getattr(model, "_n_updates", 0)),
        "episodes": int(model._episode_num),
        "parameters": model.get_parameters(),
        **{name: _moments(moments) for name, moments in _statistics(normalisation)},
        "random": _random_state(model),
    }


def running_episodes_state(model: BaseAlgorithm, normalisation: VecNormalize) -> dict[str, Any]:
    """State of a learner's running episodes.

    Args:
        model: the learner, between two rollouts.
        normalisation: wrapper of the environments, which must have `state`.
    """
    venv: Any = normalisation.venv
    seen: dict[str, Any] = {name: getattr(model, f"_last_{name}") for name in _LAST_STEP_ATTRIBUTES}
    content: dict[str, Any] = {
        "environments": {part: _tensors(arrays) for part, arrays in venv.state().items()},
        "last": _tensors({name: array for name, array in seen.items() if array is not None}),
        "discounted": torch.from_numpy(normalisation.returns),
    }
    return content


_LAST_STEP_ATTRIBUTES: Final = ("obs", "original_obs", "episode_starts")
"""Attributes of SB3's models that hold the previous step, without their prefix `_last_`."""


def restore_learner(
    content: Mapping[str, Any], model: BaseAlgorithm, normalisation: VecNormalize
) -> None:
    """Restore a learner from a checkpoint, except for its running episodes.

    Raises:
        ConfigurationError: the checkpoint belongs to another network or algorithm.
    """
    try:
        model.set_parameters(content["parameters"], exact_match=True)
        for name, moments in _statistics(normalisation):
            _restore_moments(moments, content[name])
        model.num_timesteps = content["steps"]
        model._n_updates = content["updates"]
        model._episode_num = content["episodes"]
        _restore_random_state(model, content["random"])
    except (KeyError, ValueError, RuntimeError, TypeError) as error:
        raise ConfigurationError(
            "checkpoint: expected one of the network and algorithm in config.toml, got "
            f"another: {str(error).splitlines()[0]}"
        ) from error


def restore_running_episodes(
    content: Mapping[str, Any], model: BaseAlgorithm, normalisation: VecNormalize
) -> None:
    """Restore a learner's running episodes, see `running_episodes_state`.

    Raises:
        ConfigurationError: the checkpoint belongs to other environments.
    """
    venv: Any = normalisation.venv
    try:
        venv.restore({part: _arrays(t) for part, t in content["environments"].items()})
        for name, array in _arrays(content["last"]).items():
            setattr(model, f"_last_{name}", array)
        normalisation.returns = content["discounted"].numpy().copy()
    except (KeyError, ValueError, AttributeError) as error:
        raise ConfigurationError(
            f"checkpoint: expected one of the environments in config.toml, got another: {error}"
        ) from error


def _tensors(arrays: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(np.ascontiguousarray(a)) for name, a in arrays.items()}


def _arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, Any]:
    return {name: tensor.numpy().copy() for name, tensor in tensors.items()}


def _statistics(normalisation: VecNormalize) -> list[tuple[str, RunningMeanStd]]:
    inputs: Any = normalisation.obs_rms  # a mapping only for dictionary spaces, not used here
    return [("inputs", inputs), ("returns", normalisation.ret_rms)]


def _restore_moments(into: RunningMeanStd, moments: Mapping[str, Any]) -> None:
    mean = moments["mean"].numpy()
    if mean.shape != into.mean.shape:
        raise ValueError(f"expected statistics of shape {into.mean.shape}, got {mean.shape}")
    into.mean, into.var = mean.copy(), moments["var"].numpy().copy()
    into.count = moments["count"]


def _moments(moments: RunningMeanStd) -> dict[str, Any]:
    return {
        "mean": torch.as_tensor(np.array(moments.mean)),
        "var": torch.as_tensor(np.array(moments.var)),
        "count": float(moments.count),
    }


def _random_state(model: BaseAlgorithm) -> dict[str, Any]:
    legacy: Any = np.random.get_state(legacy=True)  # noqa: NPY002
    _kind, keys, position, has_gauss, gauss = legacy
    version, words, spare = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        # SB3 shuffles and explores with the global generators
        "numpy": [torch.from_numpy(keys.astype(np.int64)), position, has_gauss, gauss],
        "python": [version, list(words), spare],
        "actions": json.dumps(model.action_space.np_random.bit_generator.state),
    }


def _restore_random_state(model: BaseAlgorithm, state: Mapping[str, Any]) -> None:
    keys, position, has_gauss, gauss = state["numpy"]
    torch.set_rng_state(state["torch"])
    words = keys.numpy().astype(np.uint32)
    np.random.set_state(("MT19937", words, position, has_gauss, gauss))  # noqa: NPY002
    version, words, spare = state["python"]
    random.setstate((version, tuple(words), spare))
    model.action_space.np_random.bit_generator.state = json.loads(state["actions"])
