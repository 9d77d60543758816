"""Pictures: both eyes and the head, with or without a window."""

import functools
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.envs.trials import SIMULATED_IDS, SIMULATED_PLANTS
from tests.naming import named
from vergence import load_head
from vergence.envs.gaze import GazeEnv, GazeVectorEnv
from vergence.envs.task import given_or_drawn_eye_images
from vergence.errors import ConfigurationError, RenderingUnavailableError
from vergence.viewer.eye_pictures import EYE_WIDTH
from vergence.viewer.pictures import VIEW_HEIGHT


@pytest.mark.slow
def test_a_picture_is_an_rgb_array_that_changes_with_the_gaze() -> None:
    for plant, head in zip(SIMULATED_PLANTS, ("simulated", "physical", "simulated"), strict=True):
        with named(plant, head):
            env = gym.make("vergence/Gaze-v0", plant=plant, head=head, render_mode="rgb_array")
            env.reset(seed=0)
            before = env.render()
            assert (before.dtype, before.ndim, before.shape[2]) == (np.uint8, 3, 3)
            for _ in range(20):
                env.step(np.array([0.2, 0.2, -0.2, 0.2], np.float32))
            after = env.render()
            assert after.shape == before.shape
            assert (after != before).mean() > 1e-3
            env.close()


@pytest.mark.slow
def test_eyes_with_images_of_their_own_size_stand_side_by_side() -> None:
    cameras = {"size": [[640, 480], [640, 360]], "principal": [[320.0, 240.0], [320.0, 180.0]]}
    head = load_head("physical").replace(cameras=cameras)
    for plant, drawn in (("kinematic", True), ("rendered", False)):
        env = GazeEnv(plant=plant, head=head, render_mode="rgb_array")
        env.reset(seed=0)
        left, right, found = given_or_drawn_eye_images(env.task, 0)
        assert found == drawn
        assert (left.shape, right.shape) == ((480, 640), (360, 640))
        assert env.render().shape == (360 + VIEW_HEIGHT, 2 * EYE_WIDTH, 3)
        env.close()


@pytest.mark.slow
def test_looking_changes_nothing() -> None:
    observations = []
    for mode in (None, "rgb_array"):
        env = GazeEnv(plant="rendered", render_mode=mode)
        env.reset(seed=0)
        for _ in range(6):
            observation, *_rest = env.step(np.full(4, 0.1))
            assert (env.render() is None) == (mode is None)
        observations.append(observation)
    assert np.array_equal(*observations)


def test_a_target_behind_the_head_can_be_pictured() -> None:
    line = {"kind": "line", "origin": (0.1, 0.0, 1.0), "end": (0.1, 0.0, -1.0), "speed": 99.0}
    env = GazeEnv(plant="kinematic", target=line, info=("truth",), render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(4):
        *_rest, info = env.step(np.zeros(4, np.float32))
    assert info["truth"]["target"][2] == pytest.approx(-1.0)
    assert env.render().ndim == 3


def test_a_vector_pictures_each_head() -> None:
    envs = GazeVectorEnv(2, plant="kinematic", render_mode="rgb_array")
    envs.reset(seed=0)
    one, two = envs.render()
    assert one.shape == two.shape
    assert (one != two).any()
    envs.close()


@pytest.mark.slow
def test_a_window_shows_the_picture() -> None:
    import pygame

    env = gym.make("vergence/Gaze-v0", plant="rendered", render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    surface = pygame.display.get_surface()
    env.step(np.zeros(4, np.float32))
    shown = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    other = GazeEnv(plant="rendered", render_mode="rgb_array")
    other.reset(seed=0)
    other.step(np.zeros(4))
    assert np.array_equal(shown, other.render())
    env.close()
    assert not pygame.display.get_init()


def test_a_window_without_pygame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    for make in (GazeEnv, functools.partial(gym.make, "vergence/Gaze-v0")):
        with pytest.raises(RenderingUnavailableError, match=r"pip install 'vergence\[render\]'"):
            make(plant="kinematic", render_mode="human")


@pytest.mark.slow
def test_gymnasiums_checker_passes_without_pygame(monkeypatch: pytest.MonkeyPatch) -> None:
    assert GazeEnv(plant="kinematic").metadata["render_modes"] == ["rgb_array", "human"]
    monkeypatch.setitem(sys.modules, "pygame", None)
    for name in SIMULATED_IDS:
        with named(name), warnings.catch_warnings():
            env = gym.make(name, plant="kinematic").unwrapped
            assert env.metadata["render_modes"] == ["rgb_array"]
            warnings.simplefilter("error")
            check_env(env)
            env.close()


def test_an_unknown_mode_is_refused() -> None:
    for make in (GazeEnv, GazeVectorEnv):
        with pytest.raises(ConfigurationError, match=r"render_mode: expected.*rgb_array.*'ansi'"):
            make(plant="kinematic", render_mode="ansi")
