"""Comparison of controllers on a robot: equal targets for all, one connection per scenario.

The trials of all controllers are interleaved, so that warming up and drift of the robot affect all
of them equally. Trials are logged, and judged from their logs, see `vergence.eval.robot.judge`.
Completed trials therefore stay usable after a kill, a fault or Ctrl-C.
"""

import sys
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from vergence.envs.task import GazeTask, run_trial
from vergence.errors import ConfigurationError, HardwareError, UserControllerError
from vergence.eval.comparison.config import ROBOT
from vergence.eval.comparison.evaluate import ControllerFailure, EvaluationResult
from vergence.eval.comparison.lineup import Lineup
from vergence.eval.robot.controller import RobotController
from vergence.eval.robot.evaluation_record import (
    EvaluationRecord,
    JournalEntry,
    RecordedTrial,
    TrialKey,
)
from vergence.eval.robot.judge import RecordedTrialsJob, missed_periods
from vergence.eval.robot.stage import TargetStage
from vergence.eval.trials.run import evaluated_and_run_periods
from vergence.eval.trials.scenarios import Scenario
from vergence.hardware.config import HardwareConfig
from vergence.hardware.plant import HardwarePlant
from vergence.hardware.safety.supervisor import OSCILLATION_REASON
from vergence.recording.writer import LogWriter
from vergence.reporting.runs import package_versions


@dataclass(frozen=True, kw_only=True)
class RobotRun:
    """Trials of some controllers on a robot."""

    lineup: Lineup
    hardware: HardwareConfig
    stage: TargetStage
    """Places the targets."""
    record: EvaluationRecord
    """The record of logs and completed trials."""
    episodes: int
    """Trials of each controller in each scenario."""
    seed: int
    """Number of the test seed."""

    @property
    def scenarios(self) -> list[Scenario]:
        """Scenarios that run on the robot."""
        return [scenario for scenario, plant in self.lineup.scenario_plant_pairs if plant == ROBOT]

    def run(
        self,
        progress: Callable[[int, int], None],
        *,
        check: Callable[[HardwareConfig], None] = lambda hardware: None,
        keep_going: bool,
    ) -> list[ControllerFailure]:
        """Run the trials that are missing.

        Args:
            progress: called with the number of trials done and their total.
            check: called with the robot before anything moves; it may raise to refuse it.
            keep_going: true to leave out user code that raises, instead of raising its error.

        Returns:
            Failures of the controllers that were left out.

        Raises:
            HardwareError: the robot was stopped; completed trials are kept.
            VergenceError: a trial cannot begin, or the record cannot be written.
        """
        for scenario in self.scenarios:
            self.stage.target(scenario)  # refuses a target that the stage cannot present
        recorded = self.recorded()
        failed: list[ControllerFailure] = []
        ready = {scenario.name: self._ready(scenario, recorded) for scenario in self.scenarios}
        total = self.episodes * sum(map(len, ready.values()))
        done = set(recorded)
        if len(done) < total:
            self.stage.check()
            check(self.hardware)
        progress(len(done), total)

        def mark_done(key: TrialKey) -> None:
            done.add(key)
            progress(len(done), total)

        for scenario in self.scenarios:
            _Connection(self, scenario, ready[scenario.name], failed, keep_going).run(
                done, mark_done
            )
        return failed

    def _ready(
        self, scenario: Scenario, recorded: dict[TrialKey, RecordedTrial]
    ) -> dict[str, RobotController]:
        """Make the controllers, by label; refuse one that differs from its earlier trials."""
        found = {}
        for contestant, resolved in self.lineup.contestants_by_scenario[scenario.name]:
            made = RobotController(contestant, self.hardware.head, resolved.options)
            for one in recorded.values():
                entry = one.entry
                same = (entry.controller_sha256, entry.options) == (
                    made.sha256,
                    made.stated_options,
                )
                if entry.key[:2] == (scenario.name, contestant.label) and not same:
                    raise ConfigurationError(
                        f"resume: expected {contestant.label} as it ran in {scenario.name}, with "
                        f"{entry.options:.200} of {entry.controller_sha256[:12] or 'vergence'}, "
                        f"got {made.stated_options:.200} of {made.sha256[:12] or 'vergence'}"
                    )
            found[contestant.label] = made
        return found

    def recorded(self) -> dict[TrialKey, RecordedTrial]:
        """Read the completed trials of this run."""
        head = self.hardware.head
        steps = {
            one.name: evaluated_and_run_periods(one, head, simulated=False)[1]
            for one in self.scenarios
        }
        found = self.record.completed_trials(lambda scenario: steps.get(scenario, sys.maxsize))
        if not self.stage.emulated:  # do not use an emulated head's ground truth here
            found = {
                key: replace(one, trial=replace(one.trial, truths=None))
                for key, one in found.items()
            }
        return {key: one for key, one in found.items() if key.trial < self.episodes}

    def outcomes(
        self,
        recorded: Mapping[TrialKey, RecordedTrial],
        failed: list[ControllerFailure],
        *,
        keep_going: bool,
    ) -> list[EvaluationResult]:
        """Judge the trials of all controllers that have not failed.

        Args:
            recorded: see `recorded`.
            failed: see `run`; failures while a controller runs again on its logs are appended.
            keep_going: see `run`.
        """
        without = {(one.scenario, one.controller) for one in failed}
        found = []
        for scenario in self.scenarios:
            for contestant, resolved in self.lineup.contestants_by_scenario[scenario.name]:
                if (scenario.name, contestant.label) in without:
                    continue
                keys = (TrialKey(scenario.name, contestant.label, i) for i in range(self.episodes))
                job = RecordedTrialsJob(
                    contestant=contestant, resolved=resolved, scenario=scenario, plant=ROBOT,
                    head=self.hardware.head, episodes=self.episodes, seed=self.seed,
                    keep_going=keep_going, hardware=self.hardware,
                    recorded=tuple(recorded[key] for key in keys),
                )  # fmt: skip
                outcome = job()
                if isinstance(outcome, ControllerFailure):
                    failed.append(outcome)
                else:
                    found.append(outcome)
        return found

    def report_note(self, recorded: Mapping[TrialKey, RecordedTrial]) -> str:
        """Note for the report: the robot, its bound, missed control periods, stopped trials."""
        hardware = self.hardware
        logged = [one.trial for one in recorded.values()]
        missed = sum(missed_periods(hardware.head, one) for one in logged)
        passed = missed + sum(one.steps for one in logged)
        loop = (
            "that of its model, as nobody has measured its loop (vergence measure-delay does)"
            if hardware.loop is None
            else f"that of its loop as measured on {hardware.loop.measured}"
        )
        swung = sum(bool(one.entry.stopped) for one in recorded.values())
        stops = f"; trials that were stopped as they swung: {swung}" if swung else ""
        stops += "".join(
            f"; run again, as a log could not be read: {text}"
            for text in self.record.unreadable.values()
        )
        return (
            f"{ROBOT} is a robot: {hardware.head.name} of {hardware.path}, before "
            f"{self.stage.description}; the bound is {loop}; {missed} of {passed} "
            f"control periods were missed{stops}"
        )


class _Connection:
    """The trials of one scenario, on one connection."""

    def __init__(
        self,
        run: RobotRun,
        scenario: Scenario,
        ready: dict[str, RobotController],
        failed: list[ControllerFailure],
        keep_going: bool,
    ) -> None:
        self._run, self._scenario, self._ready = run, scenario, ready
        self._failed, self._keep_going = failed, keep_going

    def run(self, done: set[TrialKey], mark_done: Callable[[TrialKey], None]) -> None:
        """Run the missing trials."""
        run, name = self._run, self._scenario.name
        pending = []
        for trial in range(run.episodes):
            keys = [TrialKey(name, label, trial) for label in self._ready]
            missing = [key for key in keys if key not in done]
            # if a target cannot be placed again, all controllers repeat the trial
            pending += keys if missing and not run.stage.repeatable else missing
        if not pending:
            return
        head, hardware = run.hardware.head, run.hardware
        facts = {
            "scenario": name,
            "seed": str(run.seed),
            **{f"version {package}": text for package, text in package_versions().items()},
        }
        path = run.record.new_log()
        with LogWriter(path, head=head, config=hardware.text, facts=facts) as log:
            options = {"config": hardware, "log": log, "appears": True}
            target = run.stage.target(self._scenario)
            task = GazeTask(1, head=head, plant=ROBOT, target=target, plant_options=options)
            with closing(task):
                for label in dict.fromkeys(key.controller for key in pending):
                    self._act_attributed(label, lambda one: task.prepare(one.policy))
                self._run_pending(task, pending, log, mark_done)

    def _run_pending(
        self,
        task: GazeTask,
        pending: list[TrialKey],
        log: LogWriter,
        mark_done: Callable[[TrialKey], None],
    ) -> None:
        run = self._run
        assert isinstance(task.plant, HardwarePlant)
        _, steps = evaluated_and_run_periods(self._scenario, task.head, simulated=False)
        seed = self._scenario.seed("test", run.seed)
        placed, point = -1, np.full(3, np.nan)
        for key in pending:
            if key.controller not in self._ready:
                continue
            if key.trial != placed:
                placed, point = key.trial, run.stage.place(task.plant, key.trial)
            begun, stopped = task.plant.trials, ""

            def trial(one: RobotController, number: int = key.trial) -> None:
                run_trial(task, one.policy, steps, lambda step: None, seed=seed, first_trial=number)

            try:
                went = self._act_attributed(key.controller, trial)
            except HardwareError:
                stopped = task.plant.fault
                if not stopped.startswith(OSCILLATION_REASON):
                    raise
                went = True  # oscillation counts as a result
            if task.plant.fault:
                task.plant.release()
                placed = -1  # reopened eyes look for their first target again
            if not went:
                continue
            if log.fault:
                raise HardwareError(log.fault)
            made = self._ready[key.controller]
            run.record.add(
                JournalEntry(
                    **key._asdict(),
                    log=log.path.name,
                    number=begun + 1,
                    point_m=None if np.isnan(point).any() else tuple(point.tolist()),
                    controller_sha256=made.sha256,
                    options=made.stated_options,
                    stopped=stopped,
                )
            )
            mark_done(key)

    def _act_attributed(self, label: str, act: Callable[[RobotController], None]) -> bool:
        """Let a controller act; returns false if it failed and is left out from now on."""
        made = self._ready[label]
        try:
            with made.attributing_errors():
                act(made)
        except UserControllerError as error:
            if not self._keep_going:
                raise
            failure = ControllerFailure(
                scenario=self._scenario.name, plant=ROBOT, controller=label, message=str(error)
            )
            self._failed.append(failure)
            del self._ready[label]
            return False
        return True
