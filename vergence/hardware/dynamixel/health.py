"""Temperature, voltage and load of servos, judged against the servos' own limits.

Servos with a current sensor report their current in place of a load. Both are given as a fraction
of the greatest: of the full torque, or of the servo's CURRENT_LIMIT, which has the same unit.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.control_table import (
    PRESENT_VALUES_SPAN,
    ServoMemory,
    describe_fault_bits,
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
"""Margin below the temperature limit at which a servo is warm, and gets no torque, K (chosen)."""
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


class Level(IntEnum):
    """The judgement of a servo's health, from good to bad."""

    OK = 0
    WARN = 1
    STOP = 2


class Health(NamedTuple):
    """One reading of a servo."""

    temperature_c: float
    voltage_v: float
    load: float
    """Fraction of the greatest torque or current, -1 to 1; nan if unknown."""
    errors: int
    """Bits of HARDWARE_ERROR_STATUS."""


class HealthLimits(NamedTuple):
    """Limits stored in a servo's EEPROM."""

    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float
    full_load_reading: float = np.nan
    """PRESENT_LOAD at full torque or at the current limit; nan if unknown."""


class HealthJudgement(NamedTuple):
    """Judgement of one reading."""

    level: Level
    text: str
    """Expected and actual value of each that is not ok; empty if all are."""
    is_hot: bool = False
    """True if its torque has to go off, as holding still heats it too."""


def limits_of(memory: ServoMemory, full_load_reading: float = np.nan) -> HealthLimits:
    """Limits among a servo's registers."""
    return HealthLimits(
        float(memory.get(table.TEMPERATURE_LIMIT)),
        0.1 * memory.get(table.MIN_VOLTAGE_LIMIT),
        0.1 * memory.get(table.MAX_VOLTAGE_LIMIT),
        full_load_reading,
    )


def read_limits(bus: Bus, id: int) -> HealthLimits:
    """Read a servo's limits; raise a `HardwareError` if it does not answer."""
    memory = bus.read_memory(id, ((0, 2), (31, 5)))
    full = float(_FULL_LOAD_READING)
    if memory.get(table.MODEL_NUMBER) not in _MODELS_WITHOUT_CURRENT:
        # models that lack the register refuse the read or return 0
        full = np.nan
        with suppress(HardwareError):
            full = float(bus.read(id, _CURRENT_LIMIT)) or np.nan
    return limits_of(memory, full)


def read_health(bus: Bus, limits: Mapping[int, HealthLimits]) -> dict[int, Health]:
    """Read the health of servos with one request, and faults that they announce."""
    found = {}
    for id, data in bus.sync_read(limits, *PRESENT_VALUES_SPAN).items():
        memory = ServoMemory({PRESENT_VALUES_SPAN[0]: data})
        errors = 0
        if id in bus.alerts:
            errors = _UNKNOWN_FAULT
            with suppress(HardwareError):
                errors = bus.read(id, table.HARDWARE_ERROR_STATUS, requests=1)
        found[id] = Health(
            float(memory.get(table.PRESENT_TEMPERATURE)),
            0.1 * memory.get(table.PRESENT_INPUT_VOLTAGE),
            memory.get(table.PRESENT_LOAD) / limits[id].full_load_reading,
            errors,
        )
    return found


def judge_temperature(limits: HealthLimits, temperature_c: float) -> tuple[Level, str]:
    """Judge a temperature against its limit; the text says what was expected."""
    limit_c = limits.max_temperature_c
    if temperature_c < limit_c - WARM_K:
        return Level.OK, ""
    level = Level.STOP if temperature_c >= limit_c - HOT_K else Level.WARN
    below_c = limit_c - (HOT_K if level == Level.STOP else WARM_K)
    return level, f"expected below {below_c:g} C, got {temperature_c:g} C"


def judge_voltage(limits: HealthLimits, voltage_v: float) -> tuple[Level, str]:
    """Judge a voltage against its limits; the text says what was expected."""
    least, most = limits.min_voltage_v, limits.max_voltage_v
    text = f"expected {least:.1f} to {most:.1f} V, got {voltage_v:.1f} V"
    # voltages come in steps of 0.1 V: allow half a step
    if not least - 0.05 < voltage_v < most + 0.05:
        return Level.STOP, text
    spare = _VOLTAGE_WARNING_FRACTION
    if least * (1.0 + spare) < voltage_v < most * (1.0 - spare):
        return Level.OK, ""
    return Level.WARN, text


class HealthWatch:
    """Judges one servo's readings by its limits."""

    def __init__(self, limits: HealthLimits) -> None:
        self.limits = limits
        self._full = self._high = 0

    def judge(self, health: Health) -> HealthJudgement:
        """Judge a reading; a load counts only after three readings in a row."""
        found = list(self._findings(health))
        level = max((one for one, _ in found), default=Level.OK)
        hot = health.temperature_c >= self.limits.max_temperature_c - HOT_K
        return HealthJudgement(level, "; ".join(text for _, text in found), hot)

    def _findings(self, health: Health) -> Iterator[tuple[Level, str]]:
        level, text = judge_temperature(self.limits, health.temperature_c)
        if level:
            goes = ", so its torque goes off" if level == Level.STOP else ""
            yield level, f"temperature: {text}{goes}"
        level, text = judge_voltage(self.limits, health.voltage_v)
        if level:
            yield level, f"voltage: {text}"
        share = abs(health.load)
        self._full = self._full + 1 if share >= _FULL_LOAD_FRACTION else 0
        self._high = self._high + 1 if share >= _HIGH_LOAD else 0  # not if it is unknown
        if self._full >= _LOAD_READS:
            most = f"{_FULL_LOAD_FRACTION:.0%}"
            yield Level.STOP, f"load: expected below {most}, got {share:.0%} at {_LOAD_READS} looks"
        elif self._high >= _LOAD_READS:
            yield Level.WARN, f"load: expected below {_HIGH_LOAD:.0%}, got {share:.0%}"
        if health.errors:
            yield Level.STOP, f"fault: {describe_fault_bits(health.errors)}"
