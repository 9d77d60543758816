"""Checkpoints of a training run: one file each, replaced whole, read without running anything.

A checkpoint is a mapping of tensors, numbers and words. It is read by `torch.load` with
`weights_only=True`, which builds nothing else. A kill at any moment leaves the old file or the
new one.
"""

import json
import random
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from vergence.errors import ConfigurationError
from vergence.files import whole_file

FORMAT: Final = 1
"""Version of what a checkpoint holds."""


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint; the file of that name is replaced at once or not at all.

    Args:
        path: the file.
        content: tensors, numbers, words, and lists and dictionaries of these.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        torch.save({"format": FORMAT, **content}, partial)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        ConfigurationError: there is no such file, or it is not a checkpoint.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ConfigurationError(f"expected a checkpoint, got {path}: {error.strerror}") from error
    except (RuntimeError, UnpicklingError, EOFError, ValueError, KeyError) as error:
        raise ConfigurationError(
            f"expected a checkpoint, got another or a damaged file: {path}"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigurationError(f"expected a checkpoint of format {FORMAT}, got {path}")
    return content


def state_of(model: BaseAlgorithm, normalisation: VecNormalize, *, replay: bool) -> dict[str, Any]:
    """All that training goes on from, between two rollouts.

    Args:
        model: the learner.
        normalisation: the running statistics of observations and rewards.
        replay: whether to keep a replay buffer too, where the learner has one.
    """
    content: dict[str, Any] = {
        "steps": int(model.num_timesteps),
        "updates": int(getattr(model, "_n_updates", 0)),
        "episodes": int(model._episode_num),
        "parameters": model.get_parameters(),
        "variables": {name: getattr(model, name).detach() for name in _variables(model)},
        **{name: _moments(moments) for name, moments in _statistics(normalisation)},
        "random": _random_state(model),
    }
    buffer = getattr(model, "replay_buffer", None)
    if replay and buffer is not None:
        filled = buffer.buffer_size if buffer.full else buffer.pos
        content["replay"] = {
            "position": int(buffer.pos),
            "full": bool(buffer.full),
            **{name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in _REPLAY},
        }
    return content


_REPLAY: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def restore(content: Mapping[str, Any], model: BaseAlgorithm, normalisation: VecNormalize) -> None:
    """Put a learner back to where a checkpoint was written.

    Raises:
        ConfigurationError: the checkpoint belongs to another network or algorithm.
    """
    try:
        model.set_parameters(content["parameters"], exact_match=True)
        with torch.no_grad():
            for name in _variables(model):
                getattr(model, name).copy_(content["variables"][name])
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
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None and "replay" in content:
        replay = content["replay"]
        for name in _REPLAY:
            getattr(buffer, name)[: len(replay[name])] = replay[name].numpy()
        buffer.pos, buffer.full = replay["position"], replay["full"]


def _statistics(normalisation: VecNormalize) -> list[tuple[str, RunningMeanStd]]:
    inputs: Any = normalisation.obs_rms  # a mapping for spaces that we do not have
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


def _variables(model: BaseAlgorithm) -> list[str]:
    """The tensors that SB3 trains outside of its networks, such as SAC's temperature."""
    names = model._get_torch_save_params()[1]
    return [name for name in names if getattr(model, name, None) is not None]


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
