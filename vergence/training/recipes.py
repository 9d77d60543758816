"""Recipes: settings found to train gain schedules and policies well and quickly."""

from dataclasses import dataclass, field
from typing import Any, Final

from vergence.errors import UnknownNameError


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Default settings for training a network."""

    inputs: str
    """Inputs of the network, see `vergence.controllers.networks.inputs`."""
    steps: int = 3_000_000
    """Control steps to learn from, over all environments."""
    envs: int = 256
    """Number of parallel environments."""
    episode_steps: int = 180
    """Control periods of a training episode. The target may appear as late as 0.6 s, and the time
    after settling teaches little. Evaluation runs whole trials."""
    randomise: bool = False
    """True to train with the hidden variation of scenario `hardware` in any scenario."""
    network: tuple[int, ...] = (32, 32)
    """Widths of the actor's hidden layers."""
    critic: tuple[int, ...] = (64, 64)
    """Widths of the critic's hidden layers."""
    shared: bool = True
    """True if the actor is one network applied to each joint in turn with the same weights
    (`networks.JointwisePolicy`); False for one network of all inputs. The critic always has all
    inputs."""
    activation: str = "tanh"
    """Activation of the hidden layers: `tanh`, `relu`, `elu` or `silu`."""
    algorithm: dict[str, Any] = field(default_factory=dict)
    """The options of PPO, by Stable-Baselines3's names."""
    log_std_init: float = -1.0
    """Logarithm of the initial standard deviation of exploration."""
    final_learning_rate: float | None = 3e-5
    """Learning rate at the end of the run, reached linearly; None for a constant one."""
    normalise_inputs: bool = False
    """True to normalise inputs by running statistics; this package's lie in [-1, 1] already."""
    normalise_rewards: bool = True
    """True to divide rewards by the standard deviation of the discounted return."""


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
"""The recipes by kind of training."""


def default_recipe(kind: str) -> Recipe:
    """The recipe of a kind of training.

    Raises:
        UnknownNameError: there is no such kind.
    """
    if kind not in RECIPES:
        raise UnknownNameError("recipe", kind, list(RECIPES))
    return RECIPES[kind]
