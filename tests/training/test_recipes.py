"""Defaults of `vergence train`."""

import shlex
from dataclasses import replace

import pytest

from tests.heads import text_of
from vergence.controllers.networks.inputs import KINDS
from vergence.errors import UnknownNameError
from vergence.eval.trials.loops import LATEST_ONSET_S
from vergence.eval.trials.scenarios import load_scenario
from vergence.models import load_head
from vergence.training.choices import resolve_config
from vergence.training.export import training_command
from vergence.training.options import TrainOptions
from vergence.training.recipes import RECIPES, default_recipe


@pytest.mark.parametrize("kind", sorted(RECIPES))
def test_a_recipe_is_a_runs_configuration(kind) -> None:
    config, head = resolve_config(TrainOptions(kind=kind))
    made = default_recipe(kind)
    assert config.scenario == "hardware"
    assert head.digest == load_scenario("hardware").model().digest
    assert made.inputs in KINDS
    assert (config.steps, config.envs, config.inputs) == (made.steps, made.envs, made.inputs)
    # an episode goes on after the latest onset by as long as a turn takes at the slowest
    assert made.episode_steps * head.timing.period_s > LATEST_ONSET_S + 0.7


def test_a_head_that_is_named_is_that_head_and_none_is_the_scenarios() -> None:
    ideal = resolve_config(TrainOptions(kind="policy", head="simulated"))[1]
    assert ideal.digest == load_head("simulated").digest
    webcam = load_scenario("webcam").model()
    assert resolve_config(TrainOptions(kind="policy", scenario="webcam"))[1].digest == webcam.digest


@pytest.mark.parametrize("kind", sorted(RECIPES))
def test_randomising_is_as_asked_and_else_as_the_recipe_has_it(kind) -> None:
    usual = default_recipe(kind).randomise
    for asked in (True, False, None):
        config, _head = resolve_config(TrainOptions(kind=kind, randomise=asked))
        assert config.randomise == (usual if asked is None else asked)
        words = shlex.split(training_command(config))
        assert ("--randomise" in words, "--no-randomise" in words) == (
            config.randomise,
            usual and not config.randomise,
        )
        assert "--set" not in words


def test_what_is_asked_for_on_the_command_line_goes_before_the_recipe() -> None:
    asked = {"steps": 4096, "envs": 16, "inputs": "predicted"}
    config, _head = resolve_config(TrainOptions(kind="policy", **asked))
    assert {name: getattr(config, name) for name in asked} == asked


def test_what_cannot_be_shared_is_not_shared_unless_asked_for(tmp_path) -> None:
    head = tmp_path / "tied.toml"
    head.write_text(text_of("tied"))
    options = TrainOptions(kind="policy", head=str(head))
    assert not resolve_config(options)[0].shared
    assert resolve_config(replace(options, set=("shared=true",)))[0].shared


def test_a_number_of_the_recipe_can_be_changed() -> None:
    changes = ("log_std_init=-2", "final_learning_rate=1e-4")
    config, _head = resolve_config(TrainOptions(kind="policy", set=changes))
    assert (config.log_std_init, config.final_learning_rate) == (-2, 1e-4)


def test_an_unknown_recipe_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="policy"):
        default_recipe("dance")
