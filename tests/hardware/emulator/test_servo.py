"""Emulated servos keep the manual's rules and move by the package's joint law."""

from math import exp, log
from unittest.mock import Mock

import numpy as np
import pytest
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler
from hypothesis import given
from hypothesis import strategies as st

from tests.hardware.emulator.asking import ask, read, turning, write
from tests.hardware.line import make_servo
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import TICK_RAD, TICK_RAD_S, VELOCITY_MODE
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    PacketParser,
    instruction_packet,
)
from vergence.hardware.emulator.servo import EmulatedServo, rest_start_s
from vergence.hardware.emulator.world import ServoLine

NOBODY = instruction_packet(100, Instruction.PING)
PING = instruction_packet(1, Instruction.PING)
REBOOT = instruction_packet(1, Instruction.REBOOT)
SYNC_READ = Packet(BROADCAST, Instruction.SYNC_READ, bytes((132, 0, 4, 0, 1, 2)))


def guarded(periods):
    """A line of one servo that turns, with its watchdog on since 0 s."""
    line = turning(lower=-9.0, upper=9.0)
    write(line, 0.0, 1, table.BUS_WATCHDOG, periods)
    return line


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
    late, prompt = guarded(10), guarded(10)
    late.advance_to(2.0)  # in one go, past the instant
    prompt.advance_to(0.2)
    assert prompt.watchdog_trips == late.watchdog_trips == 1
    write(prompt, 0.2, 1, table.GOAL_VELOCITY, 100)
    prompt.advance_to(2.0)
    assert late.velocities() == pytest.approx(0.0, abs=1e-9)
    assert late.positions() == pytest.approx(prompt.positions(), abs=1e-9)


def test_any_packet_on_the_line_feeds_the_watchdog():
    line = guarded(10)
    for now_s in np.arange(0.1, 1.0, 0.1):
        ask(line, now_s, NOBODY)
    assert line.watchdog_trips == 0


def test_a_watchdog_waits_while_torque_is_off():
    line = ServoLine([make_servo(1)])
    write(line, 0.0, 1, table.BUS_WATCHDOG, 1)
    line.advance_to(10.0)
    assert line.watchdog_trips == 0


def test_a_tripped_watchdog_locks_goals_until_it_is_cleared():
    line = guarded(1)
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
        before = bytes(line.servos[0].bytes)
        with named(register.name, value):
            assert write(line, 0.0, 1, register, value)[0].error == error
            assert (bytes(line.servos[0].bytes) == before) == (error != 0)


def test_the_status_return_level_says_what_is_answered():
    line = ServoLine([make_servo(1)])
    questions = [
        PING,
        instruction_packet(1, Instruction.READ, bytes((0, 0, 2, 0))),
        instruction_packet(1, Instruction.WRITE, bytes((65, 0, 1))),
    ]
    for level, answering in ((0, 1), (1, 2), (2, 3)):
        line.servos[0].set(table.STATUS_RETURN_LEVEL, level)
        assert sum(len(ask(line, 0.0, question)) for question in questions) == answering, level


def test_an_unknown_instruction_is_an_error():
    (status,) = ask(turning(), 0.0, instruction_packet(1, 0x44))
    assert status.error == ErrorNumber.INSTRUCTION


def test_a_reboot_keeps_the_eeprom_alone():
    line = turning()
    ask(line, 0.0, REBOOT)
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


def test_answers_of_equal_ids_stay_intact_only_if_they_are_the_same():
    line = ServoLine([make_servo(1), make_servo(1, position_rad=0.5)])
    assert [one.id for one in ask(line, 0.0, PING)] == [1]
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
    line = guarded(1)
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
    line = turning()
    line.servos[0].goal_scale = -1.0
    line.advance_to(0.1)
    assert line.positions()[0] < -0.01
    assert read(line, 0.1, 1, table.PRESENT_VELOCITY) < 0


def test_a_frozen_encoder_tells_one_position_while_the_joint_moves():
    line = turning()
    before = read(line, 0.1, 1, table.PRESENT_POSITION)
    line.servos[0].freeze(True)
    assert read(line, 0.3, 1, table.PRESENT_POSITION) == before
    assert read(line, 0.3, 1, table.PRESENT_VELOCITY) == 0
    line.servos[0].freeze(False)
    assert read(line, 0.3, 1, table.PRESENT_POSITION) > before + 100


LAG_S = 0.03


def spinning(speed_rad_s=0.0, **options):
    goal = round(speed_rad_s / TICK_RAD_S)
    usual = {"lag_s": LAG_S, "acceleration": 80.0, "lower": -99.0, "upper": 99.0}
    return turning(goal, **usual | options).servos[0]


def set_goal(servo, speed_rad_s):
    servo.set(table.GOAL_VELOCITY, round(speed_rad_s / TICK_RAD_S))


def test_without_friction_the_loop_answers_as_the_joint_law():
    law, own = spinning(1.0), spinning(1.0, gravity=1e-9)
    for time_s in (0.02, 0.05, 0.1, 0.3):
        law.advance_to(time_s)
        own.advance_to(time_s)
        # half a step of a Euler integration
        assert own.q == pytest.approx(law.q, abs=1.0 * 5e-4)


def test_friction_holds_a_joint_until_the_integral_breaks_it_away():
    servo = spinning(0.1, friction=0.08)
    servo.advance_to(0.02)
    assert servo.q == 0.0
    servo.advance_to(1.0)
    assert servo.v == pytest.approx(servo.get(table.GOAL_VELOCITY) * TICK_RAD_S, rel=0.02)


def test_gravity_turns_a_joint_without_torque():
    servo = spinning(gravity=0.1)
    servo.advance_to(0.5)
    held = abs(servo.q)
    servo.set(table.TORQUE_ENABLE, 0)
    servo.advance_to(1.0)
    assert held < 0.02
    assert servo.q < -0.05


def test_a_blind_loop_turns_on_at_a_goal_of_zero_until_it_has_no_torque():
    servo = spinning(2.0)
    servo.advance_to(0.2)
    servo.frozen = servo.blind = True
    servo.advance_to(0.4)
    set_goal(servo, 0.0)
    servo.advance_to(2.0)
    assert servo.v > 1.0
    servo._report()
    assert servo.get(table.PRESENT_VELOCITY) == 0
    servo.set(table.TORQUE_ENABLE, 0)
    servo.advance_to(2.5)
    assert servo.v < TICK_RAD_S


def test_an_inverted_motor_runs_away_against_its_goal():
    servo = spinning(0.2)
    servo.inverted = True
    servo.advance_to(0.5)
    assert servo.v < -5.0


def test_a_profile_limits_the_acceleration_in_velocity_mode():
    servo = spinning(3.0)
    servo.set(table.PROFILE_ACCELERATION, 10)  # 3.745 rad/s^2
    servo.advance_to(0.5)
    assert servo.v == pytest.approx(3.745 * (0.5 - LAG_S), rel=0.01)


def stopping():
    """A joint that turns at 1.2 rad/s and is told to stop at 1 s."""
    line = turning(goal=50, lag_s=0.03, acceleration=1e9, lower=-9.0, upper=9.0)
    line.advance_to(1.0)
    write(line, 1.0, 1, table.GOAL_VELOCITY, 0)
    return line


def rest(line, since_s):
    return rest_start_s([servo.trace for servo in line.servos], since_s)


def test_rest_begins_when_the_speed_falls_below_a_step():
    line = stopping()
    line.advance_to(5.0)
    for since_s in (0.5, 1.0):
        assert rest(line, since_s) == pytest.approx(1.0 + 0.03 * log(50), abs=1e-4)
    # what rests already rests since then
    assert rest(line, 3.0) == 3.0


def test_rest_does_not_depend_on_how_often_the_joint_was_looked_at():
    often, once = stopping(), stopping()
    for i in range(100):
        read(often, 1.0 + 0.0007 * i, 1, table.PRESENT_VELOCITY)
    for line in (often, once):
        line.advance_to(2.0)
    assert rest(often, 1.0) == pytest.approx(rest(once, 1.0), abs=1e-4)


def test_a_trace_of_steady_motion_stays_short():
    line = turning(lower=-1e9, upper=1e9)
    for i in range(1000):
        line.advance_to(60.0 + 0.01 * i)
    moments = line.servos[0].trace.samples_since(69.0)
    assert len(moments) < 10
    assert [moment.time_s for moment in (moments[0], moments[-1])] == pytest.approx([69.0, 69.99])


PACKETS = PacketHandler(2.0)


class PatientPort(PortHandler):
    """A port whose answers may take longer than on a wire, on a machine that is busy."""

    def setPacketTimeout(self, packet_length):
        self.setPacketTimeoutMillis(2000.0)


@pytest.fixture
def port(serve):
    port = PatientPort(serve([make_servo(1), make_servo(2, position_rad=0.5)]).port)
    assert port.openPort()
    yield port
    port.closePort()


def test_a_ping_finds_the_model(port):
    assert PACKETS.ping(port, 2) == (1060, COMM_SUCCESS, 0)


def test_bytes_that_look_like_a_header_are_written_and_read(port):
    assert PACKETS.writeTxRx(port, 1, 224, 6, [255, 255, 253, 255, 255, 253])[0] == COMM_SUCCESS
    assert PACKETS.readTxRx(port, 1, 224, 6)[0] == [255, 255, 253, 255, 255, 253]


def test_a_sync_read_brings_each_position(port):
    reader = GroupSyncRead(port, PACKETS, 132, 4)
    for id in (1, 2):
        assert reader.addParam(id)
    assert reader.txRxPacket() == COMM_SUCCESS
    assert [reader.getData(id, 132, 4) for id in (1, 2)] == [2048, 2374]


def test_a_sync_write_reaches_each_servo(port):
    writer = GroupSyncWrite(port, PACKETS, 104, 4)
    for id in (1, 2):
        assert writer.addParam(id, [10 * id, 0, 0, 0])
    assert writer.txPacket() == COMM_SUCCESS
    assert [PACKETS.read4ByteTxRx(port, id, 104)[0] for id in (1, 2)] == [10, 20]


def test_the_eeprom_is_locked_under_torque(port):
    assert PACKETS.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    result, error = PACKETS.write1ByteTxRx(port, 1, 11, VELOCITY_MODE)
    assert result == COMM_SUCCESS
    assert "not available" in PACKETS.getRxPacketError(error)
