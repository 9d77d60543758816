"""Registers that shape motion are set for a run and put back after it, in simulated time."""

import logging

import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.virtual import VirtualRobot
from tests.naming import refused
from vergence.errors import HardwareError, VergenceWarning
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import ErrorNumber
from vergence.hardware.emulator.world import World

FACTORY_SHUTDOWN = 0b110100
CHANGED = (
    (table.PROFILE_ACCELERATION, 20, 0, False), (table.PROFILE_VELOCITY, 30, 0, True),
    (table.GOAL_PWM, 300, 885, False), (table.PWM_LIMIT, 400, 885, True),
    (table.SHUTDOWN, FACTORY_SHUTDOWN, 0b111100, False), (table.SHUTDOWN, 0b000001, 0b101001, True),
)  # fmt: skip
"""A register, its value before and during the run, and whether the servo holds torque before."""
quiet = pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")


@pytest.fixture
def servo(robot):
    return robot.world.servos["left_tilt"]


@pytest.fixture
def factory(servo):
    servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    return servo


def hold(servo):
    """A servo that holds torque in velocity mode, as a stop leaves it."""
    servo.set(table.OPERATING_MODE, table.VELOCITY_MODE)
    servo.set(table.TORQUE_ENABLE, 1)


def watch_writes(servo, monkeypatch, refuse=lambda address: 0):
    """The address and value of what a servo takes, and errors that it gives instead."""
    seen, write = [], servo.write

    def watched(address, data):
        if not (error := refuse(address) or write(address, data)):
            seen.append((address, int.from_bytes(data, "little")))
        return error

    monkeypatch.setattr(servo, "write", watched)
    return seen


def refusal(error, register=table.SHUTDOWN):
    return lambda address: error if address == register.address else 0


@pytest.mark.parametrize(("register", "old", "new", "torque"), CHANGED)
def test_a_register_that_shapes_motion_is_set_and_said(
    robot, servo, register, old, new, torque, caplog
):
    servo.set(register, old)
    if torque:
        hold(servo)
    caplog.set_level(logging.INFO, "vergence.hardware.dynamixel.servos")
    said = f"left_tilt: expected {new} in {register.name}, got {old}, which is"
    with pytest.warns(VergenceWarning, match=said):
        robot.begin()
    assert servo.get(register) == new
    assert servo.get(table.TORQUE_ENABLE) == 1
    lines = [one for one in caplog.records if one.name.endswith("dynamixel.servos")]
    assert [register.name in one.message for one in lines if "expected" in one.message] == [True]
    robot.plant.close()
    # the RAM forgets by itself
    assert servo.get(register) == (old if register.address < table.EEPROM_END else new)


@quiet
def test_torque_is_off_for_one_write_alone_as_the_eeprom_is_put_back(robot, factory, monkeypatch):
    robot.begin()
    seen = watch_writes(factory, monkeypatch)
    robot.plant.close()
    torque, shutdown = table.TORQUE_ENABLE.address, table.SHUTDOWN.address
    assert [one for one in seen if one[0] <= torque] == [
        (torque, 0), (shutdown, FACTORY_SHUTDOWN), (torque, 1),
    ]  # fmt: skip
    assert (factory.get(table.TORQUE_ENABLE), factory.get(table.GOAL_VELOCITY)) == (1, 0)


def test_an_eeprom_that_cannot_be_put_back_is_said_and_torque_is_on_again(
    robot, factory, monkeypatch
):
    with pytest.warns(VergenceWarning, match="in SHUTDOWN, got 52"):
        robot.begin()
    watch_writes(factory, monkeypatch, refusal(ErrorNumber.ACCESS))
    said = "left_tilt: expected to put back SHUTDOWN 52 at the end, got id 2"
    with pytest.warns(VergenceWarning, match=said):
        robot.plant.close()
    assert (factory.get(table.SHUTDOWN), factory.get(table.TORQUE_ENABLE)) == (0b111100, 1)


@quiet
def test_what_was_changed_is_put_back_if_another_servo_ends_the_start(robot, servo, monkeypatch):
    first = robot.world.servos["left_pan"]
    first.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    changed = watch_writes(first, monkeypatch)
    watch_writes(servo, monkeypatch, lambda _address: ErrorNumber.RESULT_FAIL)
    refused("servos: left_tilt: id 2", robot.begin, error=HardwareError)
    robot.plant.close()
    assert (table.SHUTDOWN.address, 0b111100) in changed
    assert first.get(table.SHUTDOWN) == FACTORY_SHUTDOWN


def test_a_joint_that_moves_does_not_lose_its_torque(robot, factory):
    hold(factory)
    factory.set(table.GOAL_VELOCITY, 9)
    factory.blind = True  # it turns on at a goal of zero
    factory.v = 9 * table.TICK_RAD_S
    refused("left_tilt: expected a joint at rest", robot.begin, error=HardwareError)
    assert (factory.get(table.SHUTDOWN), factory.get(table.TORQUE_ENABLE)) == (FACTORY_SHUTDOWN, 1)


def test_a_servo_that_refuses_a_setting_runs_and_is_told_of(robot, factory, monkeypatch):
    watch_writes(factory, monkeypatch, refusal(ErrorNumber.DATA_RANGE))
    with pytest.warns(VergenceWarning, match="got 52, which the servo refuses to change to 60"):
        robot.begin()
    robot.plant.close()
    assert factory.get(table.SHUTDOWN) == FACTORY_SHUTDOWN


def test_servos_that_are_only_read_keep_their_settings(robot, servo):
    for register, old, *_ in CHANGED[:5]:
        servo.set(register, old)
    robot.plant.prepare()
    robot.plant.close()
    for register, old, *_ in CHANGED[:5]:
        assert servo.get(register) == old, register.name


def test_a_slow_eeprom_is_waited_for(robot):
    for servo in robot.world.servos.values():
        servo.set(table.OPERATING_MODE, table.POSITION_MODE)
        servo.eeprom_write_s = 0.06
    robot.begin()
    assert robot.registers(table.OPERATING_MODE) == [table.VELOCITY_MODE] * 4
    assert robot.plant.diagnostics()["missed_answers"] == 0


@pytest.mark.slow
@quiet
def test_lost_packets_do_not_end_a_start(monkeypatch):
    robot = VirtualRobot(monkeypatch, World(HEAD, np.array([0.0, -0.1, 1.0]), seed=1))
    robot.fault(what="lost", probability=0.05)
    for servo in robot.world.servos.values():
        servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    robot.begin()
    assert robot.plant.diagnostics()["missed_answers"] > 0
    robot.plant.close()
    assert robot.registers(table.SHUTDOWN) == [FACTORY_SHUTDOWN] * 4


@pytest.mark.parametrize("before_prepare", [True, False])
def test_a_watchdog_that_needs_a_torque_cycle_gets_one_and_is_off_in_the_end(
    robot, servo, before_prepare
):
    servo.trip_needs_torque_cycle = True
    if before_prepare:
        hold(servo)
    else:
        robot.begin()
        robot.plant.close()
    servo._trip()
    robot.begin()
    assert servo.get(table.TORQUE_ENABLE) == 1
    robot.step([0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0], count=10)
    assert robot.plant.fault == ""
    assert servo.v > 0.1
    servo._trip()
    robot.plant.close()
    assert (servo.get(table.TORQUE_ENABLE), servo.get(table.BUS_WATCHDOG)) == (1, 0)
    assert not servo._tripped
