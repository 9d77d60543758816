"""What a controller in training is compared with, and how that is said."""

from vergence.commands.train import _Watch
from vergence.eval.trials.scenarios import load_scenario
from vergence.training.validation import BASELINES, Score, Validation


def test_baselines_of_a_head_that_nothing_was_tuned_for_are_named_as_untuned():
    scenario = load_scenario("step")
    preset = scenario.model()
    assert set(Validation(scenario, preset, "kinematic", 0, 2).baselines) == {*BASELINES}
    other = Validation(scenario, preset.replace(timing={"lag_s": 0.04}), "kinematic", 0, 2)
    assert set(other.baselines) == {f"{name} (untuned for this head)" for name in BASELINES}


def test_a_run_is_said_to_be_better_than_the_baseline_by_its_name(tmp_path, capsys):
    watch = _Watch(tmp_path)
    score = Score(headline=0.7, mean=0.7, settled_fraction=1.0)
    watch.begin({"ibvs-tuned (untuned for this head)": score}, "s")
    row = {"step": 1, "headline": 0.35, "gain": 2.0, "settled_fraction": 1.0, "steps_per_s": 9}
    watch.row(row)
    said = capsys.readouterr().err
    assert "2.00 times better than ibvs-tuned (untuned for this head)," in said
