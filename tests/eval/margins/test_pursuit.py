"""Imperfections that one controller with one set of options tolerates, on targets at rest."""

import numpy as np
import pytest

from tests.naming import named
from vergence import make_controller
from vergence.envs.plants.conditions import Variation
from vergence.eval.margins.run import MarginMeasurement
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import Scenario, load_scenario

TRIALS = 10
STOOD = {
    "command_latency_s": [0.05], "feedback_latency_s": [0.02], "latency_s": [0.0, 0.2],
    "frame_phase": [0.7], "acceleration_ratio": [0.3, 5.0], "speed_gain": [0.7, 1.3],
    "detection_noise_px": [1.0], "backlash_rad": [0.004], "outlier_probability": [0.02],
}  # fmt: skip


@pytest.fixture(scope="module")
def workspace() -> Scenario:
    return load_scenario("workspace")


@pytest.mark.nightly
def test_it_stands_one_imperfection_of_a_robot_at_a_time(workspace) -> None:
    controller = make_controller("pursuit", workspace.model())

    def run(scenario):
        return run_trials(controller, scenario, episodes=TRIALS, seed=3)

    for name, values in STOOD.items():
        measure = MarginMeasurement(run, workspace, name)
        for value in values:
            with named(name, value):
                assert measure(value).settled == TRIALS


@pytest.mark.parametrize(("name", "ratio"), [("saccade", 60.0), ("pursuit", 100.0)])
def test_motors_that_a_head_file_knows_nothing_of_are_found(workspace, name, ratio) -> None:
    parts = {"limits": {"acceleration": np.array([120.0] * 3 + [2.0] * 4)}}
    slow = Scenario(
        name="slow", description="a head whose file has a placeholder for its accelerations",
        target=workspace.target, duration_s=workspace.duration_s, head_overrides=parts,
        variation=Variation(acceleration_ratio=(ratio, ratio)),
    )  # fmt: skip
    trials = run_trials(make_controller(name, slow.model()), slow, episodes=10)
    assert np.isfinite(trials.settle_s(2.0)).all()
    assert np.median(trials.ratio_to_bound(2.0)) < 2.0
