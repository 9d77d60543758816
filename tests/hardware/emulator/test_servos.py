"""Emulated servos keep the manual's rules and move by the package's joint law."""

from math import exp
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.hardware.emulator.questions import ask, read, turning, write
from tests.hardware.line import make_servo
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import TICK_RAD, TICK_RAD_S
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    PacketParser,
    instruction_packet,
)
from vergence.hardware.emulator.world import ServoLine

NOBODY = instruction_packet(100, Instruction.PING)


def test_a_joint_follows_its_velocity_goal_with_its_lag():
    line = turning(lag_s=0.1, acceleration=1e9)
    line.advance_to(0.1)
    assert line.velocities() == pytest.approx(100 * TICK_RAD_S * (1 - exp(-1)), rel=1e-9)


def test_a_joint_comes_to_its_position_goal():
    line = turning(mode=table.POSITION_MODE, position_rad=0.25)
    line.advance_to(1.0)
    assert line.positions() == pytest.approx(0.25, abs=TICK_RAD)  # torque alone moves nothing
    assert write(line, 1.0, 1, table.GOAL_POSITION, 4096)[0].error == ErrorNumber.DATA_LIMIT
    write(line, 1.0, 1, table.GOAL_POSITION, 2348)
    assert read(line, 4.0, 1, table.PRESENT_POSITION) == 2348


def test_a_joint_stops_at_its_end_stop():
    line = turning(upper=0.3)
    line.advance_to(2.0)
    assert (line.positions()[0], line.velocities()[0]) == (0.3, 0.0)


def test_angles_are_the_joints_whatever_the_gear():
    line = turning(sign=-1, zero_ticks=1000, gear_ratio=2.0, position_rad=0.25, lower=-9.0)
    assert read(line, 0.0, 1, table.PRESENT_POSITION) == round(1000 - 0.5 / TICK_RAD)
    line.advance_to(1.0)
    assert line.velocities() == pytest.approx(-100 * TICK_RAD_S / 2)
    assert read(line, 1.0, 1, table.PRESENT_VELOCITY) == 100


def test_the_reported_velocity_lags_by_its_filter():
    line = turning(lag_s=1e-6, acceleration=1e12, speed_filter_s=0.1)
    assert read(line, 0.1, 1, table.PRESENT_VELOCITY) == round(100 * (1 - exp(-1)))


def test_the_watchdog_stops_a_servo_at_its_own_instant():
    late, prompt = (turning(lower=-9.0, upper=9.0) for _ in range(2))
    for line in (late, prompt):
        write(line, 0.0, 1, table.BUS_WATCHDOG, 10)
    late.advance_to(2.0)  # in one go, past the instant
    prompt.advance_to(0.2)
    assert prompt.watchdog_trips == late.watchdog_trips == 1
    write(prompt, 0.2, 1, table.GOAL_VELOCITY, 100)
    prompt.advance_to(2.0)
    assert late.velocities() == pytest.approx(0.0, abs=1e-9)
    assert late.positions() == pytest.approx(prompt.positions(), abs=1e-9)


def test_any_packet_on_the_line_feeds_the_watchdog():
    line = turning(lower=-9.0, upper=9.0)
    write(line, 0.0, 1, table.BUS_WATCHDOG, 10)
    for now_s in np.arange(0.1, 1.0, 0.1):
        ask(line, now_s, NOBODY)
    assert line.watchdog_trips == 0


def test_a_watchdog_waits_while_torque_is_off():
    line = ServoLine([make_servo(1)])
    write(line, 0.0, 1, table.BUS_WATCHDOG, 1)
    line.advance_to(10.0)
    assert line.watchdog_trips == 0


def test_a_tripped_watchdog_locks_goals_until_it_is_cleared():
    line = turning()
    write(line, 0.0, 1, table.BUS_WATCHDOG, 1)
    line.advance_to(0.1)
    assert read(line, 0.1, 1, table.BUS_WATCHDOG) == table.WATCHDOG_TRIPPED
    assert read(line, 0.1, 1, table.GOAL_VELOCITY) == 0
    assert write(line, 0.1, 1, table.GOAL_VELOCITY, 5)[0].error == ErrorNumber.DATA_RANGE
    assert write(line, 0.1, 1, table.BUS_WATCHDOG, 0)[0].error == 0
    assert write(line, 0.1, 1, table.GOAL_VELOCITY, 5)[0].error == 0


def test_writes_under_torque_are_checked():
    for register, value, error in (
        (table.OPERATING_MODE, 1, ErrorNumber.ACCESS),
        (table.PRESENT_POSITION, 0, ErrorNumber.ACCESS),
        (table.HARDWARE_ERROR_STATUS, 0, ErrorNumber.ACCESS), (table.GOAL_VELOCITY, 265, 0),
        (table.GOAL_VELOCITY, -266, ErrorNumber.DATA_LIMIT),
        (table.TORQUE_ENABLE, 2, ErrorNumber.DATA_RANGE),
        (table.BUS_WATCHDOG, -1, ErrorNumber.DATA_RANGE),
        (table.GOAL_VELOCITY._replace(length=2), 1, ErrorNumber.DATA_LENGTH),
        (table.Register("BEHIND", 660, 2), 0, ErrorNumber.DATA_RANGE),
    ):  # fmt: skip
        line = turning()
        before = bytes(line.servos[0].memory.bytes)
        with named(register.name, value):
            assert write(line, 0.0, 1, register, value)[0].error == error
            assert (bytes(line.servos[0].memory.bytes) == before) == (error != 0)


def test_the_status_return_level_says_what_is_answered():
    line = ServoLine([make_servo(1)])
    questions = [
        instruction_packet(1, Instruction.PING),
        instruction_packet(1, Instruction.READ, bytes((0, 0, 2, 0))),
        instruction_packet(1, Instruction.WRITE, bytes((65, 0, 1))),
    ]
    for level, answering in ((0, 1), (1, 2), (2, 3)):
        line.servos[0].set(table.STATUS_RETURN_LEVEL, level)
        assert sum(len(ask(line, 0.0, question)) for question in questions) == answering, level


def test_an_unknown_instruction_is_an_error():
    line = ServoLine([make_servo(1)])
    (status,) = ask(line, 0.0, instruction_packet(1, 0x44))
    assert status.error == ErrorNumber.INSTRUCTION


def test_a_reboot_keeps_the_eeprom_alone():
    line = turning()
    ask(line, 0.0, instruction_packet(1, Instruction.REBOOT))
    servo = line.servos[0]
    assert servo.get(table.OPERATING_MODE) == table.VELOCITY_MODE
    assert servo.get(table.TORQUE_ENABLE) == servo.get(table.GOAL_VELOCITY) == 0


@given(
    id=st.sampled_from([1, 2, BROADCAST]),
    instruction=st.sampled_from(list(Instruction)) | st.integers(0, 255),
    params=st.binary(max_size=24),
)
def test_no_packet_is_too_odd_to_answer(id, instruction, params):
    line = turning()
    answers = line.answer(Packet(id, instruction, params), 0.0)
    line.advance_to(0.01)
    assert all(PacketParser().feed(answer.data) for answer in answers)


@pytest.mark.parametrize(("goal", "stops"), [(0, 1.0), (100, 1.0), (100, 1e9)])
def test_a_pause_of_an_hour_takes_few_steps(goal, stops, monkeypatch):
    line = turning(goal, lower=-stops, upper=stops, speed_filter_s=0.05)
    step = Mock(side_effect=line.servos[0]._step)
    monkeypatch.setattr(line.servos[0], "_step", step)
    line.advance_to(3600.0)
    assert step.call_count < 2000
    expected = 3600.0 * goal * TICK_RAD_S if stops > 1.0 else min(goal, 1.0)
    assert line.positions() == pytest.approx(expected, rel=1e-4)


def test_time_that_goes_back_changes_nothing():
    line = turning()
    line.advance_to(0.1)
    before = line.positions()
    line.advance_to(0.05)
    assert line.positions() == before


def test_answers_of_equal_ids_stay_intact_only_if_they_are_the_same():
    line = ServoLine([make_servo(1), make_servo(1, position_rad=0.5)])
    assert [one.id for one in ask(line, 0.0, instruction_packet(1, Instruction.PING))] == [1]
    place = table.PRESENT_POSITION
    span = bytes((place.address, 0, place.length, 0))
    assert [one.id for one in line.answer(Packet(1, Instruction.READ, span), 0.0)] == [1]
    assert ask(line, 0.0, instruction_packet(1, Instruction.READ, span)) == []
    sync = instruction_packet(BROADCAST, Instruction.SYNC_READ, span + bytes((1,)))
    assert ask(line, 0.0, sync) == []


def test_a_servo_obeys_its_secondary_id_without_an_answer():
    line = ServoLine([make_servo(1), make_servo(2)])
    line.servos[1].set(table.SECONDARY_ID, 1)
    assert [one.id for one in write(line, 0.0, 1, table.PROFILE_VELOCITY, 7)] == [1]
    assert line.servos[1].get(table.PROFILE_VELOCITY) == 7
    assert read(line, 0.0, 2, table.PROFILE_VELOCITY) == 7
