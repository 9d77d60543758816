"""Temperature, voltage and load of running servos, judged against the servos' own limits.

Servos with a current sensor report their current in place of a load. Both are given as a fraction
of the greatest: of the full torque, or of the servo's CURRENT_LIMIT, which has the same unit.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.repeated import read_register
from vergence.hardware.servo_memory import (
    PRESENT_VALUES_SPAN,
    ServoMemory,
    describe_fault_bits,
    read_memory,
)

_CURRENT_LIMIT: Final = table.Register("CURRENT_LIMIT", 38, 2)
_MODELS_WITHOUT_CURRENT: Final = frozenset((30, 1060, 1070, 1080, 1090, 1160))
"""MODEL_NUMBER of servos without a current sensor (physical: ROBOTIS's MX-28, XL430, XC430, 2XL430,
2XC430)."""
_FULL_LOAD_READING: Final = 1000
"""PRESENT_LOAD at the greatest torque (physical: register unit 0.1 %)."""
_UNKNOWN_FAULT: Final = 1 << 7
"""Bit for a fault that a servo has announced, but whose status could not be read (numerical)."""

WARM_K: Final = 10.0
"""Margin below the temperature limit at which a servo is warm, K (chosen)."""
HOT_K: Final = 5.0
"""Margin below the temperature limit at which a servo has to rest without torque, K (chosen)."""
_VOLTAGE_WARNING_FRACTION: Final = 0.03
"""Distance to a voltage limit that gives a warning, as a fraction of the limit (chosen)."""
_HIGH_LOAD: Final = 0.8
"""Fraction of the full load that counts as high (chosen)."""
_FULL_LOAD_FRACTION: Final = 0.95
"""Fraction of the full load that counts as full (chosen)."""
_LOAD_READS: Final = 3
"""Consecutive reads at full load that stop the head, or at high load that give a warning; fewer may
be an acceleration (chosen)."""


class HealthLevel(StrEnum):
    """The judgement of a servo's health, from good to bad."""

    OK = "ok"
    WARN = "warn"
    STOP = "stop"


@dataclass(frozen=True, kw_only=True)
class Health:
    """One reading of a servo."""

    temperature_c: float
    """Temperature, degrees Celsius."""
    voltage_v: float
    """Supply voltage, V."""
    load: float
    """Fraction of the greatest torque or current, -1 to 1; nan if unknown."""
    errors: int
    """Bits of HARDWARE_ERROR_STATUS."""


@dataclass(frozen=True, kw_only=True)
class HealthLimits:
    """Limits stored in a servo's EEPROM."""

    max_temperature_c: float
    """Greatest temperature, degrees Celsius."""
    min_voltage_v: float
    """Least voltage, V."""
    max_voltage_v: float
    """Greatest voltage, V."""
    full_load_reading: float
    """PRESENT_LOAD at full torque or at the current limit; nan if unknown."""


@dataclass(frozen=True, kw_only=True)
class HealthJudgement:
    """Judgement of one reading."""

    level: HealthLevel
    """Worst level of temperature, voltage, load and faults."""
    text: str
    """Expected and actual value of each that is not ok; empty if all are."""
    must_release_torque: bool = False
    """True if the servo is so hot that its torque has to go off, as holding still heats it too."""


def read_limits(bus: Bus, id: int) -> HealthLimits:
    """Read a servo's limits.

    Raises:
        HardwareError: the servo does not answer, or the line is gone.
    """
    memory = read_memory(bus, id, ((0, 2), (31, 5)))
    full = float(_FULL_LOAD_READING)
    if memory.get(table.MODEL_NUMBER) not in _MODELS_WITHOUT_CURRENT:
        # models that lack the register refuse the read or return 0
        full = np.nan
        with suppress(HardwareError):
            full = float(read_register(bus, id, _CURRENT_LIMIT)) or np.nan
    return HealthLimits(
        max_temperature_c=float(memory.get(table.TEMPERATURE_LIMIT)),
        min_voltage_v=0.1 * memory.get(table.MIN_VOLTAGE_LIMIT),
        max_voltage_v=0.1 * memory.get(table.MAX_VOLTAGE_LIMIT),
        full_load_reading=full,
    )


def read_health(bus: Bus, limits: Mapping[int, HealthLimits]) -> dict[int, Health]:
    """Read the health of several servos with one request, and the faults that they announce.

    Args:
        bus: their line.
        limits: limits of each servo to read, by id.

    Returns:
        Health of the servos that answered, by id.

    Raises:
        HardwareError: the line is gone.
    """
    found = {}
    for id, data in bus.sync_read(limits, *PRESENT_VALUES_SPAN).items():
        memory = ServoMemory({PRESENT_VALUES_SPAN[0]: data})
        errors = 0
        if id in bus.alerts:
            errors = _UNKNOWN_FAULT
            with suppress(HardwareError):
                errors = bus.read(id, table.HARDWARE_ERROR_STATUS)
        found[id] = Health(
            temperature_c=float(memory.get(table.PRESENT_TEMPERATURE)),
            voltage_v=0.1 * memory.get(table.PRESENT_INPUT_VOLTAGE),
            load=memory.get(table.PRESENT_LOAD) / limits[id].full_load_reading,
            errors=errors,
        )
    return found


class HealthWatch:
    """Judges one servo's readings.

    Args:
        limits: limits of the servo.
    """

    def __init__(self, limits: HealthLimits) -> None:
        self.limits = limits
        self._full = self._high = 0

    def judge(self, health: Health) -> HealthJudgement:
        """Judge a reading; a load counts only after three readings in a row."""
        hot, temperature = self._temperature(health.temperature_c)
        judged = [
            temperature,
            self._voltage(health.voltage_v),
            self._load(health.load),
            (HealthLevel.STOP, f"fault: {describe_fault_bits(health.errors)}")
            if health.errors
            else _NO_PROBLEM,
        ]
        order = list(HealthLevel)
        level = max((one for one, _ in judged), key=order.index)
        return HealthJudgement(
            level=level, text="; ".join(text for _, text in judged if text), must_release_torque=hot
        )

    def _temperature(self, temperature_c: float) -> tuple[bool, tuple[HealthLevel, str]]:
        limit_c = self.limits.max_temperature_c
        if temperature_c < limit_c - WARM_K:
            return False, _NO_PROBLEM
        hot = temperature_c >= limit_c - HOT_K
        below_c = limit_c - (HOT_K if hot else WARM_K)
        text = f"temperature: expected below {below_c:g} C, got {temperature_c:g} C"
        if hot:
            text += ", so its torque goes off"
        return hot, (HealthLevel.STOP if hot else HealthLevel.WARN, text)

    def _voltage(self, voltage_v: float) -> tuple[HealthLevel, str]:
        least, most = self.limits.min_voltage_v, self.limits.max_voltage_v
        text = f"voltage: expected {least:.1f} to {most:.1f} V, got {voltage_v:.1f} V"
        # voltages come in steps of 0.1 V: allow half a step
        if not least - 0.05 < voltage_v < most + 0.05:
            return HealthLevel.STOP, text
        near = (
            not least * (1.0 + _VOLTAGE_WARNING_FRACTION)
            < voltage_v
            < most * (1.0 - _VOLTAGE_WARNING_FRACTION)
        )
        return (HealthLevel.WARN, text) if near else _NO_PROBLEM

    def _load(self, load: float) -> tuple[HealthLevel, str]:
        share = abs(load)
        self._full = self._full + 1 if share >= _FULL_LOAD_FRACTION else 0
        self._high = self._high + 1 if share >= _HIGH_LOAD else 0  # also if it is unknown
        if self._high < _LOAD_READS:
            return _NO_PROBLEM
        if self._full < _LOAD_READS:
            return HealthLevel.WARN, f"load: expected below {_HIGH_LOAD:.0%}, got {share:.0%}"
        return HealthLevel.STOP, (
            f"load: expected below {_FULL_LOAD_FRACTION:.0%}, got {share:.0%} at {_LOAD_READS} "
            "looks"
        )


_NO_PROBLEM: Final = (HealthLevel.OK, "")
