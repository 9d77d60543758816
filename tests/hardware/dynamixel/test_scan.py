"""The search for servos on an unknown line, and its command."""

import pytest
import serial

from tests.commands.test_failures import call
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel import scan as scanning
from vergence.hardware.dynamixel.scan import ALL_BAUD_RATES, scan_for_servos

QUICK = {"broadcast_wait_per_id_s": 1e-4, "baud_rates": (2_000_000, 1_000_000)}


@pytest.fixture
def scan(serve):
    def of(servos, **options):
        return scan_for_servos(serve(servos).port, **QUICK | options)

    return of


@pytest.fixture
def run(serve, monkeypatch, capsys):
    """Run the command on some servos; its exit code, and what it says."""

    def of(servos, *words, **line):
        port = "/dev/ttyNONE" if servos is None else serve(servos, **line).port
        monkeypatch.setattr(
            scanning, "scan_for_servos", lambda port, **more: scan_for_servos(port, **more | QUICK)
        )
        return call("scan-bus", port, *words), *capsys.readouterr()

    return of


def test_all_rates_are_asked_once_the_likely_ones_first():
    assert ALL_BAUD_RATES[:2] == (57_600, 1_000_000)
    assert sorted(ALL_BAUD_RATES) == sorted(table.BAUD_RATES)


def test_servos_are_found_at_their_own_rates(scan, own):
    own[0].set(table.BAUD_RATE, 4)
    own[3].set(table.ID, 200)
    shares = []
    found = scan(own, progress=shares.append)
    assert [(one.id, one.baud_rate) for one in found.servos] == [
        (1, 2_000_000), (2, 1_000_000), (3, 1_000_000), (200, 1_000_000),
    ]  # fmt: skip
    assert found.servos[0].memory.get(table.PRESENT_INPUT_VOLTAGE) == 120
    assert shares == [0.0, 0.5]


@pytest.mark.slow
def test_servos_that_tell_only_their_model_are_listed(scan, own):
    own[0].set(table.MODEL_NUMBER, 12)
    own[1].set(table.STATUS_RETURN_LEVEL, 0)
    found = scan(own[:2], single_ping_ids=(1, 2), baud_rates=(1_000_000,))
    assert [(one.model_number, one.memory) for one in found.servos] == [(12, None), (1060, None)]


def test_a_rate_that_cannot_be_set_is_left_out_with_its_reason(scan, own, monkeypatch):
    def opened(port, baud, **options):
        if baud == 123_456:
            raise ValueError("Failed to set custom baud rate")
        return Serial(port, baud, **options)

    Serial = serial.Serial
    monkeypatch.setattr(serial, "Serial", opened)
    found = scan(own, baud_rates=(123_456, 1_000_000))
    assert len(found.servos) == 4
    assert "expected 123456 baud, got Failed to set" in found.unsupported_rates[123_456]


def test_the_command_lists_what_answers(run, own):
    own[0].set(table.OPERATING_MODE, table.VELOCITY_MODE)
    own[1].set_hardware_errors(0b100100)
    code, said, _ = run(own)
    assert (code, said.count("XL430-W250"), said.count("1000000")) == (0, 4, 4)
    for word in ("firmware", "velocity", "position", "12.0", "31", "2048", "overheating, overload"):
        assert word in said


def test_a_line_on_which_nobody_answers_ends_with_the_usual_reasons(run):
    code, _, said = run([])
    assert code == 1
    for word in ("expected servos, got no answer at any baud rate", "power", "Protocol 2.0"):
        assert word in said


@pytest.mark.slow
def test_equal_ids_are_listed_and_told(run, own):
    own[1].set(table.ID, 1)
    own[1].q = 0.3
    code, out, said = run(own[:3], hears_rate=True)
    assert (code, out.count("XL430-W250")) == (1, 2)
    assert "error: id 1: expected one servo at 1000000 baud, got two or more" in said


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--ids", "1")])
def test_damaged_answers_are_told_as_ids_that_collide(run, own, options):
    code, _, said = run(own[:1], *options, alter=lambda _packet, answers: answers[:-1] + b"\0")
    assert code == 1
    assert "damaged answers: servos with one id" in said


def test_ids_that_cannot_be_are_misuse(run):
    for ids in ("x", "3-1", "0-253", "-1"):
        with named(ids):
            code, _, said = run(None, f"--ids={ids}")
            assert (code, "ids: expected A-B" in said) == (2, True)
