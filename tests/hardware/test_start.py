"""The way to where a trial begins, on a robot in simulated time."""

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.safety.limits import ForbiddenPosture


@pytest.fixture
def robot(monkeypatch):
    """A robot with a posture of its left pan that is forbidden."""
    bar = ForbiddenPosture(name="the bar", slots=(3,), lower=np.array([0.5]), upper=np.array([0.7]))
    return VirtualRobot(monkeypatch, forbidden=(bar,))


def test_a_start_in_a_forbidden_posture_is_refused_before_anything_moves(robot):
    with pytest.raises(HardwareError, match=r"start: .* 'the bar', got left_pan 0\.600 rad"):
        robot.begin(left_pan_rad=0.6)
    assert [one.q for one in robot.world.servos.values()] == [0.0] * 4


@pytest.mark.slow
def test_a_start_behind_a_forbidden_posture_names_what_is_in_the_way(robot):
    begun_s = robot.clock()
    with pytest.raises(HardwareError, match=r"left_pan: .* 'the bar' is in the way"):
        robot.begin(left_pan_rad=1.0)
    assert robot.clock() - begun_s < 6.0
    assert robot.world.servos["left_pan"].q < 0.5


def test_a_joint_at_its_middle_is_proved_before_it_is_driven_fast(robot):
    robot.begin()
    assert robot.plant.robot.supervisor.proved_joints[3:].all()


def test_an_overload_before_the_start_names_the_joint_and_what_to_do(robot):
    robot.plant.prepare()
    robot.fault(what="overload", ids=[2])
    with pytest.raises(HardwareError, match=r"left_tilt: .* overload: .*; cure: hold the head"):
        robot.begin()


@pytest.mark.slow
def test_beginning_anew_brakes_a_moving_head_first(monkeypatch):
    robot = VirtualRobot(monkeypatch, acceleration_rad_s2=20.0)
    robot.begin()
    fast = np.full((1, 7), -np.inf)
    for _ in range(12):
        robot.plant.step(fast)
    moved, speeds, sleep = robot.world.servos["right_pan"], [], robot.clock.sleep
    robot.plant.robot.drive._sleep = lambda seconds: (
        speeds.append(moved.get(table.GOAL_VELOCITY)) or sleep(seconds)
    )
    robot.begin()
    # to rest in more than one command
    assert speeds[0] < speeds[1] < 0, speeds[:8]
