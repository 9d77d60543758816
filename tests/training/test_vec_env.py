"""The adapter is SB3's own DummyVecEnv, but for speed."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import vergence  # noqa: F401  registers the environments
from vergence.errors import ConfigurationError
from vergence.training.vec_env import VectorEnvAdapter

PLACES = 3
STEPS = 7
"""Steps after which an episode is cut short."""


def adapter(**options):
    env = gymnasium.make_vec(
        "vergence/Gaze-v0",
        num_envs=PLACES,
        plant="kinematic",
        max_episode_steps=STEPS,
        autoreset_mode=AutoresetMode.SAME_STEP,
        **options,
    )
    return VectorEnvAdapter(env, seed=5)


def reference(**options):
    def make():
        return gymnasium.make(
            "vergence/Gaze-v0", plant="kinematic", max_episode_steps=STEPS, **options
        )

    env = VecMonitor(DummyVecEnv([make] * PLACES))
    env.seed(5)
    return env


def test_observations_rewards_and_ends_are_those_of_dummy_vec_env():
    ours, theirs = adapter(), reference()
    rng = np.random.default_rng(1)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    ended = 0
    for _ in range(3 * STEPS):
        action = rng.uniform(-1.0, 1.0, (PLACES, 4)).astype(np.float32)
        our, their = ours.step(action), theirs.step(action)
        for mine, yours in zip(our[:3], their[:3], strict=True):
            np.testing.assert_array_equal(mine, yours)
            assert mine.dtype == yours.dtype
        for mine, yours in zip(our[3], their[3], strict=True):
            if "terminal_observation" not in yours:
                assert mine == {}
                continue
            ended += 1
            np.testing.assert_array_equal(
                mine["terminal_observation"], yours["terminal_observation"]
            )
            assert mine["TimeLimit.truncated"] is yours["TimeLimit.truncated"] is True
            assert mine["is_success"] == yours["is_success"]
            assert mine["episode"]["l"] == yours["episode"]["l"] == STEPS
            # Monitor rounds to 6 digits
            assert mine["episode"]["r"] == pytest.approx(yours["episode"]["r"], abs=1e-5)
    assert ended == 3 * PLACES


class OneStepEnv(gymnasium.vector.VectorEnv):
    """Every episode is one step long; places with an even number end for good."""

    def __init__(self):
        self.num_envs = PLACES
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        return np.zeros((PLACES, 1), np.float32), {}

    def step(self, actions):
        terminated = np.arange(PLACES) % 2 == 0
        final = np.full(PLACES, None, dtype=object)
        for i in range(PLACES):
            final[i] = np.ones(1, np.float32)
        info = {"final_obs": final, "final_info": {}}
        truncated = np.ones(PLACES, np.bool_)
        return np.zeros((PLACES, 1), np.float32), np.zeros(PLACES), terminated, truncated, info


def test_only_an_episode_cut_short_by_time_is_bootstrapped():
    # with a value of 3 everywhere and no reward, the return of a step is 3 gamma where the
    # episode would have gone on, and 0 where it really ended
    model = PPO(
        "MlpPolicy", VectorEnvAdapter(OneStepEnv()), n_steps=4, batch_size=12, gamma=0.5, seed=0
    )
    model.policy.predict_values = lambda obs: torch.full((len(obs), 1), 3.0)
    _, callback = model._setup_learn(12)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, 4)
    for place in range(PLACES):
        assert model.rollout_buffer.rewards[:, place] == pytest.approx(
            0.0 if place % 2 == 0 else 1.5
        )


def test_places_run_the_trials_of_successive_seeds_from_a_given_trial_on():
    env = VectorEnvAdapter(adapter().env, seed=11, first_trial=4)
    for place, seen in enumerate(env.reset()):
        alone = gymnasium.make("vergence/Gaze-v0", plant="kinematic")
        observation, _ = alone.reset(seed=11 + place, options={"trial": 4})
        np.testing.assert_array_equal(seen, observation)


def test_another_way_of_resetting_is_refused():
    env = gymnasium.make_vec("vergence/Gaze-v0", num_envs=2, plant="kinematic")
    with pytest.raises(ConfigurationError, match=r"expected .*SAME_STEP"):
        VectorEnvAdapter(env)


def test_attributes_belong_to_all_places():
    env = adapter()
    assert len(env.get_attr("layout")) == PLACES
    assert env.get_attr("max_episode_steps", indices=[1]) == [STEPS]
    env.set_attr("max_episode_steps", 3)
    assert env.env.max_episode_steps == 3
    with pytest.raises(ConfigurationError, match="all places"):
        env.set_attr("max_episode_steps", 3, indices=[0])
    assert env.env_is_wrapped(gymnasium.Wrapper) == [False] * PLACES
