"""A robot in a comparison: its head and loop in simulation, its bound, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from tests.eval.refusals import not_refused
from tests.hardware.test_config import document
from vergence.controllers import make_controller
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.evaluate import evaluate, laws_for_loop
from vergence.eval.comparison.lineup import resolve_lineup
from vergence.eval.robot.judge import robot_settle_bounds
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.hardware.config import load_hardware, loop_variation
from vergence.models.toml_table import toml_text
from vergence.reporting.jobs import SerialMapper

LOOP = {
    "measured": "2026-11-25", "command_latency_s": 0.01, "lag_s": 0.045, "speed_gain": 0.9,
    "backlash_rad": 0.002, "jitter_s": 0.008, "computing_s": 0.002, "acceleration_ratio": 0.5,
    "sigma": {"lag_s": 1e-4, "latency_s": 1e-3},
}  # fmt: skip


@pytest.fixture
def desk(tmp_path):
    values = document()
    values["loop"] = dict(LOOP)
    for camera in values["cameras"].values():
        camera["latency_s"] = 0.08
    path = tmp_path / "desk.toml"
    path.write_text(toml_text(values), encoding="utf-8")
    return path


def test_simulation_has_the_robots_head_and_its_loop(desk):
    config = EvaluateConfig(controllers=("ibvs-tuned",), hardware=desk, episodes=3)
    lineup = resolve_lineup(config, None, SerialMapper())
    (scenario, plant), head = lineup.scenario_plant_pairs[0], load_hardware(desk).head
    assert (scenario.name, plant, lineup.head.digest) == ("webcam", "kinematic", head.digest)
    resolved = [one for _, one in lineup.contestants_by_scenario["webcam"]]
    assert all(one.tuned for one in resolved)  # as for that head's servos
    trials = evaluate(config).trials()
    for name, value in (
        ("latency_s", 0.082), ("jitter_s", 0.008), ("lag_s", 0.045), ("command_latency_s", 0.01),
        ("feedback_latency_s", 0.0), ("acceleration_ratio", 0.5), ("speed_gain_left_pan", 0.9),
        ("backlash_rad_right_tilt", 0.002),
    ):  # fmt: skip
        assert trials[name].to_numpy() == pytest.approx(value), name
    assert trials["frame_phase"].nunique() == 3


@pytest.mark.slow
def test_the_law_for_a_loop_is_told_where_the_loop_is_known(desk):
    config = EvaluateConfig(controllers=("ibvs", "saccade"), hardware=desk, episodes=10)
    evaluation = evaluate(config)
    (line,) = laws_for_loop(evaluation)
    assert line.startswith("law for this loop (webcam on kinematic): saccade")
    desk.write_text(desk.read_text().split("[loop]")[0], encoding="utf-8")
    assert laws_for_loop(evaluation) == []


def test_the_bound_of_a_robots_trials_is_that_of_their_simulation(desk):
    hardware = load_hardware(desk)
    scenario = replace(load_scenario("webcam"), variation=loop_variation(hardware))
    controller = make_controller("saccade", hardware.head)
    trials = run_trials(controller, scenario, episodes=20, head=hardware.head)
    points = trials.target[-1].copy()
    found = robot_settle_bounds(hardware, trials, points)
    for band_px, bound_s in trials.bounds_s.items():
        assert found[band_px] == pytest.approx(bound_s, abs=1e-9)
    points[0] = np.nan
    unknown = np.isnan(robot_settle_bounds(hardware, trials, points)[2.0])
    assert np.flatnonzero(unknown).tolist() == [0]


def test_what_a_robot_cannot_have_is_refused(desk):
    cases = [
        ({"hardware": None, "plants": ("hardware",)}, "config: expected the file that describes"),
        ({"head": "icub"}, "head: expected none with --config"),
        ({"tune": True}, "tune: expected none with --config.*--head turrets"),
        ({"stage": "still"}, "stage: expected none without --plant hardware, got still"),
        ({"plants": ("hardware",)}, "plant: expected simulated ones, got hardware"),
    ]

    def ask(changes):
        config = EvaluateConfig(**{"controllers": ("ibvs",), "hardware": desk, **changes})
        resolve_lineup(config, None, SerialMapper())
        evaluate(config)

    assert not_refused(ask, cases) == []
