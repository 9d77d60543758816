"""Results of an evaluation: the outcome of each controller, and the rows of its tables."""

from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Any, Final

import pandas as pd

from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.contestants import BASELINE
from vergence.eval.comparison.summary import SWINGING, bound_summary, bound_trials, speed_up
from vergence.eval.trials.settling import SettlingBand, bands_with_bound
from vergence.hardware.config import load_hardware
from vergence.models.head import HeadModel

_LESS_OFTEN: Final = 0.01
"""Share of the trials by which a steady law may settle less often than the best (chosen)."""
_KEY_FIELDS: Final = ("scenario", "plant", "controller", "head", "trials")
_RESULT_FIELDS: Final = (
    "overshoot_median",
    "overshoot_p95",
    "residual_px",
    "residual_p95_px",
    "lost_fraction",
    "left_again_fraction",
    SWINGING,
    "fixation_rms_median_rad_s",
    "fixation_peak_to_peak_median_rad_s",
    "fixation_peak_to_peak_p95_rad_s",
    "tracking_rms_px",
    "predict_us",
    "options",
    "tuned",
    "tuned_for",
    "given",
)


def row_fields(band_px: float) -> tuple[str, ...]:
    """The fields of a row of evaluation.json.

    Args:
        band_px: the leading band of the row's scenario, px.
    """
    settling = [
        name
        for band in bands_with_bound(band_px)
        for name in (
            band.settled_fraction_column,
            band.settle_median_s_column,
            band.settle_p95_s_column,
            band.ratio_median_column,
            band.ratio_p95_column,
        )
    ]
    return (*_KEY_FIELDS, *settling, *_RESULT_FIELDS)


@dataclass(frozen=True, kw_only=True)
class EvaluationResult:
    """Results of one controller in one scenario on one plant."""

    scenario: str
    plant: str
    controller: str
    target_moves: bool
    band_px: float
    """The scenario's leading band of settling, px."""
    duration_s: float
    options: dict[str, Any]
    """The controller's options."""
    tuned: bool | None
    """True if the options were tuned for the head, see `ResolvedOptions`."""
    given: tuple[str, ...]
    """Names of the user-given options."""
    trials: pd.DataFrame
    """One row per trial."""
    summary: dict[str, Any]
    """Every statistic with the ends of its interval, `_low` and `_high`; nan if undefined."""
    curves: pd.DataFrame
    """See `error_quantile_table`."""
    effective_gains: pd.DataFrame
    """See `effective_gain_table`."""
    head: HeadModel


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Results of an evaluation.

    One `EvaluationResult` per controller, scenario and plant, with notes and failures.
    """

    config: EvaluateConfig
    outcomes: list[EvaluationResult]
    notes: list[str] = field(default_factory=list)
    """Notes on controllers and plants that are left out, and on untuned controllers."""
    failures: list[str] = field(default_factory=list)
    """Errors of user-defined controllers, which are left out."""

    def summaries(
        self, scenario: str | None = None, plant: str | None = None
    ) -> list[dict[str, Any]]:
        """Rows of the tables: the controllers of each scenario and plant, and the bound.

        Args:
            scenario: the only scenario to include; all by default.
            plant: the only plant to include; all by default.
        """
        return [
            row
            for row in self._rows
            if scenario in (None, row["scenario"]) and plant in (None, row["plant"])
        ]

    @cached_property
    def _rows(self) -> list[dict[str, Any]]:
        rows = []
        for group in self.groups().values():
            reference = next((one for one in group if one.controller == BASELINE), None)
            for one in group:
                row = dict(one.summary)
                if reference is not None:
                    row |= speed_up(
                        one.trials,
                        reference.trials,
                        one.target_moves,
                        one.band_px,
                        self.config.seed,
                    )
                    row["baseline_tuned"] = reference.tuned
                rows.append(row)
            if not group[0].target_moves:
                band_px = group[0].band_px
                least = bound_trials([one.trials for one in group], band_px)
                limit = bound_summary(least, band_px, self.config.seed)
                rows.append(limit | {"head": group[0].head.name})
        return rows

    def groups(self) -> dict[tuple[str, str], list[EvaluationResult]]:
        """Outcomes by scenario and plant."""
        found: dict[tuple[str, str], list[EvaluationResult]] = {}
        for one in self.outcomes:
            found.setdefault((one.scenario, one.plant), []).append(one)
        return found

    def rows(self) -> list[dict[str, Any]]:
        """The rows of evaluation.json: plain values, None for undefined ones."""
        return [
            {key: nonfinite_to_none(row.get(key)) for key in row_fields(group[0].band_px)}
            for (scenario, plant), group in self.groups().items()
            for row in self.summaries(scenario, plant)
        ]

    def trials(self) -> pd.DataFrame:
        """All trials, one row each."""
        return pd.concat([one.trials for one in self.outcomes], ignore_index=True)


def laws_for_loop(evaluation: Evaluation) -> list[str]:
    """The law to choose for a robot's measured loop, a sentence per scenario and plant.

    It is the quickest, or for a moving target the nearest, of those that settle as often as the
    best (to 1 %) and never swing. Empty if the loop is not known.
    """
    robot = evaluation.config.hardware
    if robot is None or load_hardware(robot).loop is None:
        return []
    found = []
    for (scenario, plant), group in evaluation.groups().items():
        band = SettlingBand(group[0].band_px)
        judged = "tracking_rms_px" if group[0].target_moves else band.settle_median_s_column
        share = band.settled_fraction_column
        rows = [one.summary for one in group if not one.summary[SWINGING]]
        most = max((row[share] for row in rows), default=0.0)
        steady = [row for row in rows if row[share] >= most - _LESS_OFTEN and most > 0.0]
        law = min(steady, key=itemgetter(judged))["controller"] if steady else "none of these"
        found.append(
            f"law for this loop ({scenario} on {plant}): {law}, of those compared the "
            f"{'nearest' if group[0].target_moves else 'quickest'} that settles and does not swing"
        )
    return found


def nonfinite_to_none(value: Any) -> Any:
    """Convert a value for JSON: None for nan and infinity."""
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
