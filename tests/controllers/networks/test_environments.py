"""The environments of a network: the gaze task behind other spaces."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from tests.naming import named
from vergence.controllers import make_controller
from vergence.controllers.networks.environments import (
    GainScheduleEnv,
    PolicyEnv,
    PolicyVectorEnv,
    training_env,
)
from vergence.controllers.networks.inputs import KINDS
from vergence.controllers.networks.learned import decode_velocity_action
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.trials.scenarios import load_scenario

ID = "vergence/GainSchedule-v0"


def test_gymnasiums_checker_has_no_complaint() -> None:
    for kind in sorted(KINDS):
        with named(kind):
            env = gym.make(ID, plant="kinematic", inputs=kind).unwrapped
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                check_env(env, skip_render_check=True)


def test_a_constant_schedule_runs_the_trial_of_the_fixed_gain() -> None:
    """Trials of one seed are equal, and gains of 4 give the article's law."""
    schedule = gym.make(ID, plant="kinematic")
    gaze = gym.make("vergence/Gaze-v0", plant="kinematic")
    law = make_controller("ibvs", gaze.unwrapped.task.head, gain=4.0)
    schedule.reset(seed=6)
    observation, _info = gaze.reset(seed=6)
    for _ in range(60):
        action, _state = law.predict(observation)
        observation, reward, *_rest = gaze.step(action)
        _inputs, same, _te, _tr, info = schedule.step(np.full(4, np.sqrt(0.8) - 1.0, "f4"))
        # gains go through a float32 action
        assert same == pytest.approx(reward, abs=1e-5)
        assert info["gains"] == pytest.approx(4.0, abs=1e-5)
    assert schedule.unwrapped.task.encoded[0] == pytest.approx(observation, abs=1e-5)


def test_a_policys_action_is_a_velocity() -> None:
    env = PolicyEnv(plant="kinematic")
    vector = PolicyVectorEnv(2, plant="kinematic")
    assert np.array_equal(vector.reset(seed=5)[0][1], env.reset(seed=6)[0])
    for _ in range(9):  # until the first image; until then the eyes are held
        env.step(np.zeros(4))
    env.step(np.array([0.5, -0.5, 1.0, 2.0]))
    assert env.task.encoded[0, 23:].tolist() == [0.125, -0.125, 1.0, 1.0]
    assert decode_velocity_action([0.0, -2.0]).tolist() == [0.0, -1.0]


def test_info_has_the_gains_beside_what_the_gaze_tasks_has() -> None:
    for info in [(), ("truth",)]:
        with named(info):
            env = gym.make(ID, plant="kinematic", info=info)
            _observation, begun = env.reset(seed=0)
            assert not begun["gains"].any()
            *_rest, after = env.step(np.array([1, 0, -1, 0], np.float32))
            assert after["gains"].tolist() == [[5.0, 20.0], [5.0, 0.0]]
            assert set(after) >= {"is_success", "reward_terms", "gains", *info}
            vector = gym.make_vec(ID, num_envs=2, plant="kinematic", info=info)
            vector.reset(seed=0)
            *_rest, many = vector.step(np.array([[1, 0, -1, 0], [0, 0, 0, 0]], np.float32))
            assert np.array_equal(many["gains"][0], after["gains"])


@pytest.mark.parametrize(
    ("kind", "mode"), [("predicted", AutoresetMode.NEXT_STEP), ("to_go", AutoresetMode.SAME_STEP)]
)
def test_the_vector_has_the_single_environments_numbers(kind, mode) -> None:
    options = {"plant": "kinematic", "inputs": kind, "max_episode_steps": 25}
    own = gym.make_vec(ID, num_envs=3, autoreset_mode=mode, **options)
    single = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    sync = gym.make_vec(ID, num_envs=3, **single, **options)
    assert np.array_equal(own.reset(seed=9)[0], sync.reset(seed=9)[0])
    rng = np.random.default_rng(0)
    for _ in range(80):
        actions = rng.uniform(-1, 1, (3, 4)).astype(np.float32)
        mine, theirs = own.step(actions), sync.step(actions)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(a, b)
        for a, b in zip(mine[4].get("final_obs", []), theirs[4].get("final_obs", []), strict=True):
            assert a is b is None or np.array_equal(a, b)


def test_a_saved_state_goes_on_to_the_last_bit_in_a_robots_loop() -> None:
    """With all that stands between a network and the loop: gates, steps that are carried over."""
    for kind, learned in (("predicted", "policy"), ("to_go", "gain-schedule")):
        with named(kind, learned):
            options = load_scenario("hardware").env_options()
            first, second = (
                training_env(learned, 3, kind, max_episode_steps=50, **options) for _ in range(2)
            )
            rng = np.random.default_rng(0)
            actions = rng.uniform(-0.6, 0.6, (60, 3, 4)).astype(np.float32)
            first.reset(seed=4)
            second.reset(seed=5)
            for action in actions[:40]:
                first.step(action)
            second.restore(first.state())
            for action in actions[40:]:
                for a, b in zip(first.step(action)[:4], second.step(action)[:4], strict=True):
                    assert np.array_equal(a, b)


def test_episodes_of_training_end_one_after_the_other() -> None:
    for kind in ["gain-schedule", "policy"]:
        with named(kind):
            envs = training_env(kind, 4, max_episode_steps=20, plant="kinematic")
            assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
            envs.reset(seed=0)
            ends = [envs.step(np.zeros((4, 4)))[3] for _ in range(45)]
            ended = [np.flatnonzero(end)[:2].tolist() for end in ends if end.any()]
            assert ended == [[3], [2], [1], [0]] * 2 + [[3]]


def test_an_unknown_kind_of_training_and_an_action_that_is_nan_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="gain-schedule, policy"):
        training_env("dance", 2)
    env = GainScheduleEnv(plant="kinematic")
    env.reset(seed=0)
    with pytest.raises(ConfigurationError, match="nan"):
        env.step(np.array([0.0, np.nan, 0.0, 0.0]))


def test_the_plant_is_closed_where_the_inputs_are_refused(monkeypatch) -> None:
    closed = []
    monkeypatch.setattr(KinematicPlant, "close", lambda plant: closed.append(plant))
    with pytest.raises(UnknownNameError, match="nonsense"):
        PolicyEnv(plant="kinematic", inputs="nonsense")
    assert len(closed) == 1
