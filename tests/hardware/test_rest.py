"""Joints that a goal of zero does not stop: without torque before half a second and half a turn."""

import numpy as np
import pytest

from benchmarks.faults import Mover
from tests.hardware.fakes import HEAD
from tests.hardware.virtual import VirtualRobot
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.emulator.world import World

pytestmark = pytest.mark.slow
BOUND_S, TRAVEL_RAD = 0.5, 0.5


@pytest.fixture
def robot(monkeypatch):
    world = World(HEAD, np.array([0.0, -0.1, 1.0]), EmulatorConfig(friction=0.03))
    return VirtualRobot(monkeypatch, world)


def drive(robot, mover, seconds):
    until_s = robot.clock() + seconds
    while robot.clock() < until_s and not robot.plant.fault:
        robot.plant.step(mover.command(robot.clock()))


def left_pan(robot):
    return robot.world.servos["left_pan"]


def travel_rad(robot, since_s):
    trace = left_pan(robot).trace.samples_since(since_s)
    return max(abs(sample.position_rad - trace[0].position_rad) for sample in trace)


@pytest.mark.parametrize(("what", "seed"), [("blind", 0), ("blind-told", 1), ("inverted", 1)])
def test_a_servo_that_zero_does_not_stop_loses_its_torque(robot, what, seed):
    robot.begin()
    left_pan(robot).set(table.SHUTDOWN, 52)  # from the factory: without the encoder
    mover = Mover(np.random.default_rng(seed))
    drive(robot, mover, 0.4 + 0.3 * seed)
    since_s = robot.clock()
    robot.fault(what=what, ids=[1])
    drive(robot, mover, 3.0)
    assert "left_pan without torque" in robot.plant.fault
    assert robot.registers(table.TORQUE_ENABLE) == [0, 1, 1, 1]
    robot.clock.sleep(1.0)
    assert robot.rested_s(since_s) < BOUND_S
    assert travel_rad(robot, since_s) < TRAVEL_RAD


@pytest.mark.parametrize("what", ["blind", "inverted"])
def test_the_motion_that_proves_joints_finds_a_servo_that_zero_does_not_stop(robot, what):
    robot.plant.prepare()
    robot.fault(what=what, ids=[1])
    since_s = robot.clock()
    with pytest.raises(HardwareError, match="left_pan"):
        robot.begin()
    assert left_pan(robot).get(table.TORQUE_ENABLE) == 0
    assert travel_rad(robot, since_s) < TRAVEL_RAD


def test_closing_reads_rest_before_it_ends(robot):
    robot.begin()
    drive(robot, Mover(np.random.default_rng(1)), 0.6)
    left_pan(robot).inverted = True
    robot.plant.close()
    assert left_pan(robot).get(table.TORQUE_ENABLE) == 0
    robot.clock.sleep(0.5)
    robot.world.advance_to(robot.clock())
    assert abs(left_pan(robot).v) < table.TICK_RAD_S


def test_a_pause_of_this_process_comes_first_in_the_reason(robot):
    robot.begin()
    drive(robot, Mover(np.random.default_rng(2)), 0.5)
    robot.clock.stand_still(1.0)
    drive(robot, Mover(np.random.default_rng(2)), 0.2)
    assert robot.plant.fault.startswith("bus: expected the servos to hear something")
    assert "without torque" not in robot.plant.fault


def test_a_fault_of_a_camera_after_a_pause_names_the_pause_first(robot):
    robot.begin()
    drive(robot, Mover(np.random.default_rng(2)), 0.5)
    robot.clock.now += 0.15  # the watchdog holds
    robot.eyes[0].ended_s = robot.clock()
    drive(robot, Mover(np.random.default_rng(2)), 0.2)
    assert "nothing was sent for 0.1" in robot.plant.fault.partition("after that")[0]
    assert "cameras.left" in robot.plant.fault.partition("after that")[2]
