"""The law on the default rig: what the article reports of its loop, on every plant."""

import gymnasium as gym
import numpy as np
import pytest

from tests.controllers.loops import settle_time, true_errors
from vergence import HeadModel, load_head, make_controller
from vergence.envs.task import GazeTask

PERIOD_S = 1 / 120


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head("simulated").replace(sensor={"detection_noise_px": 0.0})


def sweep(head: HeadModel, plant: str, y: float, gain: float) -> np.ndarray:
    # the gain sweep: (0, -100, 1000) mm jumps by 100 mm in y
    target = {"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.0, y, 1.0)}
    task = GazeTask(1, head=head, plant=plant, target=target)
    controller = make_controller("ibvs", head=head, layout=task.layout, gain=gain)
    return true_errors(task, controller, 2.0)


def overshoot(errors: np.ndarray) -> float:
    """Largest overshoot of v in either eye beyond the principal point, relative to the jump."""
    v = errors[:, 0, :, 1]
    return float((-v / v[0]).max())


@pytest.mark.parametrize(("plant", "y"), [("kinematic", 0.0), ("mujoco", -0.2)])
def test_overshoot_begins_above_a_gain_of_4_where_delay_and_lag_put_it(head, plant, y) -> None:
    # a pure delay of 66.7 ms, half a period of hold and a lag of 30 ms: 4.1 to 4.15
    assert overshoot(sweep(head, plant, y, 4.0)) < 0.005 < overshoot(sweep(head, plant, y, 4.2))


@pytest.mark.parametrize(("plant", "y"), [("kinematic", 0.0), ("mujoco", -0.2)])
def test_the_sweeps_step_settles_in_about_0_55_s_at_a_gain_of_4(head, plant, y) -> None:
    assert 0.52 <= settle_time(sweep(head, plant, y, 4.0), PERIOD_S) <= 0.58


def test_nothing_moves_before_the_jump_can_be_seen(head) -> None:
    errors = sweep(head, "mujoco", -0.2, 4.0)
    # read at step 8, acted upon at once: the first motion shows at step 9
    assert np.abs(errors[8] - errors[0]).max() < 1e-6
    assert np.abs(errors[9] - errors[0]).max() > 1e-3


@pytest.mark.parametrize(("plant", "preset"), [("kinematic", "simulated"), ("mujoco", "physical")])
def test_every_random_target_is_brought_to_both_principal_points(plant, preset) -> None:
    task = GazeTask(20, head=preset, plant=plant)
    controller = make_controller("ibvs", head=task.head, layout=task.layout)
    errors = true_errors(task, controller, 2.0)
    assert np.linalg.norm(errors[0], axis=-1).max() > 50.0
    # the physical head's encoders do not disturb the image, only the law's angles
    assert np.linalg.norm(errors[-24:], axis=-1).max() < 1.0
    gaze, _views = task.fixes()
    depth_error = np.abs(gaze.point - task.truth().target)[:, 2] / task.truth().target[:, 2]
    # 12-bit steps cost at most half a step of each of two pans: Z d / b
    allowed = 0.002 + task.truth().target[:, 2] * task.head.sensor.encoder_resolution_rad / 0.092
    assert (depth_error < 1.5 * allowed).all()


@pytest.mark.nightly
def test_stable_baselines3_evaluates_it_as_it_is() -> None:
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    def make() -> gym.Env:
        return gym.make("vergence/Gaze-v0", plant="kinematic", max_episode_steps=60)

    controller = make_controller("ibvs", head=load_head("simulated"))
    envs = DummyVecEnv([lambda: Monitor(make())])
    envs.seed(5)
    options = {"n_eval_episodes": 2, "return_episode_rewards": True}
    rewards, lengths = evaluate_policy(controller, envs, **options)
    assert lengths == [60, 60]
    env = make()
    for episode, reward in enumerate(rewards):
        observation, _info = env.reset(seed=5 if episode == 0 else None)
        total, done = 0.0, False
        while not done:
            action, _state = controller.predict(observation)
            observation, value, terminated, truncated, _info = env.step(action)
            total, done = total + value, terminated or truncated
        assert reward == pytest.approx(total, abs=1e-5)  # SB3 keeps rewards in float32


def test_it_earns_what_the_environments_reference_law_should() -> None:
    """A regression gate on task and law: the mean reward of 64 fixed episodes."""
    envs = gym.make_vec("vergence/Gaze-v0", num_envs=64, plant="kinematic")
    controller = make_controller("ibvs", head=load_head("simulated"))
    observation, _info = envs.reset(seed=0)
    total = np.zeros(64)
    for _ in range(240):
        action, _state = controller.predict(observation)
        observation, reward, *_rest, info = envs.step(action)
        total += reward
    assert info["is_success"].all()
    # 8 of 240 steps blind, most of a second of approach at 0.1 to 0.7, then nearly 1 a step
    assert 166.0 < total.mean() < 176.0
