"""Interchangeable plants: what the kinematic plant says, MuJoCo's dynamics confirm."""

import numpy as np
import pytest

from tests.envs.trials import start_of, steps
from vergence import HeadModel, load_head, make_controller
from vergence.envs.plant import make_plant
from vergence.envs.task import GazeTask

PRESETS = ("simulated", "physical")


def worst_deg(a, b) -> float:
    return float(np.rad2deg(np.abs(a - b)).max())


@pytest.mark.parametrize("preset", PRESETS)
def test_joint_angles_agree_over_a_servoed_gaze(preset) -> None:
    num, count = 6, 240
    head = load_head(preset)
    tasks = [GazeTask(num, head=head, plant=name) for name in ("kinematic", "mujoco")]
    controller = make_controller("ibvs", head=head)
    ids = np.arange(num)
    for task in tasks:
        task.begin(ids, np.full(num, 3, dtype=np.uint64), ids.astype(np.uint64))
    leader, follower = tasks
    worst = moved = 0.0
    start = leader.truth().positions
    for _ in range(count):
        action, _state = controller.predict(leader.observation)
        for task in tasks:
            task.step(action)
        worst = max(worst, worst_deg(leader.truth().positions, follower.truth().positions))
        moved = max(moved, worst_deg(leader.truth().positions, start))
    assert moved > 5.0
    assert worst < 0.02


def bang_bang(head: HeadModel, seed: int, num: int, count: int):
    """Eye commands of +-6 rad/s that switch at random and turn round 8 degrees off rest."""
    rng = np.random.default_rng(seed)
    plant = make_plant("kinematic", head, num)
    plant.begin(start_of(num))
    commands = np.zeros((count, num, 7))
    for step in range(count):
        if step % 5 == 0:
            side = 6.0 * rng.choice([-1.0, 1.0], (num, 4))
        q = plant.truth().positions[:, 3:]
        side = np.where(np.abs(q) > 0.15, -6.0 * np.sign(q), side)
        commands[step, :, 3:] = side
        plant.step(commands[step])
    return commands


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_joint_angles_agree_under_bang_bang_commands(preset, seed) -> None:
    head = load_head(preset)
    num, count = 3, 400
    commands = bang_bang(head, seed, num, count)
    runs = [
        steps(make_plant(name, head, num), start_of(num), count, lambda k: commands[k])
        for name in ("kinematic", "mujoco")
    ]
    (_, q, v), (_, q_mujoco, v_mujoco) = runs
    assert head.limits.contains(q, 0.1).all()
    assert np.abs(v).max() > 5.0
    assert worst_deg(q[..., 3:], q_mujoco[..., 3:]) < 0.1
    # the angle is right because the velocity is: a tenth of what a period at the limit adds
    assert np.abs(v - v_mujoco)[..., 3:].max() < 0.1


@pytest.mark.parametrize("lag_s", [0.015, 0.03, 0.06])
def test_joint_angles_agree_where_a_heads_lag_is_not_the_nominal_one(exact, lag_s) -> None:
    def command(step):
        return [0, 0, 0, 1, -1, 1, 1] if step < 30 else [0, 0, 0, -1, 1, -1, 0]

    runs = [
        steps(make_plant(name, exact, 2, lag_s=[0.03, lag_s]), start_of(2), 60, command)
        for name in ("kinematic", "mujoco")
    ]
    # small commands stay clear of the acceleration limit: the discretised lag is exact there
    assert worst_deg(runs[0][1], runs[1][1]) < 0.005


@pytest.mark.parametrize("name", ["kinematic", "mujoco"])
def test_lag_is_the_time_constant_of_the_response(exact: HeadModel, name) -> None:
    plant = make_plant(name, exact, 3, lag_s=[1 / 120, 2 / 120, 4 / 120])
    _r, _q, v = steps(plant, start_of(3), 4, [0, 0, 0, 1, 0, 0, 0])
    assert v[[1, 2, 4], [0, 1, 2], 3] == pytest.approx(np.full(3, 1 - np.exp(-1.0)), abs=2e-3)


def test_the_moving_neck_agrees(exact: HeadModel) -> None:
    def command(step):
        return [1.0, 0.5, -0.5, 0, 0, 0, 0] if step < 40 else [-1.0, 0, 0.5, 1.0, 0, 0, -1.0]

    runs = [
        steps(make_plant(name, exact, 1), start_of(), 90, command)
        for name in ("kinematic", "mujoco")
    ]
    # the neck's inertia depends on where the eyes and its own joints are: per cent of its lag
    assert worst_deg(runs[0][1], runs[1][1]) < 0.5


def test_a_welded_neck_leaves_the_eyes_as_they_are(exact: HeadModel) -> None:
    commands = bang_bang(exact, 5, 1, 120)
    servo, welded = (
        steps(make_plant("mujoco", exact, 1, neck=neck), start_of(), 120, lambda k: commands[k])[1]
        for neck in ("servo", "welded")
    )
    assert not welded[..., :3].any()
    assert worst_deg(servo, welded) < 0.01


def test_the_number_of_threads_changes_nothing(exact: HeadModel) -> None:
    commands = bang_bang(exact, 6, 5, 60)
    one, two = (
        steps(make_plant("mujoco", exact, 5, nthread=n), start_of(5), 60, lambda k: commands[k])[1]
        for n in (1, 2)
    )
    assert np.array_equal(one, two)
