"""The best fixed gain for a head, found in a minute by a coarse and a fine search.

The coarse search tries every tenth gain of `vergence tune ibvs`, the fine search all gains about
the best of these. The settle time falls with the gain until overshoot begins; beyond that, it jumps
up with each further oscillation. A tracking error has a single minimum over the gain. In both cases
the best gain lies next to the best one of the coarse search.
"""

import shlex
from collections.abc import Sequence
from typing import Final

from vergence.controllers.tuned import (
    TunedEntry,
    check_table_writable,
    user_table_path,
    write_tuned,
)
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.tuning.config import TuneConfig
from vergence.eval.tuning.objective import Attempt, TrialsJob, summarise_trials
from vergence.eval.tuning.spaces import SEARCH_SPACES
from vergence.models.head import HeadModel
from vergence.models.head_file import absolute_source
from vergence.reporting.jobs import Mapper

EPISODES: Final = TuneConfig.episodes
"""Number of training trials that judge a gain."""
_COARSE_STRIDE: Final = 10
"""Stride of the coarse search, in steps of the gain (chosen: speed against the risk of missing the
best gain)."""


def tune_baseline(
    scenario: Scenario, head: HeadModel, head_source: str | None, mapper: Mapper
) -> TunedEntry:
    """Find the best fixed gain and save it in the user's table of tuned options.

    Args:
        scenario: the scenario whose training trials judge the gains.
        head: the head that moves and that the law knows.
        head_source: source of the head: a preset's name or a path; None for the scenario's head.
        mapper: runs the trials.

    Returns:
        The entry of the table.

    Raises:
        ConfigurationError: the table cannot be written.
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
    """The gain with the least loss on training trials, see `vergence.eval.tuning.objective`.

    Args:
        scenario: the scenario of the trials.
        head: the head.
        mapper: runs the trials, one job per gain.

    Returns:
        The gain, 1/s, a multiple of the search's step.

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
