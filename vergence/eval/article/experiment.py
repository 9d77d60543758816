"""An experiment: a function of a config and a seed that returns a tidy table; its settings."""

import dataclasses
import shlex
import tomllib
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.errors import ConfigurationError, UnknownNameError, did_you_mean
from vergence.eval.article.config import EXPERIMENTS
from vergence.eval.article.criterion import verdict_of_ranges
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Mapper
from vergence.reporting.text import Numbers


@dataclass(frozen=True, kw_only=True)
class SummaryRow:
    """One line of the summary: the article's figure beside ours."""

    experiment: str
    quantity: str
    method: str
    axis: str
    unit: str
    article_low: float | None
    article_high: float | None
    ours_low: float | None
    """None if there is no number, such as the time of a trial that never settles."""
    ours_high: float | None
    verdict: str
    """A word of `VERDICTS` or `OTHER_VERDICTS` of `vergence.eval.article.criterion`."""

    @classmethod
    def of(
        cls, experiment: str, quantity: str, method: str, axis: str,
        article: tuple[float | None, float | None] | float | None,
        ours: tuple[float, ...] | float, verdict: str | None = None, unit: str = "mm",
    ) -> "SummaryRow":  # fmt: skip
        """Make a row from least and greatest figures, or from single ones.

        The article's are None where it reports none, ours nan. Without a verdict the ranges are
        compared.
        """
        article_low, article_high = article if isinstance(article, tuple) else (article, article)
        low, high = ours if isinstance(ours, tuple) else (ours, ours)
        if verdict is None:
            verdict = "not reported"
            if article_low is not None or article_high is not None:
                verdict = verdict_of_ranges(low, high, article_low, article_high)
        known = (float(value) if isfinite(value) else None for value in (low, high))
        ours_low, ours_high = known
        return cls(
            experiment=experiment, quantity=quantity, method=method, axis=axis, unit=unit,
            article_low=article_low, article_high=article_high, ours_low=ours_low,
            ours_high=ours_high, verdict=verdict,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment of the article: how a command runs it and a report shows it."""

    name: str
    title: str
    article: str
    """Place in the article: section, tables, figures."""
    text: str
    """The template of its section in the report, a file of `sections`: procedure and
    results, see `vergence.reporting.text`."""
    config: type[Any]
    """A frozen dataclass with a default for every field."""
    quick: Mapping[str, Any]
    """The fields that `--quick` changes."""
    run: Callable[[Any, int, Mapper], pd.DataFrame]
    """(config, seed, mapper) to a tidy table: a row per observation, a column per variable."""
    summarise: Callable[[pd.DataFrame, Any], list[SummaryRow]]
    """(table, config) to the article's figures beside ours, with verdicts."""
    numbers: Callable[[pd.DataFrame, Any], Numbers]
    """(table, config) to the numbers that the text fills in and the docs state."""
    draw: Callable[[pd.DataFrame, Any], dict[str, Figure]]
    """(table, config) to figures by name, such as `fig06-absolute-errors`."""


def rows_where(table: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """The rows of a table whose columns have the given values."""
    for column, value in values.items():
        table = table[table[column] == value]
    return table


def load_experiment(name: str) -> Experiment:
    """Load an experiment by name."""
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, list(EXPERIMENTS))
    module, _, attribute = EXPERIMENTS[name].partition(":")
    experiment: Experiment = getattr(import_module(module), attribute)
    return experiment


def resolve_config(experiment: Experiment, overrides: Mapping[str, Any], quick: bool) -> Any:
    """Apply the changes of `--quick`, if asked for, then the user's to a config."""
    config = dataclasses.replace(experiment.config(), **(experiment.quick if quick else {}))
    return _changed(experiment.name, overrides, config)


def _changed(where: str, values: Any, default: Any) -> Any:
    """Change some values of a configuration, or of a dataclass nested in one."""
    if not isinstance(values, Mapping):
        raise ConfigurationError(f"{where}: expected values by field, got {values!r}")
    known = {field.name: getattr(default, field.name) for field in dataclasses.fields(default)}
    for name, value in values.items():
        if name not in known:
            raise ConfigurationError(
                f"{where}.{name}: expected one of {', '.join(known)}, got {name!r} = {value!r}"
                f"{did_you_mean(name, known)}"
            )
    changes = {n: _like(f"{where}.{n}", value, known[n]) for n, value in values.items()}
    for name, value in changes.items() if not isinstance(default, ModelErrors) else ():
        check_value(f"{where}.{name}", name, value, known[name])
    changed = dataclasses.replace(default, **changes)
    check_bounds(where, vars(changed))
    return changed


def _like(key: str, value: Any, default: Any) -> Any:
    """Convert a value to the type of its default, or refuse it."""
    if dataclasses.is_dataclass(default):
        return _changed(key, value, default)
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) or not value:
            raise ConfigurationError(f"{key}: expected a list such as {default}, got {value!r}")
        return tuple(_like(key, item, default[0]) for item in value)
    if isinstance(default, float) and type(value) in (int, float) and isfinite(value):
        return float(value)
    if type(value) is not type(default) or isinstance(default, float):
        raise ConfigurationError(f"{key}: expected a value such as {default!r}, got {value!r}")
    return value


def job_rng(seed: int, experiment: str, *keys: int) -> np.random.Generator:
    """Random generator of one job, independent of those of all other jobs and of where it runs.

    The keys are non-negative integers that identify the job within the experiment.
    """
    entropy = [seed, zlib.crc32(experiment.encode()), *keys]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))


def job_seed(seed: int, experiment: str, *keys: int) -> int:
    """Seed of one job's plant, see `job_rng`."""
    return int(job_rng(seed, experiment, *keys).integers(2**63))


_SIGNED: Final = ("point_mm", "origin_mm", "end_mm", "place_mm", "aside_deg")
"""Name endings of coordinates and angles, which may be negative."""
_NOT_SIGNED: Final = ("mount_place_mm",)
_MAY_BE_ZERO: Final = ("settle_s", "worse_margin", "mount_rotation_deg", "mount_place_mm")
"""Fields that may be zero, besides those whose default has a zero; all others must be positive."""
_MOST_COUNT: Final = 10_000_000
"""Largest integer that a field may have (chosen: far above any useful count)."""
_ORDERED: Final = (("least_gain", "greatest_gain"), ("least_threshold_px", "greatest_threshold_px"))
"""Pairs of fields; the first must not exceed the second."""
ARTICLE_HEADS: Final = ("simulated", "physical")
"""Names of the article's own heads; the experiments reproduce their figures."""
_STEPS: Final[tuple[tuple[str, str | None, str], ...]] = (
    ("gain_step", "least_gain", "greatest_gain"),
    ("plane_step", "least_gain", "greatest_gain"),
    ("threshold_step_px", "least_threshold_px", "greatest_threshold_px"),
    ("lag_step_s", None, "greatest_lag_s"),
)
"""For each grid: the fields of its step, its first value (None for zero) and its last value."""
_MOST_STEPS: Final = 100_000
"""Largest number of steps of a grid (chosen: bounds memory, far above any useful grid)."""


def check_value(key: str, name: str, value: Any, default: Any) -> None:
    """Refuse a number or a head that a field of this name must not have."""
    if name == "head":
        _check_head(key, value)
    place = isinstance(default, tuple) and len(default) < 4 and name.endswith(("_mm", "_px"))
    if place and len(value) != len(default):
        raise ConfigurationError(f"{key}: expected {len(default)} numbers, got {value!r}")
    signed = name.endswith(_SIGNED) and name not in _NOT_SIGNED
    defaults = default if isinstance(default, tuple) else (default,)
    zero = name in _MAY_BE_ZERO or 0 in defaults
    for one in value if isinstance(value, tuple) else (value,):
        if isinstance(one, bool | str) or not isinstance(one, int | float) or signed:
            continue
        if one < 0 or (one == 0 and not zero):
            least = "of at least 0" if zero else "above 0"
            raise ConfigurationError(f"{key}: expected a number {least}, got {one!r}")
        if isinstance(one, int) and one > _MOST_COUNT:
            raise ConfigurationError(f"{key}: expected at most {_MOST_COUNT}, got {one!r}")


def _check_head(key: str, name: str) -> None:
    """Refuse a head, given by name or file, that is not one of the article's."""
    head = load_head(name)
    if head.digest not in {load_head(own).digest for own in ARTICLE_HEADS}:
        raise ConfigurationError(
            f"{key}: expected {' or '.join(ARTICLE_HEADS)}, the article's own heads, got {name}; "
            f"vergence evaluate --head {shlex.quote(name)} compares controllers on it"
        )


def check_bounds(config_name: str, values: Mapping[str, Any]) -> None:
    """Refuse reversed bounds, and grids with too many steps."""
    for low, high in _ORDERED:
        if low in values and not values[low] <= values[high]:
            raise ConfigurationError(
                f"{config_name}: expected {low} <= {high}, got {values[low]} and {values[high]}"
            )
    onsets = values.get("onset_gains", (0.0, 1.0))
    if len(onsets) != 2 or not onsets[0] < onsets[1]:
        raise ConfigurationError(
            f"{config_name}.onset_gains: expected two rising numbers, got {onsets}"
        )
    for step, least, most in _STEPS:
        if step not in values:
            continue
        span = values[most] - (0.0 if least is None else values[least])
        if span > _MOST_STEPS * values[step]:
            raise ConfigurationError(
                f"{config_name}.{step}: expected at most {_MOST_STEPS} steps to {most} = "
                f"{values[most]}, got {values[step]}"
            )


Overrides = dict[str, dict[str, Any]]
"""Values by experiment and field; nested by field for a field that is a dataclass."""


def read_overrides(path: Path | None, settings: Sequence[str]) -> Overrides:
    """Read overrides from a TOML file and, over those, from `EXPERIMENT.FIELD=VALUE` words."""
    overrides = {} if path is None else _read_file(path)
    for word in settings:
        key, equals, text = word.partition("=")
        name, *fields = (part.strip() for part in key.split("."))
        if not (equals and name and fields and all(fields)):
            raise ConfigurationError(f"set: expected EXPERIMENT.FIELD=VALUE, got {word!r}")
        place: Any = overrides.setdefault(name, {})
        for field in fields[:-1]:
            place = place.setdefault(field.replace("-", "_"), {})
            if not isinstance(place, dict):
                raise ConfigurationError(
                    f"set: expected a field with fields of its own for {word!r}, got {place!r}"
                )
        place[fields[-1].replace("-", "_")] = _read_value(text)
    for name in overrides:
        if name not in EXPERIMENTS:
            raise ConfigurationError(
                f"config: expected one of {', '.join(EXPERIMENTS)}, got {name!r}"
                f"{did_you_mean(name, EXPERIMENTS)}"
            )
    return overrides


def _read_file(path: Path) -> Overrides:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(
            f"config: expected a readable TOML file, got {path}: {error}"
        ) from error
    for name, values in content.items():
        if not isinstance(values, dict):
            raise ConfigurationError(
                f"config: expected tables named after experiments, got {name} = {values!r}"
            )
    return content


def _read_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()
