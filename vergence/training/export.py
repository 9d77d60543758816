"""Export a training run as a bundle: its network, how it was trained, and its metrics."""

import dataclasses
import shlex
import tomllib
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w
import torch

from vergence.controllers.networks.bundle import Manifest, Perceptron, write_bundle
from vergence.errors import BundleError, ConfigurationError
from vergence.reporting.runs import toml_value
from vergence.training.choices import resolve_config
from vergence.training.config import TrainConfig
from vergence.training.learner import Learner, load_learner
from vergence.training.networks import JointwisePolicy
from vergence.training.options import TrainOptions
from vergence.training.recipes import default_recipe
from vergence.training.run_checkpoints import RunCheckpoints


def export_run(run: Path, out: Path, checkpoint: str = "best", replace: bool = False) -> Manifest:
    """Write a training run's network as a bundle.

    Args:
        run: the run folder of `vergence train`.
        out: the bundle to write, `*.vgp`.
        checkpoint: `best` or `last`.
        replace: True to replace an existing file.

    Returns:
        The manifest of the bundle.

    Raises:
        BundleError: a bundle cannot hold the network, or the file cannot be written.
        ConfigurationError: the folder is not a training run with that checkpoint.
    """
    try:
        learner = load_learner(run, checkpoint)
    except OSError as error:
        raise ConfigurationError(
            f"export: expected a training run, got {run}: {error.strerror}"
        ) from error
    try:
        config = learner.config
        network = learned_network(learner)
        difference = check_agreement(network, learner)
    finally:
        learner.close()
    content = RunCheckpoints(run, config, learner.head).read(checkpoint)
    manifest = Manifest.of(
        config.kind,
        learner.inputs,
        network,
        training={
            "command": training_command(config),
            "scenario": config.scenario,
            "seed": config.seed,
            "steps": config.steps,
            "checkpoint": {"name": checkpoint, "step": int(content["steps"])},
            "config": toml_value(dataclasses.asdict(config)),
            "versions": tomllib.loads((run / "config.toml").read_text("utf-8"))["versions"],
        },
        metrics={
            "validation": _finite(content.get("validation", {})),
            "learner_difference": difference,
        },
    )
    write_bundle(out, manifest, network, replace)
    return manifest


CHECK_INPUT_COUNT: Final = 10_000
"""Random inputs on which a network and its learner must agree (numerical)."""
TOLERANCE: Final = 1e-5
"""Largest difference between their outputs: 84 machine epsilons of float32 (numerical)."""


def learned_network(learner: Learner) -> Perceptron:
    """The deterministic actor of a learner, as numbers."""
    policy: Any = learner.model.policy
    if isinstance(policy, JointwisePolicy):
        joints, modules = len(policy.mlp_extractor.by_joint), [*policy.mlp_extractor.actor]
        modules.append(policy.action_net.out)
    else:
        joints, modules = 1, [*policy.mlp_extractor.policy_net, policy.action_net]
    normalisation = None
    if learner.config.normalise_inputs:
        moments: Any = learner.normalisation.obs_rms
        std = np.sqrt(moments.var + learner.normalisation.epsilon)
        normalisation = (moments.mean.copy(), std, float(learner.normalisation.clip_obs))
    return Perceptron(
        layers=tuple(
            (one.weight.detach().numpy().copy(), one.bias.detach().numpy().copy())
            for one in modules
            if isinstance(one, torch.nn.Linear)
        ),
        activation=learner.config.activation,
        joints=joints,
        normalisation=normalisation,
    )


def check_agreement(network: Perceptron, learner: Learner, seed: int = 0) -> float:
    """Compare a network with its learner on random inputs over their whole range.

    Returns:
        Largest difference of an output.

    Raises:
        BundleError: the difference exceeds `TOLERANCE`.
    """
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-1.0, 1.0, (CHECK_INPUT_COUNT, network.input_size)).astype(np.float32)
    seen: Any = learner.normalisation.normalize_obs(inputs)
    action, _state = learner.model.predict(seen.astype(np.float32), deterministic=True)
    difference = float(np.abs(network(inputs) - action).max())
    if not difference <= TOLERANCE:
        raise BundleError(
            f"export: expected the network and torch to agree to {TOLERANCE:g}, "
            f"got {difference:.3g}"
        )
    return difference


def training_command(config: TrainConfig) -> str:
    """Command that reproduces a training run, independent of later changes of the recipe."""
    words = ["vergence", "train", config.kind]
    named = {name: getattr(config, name) for name in _COMMAND_OPTIONS}
    if config.head:
        named["head"] = config.head
    for name, value in named.items():
        words += [f"--{name}", str(value)]
    if config.randomise:
        words.append("--randomise")
    elif default_recipe(config.kind).randomise:
        words.append("--no-randomise")
    usual, _head = resolve_config(
        TrainOptions(kind=config.kind, **named, randomise=config.randomise)
    )
    changes = _changes(dataclasses.asdict(usual), dataclasses.asdict(config))
    return shlex.join([*words, *(["--set", *changes] if changes else [])])


_COMMAND_OPTIONS: Final = ("scenario", "plant", "seed", "steps", "envs", "inputs")


def _changes(usual: Mapping[str, Any], wanted: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Arguments of `--set` that change the usual values to the wanted ones."""
    changes = []
    for name, value in wanted.items():
        if isinstance(value, Mapping):
            changes += _changes(usual.get(name, {}), value, f"{prefix}{name}.")
        elif value is not None and value != usual.get(name):
            text = tomli_w.dumps({"v": toml_value(value)}).partition("=")[2]
            changes.append(f"{prefix}{name}={''.join(text.split())}")
    return changes


def _finite(value: Any) -> Any:
    """Plain values, with null for infinite or missing ones (a run that never settled)."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value
