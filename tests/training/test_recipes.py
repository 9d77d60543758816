"""What `vergence train` does unless told otherwise."""

import shlex

import pytest

from vergence.controllers.networks.inputs import KINDS
from vergence.errors import UnknownNameError
from vergence.training.choices import choose
from vergence.training.export import command_of
from vergence.training.options import TrainOptions
from vergence.training.recipes import RECIPES, recipe


@pytest.mark.parametrize(("kind", "algo"), sorted(RECIPES))
def test_a_recipe_is_a_runs_configuration(kind, algo) -> None:
    config, _head = choose(TrainOptions(kind=kind, algo=algo))
    made = recipe(kind, algo)
    assert made.inputs in KINDS
    assert (config.steps, config.envs, config.inputs) == (made.steps, made.envs, made.inputs)
    assert config.randomise == made.randomise


def test_a_schedule_is_made_for_unknown_timing() -> None:
    assert recipe("gain-schedule", "ppo").randomise


@pytest.mark.parametrize("asked", [True, False, None])
@pytest.mark.parametrize(("kind", "algo"), sorted(RECIPES))
def test_randomising_is_as_asked_and_else_as_the_recipe_has_it(kind, algo, asked) -> None:
    config, _head = choose(TrainOptions(kind=kind, algo=algo, randomise=asked))
    assert config.randomise == (recipe(kind, algo).randomise if asked is None else asked)
    words = shlex.split(command_of(config))
    usual = recipe(kind, algo).randomise
    assert ("--randomise" in words, "--no-randomise" in words) == (
        config.randomise,
        usual and not config.randomise,
    )
    assert "--set" not in words


def test_what_is_asked_for_on_the_command_line_goes_before_the_recipe() -> None:
    asked = {"steps": 4096, "envs": 16, "inputs": "error"}
    config, _head = choose(TrainOptions(kind="policy", **asked))
    assert {name: getattr(config, name) for name in asked} == asked


def test_what_cannot_be_shared_is_not_shared_unless_asked_for() -> None:
    config, _head = choose(TrainOptions(kind="policy", inputs="observation"))
    assert not config.shared
    assert choose(TrainOptions(kind="policy", inputs="observation", set=("shared=true",)))[0].shared


def test_a_number_of_the_recipe_can_be_changed() -> None:
    changes = ("log_std_init=-2", "final_learning_rate=1e-4")
    config, _head = choose(TrainOptions(kind="policy", set=changes))
    assert (config.log_std_init, config.final_learning_rate) == (-2, 1e-4)


def test_an_unknown_recipe_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="policy ppo"):
        recipe("policy", "a2c")
