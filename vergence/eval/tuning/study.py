"""A search over options as an Optuna study that can be resumed and shared.

The study is stored in a database: a SQLite file, or PostgreSQL for several machines. A call with an
existing study resumes it, whether it has ended, was killed, or is still running in other processes.
The points of a search are drawn from (seed, number of the attempt), so an interrupted search tries
the same points as an uninterrupted one. If several processes search at once, the points also depend
on the order in which earlier attempts end.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import optuna
from optuna import Study, Trial
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler, GridSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from vergence.errors import ConfigurationError, VergenceError
from vergence.eval.tuning.objective import Attempt, Objective, failure_penalised_metric
from vergence.eval.tuning.spaces import SearchRange
from vergence.eval.tuning.study_storage import open_study

MOST_POINTS: Final = 5000
"""Largest grid that is searched, in points (chosen: a bound on time)."""


@dataclass(frozen=True, kw_only=True)
class SearchSpec:
    """The search space, settings and storage of a study.

    Raises:
        ConfigurationError: `attempts` is below 1, or a grid has a span without a step or too many
            points.
    """

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
    """Try points until the study has the requested number.

    Args:
        search: the search.
        objective: the objective to minimise; it raises a `VergenceError` for an invalid point.
        progress: callback with the number of points tried and the total number.

    Returns:
        All valid points of the study, in the order of their numbers.

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

    Args:
        seed: seed of the search.
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
