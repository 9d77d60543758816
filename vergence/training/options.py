"""What a person chooses of a training run; the rest is the recipe's."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

Kind = Literal["gain-schedule", "policy"]
"""What can be learned: the gains of the article's law, or joint velocities."""
TrainingPlant = Literal["kinematic", "mujoco"]
"""What can move the heads that a network learns from: plants whose state can be saved."""


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Choices of a training run, see `vergence.training.choices.choose`."""

    kind: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(help_behavior_hint="", metavar="KIND")
    ] = None
    """gain-schedule (learns the gains of the article's law) or policy (joint velocities)."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "hardware"
    """Scenario whose training trials it learns from (see `vergence info`)."""
    plant: TrainingPlant = "kinematic"
    """What moves the heads."""
    seed: int = 0
    """Seed of everything."""
    steps: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Control steps to learn from, over all environments; the recipe's by default."""
    envs: Annotated[int | None, tyro.conf.arg(help_behavior_hint="", metavar="INT")] = None
    """Environments side by side; the recipe's by default."""
    inputs: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="INPUTS")] = None
    """What the network sees (see docs/learning.md); the recipe's by default."""
    randomise: Annotated[
        bool | None, tyro.conf.DisallowNone, tyro.conf.arg(help_behavior_hint="")
    ] = None
    """Learn with the hidden times, faults and model errors of scenario hardware, or with none but
    the scenario's own; the recipe's by default."""
    set: Annotated[
        tuple[str, ...], tyro.conf.arg(help_behavior_hint="", metavar="FIELD=VALUE")
    ] = ()
    """Changes of the recipe, such as network=[64,64] algorithm.learning_rate=1e-3."""
