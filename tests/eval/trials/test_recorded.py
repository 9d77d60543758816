"""Trials from a record, of a plant that nobody simulates."""

import numpy as np
import pytest

from vergence.controllers import make_controller
from vergence.envs.plant import PLANTS
from vergence.envs.task import GazeTask, rollout
from vergence.eval.trials.recorded import trials_from_record
from vergence.recording import Recorder

STEPS, LATENCY = 180, 8


@pytest.fixture
def trials_of(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", "tests.envs.robot:Robot")

    def run(steps: int):
        task = GazeTask(1, plant="robot", target="static")
        record = Recorder(task, STEPS + LATENCY)
        rollout(task, make_controller("state-feedback", head=task.head), steps, record)
        return trials_from_record(task, record, STEPS, scenario="desk", plant="robot")

    return run


def test_a_robot_s_record_has_the_metrics_that_need_no_truth(trials_of):
    trials = trials_of(STEPS + LATENCY)
    assert trials.duration_s == pytest.approx(1.5)
    assert 0.0 < trials.settle_s()[0] < trials.duration_s
    assert np.isfinite([trials.energy, trials.peak_rad_s, trials.steady_px]).all()
    assert np.isnan(trials.bound_s).all()


def test_a_record_that_ended_early_has_the_errors_up_to_its_last_image(trials_of):
    whole, part = trials_of(STEPS + LATENCY), trials_of(90)
    assert part.duration_s == pytest.approx(0.75)
    known = 90 - LATENCY
    assert np.array_equal(part.error[:known], whole.error[:known])
    assert (part.error[known:] == part.error[-1]).all()
