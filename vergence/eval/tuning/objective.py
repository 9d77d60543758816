"""Judge options by their loss on training trials, and find the best fixed gain for a head.

The fixed gain takes a minute, by a coarse and a fine search. The coarse search tries every tenth
gain of `vergence tune ibvs`, the fine search all gains about the best of these. The settle time
falls with the gain until overshoot begins; beyond that, it jumps up with each further oscillation.
A tracking error has a single minimum over the gain. In both cases the best gain lies next to the
best one of the coarse search.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import make_controller
from vergence.controllers.tuned import (
    TunedEntry,
    check_table_writable,
    name_for_evaluation,
    user_table_path,
    write_tuned,
)
from vergence.errors import ConfigurationError
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.tuning.spaces import SEARCH_SPACES, Options, TuneConfig
from vergence.models.head import HeadModel
from vergence.models.head_file import absolute_source
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
    """Summarise the trials of a point, from the results of its jobs; see `Objective`."""
    values, good = (np.concatenate(part) for part in zip(*job_results, strict=True))
    return {
        "headline": float(np.median(values)),
        "mean": float(np.mean(values)),
        "settled_fraction": float(np.mean(good)),
    }


EPISODES: Final = TuneConfig.episodes
"""Number of training trials that judge a gain."""
_COARSE_STRIDE: Final = 10
"""Stride of the coarse search, in steps of the gain (chosen: speed against the risk of missing the
best gain)."""


def tune_baseline(
    scenario: Scenario, head: HeadModel, head_source: str | None, mapper: Mapper
) -> TunedEntry:
    """Find the best fixed gain and save it in the user's table of tuned options.

    `head_source` is a preset's name or a path; None for the scenario's own head.
    """
    words = ["vergence", "evaluate", "ibvs-tuned", "--scenario", scenario.name]
    words += [] if head_source is None else ["--head", absolute_source(head_source)]
    check_table_writable(user_table_path())  # before the search, which takes a minute
    gain = best_gain(scenario, head, mapper)
    entry = TunedEntry(
        controller="ibvs",
        scenario=scenario.name,
        head=head.name,
        digest=head.digest,
        command=shlex.join([*words, "--tune"]),
        seed=TuneConfig.seed,
        options={"gain": gain},
    )
    write_tuned(user_table_path(), entry)
    return entry


def best_gain(scenario: Scenario, head: HeadModel, mapper: Mapper) -> float:
    """The gain with the least loss on training trials, 1/s, a multiple of the search's step.

    Raises:
        ConfigurationError: the best gain lets no trial settle, or it is the greatest gain of the
            search, beyond which a better one may lie. Neither would represent the law's best.
    """
    gains = SEARCH_SPACES["ibvs"]["gain"].points()
    coarse = range(0, len(gains), _COARSE_STRIDE)
    tried = _try([gains[place] for place in coarse], scenario, head, mapper)
    best = gains.index(min(tried, key=lambda one: one.rank).options["gain"])
    fine = range(max(0, best - _COARSE_STRIDE + 1), min(len(gains), best + _COARSE_STRIDE))
    tried += _try([gains[place] for place in fine if place != best], scenario, head, mapper)
    found = min(tried, key=lambda one: one.rank)
    gain = found.options["gain"]
    if found.results["settled_fraction"] == 0.0:
        raise ConfigurationError(
            f"tune: expected trials of {scenario.name} that settle with the head {head.name}, got "
            f"none with any gain from {gains[0]:g} to {gains[-1]:g}"
        )
    if gain == gains[-1]:
        raise ConfigurationError(
            f"tune: expected a best gain below {gain:g}, the greatest that is tried, got that one "
            f"for the head {head.name} in {scenario.name}; --options gives a greater one"
        )
    return gain


def _try(
    gains: Sequence[float], scenario: Scenario, head: HeadModel, mapper: Mapper
) -> list[Attempt]:
    config = TuneConfig(controller="ibvs", scenario=scenario.name, episodes=EPISODES)
    jobs = [
        TrialsJob(
            config=config, options={"gain": gain}, scenario=scenario, head=head,
            trial_numbers=range(EPISODES),
        )
        for gain in gains
    ]  # fmt: skip
    return [
        Attempt(number=number, options=job.options, results=summarise_trials([result]))
        for number, (job, result) in enumerate(zip(jobs, mapper(jobs), strict=True))
    ]
