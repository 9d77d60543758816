"""Tuning: the options with which a controller does best on a scenario's training trials."""

import dataclasses
import inspect
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.controllers.controller import CONTROLLERS, make_controller
from vergence.controllers.tuned import SEARCH_SPACES, Span
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.reporting.runs import write_config, write_json
from vergence.eval.reporting.style import save_figure
from vergence.eval.trials.run import headline, run_trials
from vergence.eval.trials.scenarios import Scenario, load_scenario
from vergence.eval.tuning.figures import draw_search
from vergence.eval.tuning.study import Attempt, Objective, Options, Search, run_search
from vergence.eval.tuning.study_storage import without_password
from vergence.models.head import HeadModel

PACKAGES: Final = ("optuna",)
_ALIASES: Final = {"ibvs-tuned": "ibvs"}
"""Controllers that are another one with tuned options."""


@dataclass(frozen=True, kw_only=True)
class TuneConfig:
    """What to tune, and how."""

    controller: str
    """A controller with a search space, or a kind of training."""
    scenario: str
    """Whose training trials judge."""
    head: str
    """Head: a preset's name or the path of a TOML file."""
    plant: str
    """What moves the heads."""
    trials: int
    """How many points to try in total; a grid has its own number."""
    episodes: int
    """Trials of the scenario that judge each point."""
    seed: int
    """Of the trials and the search."""
    grid: bool
    """Whether every point of the grid is tried."""
    storage: str
    """Where the study is kept: a SQLite file or a PostgreSQL URL."""
    study: str
    """Its name."""
    steps: int | None = None
    """Control steps of each short training, of a kind of training."""


@dataclass(frozen=True, kw_only=True)
class TuneResult:
    """What tuning has found."""

    best: Attempt
    attempts: list[Attempt]
    unit: str
    """`s` or `px`, of the headline metric."""


def search_space(controller: str) -> dict[str, Span]:
    """Where a controller's options are searched.

    Raises:
        UnknownNameError: there is no such controller, or it has nothing to tune.
    """
    name = _ALIASES.get(controller, controller)
    if name not in SEARCH_SPACES:
        known = [*sorted(SEARCH_SPACES), "gain-schedule", "policy"]
        raise UnknownNameError("controller to tune", controller, known)
    return SEARCH_SPACES[name]


def first_point(controller: str, spans: Mapping[str, Span]) -> Options | None:
    """The controller's own defaults, where they lie in the search; None where they do not."""
    module, _, attribute = CONTROLLERS.get(_ALIASES.get(controller, controller), "").partition(":")
    if not module:
        return None
    known = inspect.signature(getattr(import_module(module), attribute)).parameters
    point = {}
    for name, span in spans.items():
        default = known[name].default if name in known else None
        if not isinstance(default, int | float) or not span.low <= default <= span.high:
            return None
        point[name] = float(default)
    return point


def is_grid(spans: Mapping[str, Span]) -> bool:
    """Whether a search is small enough to try every point: one option with a step."""
    return len(spans) == 1 and all(span.step is not None for span in spans.values())


def controller_objective(config: TuneConfig, scenario: Scenario, head: HeadModel) -> Objective:
    """Judges options by the scenario's training trials, the same for all options.

    A trial that never settles counts as the whole trial.
    """
    name = _ALIASES.get(config.controller, config.controller)

    def judge(found: Options) -> dict[str, float]:
        options: dict[str, Any] = dict(found)
        trials = run_trials(
            make_controller(name, head, **options),
            scenario,
            episodes=config.episodes,
            plant=config.plant,
            split="train",
            seed=config.seed,
            head=head,
        )
        values = trials.tracking_px if trials.moving else trials.settle_or_trial_s()
        settled = ~trials.lost if trials.moving else np.isfinite(trials.settle_s())
        return {
            "headline": headline(trials),
            "mean": float(np.mean(values)),
            "settled_fraction": float(np.mean(settled)),
        }

    return judge


def tune(
    folder: Path,
    config: TuneConfig,
    spans: Mapping[str, Span],
    objective: Objective,
    head: HeadModel,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TuneResult:
    """Search, or go on with a search, and write what it found.

    Args:
        folder: the run folder; that of an earlier call is written over.
        config: what to tune.
        spans: where each option is searched.
        objective: what to make small.
        head: the head.
        progress: told the number of points tried, and their number in the end.

    Returns:
        What was found: the smallest headline metric (see `study.loss`), and among equal ones
        (median settle times come in whole control periods) the smallest mean.

    Raises:
        VergenceError: the study cannot be opened or goes on with another setting.
    """
    scenario = load_scenario(config.scenario)
    keys = ("controller", "scenario", "plant", "episodes", "steps")
    search = Search(
        name=config.study,
        storage=config.storage,
        spans=spans,
        setting={**{key: getattr(config, key) for key in keys}, "head": head.digest},
        attempts=config.trials,
        seed=config.seed,
        grid=config.grid,
        first=first_point(config.controller, spans),
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    attempts = run_search(search, objective, progress)
    result = TuneResult(
        best=min(attempts, key=lambda attempt: attempt.rank),
        attempts=attempts,
        unit="px" if scenario.moving else "s",
    )
    _write(folder, config, result, spans, head)
    return result


def _write(
    folder: Path,
    config: TuneConfig,
    result: TuneResult,
    spans: Mapping[str, Span],
    head: HeadModel,
) -> None:
    """Write the run's files beside their places, and rename them."""
    with tempfile.TemporaryDirectory(prefix=".tune-", dir=folder) as beside:
        partial = Path(beside)
        shown = dataclasses.replace(config, storage=without_password(config.storage))
        write_config(partial, shown, head, PACKAGES)
        rows = [
            {"number": attempt.number, **attempt.options, **attempt.found}
            for attempt in result.attempts
        ]
        pd.DataFrame(rows).to_csv(partial / "history.csv", index=False)
        title = f"{config.controller}, {config.scenario}, {config.episodes} training trials"
        figure = draw_search(result.attempts, spans, title, result.unit)
        save_figure(figure, partial / "tune")
        write_json(partial / "tune.json", summary(config, result))
        for path in sorted(partial.iterdir(), key=lambda path: path.name == "tune.json"):
            os.replace(path, folder / path.name)


def summary(config: TuneConfig, result: TuneResult) -> dict[str, Any]:
    """What `tune.json` says."""
    return {
        **{key: value for key, value in dataclasses.asdict(config).items() if key != "storage"},
        "tried": len(result.attempts),
        "unit": result.unit,
        "best": {
            "number": result.best.number,
            "options": result.best.options,
            **result.best.found,
        },
    }
