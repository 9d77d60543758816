"""Tuning: search for the options that do best on a scenario's training trials."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.config import TuneConfig
from vergence.eval.tuning.figures import draw_search
from vergence.eval.tuning.objective import Attempt, Objective
from vergence.eval.tuning.spaces import SearchRange, default_point, has_single_stepped_option
from vergence.eval.tuning.study import SearchSpec, run_search
from vergence.eval.tuning.study_storage import without_password
from vergence.files import atomic_files, hold_lock
from vergence.models.head import HeadModel
from vergence.reporting.runs import write_config_and_head, write_json
from vergence.reporting.style import save_figure

PACKAGES: Final = ("optuna",)


@dataclass(frozen=True, kw_only=True)
class TuneResult:
    """Result of tuning."""

    config: TuneConfig
    """The configuration, with defaults filled in."""
    best: Attempt
    attempts: list[Attempt]
    metric_unit: str
    """Unit of the headline metric, `s` or `px`."""


def tune(
    folder: Path,
    config: TuneConfig,
    search_ranges: Mapping[str, SearchRange],
    objective: Objective,
    head: HeadModel,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TuneResult:
    """Start or resume a search, and write its results.

    Args:
        folder: the run folder; results of an earlier call are overwritten.
        config: the configuration.
        search_ranges: search range of each option.
        objective: the objective to minimise.
        head: the head.
        progress: callback with the number of points tried and the total number.

    Returns:
        The result. The best point has the smallest loss (see `objective.loss`) and, among equal
        ones (median settle times are whole control periods), the smallest mean.

    Raises:
        VergenceError: the study cannot be opened, or its settings differ.
    """
    scenario = load_scenario(config.scenario)
    config = dataclasses.replace(
        config,
        head=config.head or scenario.head,
        grid=config.grid or has_single_stepped_option(search_ranges),
        steps=config.steps if config.learned else None,
        study=config.name,
        storage=config.storage_in(folder),
    )
    keys = ("controller", "scenario", "plant", "episodes", "steps")
    band = {} if scenario.target_moves else {"band_px": scenario.band_px}
    search = SearchSpec(
        name=config.name,
        storage=config.storage_in(folder),
        search_ranges=search_ranges,
        fixed_settings={**{key: getattr(config, key) for key in keys}, "head": head.digest, **band},
        attempts=config.trials,
        seed=config.seed,
        grid=config.grid,
        first=default_point(config.controller, search_ranges),
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    attempts = run_search(search, objective, progress)
    result = TuneResult(
        config=config,
        best=min(attempts, key=lambda attempt: attempt.rank),
        attempts=attempts,
        metric_unit="px" if scenario.target_moves else "s",
    )
    _write(folder, result, search_ranges, head)
    return result


def _write(
    folder: Path, result: TuneResult, search_ranges: Mapping[str, SearchRange], head: HeadModel
) -> None:
    config = result.config
    # processes that share a study may end together, and each writes the results of all
    with hold_lock(folder, wait=True), atomic_files(folder, moved_last="tune.json") as partial:
        shown = dataclasses.replace(config, storage=without_password(str(config.storage)))
        write_config_and_head(partial, shown, head, PACKAGES)
        rows = [
            {"number": attempt.number, **attempt.options, **attempt.results}
            for attempt in result.attempts
        ]
        pd.DataFrame(rows).to_csv(partial / "history.csv", index=False)
        title = f"{config.controller}, {config.scenario}, {config.episodes} training trials"
        figure = draw_search(result.attempts, search_ranges, title, result.metric_unit)
        save_figure(figure, partial / "tune")
        write_json(partial / "tune.json", tune_summary(result))


def tune_summary(result: TuneResult) -> dict[str, Any]:
    """Content of `tune.json`."""
    best = result.best
    return {
        **{
            key: value
            for key, value in dataclasses.asdict(result.config).items()
            if key != "storage"
        },
        "tried": len(result.attempts),
        "unit": result.metric_unit,
        "best": {"number": best.number, "options": best.options, **best.results},
    }
