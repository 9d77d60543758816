"""The user's options of a training run; the recipe sets the rest."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

Kind = Literal["gain-schedule", "policy"]
"""Kinds of training: gains of the article's law, or joint velocities."""
TrainingPlant = Literal["kinematic", "mujoco"]
"""Plants that training can use: those whose state can be saved."""


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Options of a training run, see `vergence.training.choices.resolve_config`."""

    kind: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(help_behavior_hint="", metavar="KIND")
    ] = None
    """gain-schedule (learns the gains of the article's law) or policy (joint velocities)."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "hardware"
    """Scenario whose trials are used for training (see `vergence info`)."""
    plant: TrainingPlant = "kinematic"
    """Plant that moves the heads."""
    seed: int = 0
    """Seed of everything."""
    steps: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Control steps to learn from, over all environments; the recipe's by default."""
    envs: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Environments in parallel; the recipe's by default."""
    inputs: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="INPUTS")] = None
    """Inputs of the network (see docs/learning.md); the recipe's by default."""
    randomise: Annotated[
        bool | None, tyro.conf.DisallowNone, tyro.conf.arg(help_behavior_hint="")
    ] = None
    """Train with the hidden latencies, faults and model errors of scenario hardware, or only with
    the scenario's own; the recipe's by default."""
    set: Annotated[
        tuple[str, ...], tyro.conf.arg(help_behavior_hint="", metavar="FIELD=VALUE")
    ] = ()
    """Changes of the recipe, such as network=[64,64] algorithm.learning_rate=1e-3."""
