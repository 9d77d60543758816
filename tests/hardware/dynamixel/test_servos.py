"""Registers that shape motion are set for a run and put back after it, in simulated time."""

import logging

import numpy as np
import pytest

from vergence.errors import HardwareError, VergenceWarning
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import ErrorNumber

FACTORY_SHUTDOWN = 0b110100
CHANGED = (
    (table.PROFILE_ACCELERATION, 20, 0, False), (table.PROFILE_VELOCITY, 30, 0, True),
    (table.GOAL_PWM, 300, 885, False), (table.PWM_LIMIT, 400, 885, True),
    (table.SHUTDOWN, FACTORY_SHUTDOWN, 0b111100, False), (table.SHUTDOWN, 0b000001, 0b101001, True),
)  # fmt: skip
"""A register, its value before and during the run, and whether the servo holds torque before."""


def second(robot):
    return robot.world.servos["left_tilt"]


def hold(servo):
    """A servo that holds torque in velocity mode, as a stop leaves it."""
    servo.set(table.OPERATING_MODE, table.VELOCITY_MODE)
    servo.set(table.TORQUE_ENABLE, 1)


def refuse_shutdown(servo, monkeypatch, error):
    """Let a servo answer to writes of its SHUTDOWN with an error."""
    write, place = servo.write, table.SHUTDOWN.address
    monkeypatch.setattr(
        servo, "write", lambda address, data: error if address == place else write(address, data)
    )


def torque_writes(servo, monkeypatch):
    seen, write = [], servo.write

    def watched(address, data):
        error = write(address, data)
        if address <= table.TORQUE_ENABLE.address and not error:
            seen.append((address, int.from_bytes(data, "little")))
        return error

    monkeypatch.setattr(servo, "write", watched)
    return seen


@pytest.mark.parametrize(("register", "old", "new", "torque"), CHANGED)
def test_a_register_that_shapes_motion_is_set_and_said(robot, register, old, new, torque, caplog):
    servo = second(robot)
    servo.set(register, old)
    if torque:
        hold(servo)
    caplog.set_level(logging.INFO, "vergence.hardware.dynamixel.servos")
    said = f"left_tilt: expected {new} in {register.name}, got {old}, which is"
    with pytest.warns(VergenceWarning, match=said):
        robot.begin()
    assert servo.get(register) == new
    assert servo.get(table.TORQUE_ENABLE) == 1
    said = [
        one.message
        for one in caplog.records
        if one.name.endswith("dynamixel.servos") and "expected" in one.message
    ]
    assert [register.name in line for line in said] == [True]
    robot.plant.close()
    # the RAM forgets by itself
    assert servo.get(register) == (old if register.address < table.EEPROM_END else new)


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_torque_is_off_for_one_write_alone_as_the_eeprom_is_put_back(robot, monkeypatch):
    servo = second(robot)
    servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    robot.begin()
    seen = torque_writes(servo, monkeypatch)
    robot.plant.close()
    torque, shutdown = table.TORQUE_ENABLE.address, table.SHUTDOWN.address
    assert seen == [(torque, 0), (shutdown, FACTORY_SHUTDOWN), (torque, 1)]
    assert (servo.get(table.TORQUE_ENABLE), servo.get(table.GOAL_VELOCITY)) == (1, 0)


def test_an_eeprom_that_cannot_be_put_back_is_said_and_torque_is_on_again(robot, monkeypatch):
    servo = second(robot)
    servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    with pytest.warns(VergenceWarning, match="in SHUTDOWN, got 52"):
        robot.begin()
    refuse_shutdown(servo, monkeypatch, ErrorNumber.ACCESS)
    said = "left_tilt: expected to put back SHUTDOWN 52 at the end, got id 2"
    with pytest.warns(VergenceWarning, match=said):
        robot.plant.close()
    assert (servo.get(table.SHUTDOWN), servo.get(table.TORQUE_ENABLE)) == (0b111100, 1)


@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_what_was_changed_is_put_back_if_another_servo_ends_the_start(robot, monkeypatch):
    first, servo = robot.world.servos["left_pan"], second(robot)
    first.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    monkeypatch.setattr(servo, "write", lambda _address, _data: ErrorNumber.RESULT_FAIL)
    with pytest.raises(HardwareError, match="servos: left_tilt: id 2"):
        robot.begin()
    robot.plant.close()
    assert first.get(table.SHUTDOWN) == FACTORY_SHUTDOWN


def test_a_joint_that_moves_does_not_lose_its_torque(robot, monkeypatch):
    servo = second(robot)
    servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    hold(servo)
    report = servo._report

    def moving():
        report()
        servo.set(table.PRESENT_VELOCITY, 9)

    monkeypatch.setattr(servo, "_report", moving)
    with pytest.raises(HardwareError, match="left_tilt: expected a joint at rest"):
        robot.begin()
    assert (servo.get(table.SHUTDOWN), servo.get(table.TORQUE_ENABLE)) == (FACTORY_SHUTDOWN, 1)


def test_a_servo_that_refuses_a_setting_runs_and_is_told_of(robot, monkeypatch):
    servo = second(robot)
    servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    refuse_shutdown(servo, monkeypatch, ErrorNumber.DATA_RANGE)
    with pytest.warns(VergenceWarning, match="got 52, which the servo refuses to change to 60"):
        robot.begin()
    robot.plant.close()
    assert servo.get(table.SHUTDOWN) == FACTORY_SHUTDOWN


def test_servos_that_are_only_read_keep_their_settings(robot):
    for register, old, *_ in CHANGED[:5]:
        second(robot).set(register, old)
    robot.plant.prepare()
    robot.plant.close()
    for register, old, *_ in CHANGED[:5]:
        assert second(robot).get(register) == old, register.name


def test_a_slow_eeprom_is_waited_for(robot):
    for servo in robot.world.servos.values():
        servo.set(table.OPERATING_MODE, table.POSITION_MODE)
        servo.eeprom_write_s = 0.06
    robot.begin()
    assert robot.registers(table.OPERATING_MODE) == [table.VELOCITY_MODE] * 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::vergence.errors.VergenceWarning")
def test_lost_packets_do_not_end_a_start(robot):
    robot.world._rng = np.random.default_rng(1)
    robot.fault(what="lost", probability=0.05)
    for servo in robot.world.servos.values():
        servo.set(table.SHUTDOWN, FACTORY_SHUTDOWN)
    robot.begin()
    assert robot.plant.diagnostics()["missed_answers"] > 0
    robot.plant.close()
    assert robot.registers(table.SHUTDOWN) == [FACTORY_SHUTDOWN] * 4


@pytest.mark.parametrize("before_prepare", [True, False])
def test_a_watchdog_that_needs_a_torque_cycle_gets_one_and_is_off_in_the_end(robot, before_prepare):
    servo = second(robot)
    servo.trip_needs_torque_cycle = True
    if before_prepare:
        hold(servo)
    else:
        robot.begin()
        robot.plant.close()
    servo._trip()
    robot.begin()
    assert servo.get(table.TORQUE_ENABLE) == 1
    speed = np.zeros((1, 7))
    speed[0, 4] = 0.5
    for _ in range(10):
        robot.plant.step(speed)
    assert robot.plant.fault == ""
    assert servo.v > 0.1
    servo._trip()
    robot.plant.close()
    assert (servo.get(table.TORQUE_ENABLE), servo.get(table.BUS_WATCHDOG)) == (1, 0)
    assert not servo._tripped
