"""Registered environments, single and vector, as Gymnasium and Stable-Baselines3 expect them."""

import pickle
import re
import subprocess
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, VectorEnv

from tests.envs.trials import SIMULATED_IDS
from tests.grids import some_of
from tests.naming import named, refused
from vergence.envs import MAX_EPISODE_STEPS
from vergence.envs.gaze import GazeVectorEnv
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
        refused(r"\bhead\b.*HeadModel.*JSON", env.spec.to_json)


def test_a_bare_environment_must_be_reset_first() -> None:
    options = {"plant": "kinematic", "render_mode": "rgb_array"}
    for env in (*(gym.make(id, **options).unwrapped for id in IDS), GazeVectorEnv(2, **options)):
        for call in (lambda env=env: env.step(np.zeros((2, 4), np.float32)), env.render):
            with named(env, call), pytest.raises(gym.error.ResetNeeded, match="reset first"):
                call()


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


ID = "vergence/Gaze-v0"
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


def make_both(num: int, mode: AutoresetMode, **options: object) -> tuple[VectorEnv, VectorEnv]:
    """This package's vector environment, and Gymnasium's own of single ones."""
    own = gym.make_vec(ID, num_envs=num, autoreset_mode=mode, **options)
    single = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    return own, gym.make_vec(ID, num_envs=num, **single, **options)


def drive(step: int, num: int) -> np.ndarray:
    """Actions under which the first head loses its target early and the others run to the end."""
    out = 0.02 * np.sin(0.1 * step + np.arange(4 * num).reshape(num, 4))
    out[0, [1, 3]] = 1.0
    return out.astype(np.float32)


def assert_same_info(mine: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Assert equal keys, masks and types, and equal values where the masks are set."""
    assert mine.keys() == theirs.keys()
    for key, other in theirs.items():
        one = mine[key]
        if isinstance(other, dict):
            assert_same_info(one, other)
        elif isinstance(other, np.ndarray):
            has = theirs.get(f"_{key}", np.ones(len(other), dtype=bool))
            # Gymnasium makes objects of NumPy's booleans
            assert other.dtype in (one.dtype, np.dtype(object))
            assert one.shape == other.shape
            for x, y in zip(one[has], other[has], strict=True):
                np.testing.assert_array_equal(x, y)


def test_infos_are_those_of_gymnasiums_vector_of_single_environments() -> None:
    for id in SIMULATED_IDS:
        with named(id):
            options = {"plant": "kinematic", "info": ("truth", "fixes")}
            own, sync = (
                gym.make_vec(id, 2, vectorization_mode=mode, **options)
                for mode in ("vector_entry_point", "sync")
            )
            assert_same_info(own.reset(seed=3)[1], sync.reset(seed=3)[1])
            for _ in range(12):
                infos = [envs.step(np.full((2, 4), 0.1, np.float32))[4] for envs in (own, sync)]
            assert_same_info(*infos)
            assert infos[0]["truth"]["_target"].all()


def test_a_spec_goes_through_json() -> None:
    for mode in MODES:
        with named(mode):
            envs = gym.make_vec(ID, num_envs=2, plant="kinematic", autoreset_mode=mode)
            again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
            assert again.num_envs == 2
            assert again.metadata["autoreset_mode"] is mode
            assert np.array_equal(again.reset(seed=4)[0], envs.reset(seed=4)[0])


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_autoreset_is_that_of_gymnasiums_vector_of_single_environments(mode) -> None:
    num = 3
    own, sync = make_both(num, mode, plant="kinematic", max_episode_steps=95)
    assert own.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"] == mode
    assert own.observation_space == sync.observation_space
    assert own.action_space == sync.action_space
    a, b = own.reset(seed=9)[0], sync.reset(seed=9)[0]
    assert np.array_equal(a, b)
    ended, terminated = np.zeros(num, dtype=int), 0
    for step in range(300):
        mine, theirs = own.step(drive(step, num)), sync.step(drive(step, num))
        for x, y in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(x, y)
            assert x.dtype == y.dtype
        done = mine[2] | mine[3]
        for info in (mine[4], theirs[4]):
            assert ("final_obs" in info) == (mode is AutoresetMode.SAME_STEP and done.any())
        assert_same_info({**mine[4], "final_info": None}, {**theirs[4], "final_info": None})
        if "final_obs" in mine[4]:
            assert np.array_equal(mine[4]["_final_obs"], done)
            assert_same_info(mine[4]["final_info"], theirs[4]["final_info"])
        if mode is AutoresetMode.DISABLED and done.any():
            mine, theirs = (e.reset(options={"reset_mask": done.copy()}) for e in (own, sync))
            assert np.array_equal(mine[0], theirs[0])
        ended += done
        terminated += mine[2].sum() if mode is not AutoresetMode.DISABLED else done[0]
    assert (ended >= 3).all()
    assert terminated > 0


def test_place_i_of_seed_s_runs_the_episodes_of_a_single_environment_with_seed_s_plus_i() -> None:
    num, seed, plant = 3, 40, "mujoco"
    own = gym.make_vec(ID, num_envs=num, plant=plant, head="physical", max_episode_steps=25)
    singles = [gym.make(ID, plant=plant, head="physical", max_episode_steps=25) for _ in range(num)]
    observations = own.reset(seed=seed)[0]
    expected = [env.reset(seed=seed + i)[0] for i, env in enumerate(singles)]
    assert np.array_equal(observations, expected)
    done, episodes = np.zeros(num, dtype=bool), 0
    for step in range(90):
        actions = drive(step, num)
        observations, rewards, terminated, truncated, _info = own.step(actions)
        for i, env in enumerate(singles):
            if done[i]:
                assert np.array_equal(observations[i], env.reset()[0])
                assert rewards[i] == 0.0
                continue
            alone = env.step(actions[i])
            assert np.array_equal(observations[i], alone[0])
            assert (rewards[i], terminated[i], truncated[i]) == alone[1:4]
        done = terminated | truncated
        episodes += done.sum()
    assert episodes == 9


def test_a_mask_resets_some_and_leaves_the_others() -> None:
    envs = GazeVectorEnv(3, plant="kinematic")
    envs.reset(seed=0)
    for step in range(20):
        before = envs.step(drive(step, 3))[0]
    mask = np.array([False, True, False])
    after = envs.reset(options={"reset_mask": mask})[0]
    assert np.array_equal(before[~mask], after[~mask])
    assert not np.array_equal(before[mask], after[mask])
    assert envs.reading.time_s[~mask] == pytest.approx(20 / 120)
    # what a single environment has after its first trial
    single = gym.make(ID, plant="kinematic")
    single.reset(seed=1)
    assert np.array_equal(after[1], single.reset()[0])


def test_a_mask_and_seeds_go_together() -> None:
    envs = GazeVectorEnv(3, plant="kinematic")
    first = envs.reset(seed=0)[0]
    mask = np.array([True, False, True])
    again = envs.reset(seed=[7, 8, None], options={"reset_mask": mask})[0]
    assert np.array_equal(again[0], envs.reset(seed=7)[0][0])
    assert np.array_equal(again[1], first[1])


def test_options_name_the_trials() -> None:
    envs = GazeVectorEnv(2, plant="kinematic")
    trials = [envs.reset(seed=3)[0], envs.reset()[0], envs.reset()[0]]
    assert np.array_equal(envs.reset(options={"trial": 1})[0], trials[1])
    assert np.array_equal(envs.reset()[0], trials[2])
    mixed = envs.reset(seed=3, options={"trial": [2, 0]})[0]
    assert np.array_equal(mixed, [trials[2][0], trials[0][1]])


def test_a_list_names_the_seeds_and_none_goes_on() -> None:
    envs = GazeVectorEnv(3, plant="kinematic")
    first, second = envs.reset(seed=[5, 9, 2])[0], envs.reset()[0]
    again = envs.reset(seed=[5, 9, 2])[0]
    assert np.array_equal(again, first)
    mixed = envs.reset(seed=[5, None, 2])[0]
    assert np.array_equal(mixed, [first[0], second[1], first[2]])


def test_in_disabled_mode_an_ended_episode_must_be_reset() -> None:
    envs = GazeVectorEnv(2, plant="kinematic", max_episode_steps=5, autoreset_mode="Disabled")
    envs.reset(seed=0)
    for _ in range(5):
        envs.step(np.zeros((2, 4)))
    refused("reset first", envs.step, np.zeros((2, 4)))
    envs.reset()
    assert not envs.step(np.zeros((2, 4)))[3].any()


def test_what_a_reset_and_a_step_returned_does_not_change_with_the_next() -> None:
    envs = GazeVectorEnv(2, plant="kinematic", info=("truth",))
    first = envs.reset(seed=0)[0]
    *returned, info = envs.step(np.ones((2, 4)))
    arrays = [first, *returned, info["is_success"], info["truth"]["positions"]]
    kept = [array.copy() for array in arrays]
    for _ in range(20):
        envs.step(np.ones((2, 4)))
    assert all(np.array_equal(a, b) for a, b in zip(kept, arrays, strict=True))


def test_every_place_of_a_vector_has_the_true_head_of_a_single_environment():
    errors = {"joint_offset_rad": 0.01, "principal_px": 2.0}
    options = {"plant": "kinematic", "target": "static", "model_errors": errors}
    vector = gym.make_vec("vergence/Gaze-v0", num_envs=3, model_seed=5, **options)
    vector.reset(seed=11)
    for place in range(3):
        single = gym.make("vergence/Gaze-v0", model_seed=5 + place, **options)
        single.reset(seed=11 + place)
        ours = vector.unwrapped.task.plant.true_head.packed[place]
        assert np.array_equal(ours, single.unwrapped.task.plant.true_head.packed[0])
        assert not np.array_equal(ours, single.unwrapped.task.head.packed)
