"""Health of servos: what is read of them, and how it is judged."""

import math

import pytest

from tests.hardware.desk import ready_servos
from tests.naming import named
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.checks import (
    Health,
    HealthLimits,
    HealthWatch,
    Level,
    read_health,
    read_limits,
)

LIMITS = HealthLimits(
    max_temperature_c=72.0, min_voltage_v=6.0, max_voltage_v=14.0, full_load_reading=1000.0
)
FINE = {"temperature_c": 31.0, "voltage_v": 12.0, "load": 0.1, "errors": 0}


@pytest.fixture
def bus(serve):
    served = serve(ready_servos())
    bus = Bus(served.port)
    yield bus, served.line.servos
    bus.close()


def test_health_is_read_in_units(bus):
    line, servos = bus
    servos[0].set(table.PRESENT_LOAD, -250)
    servos[0].set(table.PRESENT_INPUT_VOLTAGE, 111)
    servos[0].set(table.PRESENT_TEMPERATURE, 40)
    servos[1].set_hardware_errors(0b100100)
    limits = {ident: read_limits(line, ident) for ident in (1, 2)}
    assert limits[1] == LIMITS
    health = read_health(line, limits)
    assert (health[1].temperature_c, health[1].errors) == (40.0, 0)
    assert (health[1].voltage_v, health[1].load) == pytest.approx((11.1, -0.25))
    assert health[2].errors == 0b100100


def test_a_current_is_a_share_of_its_limit_and_nan_without_one(bus):
    line, servos = bus
    for servo, limit in zip(servos, (1193, 0), strict=False):
        servo.set(table.MODEL_NUMBER, 1020)
        servo.set(table.Register("CURRENT_LIMIT", 38, 2), limit)
        servo.set(table.PRESENT_LOAD, 597)
    health = read_health(line, {ident: read_limits(line, ident) for ident in (1, 2)})
    assert health[1].load == pytest.approx(0.5, abs=1e-3)
    assert math.isnan(health[2].load)


def test_a_servo_that_does_not_answer_has_no_health(bus):
    line, servos = bus
    limits = dict.fromkeys((1, 2), LIMITS)
    servos[1].silent = True
    assert list(read_health(line, limits)) == [1]


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
        verdict = HealthWatch(LIMITS).judge(Health(**FINE | values))
        with named(values):
            assert (verdict.level, verdict.is_hot) == (level, hot)
            assert bool(verdict.text) is (level != Level.OK)


def test_the_worst_decides_and_all_are_told():
    watch, worst = HealthWatch(LIMITS), {"temperature_c": 63.0, "voltage_v": 5.0, "load": 0.9}
    for _ in range(3):
        verdict = watch.judge(Health(**FINE | worst))
    assert verdict.level == Level.STOP
    assert [part.split(":")[0] for part in verdict.text.split("; ")] == [
        "temperature", "voltage", "load",
    ]  # fmt: skip


def test_a_high_load_counts_at_the_third_reading_in_a_row():
    for loads, expected in (
        ((0.96, 0.96, 0.5, -0.96, -0.96, -0.96), [*[Level.OK] * 5, Level.STOP]),
        ((0.9, 0.9, 0.79, 0.8, -0.96, 0.9, 0.9), [*[Level.OK] * 5, Level.WARN, Level.WARN]),
    ):
        watch = HealthWatch(LIMITS)
        assert [watch.judge(Health(**FINE | {"load": load})).level for load in loads] == expected
