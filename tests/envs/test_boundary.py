"""Wrong arguments of environments are refused in one line that names the valid ones."""

import gymnasium
import numpy as np
import pytest

from tests.envs.robot import Robot
from tests.naming import named, refused
from vergence import load_head
from vergence.envs.gaze import GazeEnv, GazeVectorEnv
from vergence.envs.plant import make_plant
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, VergenceError


@pytest.fixture(scope="module")
def env():
    env = GazeEnv(plant="kinematic")
    env.reset(seed=1)
    return env


@pytest.fixture(scope="module")
def envs():
    envs = GazeVectorEnv(2, plant="kinematic")
    envs.reset(seed=1)
    return envs


def test_a_reset_that_cannot_be_is_refused(env, envs) -> None:
    masks, seeds = (np.zeros(2, bool), np.ones(3, bool), np.ones(2, int)), ([1, 2, 3], [-1, 0])
    for each, name, values, said in (
        (env, "trial", (1.5, "3", -1, True), "trial: expected"),
        (envs, "trial", (1.5, "3", -1, True, [1, 2, 3], [1, 2.5], np.ones(2)), "trial: expected"),
        (env, "trail", (3,), r"options\.trail: expected one of trial, got"),
        (envs, "trail", (3,), "expected one of trial, reset_mask, got"),
        (envs, "reset_mask", masks, "reset_mask: expected 2 bool"),
    ):
        for value in values:
            refused(said, each.reset, options={name: value})
    for each in (env, envs):
        refused("reset: options.*expected", each.reset, options=[3])
    for seed in (*seeds, 2**64 - 1):
        refused("seed: expected", envs.reset, seed=seed)


def test_an_environment_that_cannot_be_is_refused(env) -> None:
    for num in (0, 1.5, "two", True):
        refused("expected a whole number above 0", GazeVectorEnv, num, plant="kinematic")
    for wrong in (0.0, -1.0, np.nan, "long"):
        refused("duration_s: expected", GazeEnv, plant="kinematic", duration_s=wrong)
    said = r"autoreset_mode: expected one of.*'Sometimes'"
    refused(said, GazeVectorEnv, 2, plant="kinematic", autoreset_mode="Sometimes")
    for action in (np.zeros(3), np.zeros(7), 0.0):
        refused(r"action: expected shape \(1, 4\)", env.step, action)


def test_a_refused_reset_leaves_the_trials_where_they_were() -> None:
    one, other = GazeEnv(plant="kinematic"), GazeEnv(plant="kinematic")
    for each in (one, other):
        each.reset(seed=4)
    with pytest.raises(ConfigurationError):
        one.reset(seed=9, options={"trail": 3})
    assert np.array_equal(one.reset()[0], other.reset()[0])


def test_arguments_of_a_wrong_kind_are_refused() -> None:
    for options in (
        {"plant_options": [3]}, {"plant_options": {"true_head": "physical"}}, {"plant": 3},
        {"plant": "kinematik"}, {"head": 3}, {"head": None}, {"variation": [0.1]}, {"target": 3},
    ):  # fmt: skip
        refused("expected", GazeTask, 1, error=VergenceError, **options)


MINE = '''
from tests.envs.robot import Robot
from vergence.envs.plant import Plant

class Mine(Robot):
    """A plant of a user's own."""

class Idle(Plant):
    def __init__(self, head, num): self.head, self.num = head, num
    def reset(self, ids, positions): ...
    def close(self): ...

class Stranger:
    def __init__(self, head, num): self.head, self.num = head, num

function = print
'''


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A current folder with modules of a user's own."""
    (tmp_path / "my_own_plant.py").write_text(MINE)
    (tmp_path / "my_broken_plant.py").write_text("import no_such_module\n")
    (tmp_path / "my_wrong_plant.py").write_text("class Plant(:\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*__import__("sys").path])


@pytest.mark.usefixtures("here")
def test_a_plant_of_ones_own_is_named_by_module_and_class() -> None:
    env = gymnasium.make("vergence/Gaze-v0", plant="my_own_plant:Mine")
    env.reset(seed=0)
    assert isinstance(env.unwrapped.task.plant, Robot)
    observation, *_rest = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert GazeVectorEnv(3, plant="my_own_plant:Mine").task.plant.num == 3


@pytest.mark.usefixtures("here")
def test_what_is_no_plant_is_refused_in_one_line_with_the_real_error() -> None:
    for plant, message in (
        ("my_own_plant:Idle", "one without step"),
        ("my_own_plant:Stranger", "derives from vergence.envs.plant.Plant .* got Stranger"),
        ("my_own_plant:function", "expected a class"),
        ("my_own_plant:Missing", "expected Missing in .*my_own_plant.py, got Mine"),
        ("my_broken_plant:Plant", "my_broken_plant.py:1: ModuleNotFoundError: .*'no_such_module'"),
        ("my_wrong_plant:Plant", "my_wrong_plant.py:1: SyntaxError: "),
        ("not_there:Plant", "no module not_there"),
        ("not_there", "expected one of hardware, kinematic, mujoco, rendered, module:class"),
    ):
        with named(plant, message):
            with pytest.raises(VergenceError, match=message) as error:
                GazeTask(1, plant=plant)
            assert "\n" not in str(error.value)


@pytest.mark.usefixtures("here")
def test_an_option_that_a_users_plant_does_not_take_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"plant_options\.speed: expected one of"):
        make_plant("my_own_plant:Mine", load_head("simulated"), 1, speed=3)
