"""What a training run is made of, and its place in the run folder."""

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError
from vergence.eval.reporting.runs import check_free, command_of, run_folder, write_config
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.training.options import Algorithm, Kind
from vergence.training.recipes import Recipe

KINDS: Final = get_args(Kind)
ALGORITHMS: Final = get_args(Algorithm)
ACTIVATIONS: Final = ("tanh", "relu", "elu", "silu")
PACKAGES: Final = ("torch", "stable-baselines3")
"""Packages whose versions matter beyond those of every run."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig(Recipe):
    """A training run, all choices made: what `config.toml` in a run folder says.

    Raises:
        ConfigurationError: a field has a value that cannot be.
    """

    kind: Kind
    """`gain-schedule` or `policy`."""
    algo: Algorithm
    """`ppo` or `sac`."""
    scenario: str
    """Scenario whose training trials it learns from, and whose validation trials judge it."""
    head: str
    """Head: a preset's name or the path of a TOML file; the run folder keeps a copy."""
    plant: str
    """What moves the heads."""
    seed: int
    """Seed of the networks, the exploration and the trials."""
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
    if (folder / "config.toml").is_file() and command_of(folder) in ("train", None):
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
