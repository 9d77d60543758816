"""Trials on a robot are judged by their logs, also those in which the robot was stopped."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hardware.line import desk_config
from tests.recording.logged import log_trials
from vergence.eval.comparison.config import ROBOT
from vergence.eval.comparison.contestants import GivenOptions, make_contestants
from vergence.eval.comparison.evaluate import ControllerFailure
from vergence.eval.robot.evaluation_record import JournalEntry, RecordedTrial
from vergence.eval.robot.judge import RecordedTrialsJob
from vergence.eval.trials.run import evaluated_and_run_periods
from vergence.eval.trials.scenarios import load_scenario
from vergence.recording.log import read_log

pytest.importorskip("mcap")
DESK = desk_config("/dev/null")
SCENARIO = load_scenario("webcam")
COUNTED, STEPS = evaluated_and_run_periods(SCENARIO, DESK.head, simulated=False)


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    log_trials(path, trials=2, steps=STEPS)
    return read_log(path).trials


class Forgetful:
    def __init__(self, head, layout):
        pass

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise OSError("its own device is gone")


def outcome(*recorded, controller="state-feedback"):
    contestant = make_contestants((controller,), given=GivenOptions())[0]
    resolved = contestant.resolve_options(DESK.head, SCENARIO.name)
    job = RecordedTrialsJob(
        contestant=contestant, resolved=resolved, scenario=SCENARIO, plant=ROBOT, head=DESK.head,
        episodes=len(recorded), seed=0, keep_going=True, hardware=DESK, recorded=recorded,
    )  # fmt: skip
    return job()


def as_recorded(trial, stopped=""):
    entry = JournalEntry(
        scenario=SCENARIO.name, controller="state-feedback", trial=trial.number - 1, log="run.mcap",
        number=trial.number, point_m=None, controller_sha256="", options="{}", stopped=stopped,
    )  # fmt: skip
    return RecordedTrial(entry=entry, trial=trial)


def first(trial, steps):
    reading, truth = (
        type(one)._make(rows[: steps + 1] for rows in one) for one in (trial.readings, trial.truths)
    )
    return replace(trial, readings=reading, truths=truth)


@pytest.mark.slow
def test_a_trial_in_which_the_head_was_stopped_as_it_swung_counts_and_never_settles(logged):
    settled = as_recorded(logged[0])
    # by then the eyes look at the target, so only the stop tells
    stopped = as_recorded(first(logged[1], STEPS // 2), "policy: swinging")
    table = outcome(settled, stopped).trials
    assert table["swings"].tolist() == [False, True]
    assert np.isfinite(table["settle_2px_s"]).tolist() == [True, False]
    assert table["duration_s"].tolist() == pytest.approx([COUNTED * DESK.head.timing.period_s] * 2)
    whole = outcome(settled, as_recorded(logged[1])).trials
    assert np.isfinite(whole["settle_2px_s"]).all()


@pytest.mark.slow
def test_a_controller_that_fails_when_it_is_asked_again_is_left_out(logged):
    found = outcome(as_recorded(logged[0]), controller=f"{__name__}:Forgetful")
    assert isinstance(found, ControllerFailure)
    assert "its own device is gone" in found.message
