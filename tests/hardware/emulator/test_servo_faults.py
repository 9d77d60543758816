"""Emulated servos fail as the manual says: limits, shutdown, reboot, delays and rates."""

import pytest

from tests.hardware.emulator.questions import ask, read, turning, write
from tests.hardware.line import make_servo
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    instruction_packet,
)
from vergence.hardware.emulator.servo import EmulatedServo
from vergence.hardware.emulator.world import ServoLine

PING = instruction_packet(1, Instruction.PING)
REBOOT = instruction_packet(1, Instruction.REBOOT)
SYNC_READ = Packet(BROADCAST, Instruction.SYNC_READ, bytes((132, 0, 4, 0, 1, 2)))


def test_each_answer_waits_for_its_servos_return_delay():
    line = ServoLine([EmulatedServo(1, lag_s=0.1), make_servo(2)])
    line.servos[1].set(table.RETURN_DELAY_TIME, 50)
    delays_s = [one.return_delay_s for one in line.answer(SYNC_READ, 0.0)]
    assert delays_s == pytest.approx([500e-6, 100e-6])


def test_a_servo_hears_its_own_rate_alone():
    line = ServoLine([EmulatedServo(1, lag_s=0.1), make_servo(2)])
    assert [one.id for one in line.answer(SYNC_READ, 0.0, 57_600)] == [1]
    assert [one.id for one in line.answer(SYNC_READ, 0.0, 1_000_000)] == [2]
    assert line.answer(SYNC_READ, 0.0, 0) == []


def test_what_a_servo_does_not_hear_does_not_feed_its_watchdog():
    line = turning()
    write(line, 0.0, 1, table.BUS_WATCHDOG, 1)
    line.answer(SYNC_READ, 0.01, 57_600)
    line.advance_to(0.02)
    assert line.watchdog_trips == 1


def test_a_reboot_forgets_the_turns_and_a_position_goal_is_one_within_the_turn():
    line = turning(goal=265, lower=-99.0, upper=99.0)
    before = read(line, 5.0, 1, table.PRESENT_POSITION)
    ask(line, 5.0, REBOOT)
    assert before > 2 * table.TICKS_PER_TURN
    assert read(line, 5.0, 1, table.PRESENT_POSITION) == before % table.TICKS_PER_TURN
    here = read(line, 6.0, 1, table.PRESENT_POSITION)
    write(line, 6.0, 1, table.OPERATING_MODE, table.EXTENDED_POSITION_MODE)
    write(line, 6.0, 1, table.TORQUE_ENABLE, 1)
    write(line, 6.0, 1, table.GOAL_POSITION, here + 50)
    assert read(line, 9.0, 1, table.PRESENT_POSITION) == here + 50


def test_a_joint_without_torque_comes_to_rest_with_its_lag():
    line = turning(goal=100, lower=-9.0, upper=9.0, acceleration=1e9)
    line.advance_to(1.0)
    speed, place = line.velocities()[0], line.positions()[0]
    line.servos[0].set_hardware_errors(1 << 5)
    line.advance_to(2.0)
    assert line.positions()[0] - place == pytest.approx(speed * line.servos[0].lag_s)


def test_what_leaves_its_limits_is_an_error_and_takes_torque_by_the_mask():
    for register, value, bit, torque in (
        (table.PRESENT_TEMPERATURE, 72, 0, 1), (table.PRESENT_TEMPERATURE, 73, 1 << 2, 0),
        (table.PRESENT_INPUT_VOLTAGE, 60, 0, 1), (table.PRESENT_INPUT_VOLTAGE, 59, 1 << 0, 1),
        (table.PRESENT_INPUT_VOLTAGE, 141, 1 << 0, 1),
    ):  # fmt: skip
        line = turning()
        line.servos[0].set(register, value)
        with named(register.name, value):
            assert read(line, 0.1, 1, table.HARDWARE_ERROR_STATUS) == bit
            assert read(line, 0.1, 1, table.TORQUE_ENABLE) == torque
            (status,) = ask(line, 0.1, PING)
            assert (status.alert, status.error) == (bit != 0, 0)


def test_the_mask_of_shutdown_is_the_users():
    line = turning()
    write(line, 0.0, 1, table.TORQUE_ENABLE, 0)
    write(line, 0.0, 1, table.SHUTDOWN, 1)
    write(line, 0.0, 1, table.TORQUE_ENABLE, 1)
    line.servos[0].set(table.PRESENT_TEMPERATURE, 90)
    assert read(line, 0.1, 1, table.TORQUE_ENABLE) == 1
    line.servos[0].set(table.PRESENT_INPUT_VOLTAGE, 50)
    assert read(line, 0.1, 1, table.TORQUE_ENABLE) == 0


def test_torque_comes_back_by_a_reboot_alone_and_not_while_the_servo_is_hot():
    line = turning()
    line.servos[0].set_hardware_errors(1 << 5)
    assert write(line, 0.0, 1, table.TORQUE_ENABLE, 1)[0].error == ErrorNumber.RESULT_FAIL
    ask(line, 0.0, REBOOT)
    assert not ask(line, 0.0, PING)[0].alert
    assert write(line, 0.0, 1, table.TORQUE_ENABLE, 1)[0].error == 0
    line.servos[0].set(table.PRESENT_TEMPERATURE, 90)
    ask(line, 0.0, REBOOT)
    assert read(line, 0.1, 1, table.HARDWARE_ERROR_STATUS) == 1 << 2


def test_a_joint_the_wrong_way_turns_against_its_command():
    right, wrong = turning(), turning()
    wrong.servos[0].goal_scale = -1.0
    for line in (right, wrong):
        line.advance_to(0.1)
    assert wrong.positions() == pytest.approx(-right.positions())
    assert read(wrong, 0.1, 1, table.PRESENT_VELOCITY) < 0


def test_a_frozen_encoder_tells_one_position_while_the_joint_moves():
    line = turning()
    before = read(line, 0.1, 1, table.PRESENT_POSITION)
    line.servos[0].freeze(True)
    assert read(line, 0.3, 1, table.PRESENT_POSITION) == before
    assert read(line, 0.3, 1, table.PRESENT_VELOCITY) == 0
    line.servos[0].freeze(False)
    assert read(line, 0.3, 1, table.PRESENT_POSITION) > before + 100
