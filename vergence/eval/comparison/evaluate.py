"""Compare controllers on identical trials: every controller in every scenario on every plant.

```python
evaluation = evaluate(EvaluateConfig(controllers=("ibvs", "saccade"), scenarios=("workspace",)))
evaluation.rows()                       # what evaluation.json holds
evaluate(config, {"mine": my_policy})   # anything with Stable-Baselines3's predict
```
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Any, Final, Generic, NamedTuple, TypeVar

import pandas as pd

from vergence.controllers.controller import Controller
from vergence.controllers.ibvs import IBVS, TunedIBVS
from vergence.envs.observation import ObservationLayout
from vergence.errors import ConfigurationError, UserControllerError
from vergence.eval.comparison.config import ROBOT, EvaluateConfig
from vergence.eval.comparison.contestants import (
    BASELINE,
    BOUND,
    Contestant,
    ResolvedOptions,
    errors_attributed_to,
)
from vergence.eval.comparison.lineup import Lineup, resolve_lineup
from vergence.eval.comparison.statistics import (
    SWINGING,
    bound_summary,
    bound_trials,
    speed_up,
    trial_statistics,
)
from vergence.eval.trials.curves import (
    effective_gain_table,
    error_quantile_table,
    single_predict_us,
)
from vergence.eval.trials.results import Trials
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.trials.settling import SettlingBand, bands_with_bound, bands_with_settle_time
from vergence.hardware.config import load_hardware
from vergence.models.head import HeadModel
from vergence.reporting.jobs import Mapper, SerialMapper

__all__ = [
    "BASELINE",
    "BOUND",
    "EvaluateConfig",
    "Evaluation",
    "EvaluationResult",
    "evaluate",
    "row_fields",
]


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


JobResult = TypeVar("JobResult")


@dataclass(frozen=True, kw_only=True)
class ControllerFailure:
    """Error that a user-defined controller raised in one scenario on one plant."""

    scenario: str
    plant: str
    controller: str
    message: str

    @property
    def text(self) -> str:
        """The message, and the scenario and plant from which the controller is left out."""
        return f"{self.message} (left out of {self.scenario} on {self.plant})"


class MadeController(NamedTuple):
    """A contestant's controller, made for a head."""

    controller: Controller
    options: dict[str, Any]
    """The controller's options; for a policy file its SHA-256."""
    head: HeadModel
    layout: ObservationLayout


@dataclass(frozen=True, kw_only=True)
class ContestantJob(ABC, Generic[JobResult]):
    """Picklable job of a worker for one controller in one scenario on one plant."""

    contestant: Contestant
    resolved: ResolvedOptions
    """Options, resolved before the job is sent: another machine may have another table of tuned
    options."""
    scenario: Scenario
    plant: str
    head: HeadModel | None
    """Head that replaces the scenario's; None for the scenario's."""
    episodes: int
    """Number of trials of each scenario that runs."""
    seed: int
    keep_going: bool
    """True to return a `ControllerFailure` in place of raising the error of a user-defined
    controller."""

    def __call__(self) -> JobResult | ControllerFailure:
        """Make the controller and return its results, or its failure."""
        head = self.scenario.model() if self.head is None else self.head
        layout = ObservationLayout.of(head)
        try:
            controller, options = self.contestant.make(head, layout, self.resolved.options)
            return self._evaluate(MadeController(controller, options, head, layout))
        except UserControllerError as error:
            if not self.keep_going:
                raise
            return ControllerFailure(
                scenario=self.scenario.name,
                plant=self.plant,
                controller=self.contestant.label,
                message=str(error),
            )

    @abstractmethod
    def _evaluate(self, made: MadeController) -> JobResult:
        """Compute the job's result for the controller."""

    def _trials(
        self, controller: Controller, scenario: Scenario, *, observed_trials: int = 0
    ) -> Trials:
        """Run the controller's trials, see `run_trials`; errors are attributed to it."""
        with errors_attributed_to(controller):
            return run_trials(
                controller,
                scenario,
                episodes=self.episodes,
                plant=self.plant,
                seed=self.seed,
                head=self.head,
                observed_trials=observed_trials,
            )


OBSERVED: Final = 100
"""Trials whose observations are kept, for effective gains and the duration of `predict` for one
head (chosen: memory against samples)."""


@dataclass(frozen=True, kw_only=True)
class EvaluationJob(ContestantJob[EvaluationResult]):
    """Run and summarise all trials of one controller in one scenario on one plant.

    A thousand trials take seconds, and the result is small. Smaller jobs would not balance the load
    better: all controllers make a hundred jobs, and curves and intervals need all trials of a
    controller in one process.
    """

    def _evaluate(self, made: MadeController) -> EvaluationResult:
        controller, options, head, layout = made
        if self.contestant.source in ("ibvs", BASELINE):
            options |= _gain_of(controller)
        trials = self._trials(controller, self.scenario, observed_trials=OBSERVED)
        table = _table(trials, self.contestant.label)
        summary = {
            "scenario": self.scenario.name,
            "plant": self.plant,
            "controller": self.contestant.label,
            "head": head.name,
            "options": options,
            "tuned": self.resolved.tuned,
            "tuned_for": self.resolved.tuned_for,
            "given": list(self.resolved.given_names),
            **trial_statistics(
                table, trials.target_moves, trials.duration_s, trials.band_px, self.seed
            ),
            "linear_law_fraction": trials.linear_law_fraction,
            "predict_us": trials.predict_us,
            "predict_one_us": single_predict_us(controller, trials.observation),
        }
        return EvaluationResult(
            scenario=self.scenario.name,
            plant=self.plant,
            controller=self.contestant.label,
            target_moves=trials.target_moves,
            band_px=trials.band_px,
            duration_s=trials.duration_s,
            options=options,
            tuned=self.resolved.tuned,
            given=self.resolved.given_names,
            trials=table,
            summary=summary,
            curves=error_quantile_table(trials),
            effective_gains=effective_gain_table(trials, layout),
            head=head,
        )


def _gain_of(controller: Controller) -> dict[str, Any]:
    """The constant gain of a law that has one, given as an option or by default."""
    if not isinstance(controller, IBVS | TunedIBVS):
        return {}
    gain = controller.gain
    return {"gain": float(gain.flat[0]) if (gain == gain.flat[0]).all() else gain.tolist()}


def _table(trials: Trials, label: str) -> pd.DataFrame:
    """Table with one row per trial; nan for undefined metrics and trials that never settle."""
    settling = not trials.target_moves
    nothing = float("nan")
    judged = bands_with_bound(trials.band_px)
    columns = {
        "scenario": trials.scenario,
        "plant": trials.plant,
        "controller": label,
        "trial": range(trials.num),
        "duration_s": trials.duration_s,
        **{
            band.settle_s_column: trials.settle_s(band.px) if settling else nothing
            for band in reversed(bands_with_settle_time(trials.band_px))
        },
        **{band.bound_s_column: trials.bounds_s[band.px] for band in judged},
        **{
            band.ratio_column: trials.ratio_to_bound(band.px) if settling else nothing
            for band in judged
        },
        "overshoot": trials.overshoot if settling else nothing,
        "steady_px": trials.steady_px,
        "residual_px": trials.residual_px,
        "lost": trials.lost,
        "left_again": trials.left_again if settling else nothing,
        "swings": trials.swings if settling else nothing,
        "fixation_rms_rad_s": trials.fixation_rms_rad_s,
        "fixation_peak_to_peak_rad_s": trials.fixation_peak_to_peak_rad_s,
        "energy_rad2_s": trials.energy,
        "peak_rad_s": trials.peak_rad_s,
        "tracking_px": trials.tracking_px if trials.target_moves else nothing,
        "tracking_lag_s": trials.tracking_lag_s if trials.target_moves else nothing,
        "fix_error_settled_m": trials.fix_error_at_settling_m() if settling else nothing,
        "fix_error_end_m": trials.fix_error_m[-1],
        **trials.conditions,
    }
    return pd.DataFrame(columns)


def evaluate(
    config: EvaluateConfig,
    extra_controllers: Mapping[str, Controller] | None = None,
    mapper: Mapper | None = None,
    *,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    keep_going: bool = False,
) -> Evaluation:
    """Run every controller on every scenario's trials on every plant.

    Args:
        config: the configuration.
        extra_controllers: more controllers by their names in tables: any objects with
            Stable-Baselines3's `predict`.
        mapper: runs the jobs; None to run them one by one in this process. The numbers are the same
            for any mapper, except for the duration of `predict`.
        options: options of controllers, `options[controller][scenario]`, in place of a file's.
        keep_going: True to leave out a user-defined controller that raises, and to list it in
            `failures`; if only the baseline would remain, the error is raised all the same.

    Returns:
        The evaluation.

    Raises:
        UserControllerError: a user-defined controller raises, and is not to be left out.
        VergenceError: a name is unknown, an option has an invalid value, or a plant is a robot.
    """
    mapper = mapper or SerialMapper()
    if config.on_robot:
        raise ConfigurationError(
            f"plant: expected simulated ones, got {ROBOT}: "
            "vergence.eval.robot.evaluate.evaluate_on_robot runs it"
        )
    lineup = resolve_lineup(config, extra_controllers, mapper, options)
    return run_and_join(config, lineup, mapper, keep_going=keep_going)


def run_and_join(
    config: EvaluateConfig,
    lineup: Lineup,
    mapper: Mapper,
    robot_results: Sequence[EvaluationResult] = (),
    robot_failures: Sequence[ControllerFailure] = (),
    *,
    keep_going: bool,
) -> Evaluation:
    """Run the simulated trials and join them with a robot's results, see `evaluate`."""
    jobs = [
        EvaluationJob(
            contestant=one, resolved=resolved, scenario=scenario, plant=plant, head=lineup.head,
            episodes=config.trials, seed=config.seed, keep_going=keep_going,
        )
        for scenario, plant in lineup.scenario_plant_pairs
        if plant != ROBOT
        for one, resolved in lineup.contestants_by_scenario[scenario.name]
    ]  # fmt: skip
    results = mapper(jobs)
    outcomes = [one for one in (*results, *robot_results) if isinstance(one, EvaluationResult)]
    failures = [one for one in (*results, *robot_failures) if isinstance(one, ControllerFailure)]
    if failures and {one.controller for one in outcomes} <= {BASELINE}:
        raise UserControllerError(failures[0].message)
    return Evaluation(
        config=config,
        outcomes=outcomes,
        notes=lineup.notes,
        failures=[one.text for one in failures],
    )
