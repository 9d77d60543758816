"""Recipes: what has been found to train gain schedules and policies well, and quickly."""

from dataclasses import dataclass, field
from typing import Any, Final

from vergence.errors import UnknownNameError


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How a network is trained, unless told otherwise."""

    inputs: str
    """What the network sees, see `vergence.controllers.networks.inputs`."""
    steps: int = 3_000_000
    """Control steps to learn from, over all environments."""
    envs: int = 256
    """How many environments run side by side."""
    episode_steps: int = 180
    """Control periods of an episode to learn from: the target may appear after 0.6 s, and what
    comes after settling teaches little. Evaluation runs whole trials."""
    randomise: bool = False
    """Whether to learn with the hidden variation of scenario `hardware`, whatever the scenario."""
    network: tuple[int, ...] = (32, 32)
    """Widths of the actor's hidden layers."""
    critic: tuple[int, ...] = (64, 64)
    """Widths of the critic's."""
    shared: bool = True
    """Whether the actor is one network used for each joint (`networks.JointPolicy`)."""
    activation: str = "tanh"
    """Activation of the hidden layers: `tanh`, `relu`, `elu` or `silu`."""
    algorithm: dict[str, Any] = field(default_factory=dict)
    """The options of PPO, by Stable-Baselines3's names."""
    log_std_init: float = -1.0
    """Logarithm of the first standard deviation of exploring actions."""
    final_learning_rate: float | None = 3e-5
    """Where the learning rate falls to over the run, linearly; None for a constant one."""
    normalise_inputs: bool = False
    """Whether inputs are normalised on the way: those of this package lie in [-1, 1] already."""
    normalise_rewards: bool = True
    """Whether rewards are divided by the standard deviation of the discounted return."""


_PPO: Final = {
    "learning_rate": 1e-3,
    "n_steps": 64,
    "batch_size": 4096,
    "n_epochs": 5,
    "gamma": 0.97,
    "gae_lambda": 0.95,
    "clip_range": 0.2,
    "ent_coef": 0.0,
}

RECIPES: Final[dict[str, Recipe]] = {
    "gain-schedule": Recipe(inputs="predicted", algorithm=_PPO),
    "policy": Recipe(inputs="to_go", algorithm=_PPO),
}
"""The recipes by what is learned."""


def recipe(kind: str) -> Recipe:
    """The recipe of a kind.

    Raises:
        UnknownNameError: there is none.
    """
    if kind not in RECIPES:
        raise UnknownNameError("recipe", kind, list(RECIPES))
    return RECIPES[kind]
