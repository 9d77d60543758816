"""Checks of the servos before torque, on emulated servos, and how their health is judged."""

import dataclasses
import math
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

from tests.hardware.fakes import HEAD
from tests.hardware.line import desk_config, open_briefly, ready_servos
from tests.naming import named
from vergence.errors import ChecksFailedError, HardwareError
from vergence.hardware.checks import check_servos, raise_errors
from vergence.hardware.dynamixel import checks as dynamixel_checks
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.checks import (
    Health,
    HealthLimits,
    HealthWatch,
    Level,
    check_exchange,
    check_latency_timer,
    exchange_time_s,
    open_bus,
    read_health,
    read_limits,
)
from vergence.hardware.safety.limits import ForbiddenPosture, SafetyConfig


@pytest.fixture
def check(serve):
    def of(own, config=lambda config: config, **options):
        robot = config(desk_config(serve(own).port))
        with closing(open_briefly(robot)) as servos:
            return check_servos(robot, servos, **options)

    return of


def test_servos_with_nothing_wrong_have_no_findings(check, own):
    assert check(own) == []
    own[1].set(table.VELOCITY_I_GAIN, 1920)  # stiffer is no weakness
    # a posture is taken on the turn nearest the range
    own[0].zero_ticks -= table.TICKS_PER_TURN
    own[1].zero_ticks += 2 * table.TICKS_PER_TURN
    assert check(own) == []


REGISTERS = [
    (table.FIRMWARE_VERSION, 37, "firmware 38 or later", False),
    (table.STATUS_RETURN_LEVEL, 1, "expected 2 in STATUS_RETURN_LEVEL, got 1", False),
    (table.STATUS_RETURN_LEVEL, 0, "though it answers to a ping", False),
    (table.PROTOCOL_TYPE, 21, "expected 2 in PROTOCOL_TYPE, got 21", False),
    (table.BAUD_RATE, 1, "expected 1000000 baud, as in the configuration, got 57600", False),
    (table.DRIVE_MODE, 1, "got 1 (reverse direction, which `sign`", False),
    (table.VELOCITY_LIMIT, 0, "got 0 rad/s", False),
    (table.VELOCITY_LIMIT, 100, "at least 5.97 rad/s of the joint, as the head's model", True),
    (table.VELOCITY_I_GAIN, 50, "as XL430-W250 has them from the factory, got 50 and 100", True),
    (table.SECONDARY_ID, 9, "expected 255 in SECONDARY_ID, for none, got 9", True),
    (table.PRESENT_TEMPERATURE, 62, "expected below 62 C, got 62 C", False),
]


@pytest.mark.slow
def test_a_register_that_must_not_be_so_is_one_finding_of_its_servo(check):
    for register, value, said, warning in REGISTERS:
        with named(register.name, value):
            own = ready_servos()
            own[1].set(register, value)
            (finding,) = check(own)
            assert finding.part == "servos: left_tilt"
            assert said in finding.problem
            assert finding.cure
            assert finding.warning is warning


def test_small_servos_with_a_weak_watchdog_are_a_warning(check, own):
    own[0].set(table.MODEL_NUMBER, 1200)
    own[0].set(table.VELOCITY_I_GAIN, 1600)
    own[0].set(table.VELOCITY_P_GAIN, 180)
    for firmware, warnings in ((51, [True]), (52, [])):
        own[0].set(table.FIRMWARE_VERSION, firmware)
        assert [finding.warning for finding in check(own)] == warnings, firmware


def test_another_mode_is_an_error_with_torque_alone(check, own):
    for torque, mode, count in ((1, 3, 1), (0, 3, 0), (1, 1, 0)):
        own[2].set(table.OPERATING_MODE, mode)
        own[2].set(table.TORQUE_ENABLE, torque)
        found = check(own)
        assert len(found) == count, (torque, mode)
        assert all("hold the head" in finding.cure for finding in found)


def test_a_joint_outside_its_limits_is_found_unless_zeros_are_being_set(check, own):
    own[3].q = 1.6
    (finding,) = check(own)
    assert "expected an angle of -1.500 to 1.500 rad, got 1.600 rad" in finding.problem
    assert check(own, check_joint_in_limits=False) == []


def test_a_forbidden_posture_is_found_with_the_angles_that_make_it(check, own):
    low, high = np.full(2, 0.5), np.full(2, 1.0)
    frame = ForbiddenPosture(name="the frame", slots=(3, 4), lower=low, upper=high)
    own[0].q, own[1].q = 0.6, 0.7  # 0.699 by whole ticks
    safety = SafetyConfig(forbidden=(frame,))
    (finding,) = check(own, lambda config: dataclasses.replace(config, safety=safety))
    assert "'the frame', got left_pan 0.600 rad, left_tilt 0.699 rad" in finding.problem


@pytest.mark.slow
def test_equal_ids_are_found_by_their_clocks_where_all_else_is_alike(check, own):
    own[1].set(table.ID, 1)
    own[1].bytes[120] = 1  # REALTIME_TICK
    found = check(own)
    assert any("expected one servo with the id 1, got two or more" in str(one) for one in found)


@pytest.mark.slow
def test_a_noisy_line_is_not_taken_for_equal_ids(serve, own):
    rng, damaged = np.random.default_rng(3), []

    def damage(_packet, answers):
        damaged.append(rng.random() < 0.2)
        return answers[:-1] + b"\0" if damaged[-1] else answers

    config = desk_config(serve(own, alter=damage).port)
    with closing(open_briefly(config)) as servos:
        assert check_servos(config, servos) == []
    assert sum(damaged) > 5


def test_a_servo_without_a_watchdog_is_an_error(check, own, monkeypatch):
    read = own[1].read
    monkeypatch.setattr(
        own[1], "read", lambda address, size: (7, b"") if address == 98 else read(address, size)
    )
    (finding,) = check(own)
    assert str(finding).startswith("servos: left_tilt: expected a BUS_WATCHDOG, which stops")


def test_another_kind_of_servo_is_asked_no_more(check, own):
    own[1].set(table.MODEL_NUMBER, 12)
    own[1].set(table.DRIVE_MODE, 1)
    (finding,) = check(own)
    assert "got the model number 12" in finding.problem


def written(servo):
    """The registers that somebody may have written: all but those that the servo reports."""
    return [servo.get(register) for register in table.REGISTERS if register.address < 120]


def test_mistakes_are_lines_of_one_error_and_nothing_is_written(check, own):
    own[0].set(table.VELOCITY_LIMIT, 200)
    warnings = check(own)
    assert raise_errors(warnings) == warnings
    own[0].set(table.HOMING_OFFSET, 100)
    own[2].set(table.FIRMWARE_VERSION, 30)
    own[2].set(table.PRESENT_TEMPERATURE, 70)
    before = [written(servo) for servo in own]
    with pytest.raises(HardwareError) as refused:
        raise_errors(check(own))
    lines = str(refused.value).splitlines()
    assert all("servos: " in line and "; cure: " in line for line in lines)
    assert [line.startswith("warning: ") for line in lines] == [False, False, False, True]
    assert [written(servo) for servo in own] == before


# ---- the line ----


def line(port, baud):
    return SimpleNamespace(port=port, line=SimpleNamespace(baud=baud))


def fake_adapter(folder, latency_ms):
    """A port, and where the system tells of it."""
    device = folder / f"{latency_ms}/bus/usb-serial/devices/ttyUSB7"
    device.mkdir(parents=True)
    (device / "latency_timer").write_text(f"{latency_ms}\n")
    port = folder / f"by-id{latency_ms}"
    port.symlink_to(folder / "ttyUSB7")
    return str(port), str(folder / f"{latency_ms}")


def test_an_exchange_takes_its_bytes_delays_and_latency():
    # two instructions of 34 and 18 bytes, four answers of 19
    assert exchange_time_s(4, 1_000_000, 0.0, 0.0) == pytest.approx(1e-5 * (34 + 18 + 76))
    assert exchange_time_s(4, 57_600, 2e-3, 1e-3) == pytest.approx(10 / 57_600 * 128 + 3e-3)


def test_a_line_too_slow_for_the_control_period_is_an_error():
    (finding,) = check_exchange(line("/dev/ttyNONE", 57_600), HEAD, 4, dict.fromkeys("abcd", 0))
    assert not finding.warning
    said = "within 60% of the control period of 16.7 ms, got 22.2 ms at 57600 baud"
    assert said in finding.problem


def test_return_delays_that_take_a_tenth_of_the_period_are_a_warning(check, own):
    for servo in own:
        servo.set(table.RETURN_DELAY_TIME, 250)
    (finding,) = check(own)
    assert finding.warning
    assert "left_pan 250" in finding.problem
    own[0].set(table.RETURN_DELAY_TIME, 0)
    assert check(own) == []


def test_an_adapter_that_holds_bytes_back_is_a_warning(tmp_path):
    finding = check_latency_timer(*fake_adapter(tmp_path, 16))
    assert finding.warning
    assert "ttyUSB7/latency_timer" in finding.cure
    assert check_latency_timer(*fake_adapter(tmp_path, 1)) is None


def test_an_adapters_latency_counts_into_the_period(tmp_path):
    port, sysfs = fake_adapter(tmp_path, 16)
    (finding,) = check_exchange(line(port, 1_000_000), HEAD, 4, {}, sysfs)
    assert "16 ms the adapter's latency" in finding.problem
    assert "ttyUSB7/latency_timer, or a control_rate_hz of 34 at most" in finding.cure


def test_a_port_that_is_not_there_is_told_with_those_that_are(monkeypatch):
    monkeypatch.setattr(dynamixel_checks, "glob", lambda _pattern: ["/dev/ttyUSB3"])
    with pytest.raises(ChecksFailedError, match=r"no such device; cure: .*: /dev/ttyUSB3"):
        open_bus("/dev/ttyNONE", 1_000_000)


def test_a_port_that_somebody_has_open_is_told_with_the_cure(serve, own):
    config = serve(own).port, 1_000_000
    said = "another process has open; cure: .*fuser"
    with closing(open_bus(*config)), pytest.raises(ChecksFailedError, match=said):
        open_bus(*config)


def test_faults_are_told_in_words():
    words = "input voltage, overheating, motor encoder, electrical shock, overload"
    assert table.describe_fault_bits(0b111101) == words
    for bit, word in zip((0, 2, 3, 4, 5), words.split(", "), strict=True):
        assert table.describe_fault_bits(1 << bit) == word


# ---- health ----

LIMITS = HealthLimits(
    max_temperature_c=72.0, min_voltage_v=6.0, max_voltage_v=14.0, full_load_reading=1000.0
)


def health_of(**values):
    return Health(**{"temperature_c": 31.0, "voltage_v": 12.0, "load": 0.1, "errors": 0} | values)


@pytest.fixture
def bus(serve, own):
    with closing(Bus(serve(own).port)) as bus:
        yield bus


def test_health_is_read_in_units_of_the_servos_that_answer(bus, own):
    own[0].set(table.PRESENT_LOAD, -250)
    own[0].set(table.PRESENT_INPUT_VOLTAGE, 111)
    own[0].set(table.PRESENT_TEMPERATURE, 40)
    own[1].set_hardware_errors(0b100100)
    limits = {ident: read_limits(bus, ident) for ident in (1, 2, 3)}
    assert limits[1] == LIMITS
    own[2].silent = True
    health = read_health(bus, limits)
    assert list(health) == [1, 2]
    assert (health[1].temperature_c, health[1].errors) == (40.0, 0)
    assert (health[1].voltage_v, health[1].load) == pytest.approx((11.1, -0.25))
    assert health[2].errors == 0b100100


def test_a_current_is_a_share_of_its_limit_and_nan_without_one(bus, own):
    for servo, limit in zip(own, (1193, 0), strict=False):
        servo.set(table.MODEL_NUMBER, 1020)
        servo.set(table.Register("CURRENT_LIMIT", 38, 2), limit)
        servo.set(table.PRESENT_LOAD, 597)
    health = read_health(bus, {ident: read_limits(bus, ident) for ident in (1, 2)})
    assert health[1].load == pytest.approx(0.5, abs=1e-3)
    assert math.isnan(health[2].load)


JUDGED = [
    ({}, Level.OK, False), ({"load": math.nan}, Level.OK, False),
    ({"temperature_c": 61.0}, Level.OK, False),
    ({"temperature_c": 62.0}, Level.WARN, False),
    ({"temperature_c": 67.0}, Level.STOP, True), ({"voltage_v": 6.3}, Level.OK, False),
    ({"voltage_v": 6.1}, Level.WARN, False), ({"voltage_v": 13.7}, Level.WARN, False),
    ({"voltage_v": 5.9}, Level.STOP, False), ({"voltage_v": 14.1}, Level.STOP, False),
    ({"load": -0.79}, Level.OK, False), ({"errors": 0b1}, Level.STOP, False),
]  # fmt: skip


def test_a_reading_is_judged_by_its_limits():
    for values, level, hot in JUDGED:
        verdict = HealthWatch(LIMITS).judge(health_of(**values))
        with named(values):
            assert (verdict.level, verdict.is_hot) == (level, hot)
            assert bool(verdict.text) is (level != Level.OK)


def test_the_worst_decides_and_all_are_told():
    watch = HealthWatch(LIMITS)
    for _ in range(3):
        verdict = watch.judge(health_of(temperature_c=63.0, voltage_v=5.0, load=0.9))
    assert verdict.level == Level.STOP
    told = [part.split(":")[0] for part in verdict.text.split("; ")]
    assert told == ["temperature", "voltage", "load"]


def test_a_high_load_counts_at_the_third_reading_in_a_row():
    for loads, expected in (
        ((0.96, 0.96, 0.5, -0.96, -0.96, -0.96), [*[Level.OK] * 5, Level.STOP]),
        ((0.9, 0.9, 0.79, 0.8, -0.96, 0.9, 0.9), [*[Level.OK] * 5, Level.WARN, Level.WARN]),
    ):
        watch = HealthWatch(LIMITS)
        assert [watch.judge(health_of(load=load)).level for load in loads] == expected
