"""The thread that speaks for a policy that pauses, on a robot in simulated time."""

import time

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.world import World

FAST = np.full((1, 7), 2.0)


@pytest.fixture
def robot(monkeypatch):
    """A robot whose joints all turn at 2 rad/s."""
    one = VirtualRobot(monkeypatch)
    one.begin()
    for _ in range(20):
        one.plant.step(FAST)
    return one


def goals(world: World) -> list[int]:
    return [one.get(table.GOAL_VELOCITY) for one in world.servos.values()]


def test_a_wish_is_kept_for_two_periods_more_and_then_the_joints_are_braked(robot):
    turning = goals(robot.world)
    period_s = robot.plant.head.timing.period_s
    robot.clock.sleep(1.9 * period_s)
    assert np.abs(np.subtract(goals(robot.world), turning)).max() <= 1  # carried over
    robot.clock.sleep(4.0 * period_s)
    assert goals(robot.world) == [0] * 4


def test_a_policy_that_comes_back_in_time_goes_on_a_period_after_what_was_said_for_it(robot):
    drive, period_s = robot.plant._open.drive, robot.plant.head.timing.period_s
    robot.clock.sleep(period_s)
    kept_s = drive._kept_s
    robot.plant.step(FAST)
    assert robot.plant.fault == ""
    assert drive._wished_s == pytest.approx(kept_s + period_s)


@pytest.mark.parametrize("error", [HardwareError("nobody answers"), RuntimeError("a mistake")])
def test_what_goes_wrong_meanwhile_stops_the_head_and_not_the_thread(robot, monkeypatch, error):
    def fail():
        raise error

    with monkeypatch.context() as broken:
        broken.setattr(robot.plant._open.drive._line, "sense", fail)
        robot.clock.sleep(0.2)
    assert robot.plant.fault == str(error)
    assert goals(robot.world) == [0] * 4
    robot.plant.step(FAST)  # says so once
    with pytest.raises(HardwareError, match="release it first"):
        robot.plant.step(FAST)


def test_the_thread_ends_with_the_drive(robot):
    drive = robot.plant._open.drive
    super(type(drive), drive).start()  # in real time: it has nothing to say, as all is at rest
    robot.plant.step(0.0 * FAST)
    robot.plant.close()
    time.sleep(0.01)
    assert not drive.is_alive()
