"""The search for servos on an unknown line, and its command."""

import pytest
import serial

from tests.commands.test_failures import call
from tests.hardware.line import ready_servos
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel import scan as scanning
from vergence.hardware.dynamixel.scan import ALL_BAUD_RATES, scan_for_servos

QUICK = {"broadcast_wait_per_id_s": 1e-4, "baud_rates": (2_000_000, 1_000_000)}


def test_all_rates_are_asked_once_the_likely_ones_first():
    assert ALL_BAUD_RATES[:2] == (57_600, 1_000_000)
    assert sorted(ALL_BAUD_RATES) == sorted(table.BAUD_RATES)


def test_servos_are_found_at_their_own_rates(serve):
    own = ready_servos()
    own[0].set(table.BAUD_RATE, 4)
    own[3].set(table.ID, 200)
    shares = []
    found = scan_for_servos(serve(own).port, progress=shares.append, **QUICK)
    assert [(one.id, one.baud_rate) for one in found.servos] == [
        (1, 2_000_000), (2, 1_000_000), (3, 1_000_000), (200, 1_000_000),
    ]  # fmt: skip
    assert found.servos[0].memory.get(table.PRESENT_INPUT_VOLTAGE) == 120
    assert shares == [0.0, 0.5]


@pytest.mark.slow
def test_servos_that_tell_only_their_model_are_listed(serve):
    own = ready_servos()[:2]
    own[0].set(table.MODEL_NUMBER, 12)
    own[1].set(table.STATUS_RETURN_LEVEL, 0)
    options = QUICK | {"baud_rates": (1_000_000,)}
    found = scan_for_servos(serve(own).port, single_ping_ids=(1, 2), **options)
    assert [(one.model_number, one.memory) for one in found.servos] == [(12, None), (1060, None)]


def test_a_rate_that_cannot_be_set_is_left_out_with_its_reason(serve, monkeypatch):
    def opened(port, baud, **options):
        if baud == 123_456:
            raise ValueError("Failed to set custom baud rate")
        return Serial(port, baud, **options)

    Serial = serial.Serial
    monkeypatch.setattr(serial, "Serial", opened)
    options = QUICK | {"baud_rates": (123_456, 1_000_000)}
    found = scan_for_servos(serve(ready_servos()).port, **options)
    assert len(found.servos) == 4
    assert "expected 123456 baud, got Failed to set" in found.unsupported_rates[123_456]


def run(monkeypatch, *words):
    scan_all = scanning.scan_for_servos
    monkeypatch.setattr(
        scanning, "scan_for_servos", lambda port, **options: scan_all(port, **options | QUICK)
    )
    return call("scan-bus", *words)


def test_the_command_lists_what_answers(serve, monkeypatch, capsys):
    own = ready_servos()
    own[0].set(table.OPERATING_MODE, table.VELOCITY_MODE)
    own[1].set_hardware_errors(0b100100)
    assert run(monkeypatch, serve(own).port) == 0
    said = capsys.readouterr().out
    assert said.count("XL430-W250") == 4
    assert said.count("1000000") == 4
    for word in ("firmware", "velocity", "position", "12.0", "31", "2048", "overheating, overload"):
        assert word in said


def test_a_line_on_which_nobody_answers_ends_with_the_usual_reasons(serve, monkeypatch, capsys):
    assert run(monkeypatch, serve([]).port) == 1
    said = capsys.readouterr().err
    assert "expected servos, got no answer at any baud rate" in said
    assert "power" in said
    assert "Protocol 2.0" in said


@pytest.mark.slow
def test_equal_ids_are_listed_and_told(serve, monkeypatch, capsys):
    own = ready_servos()[:3]
    own[1].set(table.ID, 1)
    own[1].q = 0.3
    assert run(monkeypatch, serve(own, hears_rate=True).port) == 1
    said = capsys.readouterr()
    assert said.out.count("XL430-W250") == 2
    assert "error: id 1: expected one servo at 1000000 baud, got two or more" in said.err


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--ids", "1")])
def test_damaged_answers_are_told_as_ids_that_collide(serve, monkeypatch, capsys, options):
    served = serve(ready_servos()[:1], alter=lambda _packet, answers: answers[:-1] + b"\0")
    assert run(monkeypatch, served.port, *options) == 1
    assert "damaged answers: servos with one id" in capsys.readouterr().err


def test_ids_that_cannot_be_are_misuse(monkeypatch, capsys):
    for ids in ("x", "3-1", "0-253", "-1"):
        with named(ids):
            assert run(monkeypatch, "/dev/ttyNONE", f"--ids={ids}") == 2
            assert "ids: expected A-B" in capsys.readouterr().err
