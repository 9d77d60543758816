"""Baselines of a controller in training, and messages on the comparison."""

import dataclasses

import pytest

from tests.naming import named
from vergence import make_controller
from vergence.commands.train import _end, _Watch
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.training.listener import TrainingResult
from vergence.training.validation import BASELINES, Validation, ValidationScore


@pytest.mark.slow
def test_baselines_of_a_head_that_nothing_was_tuned_for_are_named_as_untuned():
    scenario = load_scenario("hardware")
    preset = scenario.model()
    assert set(Validation(scenario, preset, "kinematic", 0, 2).baselines) == {*BASELINES}
    other = Validation(scenario, preset.replace(timing={"lag_s": 0.04}), "kinematic", 0, 2)
    tuned = {f"{name} (untuned for this head)" for name in BASELINES if name != "saccade"}
    assert set(other.baselines) == {*tuned, "saccade"}  # which has nothing to be tuned


def test_where_targets_move_the_law_to_beat_is_the_one_that_follows_them():
    scenario = load_scenario("hardware-fast")
    validation = Validation(scenario, scenario.model(), "kinematic", 0, 2)
    assert "pursuit" in validation.baselines
    assert "saccade" not in validation.baselines
    assert validation.unit == "px"


def test_settling_counts_in_the_band_that_leads_the_scenario():
    """A law that stays 1.5 px off has settled in 2 px, and not in 1."""
    hardware, workspace = load_scenario("hardware"), load_scenario("workspace")
    assert (hardware.band_px, workspace.band_px) == (2.0, 1.0)
    for scenario in (hardware, workspace):
        trials = run_trials(
            make_controller("saccade", scenario.model()), scenario, episodes=5, split="validation"
        )
        settle = trials.settle_or_trial_s(scenario.band_px)
        assert ValidationScore.of(trials).mean == pytest.approx(settle.mean())


def test_the_trials_are_those_of_the_validation_split_with_the_runs_seed():
    scenario = dataclasses.replace(load_scenario("hardware"), duration_s=0.5)
    controller = make_controller("saccade", scenario.model())
    validation = Validation(scenario, scenario.model(), "kinematic", 3, 2)
    trials = run_trials(controller, scenario, episodes=2, seed=3, split="validation")
    assert validation.score(controller) == ValidationScore.of(trials)


def test_a_run_is_compared_with_the_best_baseline_by_its_name(tmp_path, capsys):
    score = ValidationScore(headline=0.7, mean=0.7, settled_fraction=1.0)
    for gain, unit, said in [
        (2.0, "s", "2.00 times faster than"),
        (0.185, "s", "5.41 times slower than"),
        (2.0, "px", "2.00 times nearer than"),
        (0.5, "px", "2.00 times farther than"),
        (1.001, "s", "neither faster nor slower than"),
    ]:
        with named(gain, unit):
            watch = _Watch(tmp_path)
            watch.begin({"ibvs-tuned (untuned for this head)": score}, unit)
            row = {"step": 1, "headline": 0.7 / gain, "settled_fraction": 1.0, "steps_per_s": 9}
            watch.row({**row, "gain": gain})
            assert f"{said} ibvs-tuned (untuned for this head)," in capsys.readouterr().err


def test_the_end_of_a_run_says_who_is_slower_than_the_best_baseline(capsys, tmp_path):
    baselines = {
        name: ValidationScore(headline=headline, mean=headline, settled_fraction=1.0)
        for name, headline in (("ibvs", 0.6), ("saccade", 0.2))
    }
    row = {"step": 1, "headline": 1.0, "mean": 1.0, "settled_fraction": 1.0, "gain": 0.2}
    rows = [{**row, "best": True}]
    done = TrainingResult(
        folder=tmp_path, steps=1, finished=True, unit="s", baselines=baselines, rows=rows
    )
    assert _end(done) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "than saccade" in printed
    assert "3.00 times slower" in printed
    assert "5.00 times slower" in printed
