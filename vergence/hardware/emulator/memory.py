"""The control table of an emulated servo: its bytes, their factory values, ranges and locks.

Registers below `EEPROM_END` and the registers of measurements survive a reboot.
"""

from typing import Final

from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.control_table import Register
from vergence.hardware.dynamixel.packets import ErrorNumber

_TABLE_END: Final = 661
"""Address after the last register (physical: XL430-W250)."""
_MAX_READ_BYTES: Final = 256
"""Most bytes per read: their status fits into a packet with any byte stuffing (chosen)."""
_MEASUREMENT_ADDRESSES: Final = slice(120, 147)
"""Addresses of measurements, which nobody writes: REALTIME_TICK to PRESENT_TEMPERATURE (physical:
Dynamixel X series)."""
_MAX_EXTENDED_POSITION: Final = 1_048_575
"""Greatest position in extended position mode, ticks: 256 turns (physical: XL430-W250)."""

_FACTORY_VALUES: Final = {
    table.MODEL_NUMBER: 1060,
    table.FIRMWARE_VERSION: 45,
    table.ID: 1,
    table.BAUD_RATE: 1,
    table.RETURN_DELAY_TIME: 250,
    table.OPERATING_MODE: table.POSITION_MODE,
    table.SECONDARY_ID: 255,
    table.PROTOCOL_TYPE: 2,
    table.TEMPERATURE_LIMIT: 72,
    table.MAX_VOLTAGE_LIMIT: 140,
    table.MIN_VOLTAGE_LIMIT: 60,
    table.PWM_LIMIT: table.FULL_PWM,
    table.VELOCITY_LIMIT: 265,
    table.MAX_POSITION_LIMIT: 4095,
    table.SHUTDOWN: 0b110100,
    table.STATUS_RETURN_LEVEL: 2,
    table.VELOCITY_I_GAIN: 1000,
    table.VELOCITY_P_GAIN: 100,
    table.GOAL_PWM: table.FULL_PWM,
    table.PRESENT_INPUT_VOLTAGE: 120,
    table.PRESENT_TEMPERATURE: 31,
}
"""Factory values of an XL430-W250, at 12 V and 31 degrees Celsius; other registers are 0."""

_RANGES: Final = {
    table.ID: (0, 252),
    table.BAUD_RATE: (0, len(table.BAUD_RATES) - 1),
    table.RETURN_DELAY_TIME: (0, 254),
    table.DRIVE_MODE: (0, 0),
    table.PROTOCOL_TYPE: (2, 2),
    table.HOMING_OFFSET: (-1_044_479, 1_044_479),
    table.TEMPERATURE_LIMIT: (0, 100),
    table.MAX_VOLTAGE_LIMIT: (60, 140),
    table.MIN_VOLTAGE_LIMIT: (60, 140),
    table.PWM_LIMIT: (0, table.FULL_PWM),
    table.VELOCITY_LIMIT: (0, 2047),
    table.MAX_POSITION_LIMIT: (0, 4095),
    table.MIN_POSITION_LIMIT: (0, 4095),
    table.TORQUE_ENABLE: (0, 1),
    table.STATUS_RETURN_LEVEL: (0, 2),
    table.VELOCITY_I_GAIN: (0, 16_383),
    table.VELOCITY_P_GAIN: (0, 16_383),
    table.BUS_WATCHDOG: (0, table.WATCHDOG_MOST),
    table.PROFILE_ACCELERATION: (0, 32_767),
    table.PROFILE_VELOCITY: (0, 32_767),
}
_MODES: Final = (table.VELOCITY_MODE, table.POSITION_MODE, table.EXTENDED_POSITION_MODE)
_READ_ONLY: Final = (table.MODEL_NUMBER, table.FIRMWARE_VERSION, table.HARDWARE_ERROR_STATUS)


class ControlTable:
    """A control table.

    Args:
        id: value of the register ID.

    Attributes:
        bytes: all bytes of the table.
    """

    def __init__(self, id: int) -> None:
        self.bytes = bytearray(_TABLE_END)
        for register, value in _FACTORY_VALUES.items():
            self.set(register, value)
        self.set(table.ID, id)

    def get(self, register: Register) -> int:
        """Value of a register."""
        return register.decode(self.bytes[register.address : register.end])

    def set(self, register: Register, value: int) -> None:
        """Set a register, without checks of locks and ranges."""
        self.bytes[register.address : register.end] = register.encode(value)

    def reboot(self) -> None:
        """Reset all registers but the EEPROM and the measurements."""
        measured = self.bytes[_MEASUREMENT_ADDRESSES]
        self.bytes[table.EEPROM_END :] = bytes(_TABLE_END - table.EEPROM_END)
        for register, value in _FACTORY_VALUES.items():
            if register.address >= table.EEPROM_END:
                self.set(register, value)
        self.bytes[_MEASUREMENT_ADDRESSES] = measured

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Error number and bytes of the answer to a read instruction."""
        if not 0 < length <= _MAX_READ_BYTES or address + length > _TABLE_END:
            return ErrorNumber.DATA_RANGE, b""
        return 0, bytes(self.bytes[address : address + length])

    def refusal(self, address: int, data: bytes) -> int:
        """Error number of an instruction to write these bytes; 0 for none."""
        end = address + len(data)
        if end > _TABLE_END:
            return ErrorNumber.DATA_RANGE
        if not data:
            return ErrorNumber.DATA_LENGTH
        locked = address < table.EEPROM_END and self.get(table.TORQUE_ENABLE)
        if locked or (address < _MEASUREMENT_ADDRESSES.stop and end > _MEASUREMENT_ADDRESSES.start):
            return ErrorNumber.ACCESS
        for register in table.REGISTERS:
            if register.end <= address or end <= register.address:
                continue
            if register in _READ_ONLY:
                return ErrorNumber.ACCESS
            value = written_value(register, address, data)
            if value is None:
                return ErrorNumber.DATA_LENGTH
            if error := self._out_of_range(register, value):
                return error
        return 0

    def _out_of_range(self, register: Register, value: int) -> int:
        least, most = _RANGES.get(register, (register.least, register.most))
        if not least <= value <= most:
            return ErrorNumber.DATA_RANGE
        if register == table.OPERATING_MODE and value not in _MODES:
            return ErrorNumber.DATA_RANGE
        least, most = self._limits(register)
        return 0 if least <= value <= most else ErrorNumber.DATA_LIMIT

    def _limits(self, register: Register) -> tuple[int, int]:
        """Range of a goal register under the servo's own settings."""
        if register == table.GOAL_VELOCITY:
            limit = self.get(table.VELOCITY_LIMIT)
            return -limit, limit
        if register == table.GOAL_PWM:
            limit = self.get(table.PWM_LIMIT)
            return -limit, limit
        if register == table.GOAL_POSITION:
            mode = self.get(table.OPERATING_MODE)
            if mode == table.POSITION_MODE:
                return self.get(table.MIN_POSITION_LIMIT), self.get(table.MAX_POSITION_LIMIT)
            if mode == table.EXTENDED_POSITION_MODE:
                return -_MAX_EXTENDED_POSITION, _MAX_EXTENDED_POSITION
        return register.least, register.most


def written_value(register: Register, address: int, data: bytes) -> int | None:
    """Value that bytes at an address write into a register; None unless they cover all of it."""
    at = register.address - address
    if not 0 <= at <= len(data) - register.length:
        return None
    return register.decode(data[at : at + register.length])
