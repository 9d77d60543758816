"""Trials on a robot, judged from their logs by running each controller again on the readings."""

from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.envs.plant import TrialStart, simulation_of
from vergence.envs.reading import BoolArray, Reading, Truth
from vergence.envs.targets.motion import motion_rows
from vergence.envs.task import GazeTask
from vergence.eval.comparison.contestants import errors_attributed_to
from vergence.eval.comparison.evaluate import EvaluationJob
from vergence.eval.robot.evaluation_record import RecordedTrial
from vergence.eval.robot.stage import REST_TARGET
from vergence.eval.trials.bound import settle_bound
from vergence.eval.trials.results import Trials, join_trials
from vergence.eval.trials.run import (
    InstrumentedController,
    evaluated_and_run_periods,
    run_trial_batch,
)
from vergence.eval.trials.scenarios import Scenario
from vergence.eval.trials.settling import bands_with_bound
from vergence.hardware.config import HardwareConfig, loop_variation
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.log import REPLAYED_ENTRY_POINT, LoggedTrial
from vergence.triangulation import triangulate_views

_MEASURING_WINDOW_S: Final = 0.5
"""Time at a trial's end over which the target's position is measured, s (chosen)."""
_PLACEHOLDER_TARGET: Final = np.array([0.0, 0.0, 1.0])
"""(3,) placeholder that any head can look at, for trials with unknown targets, in N, m (chosen)."""


@dataclass(frozen=True, kw_only=True)
class RecordedTrialsJob(EvaluationJob):
    """Job for the outcome of one controller in one scenario, from trials in a robot's logs."""

    hardware: HardwareConfig
    recorded: tuple[RecordedTrial, ...]
    """The recorded trials, in order of their numbers."""

    def _trials(
        self, controller: Controller, scenario: Scenario, *, observed_trials: int = 0
    ) -> Trials:
        """Judge the logged trials; the controller runs again on their readings."""
        head, found, points = self.hardware.head, [], []
        _, steps = evaluated_and_run_periods(scenario, head, simulated=False)
        for place, one in enumerate(self.recorded):
            trial = one.trial
            if one.entry.stopped:
                trial = _extended_to_full_length(trial, steps, head.timing.period_s)
            options = {"trials": [trial]}
            task = GazeTask(
                1, head=head, plant=REPLAYED_ENTRY_POINT, target=REST_TARGET, plant_options=options
            )
            timed = InstrumentedController(controller, int(place < observed_trials))
            with errors_attributed_to(controller):
                trials = run_trial_batch(task, timed, scenario, plant=self.plant)
            trials = replace(
                trials,
                stopped_for_swinging=np.array([bool(one.entry.stopped)]),
                conditions={"missed_periods": np.array([float(missed_periods(head, one.trial))])},
            )
            if np.isfinite(one.point).all():
                trials = replace(trials, target=np.broadcast_to(one.point, trials.target.shape))
            known = trials.target[-1, 0]
            points.append(known if np.isfinite(known).all() else _measured_target(head, one.trial))
            found.append(trials)
        all_of_them = join_trials(found)
        if scenario.target_moves:
            return all_of_them
        return replace(
            all_of_them, bounds_s=robot_settle_bounds(self.hardware, all_of_them, np.array(points))
        )


def missed_periods(head: HeadModel, trial: LoggedTrial) -> int:
    """Number of control periods of a trial that were skipped as the previous one was late."""
    passed = round(float(trial.readings.time_s[-1, 0]) * head.timing.control_rate_hz)
    return passed - trial.steps


def _extended_to_full_length(trial: LoggedTrial, steps: int, period_s: float) -> LoggedTrial:
    """Extend a stopped trial to full length, with the head at rest and no new images."""
    missing = steps - trial.steps

    def longer(values: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)])

    rest = slice(trial.steps + 1, None)
    reading = Reading._make(map(longer, trial.readings))
    for times in (reading.time_s, reading.joints_s):
        times[rest, 0] += period_s * np.arange(1, missing + 1)
    for speeds in (reading.velocities, reading.command):
        speeds[rest] = 0.0
    truth = None if trial.truths is None else Truth._make(map(longer, trial.truths))
    return replace(trial, readings=reading, truths=truth)


def _measured_target(head: HeadModel, trial: LoggedTrial) -> FloatArray:
    """(3,) target position triangulated at the trial's end, in N, m; nan if it was not visible."""
    reading = trial.readings
    held = reading.time_s[:, 0] > reading.time_s[-1, 0] - _MEASURING_WINDOW_S
    rows = held & reading.visible[:, 0].all(axis=-1)
    if not rows.any():
        return np.full(3, np.nan)
    seen = triangulate_views(head, reading.positions_at_exposure[rows, 0], reading.pixels[rows, 0])
    return np.asarray(np.median(seen.point, axis=0))


def robot_settle_bounds(
    hardware: HardwareConfig, trials: Trials, points: FloatArray
) -> dict[float, FloatArray]:
    """Time-optimal bounds of trials on a robot, from its known or measured loop.

    The time of the first image that shows the target is the trial's own. The motion from there is
    simulated with the model's joints and the measured loop, see `vergence.hardware.config`.

    Args:
        hardware: the robot.
        trials: n trials.
        points: (n, 3) positions of their targets, in N, m.

    Returns:
        (n,) bounds in s by settling band in px; nan for an unknown target position.
    """
    known: BoolArray = np.asarray(np.isfinite(points).all(axis=-1))
    seen = trials.visible.any(axis=-1)
    sight_s = np.where(seen.any(axis=0), trials.time_s[seen.argmax(axis=0)], np.inf)
    task = GazeTask(
        trials.num, head=hardware.head, plant="kinematic", target=REST_TARGET,
        variation=loop_variation(hardware),
    )  # fmt: skip
    keys = np.zeros(trials.num, dtype=np.uint64)
    places = np.where(known[:, np.newaxis], points, _PLACEHOLDER_TARGET)
    start = TrialStart(np.arange(trials.num), keys, keys, trials.positions[0], motion_rows(places))
    with closing(task):
        simulation_of(task.plant).begin(start)
        found = {
            band.px: settle_bound(task, band.px, sight_s)
            for band in bands_with_bound(trials.band_px)
        }
    return {band_px: np.where(known, one, np.nan) for band_px, one in found.items()}
