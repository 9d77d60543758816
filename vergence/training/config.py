"""The configuration of a training run, and its files in the run folder."""

import dataclasses
import math
import tomllib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, get_args, get_type_hints

from vergence.envs.streams import as_seed
from vergence.errors import ConfigurationError, did_you_mean
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.reporting.runs import (
    check_folder_free,
    run_folder,
    run_folder_command,
    write_config_and_head,
)
from vergence.training.algorithm_options import check_ppo_options
from vergence.training.options import Kind, TrainingPlant
from vergence.training.recipes import Recipe

MAX_WIDTH: Final = 4096
MAX_PRODUCTS: Final = 2**20
"""Largest width of a hidden layer, and number of weights between them (chosen: a bundle's size)."""
KINDS: Final = get_args(Kind)
PLANTS: Final = get_args(TrainingPlant)
ACTIVATIONS: Final = ("tanh", "relu", "elu", "silu")
PACKAGES: Final = ("torch", "stable-baselines3")
"""Packages whose versions are recorded in addition to those of every run."""
_MAX_COUNTS: Final = {
    "steps": 2**53,
    "envs": 2**20,  # number of environments that get distinct seeds in a scenario's split
    "episode_steps": 2**31,
    "evaluations": 2**31,
    "episodes": 2**20,
    "threads": 256,
}
"""Largest value of each count; the smallest is 1."""
_LOG_STD_RANGE: Final = (-20.0, 2.0)
"""Bounds of `log_std_init`, logarithm of a standard deviation of actions in [-1, 1] (numerical)."""
_TYPES_BY_ANNOTATION: Final[dict[Any, tuple[type, ...]]] = {
    int: (int,),
    bool: (bool,),
    float: (float, int),
    float | None: (float, int, type(None)),
    tuple[int, ...]: (tuple,),
    dict[str, Any]: (dict,),
}
"""Python types that the values of a field may have, by the field's annotation; else `str`."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig(Recipe):
    """The complete configuration of a training run, as in the run folder's `config.toml`.

    Raises:
        ConfigurationError: a field has an invalid value.
    """

    kind: Kind
    """`gain-schedule` or `policy`."""
    scenario: str
    """Scenario whose training trials are used for learning, and its validation trials for
    evaluation."""
    head: str
    """Head: a preset's name, the path of a TOML file, or empty for the scenario's own; the run
    folder keeps a copy."""
    plant: TrainingPlant
    """Plant that moves the heads."""
    seed: int
    """Seed of the networks, the exploration and the trials."""
    evaluations: int = 40
    """Number of evaluations during the run; the run is saved at each."""
    episodes: int = 300
    """Validation trials per evaluation."""
    threads: int = 1
    """Threads of torch."""

    def __post_init__(self) -> None:
        for name in get_type_hints(TrainConfig):
            check_type(name, getattr(self, name))
        for name, known in (
            ("kind", KINDS),
            ("plant", PLANTS),
            ("activation", ACTIVATIONS),
        ):
            _check_known(name, getattr(self, name), known)
        for name, most in _MAX_COUNTS.items():
            count = getattr(self, name)
            if not 1 <= count <= most:
                raise ConfigurationError(
                    f"{name}: expected a whole number from 1 to {most}, got {count}"
                )
        for name in ("network", "critic"):
            _check_widths(name, getattr(self, name))
        if not _LOG_STD_RANGE[0] <= self.log_std_init <= _LOG_STD_RANGE[1]:
            raise ConfigurationError(
                f"log_std_init: expected a number from {_LOG_STD_RANGE[0]:g} to "
                f"{_LOG_STD_RANGE[1]:g}, "
                f"got {self.log_std_init!r}"
            )
        last = self.final_learning_rate
        if last is not None and not (math.isfinite(last) and last >= 0.0):
            raise ConfigurationError(f"final_learning_rate: expected a number from 0, got {last!r}")
        check_ppo_options(self.algorithm)
        as_seed(self.seed)


def check_kind(kind: str) -> None:
    """Raise an error for an unknown kind of training.

    Raises:
        ConfigurationError: there is no kind of that name.
    """
    _check_known("train", kind, KINDS)


def check_type(name: str, value: object) -> None:
    """Raise an error for a value of the wrong type.

    Args:
        name: a field of `TrainConfig`.
        value: its value.

    Raises:
        ConfigurationError: the value has another type than the field.
    """
    hint = get_type_hints(TrainConfig)[name]
    expected = _TYPES_BY_ANNOTATION.get(hint, (str,))
    if not isinstance(value, expected) or (isinstance(value, bool) and hint is not bool):
        words = " or ".join("list" if one is tuple else one.__name__ for one in expected)
        raise ConfigurationError(
            f"{name}: expected a value of type {words.removesuffix(' or NoneType')}, got {value!r}"
        )


def _check_known(name: str, value: object, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ConfigurationError(
            f"{name}: expected one of {', '.join(known)}, got {value!r}{did_you_mean(value, known)}"
        )


def _check_widths(name: str, widths: tuple[Any, ...]) -> None:
    """Check that a bundle can hold hidden layers of these widths."""
    whole = all(isinstance(w, int) and not isinstance(w, bool) for w in widths)
    if not widths or not whole or not all(1 <= width <= MAX_WIDTH for width in widths):
        raise ConfigurationError(
            f"{name}: expected the widths of hidden layers, from 1 to {MAX_WIDTH}, "
            f"got {list(widths)!r}"
        )
    products = sum(a * b for a, b in pairwise(widths))
    if products > MAX_PRODUCTS:
        raise ConfigurationError(
            f"{name}: expected at most {MAX_PRODUCTS} weights between hidden layers, got {products}"
        )


def begin_run(folder: Path, config: TrainConfig, head: HeadModel) -> None:
    """Create a run folder with the configuration, the head and the packages' versions.

    Raises:
        ConfigurationError: the folder cannot be created or is not empty.
    """
    with run_folder(folder) as partial:
        write_config_and_head(partial, config, head, PACKAGES)


def check_empty(folder: Path) -> None:
    """Raise an error for a folder that is not empty; it says how to resume a run in the folder.

    Raises:
        ConfigurationError: the folder is not empty.
    """
    if (folder / "config.toml").is_file() and run_folder_command(folder) in ("train", None):
        raise ConfigurationError(
            f"out: expected a new or empty folder, got a run: {folder} "
            f"(vergence train --resume {folder} goes on with it)"
        )
    check_folder_free(folder)


def load_run(folder: Path) -> tuple[TrainConfig, HeadModel]:
    """Load the configuration and the head of a training run.

    Args:
        folder: the run folder.

    Raises:
        ConfigurationError: it is not a run folder of `vergence train`, or its head has changed.
    """
    path = folder / "config.toml"
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        fields = content["config"]
        known = {field.name for field in dataclasses.fields(TrainConfig)}
        if not isinstance(fields, dict) or not known >= set(fields):
            raise KeyError("config")
        lists = {name: tuple(v) for name, v in fields.items() if isinstance(v, list)}
        config = TrainConfig(**{**fields, **lists})
        digest = content["head"]["digest"]
    except OSError as error:
        raise ConfigurationError(
            f"expected the folder of a training run, got {folder}: {path.name}: {error.strerror}"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise ConfigurationError(
            f"expected the folder of a training run, got another {path}"
        ) from error
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    head = load_head(str(folder / "head.toml"))
    if head.digest != digest:
        raise ConfigurationError(
            f"{folder / 'head.toml'}: expected the head that config.toml names (digest "
            f"{str(digest)[:12]}), got another ({head.digest[:12]})"
        )
    return config, head
