"""A running environment is saved and put back: what follows is the same, bit by bit."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.everything import EVERYTHING
from vergence.controllers.networks.environments import training_env
from vergence.envs.gaze import GazeVectorEnv
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario

PLACES = 5
STEPS = 30
"""Steps of an episode; in the rest of the first one images and commands are on their way."""
UNKNOWN = load_scenario("robust").variation


def gaze(**options):
    mode = AutoresetMode.SAME_STEP
    return GazeVectorEnv(PLACES, max_episode_steps=STEPS, autoreset_mode=mode, **options)


def trained(kind, **options):
    return training_env(kind, PLACES, max_episode_steps=STEPS, **options)


CASES = {
    "wander": lambda: gaze(plant="kinematic", target="wander", variation=EVERYTHING),
    "everything in mujoco": lambda: gaze(plant="mujoco", variation=EVERYTHING),
    "step in mujoco": lambda: gaze(plant="mujoco", target="double-step"),
    "gain schedule": lambda: trained("gain-schedule", plant="kinematic", variation=UNKNOWN),
    "policy": lambda: trained("policy", plant="mujoco"),
}


def steps(env, number, seed):
    rng = np.random.default_rng(seed)
    for _ in range(number):
        action = rng.uniform(-1.0, 1.0, (PLACES, 4)).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        tracking, truth = info["reward_terms"]["tracking"], env.unwrapped.task.truth()
        yield observation, reward, terminated, truncated, tracking, *truth


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_restored_environment_goes_on_as_the_saved_one_did(case):
    saved, fresh = CASES[case](), CASES[case]()
    saved.reset(seed=3)
    list(steps(saved, STEPS + 3, 1))
    state = saved.state()
    went_on = list(steps(saved, 2 * STEPS, 2))
    fresh.restore(state)
    saved.restore(state)  # which has been elsewhere in the meantime
    for env in (fresh, saved):
        for ours, theirs in zip(steps(env, 2 * STEPS, 2), went_on, strict=True):
            for mine, yours in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(mine, yours)
        env.close()


def test_a_state_does_not_change_with_its_environment():
    env = gaze(plant="kinematic")
    env.reset(seed=3)
    state = env.state()
    before = {part: {n: a.copy() for n, a in arrays.items()} for part, arrays in state.items()}
    list(steps(env, 3, 1))
    for part, arrays in state.items():
        for name, array in arrays.items():
            np.testing.assert_array_equal(array, before[part][name])


def test_the_state_of_another_environment_is_refused():
    env, other = gaze(plant="kinematic"), gaze(plant="mujoco")
    other.reset(seed=0)
    with pytest.raises(ConfigurationError, match=r"state: expected that of simulations"):
        env.restore(other.state())


def test_detectors_that_remember_have_no_state_to_be_saved():
    env = GazeVectorEnv(1, plant="rendered")
    with pytest.raises(ConfigurationError, match="expected the plant kinematic or mujoco"):
        env.state()
    env.close()
