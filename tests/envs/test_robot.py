"""A plant that is no simulation: the task runs on it, and the world is its target."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.robot import EARLIER_S, LATENCY
from tests.naming import named, refused
from vergence import make_controller
from vergence.envs.gaze import GazeEnv
from vergence.envs.plant import PLANTS, is_simulated, make_plant, simulation_of
from vergence.envs.targets.motion import motion_fields
from vergence.envs.task import GazeTask, given_or_drawn_eye_images, rollout
from vergence.errors import ConfigurationError
from vergence.eval.trials.bound import settle_bound
from vergence.viewer import marks


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", "tests.envs.robot:Robot")


@pytest.fixture
def task():
    return begin(GazeTask(1, plant="robot", info=("truth", "fixes")))


def test_its_target_is_the_world_and_nobody_knows_the_truth_or_draws_an_image(task):
    assert task.truth() is None
    assert given_or_drawn_eye_images(task, 0) is None
    assert set(task.info()) == {"is_success", "reward_terms", "gaze", "itpc"}


def test_a_trial_begins_where_the_target_says_as_in_a_simulation(task):
    simulated = begin(GazeTask(1, plant="kinematic"))
    assert task.reading.positions.any()
    assert np.array_equal(task.reading.positions, simulated.truth().positions)


def test_where_the_world_is_the_target_no_target_is_refused():
    beside = {"kind": "static", "point": (2.0, 0.0, 0.5)}
    begin(GazeTask(1, plant="robot", target=beside))
    refused("target", GazeTask, 1, plant="tests.envs.robot:Emulated", target=beside)


def test_targets_are_placed_before_the_head_where_a_plant_can():
    task = begin(GazeTask(1, plant="tests.envs.robot:Emulated", target="step"))
    assert task.plant.calls == ["show", "reset"]
    assert motion_fields(task.plant.shown)["before"].tolist() == [[0.0, -0.1, 1.0]]


def test_a_rollout_compiles_and_asks_the_policy_once_before_anything_moves(task):
    calls = task.plant.calls = []
    law = make_controller("ibvs", head=task.head)

    class Asked:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            calls.append("predict")
            if len(calls) == 2:
                assert state is None
                assert episode_start.all()
            return law.predict(observation, state, episode_start, deterministic)

    rollout(task, Asked(), 2, lambda _step: None)
    assert calls == ["prepare", "predict", "reset", "predict", "step", "predict", "step", "close"]


def test_a_policy_of_another_shape_is_refused_before_anything_moves(task):
    class Single:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros(4), state

    calls = task.plant.calls = []
    with pytest.raises(ConfigurationError, match=r"action: expected shape \(1, 4\)"):
        rollout(task, Single(), 2, lambda _step: None)
    assert calls == ["prepare", "close"]


def test_the_age_of_an_image_counts_from_the_measured_exposure(task):
    for _ in range(LATENCY + 3):
        task.step(np.zeros((1, 4)))
    age = task.layout.decode(task.observation).image_age_s[0]
    # a float32 keeps seven digits
    assert age == pytest.approx(LATENCY / 120 + EARLIER_S, abs=1e-7)


def test_a_controller_brings_the_target_to_the_principal_points(task):
    controller = make_controller("ibvs", head=task.head)
    for _ in range(240):
        action, _state = controller.predict(task.observation)
        task.step(action)
    assert np.linalg.norm(task.pixel_error, axis=-1).max() < 0.5
    assert task.success.all()


def test_the_environment_runs_and_draws_on_it_and_closes_it():
    env = GazeEnv(plant="robot", render_mode="rgb_array")
    env.reset(seed=3)
    for _ in range(LATENCY + 1):
        observation, reward, lost, truncated, info = env.step(np.full(4, 0.1, np.float32))
    assert observation in env.observation_space
    assert 0.0 < reward < 1.0
    assert not lost
    assert not truncated
    assert not (info["is_success"])
    assert env.render().ndim == 3
    env.close()
    assert not env.task.plant.open


def test_its_picture_has_the_fix_but_no_board_for_a_target_that_nobody_knows(monkeypatch):
    fixes, ball = [], marks.ball
    monkeypatch.setattr(marks, "ball", lambda *args: fixes.append(args[0]) or ball(*args))
    monkeypatch.setattr(marks, "board", None)
    env = GazeEnv(plant="robot", render_mode="rgb_array")
    env.reset(seed=0)
    # until the axes cross in front of the eyes
    controller = make_controller("ibvs", head=env.task.head)
    for _ in range(120):
        env.step(controller.predict(env.task.observation)[0][0])
    assert np.isfinite(env.task.fixes()[0].point).all()
    env.render()
    assert len(fixes) == 1


def test_what_needs_a_simulation_says_so(task):
    assert not is_simulated("robot")
    refused("expected a simulated one, got Robot", simulation_of, task.plant)
    refused("expected a simulated one", settle_bound, task)


def test_every_simulated_plant_is_a_simulation(simulated):
    for plant in ["kinematic", "mujoco", "rendered"]:
        with named(plant):
            made = make_plant(plant, simulated)
            assert is_simulated(plant)
            assert simulation_of(made) is made
            assert (made.frames() is None) == (plant != "rendered")


def test_an_action_that_is_nan_never_reaches_the_plant(task, monkeypatch):
    monkeypatch.setattr(task.plant, "step", None)  # a call would fail otherwise
    refused("action: expected numbers, got nan", task.step, np.full((1, 4), np.nan))
