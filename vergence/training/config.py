"""What a training run is made of, and its place in the run folder."""

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError
from vergence.eval.reporting.runs import check_free, run_folder, write_config
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel

KINDS: Final = ("gain-schedule", "policy")
"""What can be learned: the gains of the article's law, or joint velocities."""
ALGORITHMS: Final = ("ppo", "sac")
PACKAGES: Final = ("torch", "stable-baselines3")
"""Packages whose versions matter beyond those of every run."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training run, all choices made: what `config.toml` in a run folder says.

    Raises:
        ConfigurationError: a field has a value that cannot be.
    """

    kind: str
    """`gain-schedule` or `policy`."""
    algo: str
    """`ppo` or `sac`."""
    scenario: str
    """Scenario whose training trials it learns from, and whose validation trials judge it."""
    head: str
    """Head: a preset's name or the path of a TOML file; the run folder keeps a copy."""
    plant: str
    """What moves the heads."""
    seed: int
    """Seed of the networks, the exploration and the trials."""
    steps: int
    """Control steps to learn from, over all environments."""
    envs: int
    """How many environments run side by side."""
    inputs: str
    """What the network sees, see `vergence.controllers.networks.inputs`."""
    algorithm: dict[str, Any]
    """The algorithm's own options, by Stable-Baselines3's names."""
    episode_steps: int = 120
    """Control periods of an episode to learn from; evaluation runs whole trials."""
    network: tuple[int, ...] = (64, 64)
    """Widths of the actor's hidden layers."""
    critic: tuple[int, ...] = (64, 64)
    """Widths of the critic's."""
    shared: bool = False
    """Whether the actor is one network used for each joint, for PPO."""
    activation: str = "tanh"
    """Activation of the hidden layers: `tanh`, `relu`, `elu` or `silu`."""
    log_std_init: float = 0.0
    """Logarithm of the first standard deviation of exploring actions, for PPO."""
    final_learning_rate: float | None = None
    """Where the learning rate falls to over the run, linearly; None for a constant one."""
    normalise_inputs: bool = True
    """Whether the network sees inputs less their mean by their standard deviation."""
    normalise_rewards: bool = True
    """Whether rewards are divided by the standard deviation of the discounted return."""
    randomise: bool = False
    """Whether to learn with the hidden variation of scenario `robust`, whatever the scenario."""
    evaluations: int = 40
    """How often it is evaluated and saved in the course of the run."""
    episodes: int = 300
    """Validation trials of an evaluation."""
    threads: int = 1
    """Threads of torch."""

    def __post_init__(self) -> None:
        for name, known in (("kind", KINDS), ("algo", ALGORITHMS), ("activation", ACTIVATIONS)):
            if getattr(self, name) not in known:
                raise ConfigurationError(
                    f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}"
                )
        for name in ("steps", "envs", "episode_steps", "evaluations", "episodes", "threads"):
            value: Any = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise ConfigurationError(f"{name}: expected a whole number from 1, got {value!r}")
        for name in ("network", "critic"):
            widths: tuple[Any, ...] = getattr(self, name)
            if not widths or not all(isinstance(width, int) and width > 0 for width in widths):
                raise ConfigurationError(
                    f"{name}: expected the widths of hidden layers, got {list(widths)!r}"
                )
        as_seed(self.seed)


ACTIVATIONS: Final = ("tanh", "relu", "elu", "silu")


def begin_run(folder: Path, config: TrainConfig, head: HeadModel) -> None:
    """Make a run folder with the configuration, the head and the versions.

    Raises:
        ConfigurationError: the folder cannot be made or has something in it.
    """
    with run_folder(folder) as partial:
        write_config(partial, config, head, PACKAGES)


def check_new(folder: Path) -> None:
    """Refuse a run folder with something in it, and say how to go on with a run in it.

    Raises:
        ConfigurationError: there is something.
    """
    if (folder / "config.toml").is_file():
        raise ConfigurationError(
            f"out: expected a new or empty folder, got a run: {folder} "
            f"(vergence train --resume {folder} goes on with it)"
        )
    check_free(folder)


def load_run(folder: Path) -> tuple[TrainConfig, HeadModel]:
    """The configuration and the head of a training run.

    Args:
        folder: the run folder.

    Raises:
        ConfigurationError: it is no run folder of `vergence train`.
    """
    path = folder / "config.toml"
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        fields = content["config"]
        known = {field.name for field in dataclasses.fields(TrainConfig)}
        if not isinstance(fields, dict) or not known >= set(fields):
            raise KeyError("config")
        widths = {name: tuple(fields[name]) for name in ("network", "critic")}
        config = TrainConfig(**{**fields, **widths})
    except OSError as error:
        raise ConfigurationError(
            f"expected the folder of a training run, got {folder}: {path.name}: {error.strerror}"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise ConfigurationError(
            f"expected the folder of a training run, got another {path}"
        ) from error
    return config, load_head(str(folder / "head.toml"))
