"""What `vergence train` does unless told otherwise."""

import pytest

from vergence.controllers.networks.inputs import KINDS
from vergence.errors import UnknownNameError
from vergence.training.choices import choose
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


def test_a_number_of_the_recipe_can_be_changed() -> None:
    changes = ("log_std_init=-2", "final_learning_rate=1e-4")
    config, _head = choose(TrainOptions(kind="policy", set=changes))
    assert (config.log_std_init, config.final_learning_rate) == (-2, 1e-4)


def test_an_unknown_recipe_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="policy ppo"):
        recipe("policy", "a2c")
