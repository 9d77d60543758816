"""The law itself: decay, depth, gains; what the article reports of its loop, on every plant."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.controllers.loops import settle_time, true_errors
from tests.grids import some_of
from tests.naming import named
from vergence import HeadModel, load_head, make_controller
from vergence.controllers.ibvs import gain_for_loop
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import UnknownNameError

# a jump that moves the image along both axes of both eyes
BEFORE, AFTER = (0.0, -0.1, 1.0), (0.06, -0.16, 0.95)
JUMP = {"kind": "step", "before": BEFORE, "after": AFTER}


SENSOR_ERRORS = ("detection_noise_px", "encoder_resolution_rad", "velocity_resolution_rad_s")


@pytest.fixture
def preset() -> HeadModel:
    return load_head("physical")


def ideal_head(name: str) -> HeadModel:
    """A head without delay, lag, limits and noise."""
    return load_head(name).replace(
        timing={"latency_s": 0.0, "lag_s": 0.0, "exposure_s": 0.0},
        limits={"velocity": np.full(7, 100.0), "acceleration": np.full(7, np.inf)},
        sensor=dict.fromkeys(SENSOR_ERRORS, 0.0),
    )


IDEAL = ideal_head("physical")


def run(head, time_s: float = 2.0, plant="kinematic", target=JUMP, **options) -> np.ndarray:
    """(steps + 1, 2, 2) true errors after the jump."""
    task = GazeTask(1, head=head, plant=plant, target=target)
    controller = make_controller("ibvs", head=head, layout=task.layout, **options)
    return true_errors(task, controller, time_s)[:, 0]


def deviation(errors: np.ndarray, gains: object) -> np.ndarray:
    """(2, 2) greatest distance from exp(-k t), as a share of the initial error."""
    t = np.arange(len(errors))[:, None, None] / 120.0
    assert np.abs(errors[0]).min() > 3.0  # every axis of every eye has something to do
    expected = errors[0] * np.exp(-np.broadcast_to(gains, (2, 2)) * t)
    return (np.abs(errors - expected) / np.abs(errors[0])).max(axis=0)


def test_without_delay_every_error_decays_as_exp_minus_k_t() -> None:
    for k, depth in some_of([1.0, [[1.0, 4.0], [3.0, 2.0]], 4.0], ["triangulated", 1.0]):
        with named(k, depth):
            # holding a command for T costs k T / (2 e) of the initial error: 0.6 % at k = 4
            assert deviation(run(IDEAL, gain=k, depth=depth), k).max() < 0.01


def test_the_gain_for_a_loop_is_the_articles_and_does_not_ring_in_a_slower_one() -> None:
    assert gain_for_loop(load_head("physical").timing) == 4.0
    slow = load_head("turrets").replace(sensor=dict.fromkeys(SENSOR_ERRORS, 0.0))
    jump = {"kind": "static", "point": (0.15, 0.06, 0.9), "start": "rest"}
    most = []
    for gain in (gain_for_loop(slow.timing), 4.0):
        errors = run(slow, 3.0, target=jump, gain=gain)
        most.append((-errors / errors[0]).max())
    assert most[0] < 0.01
    assert most[1] > 0.05


@settings(max_examples=20)
@given(k=st.floats(0.5, 4.0), x=st.floats(-0.1, 0.1), y=st.floats(-0.2, 0.0), z=st.floats(0.5, 2.0))
def test_the_command_moves_the_image_towards_the_principal_point_at_k(k, x, y, z) -> None:
    head = ideal_head("simulated")
    law = make_controller("ibvs", head=head, gain=k)
    point, q = np.array([x, y, z]), head.fixate(BEFORE)
    error = head.project(q, point) - head.cameras.principal
    command = np.concatenate([np.zeros(3), law.command(q, error)])
    h = 1e-6
    ahead, behind = (head.project(q + side * h * command, point) for side in (1, -1))
    # central differences of a pixel: rounding of 1e-13 px over 2e-6 s, truncation less
    assert (ahead - behind) / (2 * h) == pytest.approx(-k * error, abs=1e-5)


def test_the_triangulated_depth_makes_the_law_exact_where_a_constant_one_is_not() -> None:
    # tilt carries the optical centre, 30 mm above its axis, along the line of sight: off the
    # axis, at 0.4 m, a depth that is five times too large is worth about a per cent
    head = ideal_head("simulated")
    point, q = np.array([0.03, -0.06, 0.4]), head.fixate([0.0, -0.03, 0.4])
    error = head.project(q, point) - head.cameras.principal
    off = []
    for depth in ("triangulated", 0.4, 2.0):
        command = make_controller("ibvs", head=head, gain=1.0, depth=depth).command(q, error)
        full = np.concatenate([np.zeros(3), command])
        rate = (head.project(q + 1e-6 * full, point) - head.project(q - 1e-6 * full, point)) / 2e-6
        off.append(np.abs(rate + error).max() / np.abs(error).max())
    assert off[0] < 1e-6
    assert off[0] < off[1] < 0.005 < off[2]  # depth along an eye's axis is not quite the z of N


def test_an_eye_that_sees_nothing_is_held_and_the_other_goes_on(preset) -> None:
    for eye in (0, 1):
        with named(eye):
            law = make_controller("ibvs", head=preset)
            q = preset.fixate(BEFORE)
            error = preset.project(q, AFTER, distorted=False) - preset.cameras.principal
            error[eye] = np.nan
            command = law.command(q, error).reshape(2, 2)
            assert not command[eye].any()
            assert np.abs(command[1 - eye]).min() > 0.01


@settings(max_examples=20)
@given(error=st.lists(st.floats(-400, 400), min_size=4, max_size=4), limit=st.floats(0.1, 5.0))
def test_a_speed_limit_keeps_the_direction_of_each_eye(error, limit) -> None:
    head = load_head("simulated")
    q, pixels = head.fixate(BEFORE), np.array(error).reshape(2, 2)
    unlimited = head.replace(limits={"velocity": np.full(7, 1e6)})
    free = make_controller("ibvs", head=unlimited, gain=4.0).command(q, pixels)
    held = make_controller("ibvs", head=head, gain=4.0, speed_limit=limit).command(q, pixels)
    for a, b in zip(free.reshape(2, 2), held.reshape(2, 2), strict=True):
        assert np.abs(b).max() <= limit * (1 + 1e-12)
        share = limit / max(limit, np.abs(a).max())
        assert b == pytest.approx(share * a, abs=1e-12)
    fast = make_controller("ibvs", head=head, gain=1000.0).command(q, np.full((2, 2), 100.0))
    assert np.abs(fast.reshape(2, 2)).max(axis=1) == pytest.approx([6.0, 6.0], rel=1e-12)


def test_it_uses_the_angles_of_the_image_and_not_the_present_ones(preset) -> None:
    # the same image with other present angles: the same command
    layout = ObservationLayout.of(preset)
    law = make_controller("ibvs", head=preset, layout=layout)
    rng = np.random.default_rng(3)
    observation = rng.uniform(-0.2, 0.2, layout.size).astype(np.float32)
    observation[layout.fields["visible"]] = 1.0
    moved = observation.copy()
    moved[layout.fields["positions"]] += 0.3
    assert np.array_equal(law.predict(observation)[0], law.predict(moved)[0])
    moved[layout.fields["positions_at_exposure"]] += 0.3
    assert not np.array_equal(law.predict(observation)[0], law.predict(moved)[0])


def test_an_unknown_controller_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"controller: expected one of.*ibvs.*'ibsv'"):
        make_controller("ibsv", head=load_head("simulated"))


PERIOD_S = 1 / 120


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head("simulated").replace(sensor={"detection_noise_px": 0.0})


def sweep(head: HeadModel, plant: str, y: float, gain: float) -> np.ndarray:
    # the gain sweep: (0, -100, 1000) mm jumps by 100 mm in y
    target = {"kind": "step", "before": BEFORE, "after": (0.0, y, 1.0)}
    return run(head, plant=plant, target=target, gain=gain)


def overshoot(errors: np.ndarray) -> float:
    """Largest overshoot of v in either eye beyond the principal point, relative to the jump."""
    v = errors[..., 1]
    return float((-v / v[0]).max())


@pytest.mark.parametrize(("plant", "y"), [("kinematic", 0.0), ("mujoco", -0.2)])
def test_the_sweep_overshoots_above_a_gain_of_4_which_settles_in_about_0_55_s(
    head, plant, y
) -> None:
    errors = sweep(head, plant, y, 4.0)
    # a pure delay of 66.7 ms, half a period of hold and a lag of 30 ms: 4.1 to 4.15
    assert overshoot(errors) < 0.005 < overshoot(sweep(head, plant, y, 4.2))
    assert 0.52 <= settle_time(errors, PERIOD_S) <= 0.58
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
    rewards, lengths = evaluate_policy(
        controller, envs, n_eval_episodes=1, return_episode_rewards=True
    )
    assert lengths == [60]
    env = make()
    observation, _info = env.reset(seed=5)
    total = 0.0
    for _ in range(60):
        observation, reward, *_rest = env.step(controller.predict(observation)[0])
        total += reward
    assert rewards == pytest.approx([total], abs=1e-5)  # SB3 keeps rewards in float32


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
