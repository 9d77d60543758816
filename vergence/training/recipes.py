"""Recipes: what has been found to train gain schedules and policies well, and quickly."""

from dataclasses import dataclass, field
from typing import Any, Final

from vergence.errors import UnknownNameError


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How a network is trained, unless told otherwise."""

    inputs: str
    """What the network sees, see `vergence.controllers.networks.inputs`."""
    steps: int
    """Control steps to learn from, over all environments."""
    envs: int = 256
    """How many environments run side by side."""
    episode_steps: int = 120
    """Control periods of an episode to learn from: what comes after settling teaches little.
    Evaluation runs whole trials."""
    randomise: bool = False
    """Whether to learn with the hidden variation of scenario `robust`, whatever the scenario."""
    network: tuple[int, ...] = (32, 32)
    """Widths of the actor's hidden layers."""
    critic: tuple[int, ...] = (64, 64)
    """Widths of the critic's."""
    shared: bool = True
    """Whether the actor is one network used for each joint (`networks.JointPolicy`)."""
    activation: str = "tanh"
    """Activation of the hidden layers: `tanh`, `relu`, `elu` or `silu`."""
    algorithm: dict[str, Any] = field(default_factory=dict)
    """The algorithm's own options, by Stable-Baselines3's names."""
    log_std_init: float = -1.0
    """Logarithm of the first standard deviation of exploring actions (PPO)."""
    final_learning_rate: float | None = None
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

# a few thousand steps a second, as every step of all environments is learned from at once
_SAC: Final = {
    "learning_rate": 1e-3,
    "buffer_size": 300_000,
    "learning_starts": 10_000,
    "batch_size": 512,
    "train_freq": 1,
    "gradient_steps": 4,
    "gamma": 0.97,
}

RECIPES: Final[dict[tuple[str, str], Recipe]] = {
    ("gain-schedule", "ppo"): Recipe(
        inputs="predicted",
        steps=2_000_000,
        randomise=True,  # one schedule for known and for unknown timing
        algorithm=_PPO,
        final_learning_rate=3e-5,
    ),
    ("policy", "ppo"): Recipe(
        inputs="to_go", steps=3_000_000, algorithm=_PPO, final_learning_rate=3e-5
    ),
    ("gain-schedule", "sac"): Recipe(
        inputs="predicted", steps=500_000, envs=64, shared=False, algorithm=_SAC
    ),
    ("policy", "sac"): Recipe(
        inputs="to_go",
        steps=800_000,
        envs=64,
        shared=False,
        # a policy that must act at random cannot hold a target within a pixel
        algorithm={**_SAC, "gamma": 0.95, "target_entropy": -12.0},
    ),
}
"""The recipes by what is learned and the algorithm."""


def recipe(kind: str, algo: str) -> Recipe:
    """The recipe of a kind and an algorithm.

    Raises:
        UnknownNameError: there is none.
    """
    if (kind, algo) not in RECIPES:
        raise UnknownNameError("recipe", f"{kind} {algo}", [" ".join(key) for key in RECIPES])
    return RECIPES[kind, algo]
