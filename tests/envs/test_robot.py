"""A plant that is no simulation: the task runs on it, and the world is its target."""

import numpy as np
import pytest

from tests.envs.robot import EARLIER_S, LATENCY, Robot
from vergence import make_controller
from vergence.envs import views
from vergence.envs.gaze import GazeEnv
from vergence.envs.plant import PLANTS, make_plant, simulation_of
from vergence.envs.task import GazeTask
from vergence.envs.views import eye_images
from vergence.errors import ConfigurationError
from vergence.eval.trials.bound import settle_bound

ZERO = np.zeros(1, dtype=np.uint64)


@pytest.fixture(autouse=True)
def _registered(monkeypatch, without_opengl):
    monkeypatch.setitem(PLANTS, "robot", "tests.envs.robot:Robot")


@pytest.fixture
def task():
    task = GazeTask(1, plant="robot", info=("truth", "fixes"))
    task.begin(np.arange(1), ZERO, ZERO)
    return task


def test_its_target_is_the_world_and_nobody_knows_the_truth(task):
    assert task.target is None
    assert task.truth() is None
    assert set(task.info()) == {"is_success", "reward_terms", "gaze", "itpc"}


def test_a_trial_begins_at_rest(task):
    assert np.array_equal(task.reading.positions[0], task.head.rest())


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
    assert not info["is_success"]
    assert env.render().ndim == 3
    env.close()
    assert not env.task.plant.open


def test_nothing_is_drawn_in_place_of_the_images_that_it_has_not(task):
    assert eye_images(task, 0) is None


def test_its_picture_has_no_circle_for_a_target_that_nobody_knows(monkeypatch):
    drawn = []
    monkeypatch.setattr(views.cv2, "circle", lambda *args: drawn.append(args[2]))
    env = GazeEnv(plant="robot", render_mode="rgb_array")
    env.reset(seed=0)
    # until the axes cross in front of the eyes
    controller = make_controller("ibvs", head=env.task.head)
    for _ in range(120):
        env.step(controller.predict(env.task.observation)[0][0])
    assert np.isfinite(env.task.fixes()[0].point).all()
    env.render()
    eyes_alone = 4
    assert len(drawn) == eyes_alone


def test_what_needs_a_simulation_says_so(task):
    with pytest.raises(ConfigurationError, match="expected a simulated one, got Robot"):
        simulation_of(task.plant)
    with pytest.raises(ConfigurationError, match="expected a simulated one"):
        settle_bound(task)


@pytest.mark.parametrize("plant", ["kinematic", "mujoco", "rendered"])
def test_every_simulated_plant_has_a_simulation(simulated, plant):
    made = make_plant(plant, simulated)
    assert made.simulation is made
    assert (made.frames() is None) == (plant != "rendered")


def test_a_plant_has_neither_simulation_nor_images_unless_it_says_so(simulated):
    robot = Robot(simulated)
    assert robot.simulation is None
    assert robot.frames() is None


def test_an_action_that_is_nan_never_reaches_the_plant(task, monkeypatch):
    monkeypatch.setattr(task.plant, "step", None)  # a call would fail otherwise
    with pytest.raises(ConfigurationError, match="action: expected numbers, got nan"):
        task.step(np.full((1, 4), np.nan))
