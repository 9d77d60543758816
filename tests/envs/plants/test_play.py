"""Play between motors and joints: where it is at first, and what it does when motors turn."""

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of
from tests.envs.trials import assert_uniform, begin, start_of, steps
from tests.heads import head_of
from tests.naming import named
from vergence.envs.plant import make_plant

T = 1 / 120
PLAY = 0.01


def test_joints_begin_anywhere_in_their_play(exact) -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            num = 600
            plant = make_plant(plant_name, exact, num, backlash_rad=PLAY)
            reading = begin(plant, start_of(num))
            truth = plant.truth()
            assert np.array_equal(reading.positions, truth.motors)  # encoders sit on the motors
            assert not truth.motors.any()
            off = truth.positions / PLAY + 0.5
            assert (off[:, :3] == 0.5).all()  # a neck has none
            for joint in range(3, 7):
                assert_uniform(off[:, joint])
            pairs = np.corrcoef(off[:, 3:].T) - np.eye(4)
            assert np.abs(pairs).max() < 4 / np.sqrt(num)


@pytest.mark.slow
@pytest.mark.parametrize("plant_name", ["kinematic", "mujoco"])
def test_a_joint_lags_half_its_play_behind_the_motor_that_pushes_it(exact, plant_name) -> None:
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, exact, 1, backlash_rad=PLAY, **own)
    commands = np.zeros((120, 7))
    commands[:, 3:] = np.where(np.arange(120) < 50, 0.4, -0.4)[:, None] * [1, -1, 0.5, 1]
    _r, q, v = steps(plant, start_of(), 120, lambda k: commands[k])
    motion = motion_of(exact, commands)
    motors = np.array([motion(k * T)[0] for k in range(121)])[:, 3:]
    joints, rates = q[:, 0, 3:], v[:, 0, 3:]
    # the play's own law, step by step: clip(joint, motor - b/2, motor + b/2) on a fine grid
    fine = np.array([motion(k * T / 40)[0] for k in range(4801)])[:, 3:]
    driven = joints[0].copy()
    expected = [driven]
    for k in range(1, len(fine)):
        driven = np.clip(driven, fine[k] - 0.5 * PLAY, fine[k] + 0.5 * PLAY)
        if k % 40 == 0:
            expected.append(driven)
    # where a motor turns the grid misses 1e-7 rad; MuJoCo looks four times a period
    within = 1e-6 if plant_name == "kinematic" else 3e-4
    assert joints == pytest.approx(np.array(expected), abs=within)
    crossing = np.abs(np.array(expected) - motors) < 0.49 * PLAY
    assert crossing[52:].sum() > 8
    assert (rates[crossing] == 0.0).all()


def test_play_belongs_to_the_actuator() -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            head = head_of("tied").replace(sensor={"encoder_resolution_rad": 0.0})
            play = np.array([0.0, 0.02, 0.0])
            plant = make_plant(plant_name, head, 200, backlash_rad=np.tile(play, (200, 1)))
            begin(plant, start_of(200))
            truth = plant.truth()
            driven = head.actuation.actuators_of(truth.positions)[:, 3:6]
            off = driven - truth.motors[:, 3:6]
            assert np.abs(off[:, [0, 2]]).max() < 1e-12
            assert np.abs(off[:, 1]).max() <= 0.01 + 1e-12
            assert np.ptp(off[:, 1]) > 0.018


def test_a_heads_own_play_holds_where_nothing_is_said(exact) -> None:
    head = exact.replace(sensor={"backlash_rad": 0.004})
    given = make_plant("kinematic", head, 1).conditions.backlash_rad
    assert given[0].tolist() == [0.0, 0.0, 0.0, 0.004, 0.004, 0.004, 0.004]
    none = make_plant("kinematic", head, 1, backlash_rad=0.0).conditions.backlash_rad
    assert not none.any()


def test_drawn_play_is_only_where_there_are_actuators() -> None:
    head = head_of("tied")
    plant = make_plant("kinematic", head, 50, variation={"backlash_rad": (0.001, 0.01)})
    begin(plant, start_of(50))
    play = plant.conditions.backlash_rad
    assert not play[:, [0, 1, 2, 6]].any()
    assert play[:, 3:6].min() >= 0.001
    assert play[:, 3:6].max() <= 0.01
