"""What an evaluation was asked for, and what it came to: configuration, outcomes, their rows."""

from dataclasses import dataclass, field
from typing import Any, Final

import pandas as pd

from vergence.eval.comparison.contestants import BASELINE
from vergence.eval.comparison.summary import bound_summary, compare
from vergence.models.head import HeadModel

ROW: Final = (
    "scenario",
    "plant",
    "controller",
    "trials",
    "settled_fraction",
    "settle_1px_median_s",
    "settle_1px_p95_s",
    "ratio_to_bound_median",
    "ratio_to_bound_p95",
    "overshoot_median",
    "overshoot_p95",
    "lost_fraction",
    "tracking_rms_px",
    "predict_us",
)
"""The fields of a row of evaluation.json."""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """What to compare, and how."""

    controllers: tuple[str, ...] = ()
    """See `contestants`; none for all that can be made here."""
    scenarios: tuple[str, ...] = ("workspace",)
    """Names of scenarios."""
    plants: tuple[str, ...] = ("kinematic",)
    """What moves the heads."""
    episodes: int = 1000
    """Trials of each."""
    seed: int = 0
    """Seed of the trials, among the test seeds, and of the intervals' resampling."""
    head: str | None = None
    """A preset or TOML file in place of the scenarios' own heads."""
    workers: int = 1
    """Processes; the numbers are the same for any, but for the time that predict takes."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one controller came to in one scenario on one plant."""

    scenario: str
    plant: str
    controller: str
    moving: bool
    duration_s: float
    options: dict[str, Any]
    """The options that it ran with."""
    trials: pd.DataFrame
    """A row a trial."""
    summary: dict[str, Any]
    """Every statistic with the ends of its interval, `_low` and `_high`; nan for no meaning."""
    curves: pd.DataFrame
    """See `error_curves`."""
    gains: pd.DataFrame
    """See `effective_gains`."""
    head: HeadModel


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """All outcomes."""

    config: EvaluateConfig
    outcomes: list[Outcome]
    notes: list[str] = field(default_factory=list)
    """What was left out, and why."""

    def summaries(self) -> list[dict[str, Any]]:
        """The rows of all tables: each scenario's and plant's controllers, and their bound."""
        rows = []
        for group in self.groups().values():
            reference = next((one for one in group if one.controller == BASELINE), None)
            for one in group:
                row = dict(one.summary)
                if reference is not None:
                    row |= compare(one.trials, reference.trials, one.moving, self.config.seed)
                rows.append(row)
            if not group[0].moving:
                rows.append(bound_summary(group[0].trials, self.config.seed))
        return rows

    def groups(self) -> dict[tuple[str, str], list[Outcome]]:
        """Outcomes by scenario and plant."""
        found: dict[tuple[str, str], list[Outcome]] = {}
        for one in self.outcomes:
            found.setdefault((one.scenario, one.plant), []).append(one)
        return found

    def rows(self) -> list[dict[str, Any]]:
        """The rows of evaluation.json: plain values, None where one has no meaning."""
        return [{key: plain_value(row.get(key)) for key in ROW} for row in self.summaries()]

    def trials(self) -> pd.DataFrame:
        """All trials, a row each."""
        return pd.concat([one.trials for one in self.outcomes], ignore_index=True)


def plain_value(value: Any) -> Any:
    """A value as JSON has it: None for nan and infinity."""
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
