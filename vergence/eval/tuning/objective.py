"""Objective of a search: the loss of a controller's options on training trials."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import make_controller
from vergence.controllers.tuned import name_for_evaluation
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.tuning.config import TuneConfig
from vergence.eval.tuning.spaces import Options
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import Mapper, SerialMapper

Objective = Callable[[Options], Mapping[str, float]]
"""Function from options to results: `headline` (smaller is better), `mean` (which breaks ties),
`settled_fraction` if trials can fail, and other numbers to record."""

MIN_SETTLED_FRACTION: Final = 0.99
"""Fraction of settled trials below which the loss exceeds the headline metric (chosen)."""
_FAILURE_PENALTY: Final = 10.0
"""Relative increase of the loss per fraction of settled trials that is missing: 10 % per percentage
point (chosen: failures against speed)."""
_LEAST_JOB_TRIALS: Final = 25
"""Least number of trials in a job (chosen: balance of load against overhead)."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One point of a search."""

    number: int
    options: Options
    results: dict[str, float]
    """Results of the objective."""

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key, loss and then mean; smaller is better."""
        return failure_penalised_metric(self.results), self.results["mean"]


def failure_penalised_metric(results: Mapping[str, float]) -> float:
    """Headline metric with a penalty for failed trials: the value that a search minimises.

    Each percentage point of settled trials missing below 99 % increases it by 10 %.

    The median alone would sacrifice almost half of all trials for a shorter settle time of the
    rest. The first per cent of failures has no penalty: the metric includes failed trials already,
    with their whole duration.
    """
    short = max(0.0, MIN_SETTLED_FRACTION - results.get("settled_fraction", 1.0))
    return results["headline"] * (1.0 + _FAILURE_PENALTY * short)


@dataclass(frozen=True, kw_only=True)
class TrialsJob:
    """Picklable job that runs some of the training trials that judge a point."""

    config: TuneConfig
    options: Options
    scenario: Scenario
    head: HeadModel
    trial_numbers: range
    """Numbers of the trials."""

    def __call__(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Run the trials; return (n,) the metric of each, and (n,) True for successful ones.

        The metric is the settle time to the scenario's leading band, s, or the duration of a trial
        that never settles. For moving targets it is the tracking error, px, and a trial that loses
        its target has failed.
        """
        options: dict[str, Any] = self.options
        trials = run_trials(
            make_controller(name_for_evaluation(self.config.controller), self.head, **options),
            self.scenario,
            episodes=len(self.trial_numbers),
            plant=self.config.plant,
            split="train",
            seed=self.config.seed,
            head=self.head,
            first_trial=self.trial_numbers.start,
        )
        if trials.target_moves:
            return trials.tracking_px, ~trials.lost
        band_px = trials.band_px
        return trials.settle_or_trial_s(band_px), np.isfinite(trials.settle_s(band_px))


def controller_objective(
    config: TuneConfig, scenario: Scenario, head: HeadModel, mapper: Mapper | None = None
) -> Objective:
    """Make an objective that judges all options by the same training trials of the scenario.

    The jobs are parts of a point's trials, not points: the next point of a search depends on all
    points before it, and so would depend on the number of points tried at a time. A trial is the
    same in any batch, so the results are the same for any mapper.

    Args:
        config: the configuration of tuning.
        scenario: the scenario of the trials.
        head: the head that moves and that the controller knows.
        mapper: runs the trials; this process by default.
    """
    mapper = mapper or SerialMapper()

    def judge(options: Options) -> dict[str, float]:
        parts = max(1, min(mapper.workers, config.episodes // _LEAST_JOB_TRIALS))
        ends = [config.episodes * part // parts for part in range(parts + 1)]
        jobs = [
            TrialsJob(
                config=config,
                options=options,
                scenario=scenario,
                head=head,
                trial_numbers=range(*pair),
            )
            for pair in pairwise(ends)
        ]
        return summarise_trials(mapper(jobs))

    return judge


def summarise_trials(
    job_results: Sequence[tuple[FloatArray, NDArray[np.bool_]]],
) -> dict[str, float]:
    """Summarise the trials of a point.

    Args:
        job_results: results of the point's jobs.

    Returns:
        See `Objective`.
    """
    values, good = (np.concatenate(part) for part in zip(*job_results, strict=True))
    return {
        "headline": float(np.median(values)),
        "mean": float(np.mean(values)),
        "settled_fraction": float(np.mean(good)),
    }
