"""Definition of an experiment: a function of a config and a seed that returns a tidy table."""

import dataclasses
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.errors import ConfigurationError, UnknownNameError, did_you_mean
from vergence.eval.article.config_rules import check_bounds, check_value
from vergence.eval.article.criterion import verdict_of_ranges
from vergence.eval.article.registry import EXPERIMENTS
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
        cls,
        experiment: str,
        quantity: str,
        method: str,
        axis: str,
        article: tuple[float | None, float | None] | float | None,
        ours: tuple[float, float] | float,
        verdict: str | None = None,
        unit: str = "mm",
    ) -> "SummaryRow":
        """Make a row from ranges.

        Args:
            experiment: name of the experiment.
            quantity: the compared quantity.
            method: the triangulation method, or the control law.
            axis: axis of the quantity.
            article: the article's least and greatest figure, one of them None if it reports only
                the other; or a single figure; None for none.
            ours: our least and greatest figure, or a single one; nan for none.
            verdict: see the field; None to compare the ranges, see `verdict_of_ranges`.
            unit: unit of both figures.
        """
        article_low, article_high = article if isinstance(article, tuple) else (article, article)
        low, high = ours if isinstance(ours, tuple) else (ours, ours)
        if verdict is None:
            verdict = "not reported"
            if article_low is not None or article_high is not None:
                verdict = verdict_of_ranges(low, high, article_low, article_high)
        return cls(
            experiment=experiment,
            quantity=quantity,
            method=method,
            axis=axis,
            unit=unit,
            article_low=article_low,
            article_high=article_high,
            ours_low=float(low) if isfinite(low) else None,
            ours_high=float(high) if isfinite(high) else None,
            verdict=verdict,
        )


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment of the article: how a command runs it and a report shows it."""

    name: str
    title: str
    article: str
    """Place in the article: section, tables, figures."""
    text: str
    """The template of its section in the report, `section.jinja` in its folder: procedure and
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


def load_experiment(name: str) -> Experiment:
    """Load an experiment by name.

    Raises:
        UnknownNameError: there is no such experiment.
    """
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, list(EXPERIMENTS))
    module, _, attribute = EXPERIMENTS[name].partition(":")
    experiment: Experiment = getattr(import_module(module), attribute)
    return experiment


def resolve_config(experiment: Experiment, overrides: Mapping[str, Any], quick: bool) -> Any:
    """Apply the changes of `--quick`, if asked for, and then the user's to an experiment's config.

    Args:
        experiment: the experiment.
        overrides: the user's values by field.
        quick: true to apply the changes of `--quick` first.

    Returns:
        The config.

    Raises:
        ConfigurationError: a field is unknown, or a value is not allowed or not of its default's
            type.
    """
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

    Args:
        seed: the run's seed.
        experiment: the experiment's name.
        keys: non-negative integers that identify the job within the experiment.
    """
    entropy = [seed, zlib.crc32(experiment.encode()), *keys]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
