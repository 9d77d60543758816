"""The bus keeps what answers its question, and says what is wrong, on a real pseudo-terminal."""

import os
import select
import sys

import pytest

from tests.hardware.line import make_servo
from tests.naming import refused
from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import REQUESTS, Bus
from vergence.hardware.dynamixel.packets import Instruction, status_packet

# A thread that serves may be late on a machine that is busy: only what waits in vain waits briefly.
PATIENT = {"cycle_timeout_s": 2.0, "single_timeout_s": 2.0}
BRIEF = {"cycle_timeout_s": 0.02, "single_timeout_s": 0.02}


@pytest.fixture
def connect():
    buses = []

    def open_bus(served, **options):
        buses.append(Bus(served.port, **{**PATIENT, **options}))
        return buses[-1]

    yield open_bus
    for bus in buses:
        bus.close()


def test_what_is_written_is_read(serve, connect):
    bus = connect(serve([make_servo(1)]))
    bus.write(1, table.HOMING_OFFSET, -12)
    assert bus.read(1, table.HOMING_OFFSET) == -12
    refused("TORQUE_ENABLE: expected 0 to 255, got 256", bus.write, 1, table.TORQUE_ENABLE, 256)


@pytest.mark.slow
def test_a_sync_read_keeps_those_that_answer(serve, connect):
    servos = [make_servo(id, position_rad=0.1 * id) for id in (1, 2, 3)]
    servos[1].silent = True
    bus = connect(serve(servos), cycle_timeout_s=0.2)
    found = bus.sync_read([1, 2, 3, 3], table.PRESENT_POSITION.address, 4)
    ticks = {id: table.PRESENT_POSITION.decode(data) for id, data in found.items()}
    assert ticks == {1: 2113, 3: 2244}
    assert bus.missed_answers == 1
    assert bus.sync_read([1], 660, 4) == {}  # it refuses
    assert bus.missed_answers == 2


def test_a_sync_read_waits_for_the_answers_of_all_on_the_line(serve, connect, monkeypatch):
    bus, sizes = connect(serve([make_servo(1)]), **BRIEF), []
    monkeypatch.setattr(bus.line, "wire_s", lambda size: sizes.append(size) or 0.0)
    for ids in ([1], [1, 2, 3]):
        bus.sync_read(ids, table.PRESENT_POSITION.address, 4)
    assert sizes[1] - sizes[0] == 2 * (1 + 11 + 4)  # an id asked, and a packet with four bytes


def test_a_servo_that_is_silent_is_named(serve, connect):
    served = serve([make_servo(1)])
    bus = connect(served, **BRIEF)
    assert bus.ping(4) is None
    expected = f"id 4 on {served.port}: expected an answer to a read of MODEL_NUMBER within 20 ms"
    refused(f"^{expected}, got none$", bus.read, 4, table.MODEL_NUMBER, error=HardwareError)
    assert bus.missed_answers == REQUESTS


def test_an_answer_that_came_late_is_not_taken_for_the_next(serve, connect):
    served = serve([make_servo(1)])
    bus = connect(served)
    late = status_packet(1, bytes((99, 0)))  # as long as the answer to come
    for part in (late, late[:8]):
        served.send(part)
        assert select.select([bus.line._serial.fd], [], [], 5.0)[0]
        assert bus.read(1, table.MODEL_NUMBER) == 1060
    assert bus.stale.total() == 1


def test_an_answer_of_another_servo_or_length_is_passed_over(serve, connect):
    other, wrong = status_packet(2, bytes((99, 0))), status_packet(1, bytes(4))
    later = status_packet(1, bytes((99, 0)))
    line = serve([make_servo(1)], alter=lambda _packet, answers: other + wrong + answers + later)
    bus = connect(line)
    assert bus.read(1, table.MODEL_NUMBER) == 1060
    assert bus.stale[2] == 1
    line.alter, bus.single_timeout_s = lambda _packet, _answers: wrong, 0.02
    refused("got one of 4 bytes, not 2", bus.read, 1, table.MODEL_NUMBER, error=HardwareError)


def test_echoes_are_no_answers(serve, connect):
    bus = connect(serve([make_servo(1), make_servo(2)], echo=True))
    bus.sync_write(table.GOAL_VELOCITY, {1: 3, 2: 4})
    assert bus.read(2, table.GOAL_VELOCITY) == 4
    assert bus.sync_read([1, 2], table.GOAL_VELOCITY.address, 4).keys() == {1, 2}
    assert (bus.stale.total(), bus.missed_answers) == (0, 0)


def test_a_refusal_is_told_in_words(serve, connect):
    bus = connect(serve([make_servo(1)]))
    bus.write(1, table.TORQUE_ENABLE, 1)
    with pytest.raises(HardwareError, match=r"a write of 1 to OPERATING_MODE, got error 7 \(.*tor"):
        bus.write(1, table.OPERATING_MODE, 1)


def test_an_alert_is_no_error_and_kept_until_an_answer_without_it(serve, connect):
    servo = make_servo(1)
    servo.set_hardware_errors(32)
    bus = connect(serve([servo, make_servo(2)]))
    bus.write(1, table.TORQUE_ENABLE, 0)
    bus.write(2, table.TORQUE_ENABLE, 0)
    assert bus.alerts == {1}
    servo.set(table.HARDWARE_ERROR_STATUS, 0)
    bus.ping(1)
    assert bus.alerts == set()


def test_a_line_that_is_gone_is_an_error(serve, connect):
    served = serve([make_servo(1)])
    bus = connect(served)
    served.hang_up()
    for ask in (
        lambda: bus.read(1, table.MODEL_NUMBER),
        lambda: bus.sync_read([1], table.PRESENT_POSITION.address, 4),
        lambda: bus.sync_write(table.GOAL_VELOCITY, {1: 0}),
    ):
        refused("the serial line is gone", ask, error=HardwareError)


def test_a_line_that_goes_while_an_answer_is_awaited_is_an_error(serve, connect):
    served = serve([make_servo(1)])

    def pull(packet, _answers):
        os.close(served._master)
        served._master = os.open(os.devnull, os.O_RDWR)
        return b""

    served.alter = pull
    bus = connect(served)
    refused("the serial line is gone", bus.read, 1, table.MODEL_NUMBER, error=HardwareError)


def test_a_closed_bus_says_so(serve, connect):
    bus = connect(serve([make_servo(1)]))
    bus.close()
    refused("got a closed one", bus.ping, 1, error=HardwareError)


def test_a_file_is_no_port(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(b"")
    refused(r"file: expected a serial port, got Inappropriate", Bus, str(file), error=HardwareError)


def test_other_systems_are_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "termios", None)
    refused("COM3: expected Linux or macOS", Bus, "COM3", error=HardwareError)


def test_another_rate_works_by_pyserial(serve, connect):
    bus = connect(serve([make_servo(1)]), baud=123_456)
    assert bus.ping(1) == 1060


def test_a_line_that_takes_no_more_is_an_error_and_loses_nothing_silently(serve, connect):
    served = serve([make_servo(1)])
    bus = connect(served)
    os.write(served._waker, b"x")  # nobody reads any more
    served._thread.join()
    with pytest.raises(HardwareError, match=r"expected to send 1000000 bytes .* are left"):
        bus.line.send(bytes(1_000_000), timeout_s=0.01)


def test_what_does_not_fit_at_once_is_sent_in_pieces(serve, connect):
    seen = []
    served = serve([make_servo(1)], alter=lambda packet, answers: seen.append(packet) or answers)
    bus = connect(served)
    bus.line.send(bytes(200_000), timeout_s=10.0)
    assert bus.ping(1) == 1060
    assert [packet.instruction for packet in seen] == [Instruction.PING]
