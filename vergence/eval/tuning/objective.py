"""What a search makes small: how a controller with some options does on training trials."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import make_controller
from vergence.controllers.tuned import judged_as
from vergence.eval.jobs import Mapper, SerialMapper
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.tuning.config import TuneConfig
from vergence.eval.tuning.spaces import Options
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

Objective = Callable[[Options], Mapping[str, float]]
"""Options to what came of them: `headline`, smaller is better, `mean`, which tells equal ones
apart, `settled_fraction` where trials can fail, and other numbers to be kept."""

LEAST_SETTLED: Final = 0.99
"""Share of trials that must settle before a shorter median counts as it is."""
_FAILURE_COSTS: Final = 10.0
_LEAST: Final = 25
"""Trials that are worth a job of their own."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One point of a search."""

    number: int
    options: Options
    found: dict[str, float]
    """What the objective returned."""

    @property
    def rank(self) -> tuple[float, float]:
        """Smaller is better."""
        return loss(self.found), self.found["mean"]


def loss(found: Mapping[str, float]) -> float:
    """What a search makes small: the headline metric, a tenth dearer for each per cent that fails.

    A median alone would give up trials beyond it, almost half of all, for a shorter one. The
    first per cent costs nothing more: failures are in the metric already, as whole trials.
    """
    short = max(0.0, LEAST_SETTLED - found.get("settled_fraction", 1.0))
    return found["headline"] * (1.0 + _FAILURE_COSTS * short)


@dataclass(frozen=True, kw_only=True)
class TrialsJob:
    """Some of the training trials that judge a point; picklable."""

    config: TuneConfig
    options: Options
    scenario: Scenario
    head: HeadModel
    numbers: range
    """Which trials."""

    def __call__(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(n,) what each trial is judged by, and whether it is a good one.

        That is the settle time to the scenario's leading band, s, the whole trial's for one that
        never settles; for moving targets the tracking error, px, of which a lost one is not good.
        """
        options: dict[str, Any] = self.options
        trials = run_trials(
            make_controller(judged_as(self.config.controller), self.head, **options),
            self.scenario,
            episodes=len(self.numbers),
            plant=self.config.plant,
            split="train",
            seed=self.config.seed,
            head=self.head,
            first_trial=self.numbers.start,
        )
        if trials.moving:
            return trials.tracking_px, ~trials.lost
        band_px = trials.band_px
        return trials.settle_or_trial_s(band_px), np.isfinite(trials.settle_s(band_px))


def controller_objective(
    config: TuneConfig, scenario: Scenario, head: HeadModel, mapper: Mapper | None = None
) -> Objective:
    """Judges options by the scenario's training trials, the same for all options.

    The trials of a point are what is shared out, and not points: what a search tries next depends
    on all points before, and would depend on how many are tried at a time. A trial is the same in
    any batch, so the numbers are the same for any mapper.

    Args:
        config: what is tuned.
        scenario: whose trials.
        head: the head that moves and that the controller knows.
        mapper: runs the trials; this process by default.
    """
    mapper = mapper or SerialMapper()

    def judge(options: Options) -> dict[str, float]:
        parts = max(1, min(mapper.workers, config.episodes // _LEAST))
        ends = [config.episodes * part // parts for part in range(parts + 1)]
        jobs = [
            TrialsJob(
                config=config, options=options, scenario=scenario, head=head, numbers=range(*pair)
            )
            for pair in pairwise(ends)
        ]
        return judged(mapper(jobs))

    return judge


def judged(parts: Sequence[tuple[FloatArray, NDArray[np.bool_]]]) -> dict[str, float]:
    """What the trials of a point come to.

    Args:
        parts: what the jobs of the point have returned.

    Returns:
        See `Objective`.
    """
    values, good = (np.concatenate(part) for part in zip(*parts, strict=True))
    return {
        "headline": float(np.median(values)),
        "mean": float(np.mean(values)),
        "settled_fraction": float(np.mean(good)),
    }
