"""Random numbers in compiled code are NumPy's Philox; a saved environment goes on bit by bit."""

import numba
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.envs.trials import EVERYTHING
from tests.heads import head_of
from tests.naming import refused
from vergence.controllers.networks.environments import training_env
from vergence.envs.gaze import GazeVectorEnv
from vergence.envs.streams import random_words, to_normals, to_uniform
from vergence.eval.trials.scenarios import load_scenario

WORD = st.integers(0, 2**64 - 1)


@numba.njit
def uniforms(seed, trial, purpose, block, out):
    for lane in range(out.shape[0]):
        words = random_words(seed, trial, purpose, block, 1 + lane)
        for i in range(4):
            out[lane, i] = to_uniform(words[i])


@numba.njit
def normals(seed, trial, purpose, out):
    for block in range(out.shape[0]):
        words = random_words(seed, trial, purpose, block, 1)
        out[block, 0], out[block, 1] = to_normals(words[0], words[1])
        out[block, 2], out[block, 3] = to_normals(words[2], words[3])


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    out = np.empty((50_000, 4))
    normals(np.uint64(11), np.uint64(5), 1, out)
    return out


@pytest.mark.slow
@given(seed=WORD, trial=WORD, purpose=st.integers(0, 3), block=st.integers(0, 2**62))
def test_uniform_numbers_are_those_of_numpys_philox(seed, trial, purpose, block) -> None:
    out = np.empty((3, 4))
    uniforms(np.uint64(seed), np.uint64(trial), purpose, block, out)
    counter = np.array([0, 0, purpose, block], np.uint64)
    philox = np.random.Philox(key=np.array([seed, trial], np.uint64), counter=counter)
    assert (out.ravel() == np.random.Generator(philox).random(12)).all()


def test_normal_numbers_have_its_distribution_out_to_the_tails(drawn: np.ndarray) -> None:
    for column in drawn.T:
        assert stats.kstest(column, "norm").pvalue > 1e-4
    # 12.7 numbers are expected
    tails = np.abs(drawn) > 4.0
    assert tails.sum() == pytest.approx(2 * drawn.size * stats.norm.sf(4.0), abs=5 * 12.7**0.5)


def test_the_numbers_of_a_block_do_not_depend_on_one_another(drawn: np.ndarray) -> None:
    for numbers in (drawn, drawn**2):
        correlation = np.corrcoef(numbers.T) - np.eye(4)
        assert np.abs(correlation).max() < 5 / len(drawn) ** 0.5
    for first, second in ((0, 1), (2, 3)):
        angle = np.arctan2(drawn[:, second], drawn[:, first])
        assert stats.kstest(angle, "uniform", args=(-np.pi, 2 * np.pi)).pvalue > 1e-4


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
    "tied joints": lambda: gaze(plant="kinematic", head=head_of("tied")),
    "tied joints in mujoco": lambda: gaze(plant="mujoco", head=head_of("tied")),
}


def steps(env, number, seed):
    rng = np.random.default_rng(seed)
    for _ in range(number):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
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
    refused(r"state: expected that of simulations", env.restore, other.state())


def test_detectors_that_remember_have_no_state_to_be_saved():
    env = GazeVectorEnv(1, plant="rendered")
    refused("expected the plant kinematic or mujoco", env.state)
    env.close()
