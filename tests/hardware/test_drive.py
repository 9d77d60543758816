"""The thread that speaks for a policy that pauses, on a robot in simulated time."""

import time
from unittest.mock import Mock

import numpy as np
import pytest

from tests.hardware.virtual import LIMIT_RAD, VirtualRobot
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table

FAST = np.full((1, 7), 2.0)


@pytest.fixture
def robot(monkeypatch):
    one = VirtualRobot(monkeypatch)
    one.begin()
    for _ in range(20):
        one.plant.step(FAST)
    return one


def goals(robot):
    return robot.registers(table.GOAL_VELOCITY)


def test_a_command_is_repeated_for_two_periods_more_and_then_the_joints_are_braked(robot):
    turning = goals(robot)
    period_s = robot.plant.head.timing.period_s
    robot.clock.sleep(1.9 * period_s)
    assert np.abs(np.subtract(goals(robot), turning)).max() <= 1  # carried over
    robot.clock.sleep(4.0 * period_s)
    assert goals(robot) == [0] * 4


def test_a_policy_that_comes_back_in_time_goes_on_a_period_after_what_was_said_for_it(robot):
    drive, period_s = robot.plant.robot.drive, robot.plant.head.timing.period_s
    robot.clock.sleep(period_s)
    repeated_s = drive._repeated_s
    robot.plant.step(FAST)
    assert robot.plant.fault == ""
    assert drive._requested_s == pytest.approx(repeated_s + period_s)


@pytest.mark.parametrize("error", [HardwareError("nobody answers"), RuntimeError("a mistake")])
def test_what_goes_wrong_meanwhile_stops_the_head_and_not_the_thread(robot, monkeypatch, error):
    with monkeypatch.context() as broken:
        broken.setattr(robot.plant.robot.drive._servos, "read", Mock(side_effect=error))
        robot.clock.sleep(0.2)
    assert robot.plant.fault == str(error)
    assert goals(robot) == [0] * 4
    robot.plant.step(FAST)  # says so once
    with pytest.raises(HardwareError, match="release it first"):
        robot.plant.step(FAST)


def test_the_thread_ends_with_the_drive(robot):
    drive = robot.plant.robot.drive
    super(type(drive), drive).start()  # in real time: it has nothing to say, as all is at rest
    robot.plant.step(0.0 * FAST)
    robot.plant.close()
    time.sleep(0.01)
    assert not drive.is_alive()


@pytest.mark.slow
def test_a_process_that_stands_still_leads_no_joint_beyond_its_limit(monkeypatch):
    for steps in (4, 25):
        robot = VirtualRobot(monkeypatch)
        robot.begin()
        for _ in range(steps):
            robot.plant.step(np.full((1, 7), np.inf))
        robot.clock.stand_still(1.0)
        robot.world.advance_to(robot.clock())
        assert 0.3 < max(one.q for one in robot.world.servos.values()) < LIMIT_RAD, steps


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lost", "silent", "unplug", "stuck"])
def test_a_fault_of_the_line_leads_no_joint_beyond_its_limit(monkeypatch, what):
    robot = VirtualRobot(monkeypatch)
    robot.begin()
    fast = np.full((1, 7), np.inf)
    for _ in range(20):
        robot.plant.step(fast)
    robot.fault(what=what) if what in ("lost", "unplug") else robot.fault(what=what, ids=[1])
    while not robot.plant.fault:
        robot.plant.step(fast)
    robot.clock.sleep(0.5)
    robot.world.advance_to(robot.clock())
    assert max(one.q for one in robot.world.servos.values()) < LIMIT_RAD


def test_who_has_not_begun_a_trial_may_not_step(monkeypatch):
    robot = VirtualRobot(monkeypatch)
    robot.begin()
    interrupt = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr(robot.plant.robot.drive._servos, "switch_on", interrupt)
    with pytest.raises(KeyboardInterrupt):
        robot.begin()
    with pytest.raises(HardwareError, match="expected a reset first"):
        robot.plant.step(FAST)


def test_a_child_process_leaves_the_servos_to_its_parent(robot, monkeypatch):
    watchdogs = robot.registers(table.BUS_WATCHDOG)
    drive = robot.plant.robot.drive
    with monkeypatch.context() as child:
        child.setattr(drive, "_pid", -1)
        with pytest.raises(HardwareError, match="expected a reset first"):
            drive.send(FAST[0])
        robot.plant.close()
    assert robot.registers(table.BUS_WATCHDOG) == watchdogs


def test_a_servo_that_does_not_confirm_to_be_at_rest_keeps_its_watchdog(robot):
    robot.fault(what="lost", ids=[2])
    robot.plant.robot.close()
    assert [watchdog > 0 for watchdog in robot.registers(table.BUS_WATCHDOG)] == [0, 1, 0, 0]


@pytest.mark.slow
def test_a_command_that_is_held_back_is_not_repeated_either(monkeypatch):
    robot = VirtualRobot(monkeypatch, search=True, overruns=1.0)
    robot.begin()
    monkeypatch.setattr(robot.eyes[0], "take_searched_images", list)
    monkeypatch.setattr(robot.eyes[1], "take_searched_images", list)
    robot.plant.reading.visible[:] = False
    fastest = []
    for _ in range(60):
        robot.plant.step(3.0 * FAST)
        robot.clock.sleep(0.03)
        fastest.append(np.abs(goals(robot)).max() * table.TICK_RAD_S)
    # the policy drives until the target counts as lost; then the spiral of the search does
    assert max(fastest[:10]) > 2.0
    assert 0.0 < max(fastest[30:]) < 1.0
