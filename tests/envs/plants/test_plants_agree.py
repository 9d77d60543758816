"""Interchangeable plants: what the kinematic plant says, MuJoCo's dynamics confirm."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.trials import start_of, steps
from tests.heads import head_of, text_of
from tests.naming import named
from vergence import HeadModel, load_head, make_controller
from vergence.envs.plant import make_plant
from vergence.envs.task import GazeTask
from vergence.models import parse_head


def worst_deg(a, b) -> float:
    return float(np.rad2deg(np.abs(a - b)).max())


def test_joint_angles_agree_over_a_servoed_gaze() -> None:
    num, count = 6, 120
    head = load_head("physical")
    tasks = [GazeTask(num, head=head, plant=name) for name in ("kinematic", "mujoco")]
    controller = make_controller("ibvs", head=head)
    leader, follower = (begin(task, 3) for task in tasks)
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


def test_joint_angles_agree_where_a_heads_lag_is_not_the_nominal_one(exact) -> None:
    def command(step):
        return [0, 0, 0, 1, -1, 1, 1] if step < 30 else [0, 0, 0, -1, 1, -1, 0]

    runs = [
        steps(make_plant(name, exact, 3, lag_s=[0.03, 0.015, 0.06]), start_of(3), 60, command)
        for name in ("kinematic", "mujoco")
    ]
    # small commands stay clear of the acceleration limit: the discretised lag is exact there
    assert worst_deg(runs[0][1], runs[1][1]) < 0.005


def test_lag_is_the_time_constant_of_the_response(exact: HeadModel) -> None:
    for name in ["kinematic", "mujoco"]:
        with named(name):
            plant = make_plant(name, exact, 3, lag_s=[1 / 120, 2 / 120, 4 / 120])
            _r, _q, v = steps(plant, start_of(3), 4, [0, 0, 0, 1, 0, 0, 0])
            reached = v[[1, 2, 4], [0, 1, 2], 3]
            assert reached == pytest.approx(np.full(3, 1 - np.exp(-1.0)), abs=2e-3)


def test_the_moving_neck_agrees(exact: HeadModel) -> None:
    def command(step):
        return [1.0, 0.5, -0.5, 0, 0, 0, 0] if step < 40 else [-1.0, 0, 0.5, 1.0, 0, 0, -1.0]

    runs = [
        steps(make_plant(name, exact, 1), start_of(), 90, command)
        for name in ("kinematic", "mujoco")
    ]
    # the neck's inertia depends on where the eyes and its own joints are: per cent of its lag
    assert worst_deg(runs[0][1], runs[1][1]) < 0.5


PAN_AND_VERGENCE = "pan of both eyes and vergence of one"
PLAY_AND_LAGS = "play, and a lag for each actuator"
PRESETS = ("simulated", "physical", "turrets")


def any_head(name: str) -> HeadModel:
    if name == PAN_AND_VERGENCE:
        one = text_of("tied").replace("left_pan = 0.5, right_pan = -0.5", "right_pan = -1.0")
        return parse_head(one)
    if name == PLAY_AND_LAGS:
        text = text_of("tied").replace('name = "tilt"', 'name = "tilt"\nlag_s = 0.0')
        version = 'name = "version"\nlag_s = 0.06\nbacklash_rad = 0.01'
        return parse_head(text.replace('name = "version"', version))
    return load_head(name) if name in PRESETS else head_of(name)


def switching(head: HeadModel, seed: int, num: int, count: int):
    """Actuator commands at full speed that switch at random and turn round 8 degrees off."""
    rng, own = np.random.default_rng(seed), head.actuation
    middle = 0.5 * (own.lower + own.upper)
    start = start_of(num, positions=own.joints_of(middle))
    plant = make_plant("kinematic", head, num)
    plant.begin(start)
    commands = np.zeros((count, num, 7))
    for step in range(count):
        if step % 5 == 0:
            side = rng.choice([-1.0, 1.0], (num, 7)) * own.velocity
        away = own.actuators_of(plant.truth().positions) - middle
        side = np.where(np.abs(away) > 0.15, -own.velocity * np.sign(away), side)
        commands[step, :, 3:] = side[:, 3:]
        plant.step(commands[step])
    return start, commands


@pytest.mark.parametrize("name", ["mis", "panfirst", *PRESETS, PAN_AND_VERGENCE, PLAY_AND_LAGS])
def test_joints_of_any_head_agree_under_switching_commands(name) -> None:
    head, num, count = any_head(name), 2, 180
    start, commands = switching(head, 0, num, count)
    (_, q, v), (_, q_mujoco, v_mujoco) = (
        steps(make_plant(plant, head, num), start, count, lambda k: commands[k])
        for plant in ("kinematic", "mujoco")
    )
    assert worst_deg(q, q[0]) > 10.0
    # eyes push a neck a little, whose commands are zero
    eyes = np.s_[..., 3:] if name in PRESETS else np.s_[...]
    assert worst_deg(q[eyes], q_mujoco[eyes]) < 0.1
    # the angle is right because the velocity is: a tenth of what a period at the limit adds
    assert np.abs(v - v_mujoco)[eyes].max() < 0.1
    # MuJoCo's ties give a little; the plant's joints are what its motors say
    own = head.actuation
    assert np.abs(own.joints_of(own.actuators_of(q_mujoco)) - q_mujoco).max() < 1e-12


def test_actuators_stop_alike_at_their_limits() -> None:
    for name in ["mis", PAN_AND_VERGENCE]:
        with named(name):
            head = any_head(name)
            start, speed = start_of(positions=head.rest()), head.actuation.velocity
            paths = [
                steps(make_plant(plant, head, 1), start, 120, speed)[1]
                for plant in ("kinematic", "mujoco")
            ]
            assert worst_deg(paths[0][-1], paths[1][-1]) < 0.1


@pytest.mark.slow
def test_a_welded_neck_leaves_the_eyes_as_they_are(exact: HeadModel) -> None:
    for head in (exact, any_head("tied")):
        with named(head.name):
            start, commands = switching(head, 3, 1, 120)
            servo, welded = (
                steps(make_plant("mujoco", head, 1, neck=neck), start, 120, commands.__getitem__)[1]
                for neck in ("servo", "welded")
            )
            assert not welded[..., :3].any()
            assert worst_deg(servo, welded) < 0.01
