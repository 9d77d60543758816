"""The registered environments as Gymnasium and Stable-Baselines3 expect them."""

import pickle
import re
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence

from tests.envs.simulated import SIMULATED_IDS
from tests.grids import some_of
from tests.naming import named
from vergence.envs import MAX_EPISODE_STEPS
from vergence.envs.gaze import GazeEnv
from vergence.envs.plants.conditions import Variation
from vergence.errors import ConfigurationError
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors

IDS = SIMULATED_IDS
FAST = ("kinematic", "mujoco")


@pytest.fixture(params=list(zip(IDS, FAST, strict=True)), ids=" ".join)
def each(request: pytest.FixtureRequest):
    """Every registered environment and both plants of dynamics."""
    id, plant = request.param
    env = gym.make(id, plant=plant)
    yield env
    env.close()


@pytest.fixture
def env():
    env = gym.make("vergence/Gaze-v0", plant="kinematic")
    yield env
    env.close()


def rollout(env: gym.Env, count: int, seed: int, reset: bool = True) -> list[object]:
    """Everything that an environment returns, random actions, several episodes."""
    env.action_space.seed(seed)
    out: list[object] = [env.reset(seed=seed)] if reset else []
    for _ in range(count):
        out.append(env.step(env.action_space.sample()))
        if out[-1][2] or out[-1][3]:
            out.append(env.reset())
    return out


def identical(a: list[object], b: list[object]) -> bool:
    return len(a) == len(b) and all(
        data_equivalence(x, y, exact=True) for x, y in zip(a, b, strict=True)
    )


def first_sight(env: gym.Env, **reset: object) -> np.ndarray:
    """The observation once the first image has arrived: not all show the joints before."""
    env.reset(**reset)
    for _ in range(10):
        observation = env.step(np.zeros(4, np.float32))[0]
    return observation


@pytest.mark.slow
def test_gymnasiums_checker_has_no_complaint() -> None:
    env = gym.make("vergence/Gaze-v0", plant="mujoco").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)
    env.close()


@pytest.mark.nightly
def test_stable_baselines3s_checker_has_no_complaint() -> None:
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    env = gym.make("vergence/Gaze-v0", plant="kinematic")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_for_sb3(env, warn=True)
    env.close()


def test_a_seed_decides_everything_over_several_episodes(each) -> None:
    one, again = (gym.make(each.spec, max_episode_steps=40) for _ in range(2))
    assert identical(rollout(one, 90, seed=7), rollout(again, 90, seed=7))
    assert not identical(rollout(one, 5, seed=7), rollout(again, 5, seed=8))


def test_resetting_goes_on_to_the_next_trial_and_begins_again_with_a_seed(env) -> None:
    first, second = first_sight(env, seed=4), first_sight(env)
    assert not np.array_equal(first, second)
    assert np.array_equal(first_sight(env, seed=4), first)
    assert np.array_equal(first_sight(env), second)
    assert not np.array_equal(first_sight(gym.make(env.spec)), first_sight(gym.make(env.spec)))


def test_an_option_names_the_trial(each) -> None:
    observations = [first_sight(each, seed=4), *(first_sight(each) for _ in range(3))]
    assert np.array_equal(first_sight(each, options={"trial": 2}), observations[2])
    assert np.array_equal(first_sight(each), observations[3])
    assert np.array_equal(first_sight(each, seed=4, options={"trial": 1}), observations[1])


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "count"), [("mujoco", 60), ("rendered", 16)])
def test_pickled_in_mid_episode_the_copy_goes_on_identically(plant, count) -> None:
    env = gym.make("vergence/Gaze-v0", plant=plant, head="physical", max_episode_steps=40)
    rollout(env, 12, seed=5)
    copy = pickle.loads(pickle.dumps(env))
    assert copy is not env
    assert identical(rollout(env, count, 6, reset=False), rollout(copy, count, 6, reset=False))


@pytest.mark.slow
def test_a_spec_with_values_of_python_goes_through_json() -> None:
    for argument, id in some_of(
        [
            {"model_errors": ModelErrors(joint_offset_rad=0.01)},
            {"variation": Variation(latency_s=(0.03, 0.1), model_errors={"link_m": 0.001})},
            {"info": {"truth", "fixes"}},
            {"head": "physical", "plant_options": {"lag_s": 0.02}},
            {"target": {"kind": "static", "point": np.array([0.0, -0.1, 0.8])}},
        ],
        IDS,
    ):
        with named(argument, id):
            env = gym.make(id, plant="kinematic", **argument)
            again = gym.make(EnvSpec.from_json(env.spec.to_json()))
            assert again.spec.to_json() == env.spec.to_json()
            seen, seen_again = (rollout(one, 30, seed=2) for one in (env, again))
            assert all(np.array_equal(x[0], y[0]) for x, y in zip(seen, seen_again, strict=True))
            assert seen[0][1].keys() == seen_again[0][1].keys()


def test_a_spec_with_a_head_object_says_that_json_cannot_hold_it() -> None:
    for make in (gym.make, gym.make_vec):
        env = make("vergence/Gaze-v0", plant="kinematic", head=load_head("physical"))
        with pytest.raises(ConfigurationError, match=r"\bhead\b.*HeadModel.*JSON"):
            env.spec.to_json()


def test_a_bare_environment_must_be_reset_first() -> None:
    for id in IDS:
        for call in ("step", "render"):
            with named(id, call):
                env = gym.make(id, plant="kinematic", render_mode="rgb_array").unwrapped
                with pytest.raises(gym.error.ResetNeeded, match="reset first"):
                    env.step(np.zeros(4, np.float32)) if call == "step" else env.render()


def test_pictures_are_played_at_the_heads_control_rate() -> None:
    for id in IDS:
        for head, rate in (("simulated", 120), ("turrets", 60)):
            with named(id, head, rate):
                assert load_head(head).timing.control_rate_hz == rate
                for make in (gym.make, gym.make_vec):
                    fps = make(id, plant="kinematic", head=head).metadata["render_fps"]
                    assert fps == rate
                    assert isinstance(fps, int)  # gymnasium.utils.play takes no other


def test_an_unknown_argument_is_told_all_that_there_are() -> None:
    for id in IDS:
        with named(id):
            for make, own in (
                (gym.make, {"render_mode"}),
                (gym.make_vec, {"render_mode", "num_envs", "max_episode_steps", "autoreset_mode"}),
            ):
                with pytest.raises(ConfigurationError) as caught:
                    make(id, plant="rendered", foo=1)
                words = set(re.findall(r"\w+", str(caught.value)))
                assert {"foo", "head", "target", "plant_options"} | own <= words
                assert {"width_rad", "lag_s"} <= words, "options of the plant"
                assert ("inputs" in words) == ("GainSchedule" in id)


def test_time_runs_out_exactly_once(env) -> None:
    for expected, options in ((MAX_EPISODE_STEPS, {}), (30, {"max_episode_steps": 30})):
        env = gym.make(env.spec, **options)
        for _episode in range(2):
            env.reset(seed=1)
            ends = [env.step(np.zeros(4, np.float32))[2:4] for _ in range(expected)]
            assert ends == [(False, False)] * (expected - 1) + [(False, True)]


def test_a_lost_target_terminates(env) -> None:
    env.reset(seed=1)
    for _ in range(MAX_EPISODE_STEPS - 1):
        _o, reward, terminated, truncated, info = env.step(np.array([0, 1, 0, 1], np.float32))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["reward_terms"]["lost"] == -25.0
    assert reward == -25.0


def test_info_on_request_is_that_of_one_head() -> None:
    env = gym.make("vergence/Gaze-v0", plant="kinematic", info=("truth", "fixes"))
    _observation, info = env.reset(seed=0)
    for _ in range(12):
        *_rest, info = env.step(np.zeros(4, np.float32))
    assert info["truth"]["target"].shape == (3,)
    assert info["truth"]["pixel_error"].shape == (2, 2)
    assert info["itpc"]["covariance"].shape == (3, 3)
    assert info["gaze"]["valid"].shape == ()
    error = np.abs(info["itpc"]["point"] - info["truth"]["target"])
    assert (error < 6 * np.sqrt(np.diag(info["itpc"]["covariance"]))).all()


def test_an_action_of_another_shape_is_refused() -> None:
    env = GazeEnv(plant="kinematic")
    env.reset(seed=0)
    said = r"action: expected shape \(1, 4\)"
    for action in [np.zeros(3), np.zeros(7), 0.0]:
        with named(action), pytest.raises(ConfigurationError, match=said):
            env.step(action)


def test_actions_are_limited_to_the_box(env) -> None:
    ends = []
    for scale in (1.0, 5.0):
        env.reset(seed=0)
        action = scale * np.array([1.0, -1.0, 1.0, -1.0])
        ends.append([env.unwrapped.step(action)[0] for _ in range(5)])
    assert np.array_equal(*ends)


@pytest.mark.nightly
def test_a_name_with_its_module_needs_no_import() -> None:
    code = """
import gymnasium, sys
assert "vergence" not in sys.modules
env = gymnasium.make("vergence:vergence/Gaze-v0", plant="kinematic")
observation, info = env.reset(seed=0)
envs = gymnasium.make_vec("vergence:vergence/Gaze-v0", num_envs=2, plant="kinematic")
assert (envs.reset(seed=0)[0][0] == observation).all()
print(env.spec.id)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "vergence/Gaze-v0"


@pytest.mark.slow
def test_the_environments_are_registered_where_vergence_is_imported_first() -> None:
    code = """
import vergence, gymnasium
print(*(name for name in gymnasium.registry if 'vergence' in name))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    names = ["vergence/Gaze-v0", "vergence/GainSchedule-v0", "vergence/GazeHardware-v0"]
    assert done.stdout.split() == names, done.stderr


def test_an_episode_ends_after_its_seconds_however_many_steps_they_have() -> None:
    for plant, fewest in (("kinematic", 120), ("tests.envs.robot:Late", 90)):
        env = gym.make("vergence/Gaze-v0", plant=plant, target="static", duration_s=1.0)
        env.reset(seed=0)
        steps, truncated = 0, False
        while not truncated:
            *_rest, truncated, _info = env.step(np.zeros(4, np.float32))
            steps += 1
            assert truncated == (env.unwrapped.reading.time_s[0] > 1.0 - 1e-9)
        assert fewest <= steps <= 120
        assert '"duration_s": 1.0' in env.spec.to_json()


def test_a_duration_that_cannot_be_is_refused() -> None:
    for wrong in (0.0, -1.0, np.nan, "long"):
        with named(wrong), pytest.raises(ConfigurationError, match="duration_s: expected"):
            GazeEnv(plant="kinematic", duration_s=wrong)
