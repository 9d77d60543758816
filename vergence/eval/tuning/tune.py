"""Search for the options that do best on a scenario's training trials; write the results.

A search is an Optuna study in a database: a SQLite file, or PostgreSQL for several machines. A call
with an existing study resumes it, whether it has ended, was killed, or is still running in other
processes. The points of a search are drawn from (seed, number of the attempt), so an interrupted
search tries the same points as an uninterrupted one. If several processes search at once, the
points also depend on the order in which earlier attempts end.
"""

import dataclasses
import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import optuna
import pandas as pd
from matplotlib.figure import Figure
from optuna import Study, Trial
from optuna.distributions import BaseDistribution
from optuna.exceptions import StorageInternalError
from optuna.samplers import BaseSampler, GridSampler, TPESampler
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from vergence.errors import ConfigurationError, VergenceError
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.objective import Attempt, Objective, failure_penalised_metric
from vergence.eval.tuning.spaces import (
    SearchRange,
    TuneConfig,
    default_point,
    has_single_stepped_option,
)
from vergence.files import atomic_files, hold_lock
from vergence.models.head import HeadModel
from vergence.reporting.runs import write_config_and_head, write_json
from vergence.reporting.style import (
    BLUE,
    GREY,
    ORANGE,
    figure_style,
    legend_below,
    new_figure,
    save_figure,
)

_CONNECT_TIMEOUT_S: Final = 10
"""Time limit for connecting to a PostgreSQL server, s (chosen: slow networks against waiting)."""
_CREATION_RACE_ERRORS: Final = (
    "already exists",
    "UniqueViolation",
    "UNIQUE constraint",
    "is locked",
)
_RETRY_PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, None)


@contextmanager
def open_study(file_or_url: str, name: str, sampler: BaseSampler) -> Iterator[Study]:
    """Open or create a study; its connections are closed at the end of the context."""
    try:
        study, storage = _create(file_or_url, name, sampler)
    except (SQLAlchemyError, ImportError, RuntimeError) as error:
        raise ConfigurationError(
            f"storage: expected a SQLite file or a PostgreSQL URL that can be opened, got "
            f"{without_password(file_or_url)}: {str(error).splitlines()[0]}"
        ) from error
    try:
        yield study
    except (SQLAlchemyError, StorageInternalError) as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else error
        raise ConfigurationError(
            f"storage: {without_password(file_or_url)} can no longer be read or written: "
            f"{str(cause or error).splitlines()[0]} (what is in it stays; the next call goes on)"
        ) from error
    finally:
        with suppress(SQLAlchemyError):
            storage.remove_session()
        storage.engine.dispose()


def _create(place: str, name: str, sampler: BaseSampler) -> tuple[Study, RDBStorage]:
    """Open or create the study; retry if another process is creating the tables meanwhile."""
    url = _url(place)
    # without a timeout, a server that accepts the connection but never answers would block forever
    patient = url.startswith("sqlite") or "connect_timeout=" in url
    connect = {} if patient else {"connect_timeout": _CONNECT_TIMEOUT_S}
    for pause_s in _RETRY_PAUSES_S:
        try:
            storage = RDBStorage(url, engine_kwargs={"connect_args": connect})
            study = optuna.create_study(
                storage=storage,
                study_name=name,
                sampler=sampler,
                direction="minimize",
                load_if_exists=True,
            )
            return study, storage
        except DBAPIError as error:
            if pause_s is None or not any(word in str(error) for word in _CREATION_RACE_ERRORS):
                raise
            time.sleep(pause_s)
    raise AssertionError("the last pause is None")


def without_password(storage: str) -> str:
    """Hide the password of a study's storage, for messages and files."""
    return re.sub(r"(://[^/?#:]*:)[^/?#]*@", r"\1***@", storage)


def _url(storage: str) -> str:
    if "://" not in storage:
        path = Path(storage)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(
                f"storage: expected a file that can be made, got {storage}: {error.strerror}"
            ) from error
        return f"sqlite:///{path.absolute()}"
    kind, _, rest = storage.partition("://")
    # for the plain name, SQLAlchemy would require psycopg2
    return f"postgresql+psycopg://{rest}" if kind in ("postgresql", "postgres") else storage


MOST_POINTS: Final = 5000
"""Largest grid that is searched, in points (chosen: a bound on time)."""


@dataclass(frozen=True, kw_only=True)
class SearchSpec:
    """The search space, settings and storage of a study."""

    name: str
    """The study's name."""
    storage: str
    """A SQLite file, or the URL of a PostgreSQL database."""
    search_ranges: Mapping[str, SearchRange]
    """Search range of each option."""
    fixed_settings: Mapping[str, Any]
    """All else that the results depend on; a study resumes only with equal values."""
    attempts: int
    """Total number of points to try; ignored for a grid."""
    seed: int
    grid: bool
    """True to try every point of the grid of the search ranges' steps."""
    first: Mapping[str, float] | None = None
    """Point to try first, if any; ignored for a grid."""

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise ConfigurationError(f"trials: expected at least 1, got {self.attempts}")
        if self.grid:
            for name, span in self.search_ranges.items():
                if span.step is None:
                    raise ConfigurationError(
                        f"grid: expected spans with a step, got {name} without one"
                    )
            if self.total > MOST_POINTS:
                raise ConfigurationError(
                    f"grid: expected at most {MOST_POINTS} points, got {self.total}"
                )

    @property
    def total(self) -> int:
        """Total number of points of the finished study."""
        if self.grid:
            return math.prod(len(span.points()) for span in self.search_ranges.values())
        return self.attempts

    def sampler(self) -> BaseSampler:
        """Make the sampler that chooses the points."""
        if self.grid:
            points = {name: span.points() for name, span in self.search_ranges.items()}
            return _PatientGrid(points, seed=self.seed)
        return _KeyedSampler(self.seed)


def run_search(
    search: SearchSpec,
    objective: Objective,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Attempt]:
    """Try points until the study has the requested number; return all valid ones by their numbers.

    Raises:
        ConfigurationError: the study cannot be opened or has another setting.
        VergenceError: no point is valid.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with open_study(search.storage, search.name, search.sampler()) as study:
        _check_setting(study, search)
        if search.first is not None and not search.grid:
            study.enqueue_trial(dict(search.first), skip_if_exists=True)
        refused = _fill(study, search, objective, progress)
        attempts = [
            Attempt(
                number=trial.number,
                options=dict(trial.params),
                results={name: float(value) for name, value in trial.user_attrs.items()},
            )
            for trial in study.get_trials(deepcopy=False)
            if trial.state == TrialState.COMPLETE
        ]
    if not attempts:
        raise refused or ConfigurationError(
            f"study {search.name}: expected points that can be tried, got none"
        )
    return attempts


def _fill(
    study: Study,
    search: SearchSpec,
    objective: Objective,
    progress: Callable[[int, int], None],
) -> VergenceError | None:
    """Try points until there are enough; return the last error of an invalid point, if any."""
    refused: VergenceError | None = None
    while (done := _count(study)) < search.total:
        progress(done, search.total)
        trial = study.ask()
        try:
            options = {
                name: _suggest(trial, name, span) for name, span in search.search_ranges.items()
            }
            found = objective(options)
        except VergenceError as error:
            refused = error
            study.tell(trial, state=TrialState.PRUNED)
            continue
        except BaseException:
            # a grid's sampler repeats unfinished points, but not failed ones
            if not search.grid:
                study.tell(trial, state=TrialState.FAIL)
            raise
        for name, value in found.items():
            trial.set_user_attr(name, float(value))
        study.tell(trial, failure_penalised_metric(found))
    progress(search.total, search.total)
    return refused


def _suggest(trial: Trial, name: str, span: SearchRange) -> float:
    # without a step: a grid's points are exact decimals, which Optuna would round differently
    return trial.suggest_float(name, span.low, span.high, log=span.scale == "log")


def _count(study: Study) -> int:
    """Number of points tried, including invalid ones."""
    states = (TrialState.COMPLETE, TrialState.PRUNED)
    trials = study.get_trials(deepcopy=False, states=states)
    # several processes may have tried a point of a grid twice
    points = {json.dumps(trial.params, sort_keys=True) for trial in trials}
    return len(points) if study.user_attrs.get("grid") else len(trials)


def _check_setting(study: Study, search: SearchSpec) -> None:
    """Refuse to resume a study with different settings."""
    setting = {**search.fixed_settings, "grid": search.grid, "seed": search.seed}
    setting["spans"] = {name: list(span) for name, span in search.search_ranges.items()}
    setting = json.loads(json.dumps(setting))
    begun = study.user_attrs
    for name, value in setting.items():
        if name in begun and begun[name] != value:
            raise ConfigurationError(
                f"study {search.name}: expected {name} = {begun[name]}, with which it was begun, "
                f"got {value} (another --study begins anew)"
            )
        if name not in begun:
            study.set_user_attr(name, value)


class _PatientGrid(GridSampler):
    """Optuna's grid sampler, without its call to stop the study when the grid is complete."""

    def after_trial(
        self,
        study: Study,
        trial: FrozenTrial,
        state: TrialState,
        values: Sequence[float] | None,
    ) -> None:
        """Do nothing: the loop in `_fill` counts the points itself."""


class _KeyedSampler(BaseSampler):
    """A TPE sampler that is made anew for each attempt, seeded by the attempt's number.

    An interrupted search then resumes as if it had not been interrupted, and processes that share a
    study never draw the same numbers.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        """See `BaseSampler`."""
        (word,) = np.random.SeedSequence([self._seed, trial.number]).generate_state(1)
        self._sampler = TPESampler(seed=int(word), multivariate=True)
        self._sampler.before_trial(study, trial)

    def infer_relative_search_space(
        self, study: Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """See `BaseSampler`."""
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """See `BaseSampler`."""
        return self._sampler.sample_relative(study, trial, search_space)

    def sample_independent(
        self, study: Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """See `BaseSampler`."""
        return self._sampler.sample_independent(study, trial, name, distribution)


_METRIC_LABELS = {"s": "settle time (s)", "px": "tracking RMS (px)"}


def draw_search(
    attempts: Sequence[Attempt], search_ranges: Mapping[str, SearchRange], title: str, unit: str
) -> Figure:
    """Draw the headline metric, in `s` or `px`, against the only option or in a panel for each."""
    best = min(attempts, key=lambda attempt: attempt.rank)
    with figure_style():
        if len(search_ranges) == 1:
            figure = _curve(attempts, best, next(iter(search_ranges)), unit)
        else:
            figure = _slices(attempts, best, search_ranges, unit)
        figure.suptitle(title, fontsize=12)
    return figure


def _curve(attempts: Sequence[Attempt], best: Attempt, name: str, unit: str) -> Figure:
    figure = new_figure(9.0, 4.4)
    axes = figure.subplots()
    ordered = sorted(attempts, key=lambda attempt: attempt.options[name])
    x = np.array([attempt.options[name] for attempt in ordered])
    for key, style in (
        ("headline", {"color": BLUE, "linestyle": "-", "label": "median"}),
        ("mean", {"color": GREY, "linestyle": "--", "label": "mean", "linewidth": 1.2}),
    ):
        axes.plot(x, [attempt.results[key] for attempt in ordered], **style)
    at = best.options[name]
    axes.plot(at, best.results["headline"], "o", color=ORANGE, markersize=8)
    axes.annotate(
        f"{name} = {at:g}: {best.results['headline']:.3f} {unit}",
        (at, best.results["headline"]),
        xytext=(10, -4),
        textcoords="offset points",
        va="top",
        color=ORANGE,
    )
    axes.margins(y=0.12)
    axes.set(xlabel=f"{name} (1/s)" if "gain" in name else name, ylabel=_METRIC_LABELS[unit])
    legend_below(figure, 2)
    return figure


def _slices(
    attempts: Sequence[Attempt], best: Attempt, search_ranges: Mapping[str, SearchRange], unit: str
) -> Figure:
    columns = min(4, len(search_ranges))
    rows = -(-len(search_ranges) // columns)
    figure = new_figure(3.0 * columns + 1.2, 3.1 * rows + 0.4)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    value = [attempt.results["headline"] for attempt in attempts]
    number = [attempt.number for attempt in attempts]
    for axes in panels.flat[len(search_ranges) :]:
        axes.set_visible(False)
    for axes, (name, span) in zip(panels.flat, search_ranges.items(), strict=False):
        x = [attempt.options[name] for attempt in attempts]
        dots = axes.scatter(x, value, c=number, cmap="viridis", s=16, linewidths=0)
        axes.plot(
            best.options[name],
            best.results["headline"],
            "o",
            markersize=11,
            markerfacecolor="none",
            markeredgecolor=ORANGE,
            markeredgewidth=2.0,
        )
        axes.set_xscale(span.scale)
        axes.set(xlabel=name, title=f"best: {best.options[name]:.4g}")
        axes.title.set_color(ORANGE)
    for row in panels:
        row[0].set_ylabel(_METRIC_LABELS[unit])
    figure.colorbar(dots, ax=panels, label="attempt")
    return figure


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
        The result. The best point has the smallest loss (see `Attempt.rank`) and, among equal
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
