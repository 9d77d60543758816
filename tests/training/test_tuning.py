"""Recipes are tuned by short trainings."""

import pytest

from tests.training.runs import PPO, SMALL
from vergence.eval.trials.scenarios import load_scenario
from vergence.eval.tuning.spaces import TuneConfig
from vergence.eval.tuning.tune import tune
from vergence.training.choices import resolve_config
from vergence.training.options import TrainOptions
from vergence.training.tuning import RECIPE_SEARCH_RANGES, recipe_changes, training_objective


def test_every_option_of_the_search_is_a_change_of_the_recipe():
    middle = {name: 0.5 * (span.low + span.high) for name, span in RECIPE_SEARCH_RANGES.items()}
    config, _ = resolve_config(TrainOptions(kind="policy", set=tuple(recipe_changes(middle))))
    assert config.algorithm["learning_rate"] == middle["learning_rate"]
    assert config.algorithm["clip_range"] == middle["clip_range"]
    assert config.algorithm["gae_lambda"] == middle["gae_lambda"]
    assert config.algorithm["gamma"] == 1.0 - 1.0 / middle["discount_time_steps"]
    assert config.log_std_init == middle["log_std_init"]


@pytest.mark.nightly
def test_recipes_are_judged_by_short_trainings_that_leave_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("vergence.eval.tuning.tune.save_figure", lambda *_: None)
    config = TuneConfig(
        controller="gain-schedule",
        scenario="workspace",
        head="simulated",
        plant="kinematic",
        trials=2,
        episodes=3,
        seed=0,
        grid=False,
        storage=str(tmp_path / "study.db"),
        study="test",
        steps=128,
    )

    def small(options):
        return [*SMALL, *PPO, "evaluations=1", "episodes=2", *recipe_changes(options)]

    objective = training_objective(config, tmp_path, small)
    head = load_scenario("workspace").model()
    result = tune(tmp_path, config, RECIPE_SEARCH_RANGES, objective, head)
    assert len(result.attempts) == 2
    assert all(set(attempt.options) == set(RECIPE_SEARCH_RANGES) for attempt in result.attempts)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("config.toml", "head.toml", "history.csv", "study.db", "tune.json"),
    }
