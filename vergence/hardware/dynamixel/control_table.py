"""Registers of Dynamixel X-series servos and their units.

Addresses, lengths and units are those of ROBOTIS's manuals. Registers below `EEPROM_END` survive
power-off and cannot be written while torque is on.
"""

from math import pi
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError


class Register(NamedTuple):
    """A number in a servo's memory, little-endian."""

    name: str
    address: int
    length: int
    signed: bool = False

    @property
    def end(self) -> int:
        """Address after its last byte."""
        return self.address + self.length

    @property
    def least(self) -> int:
        """Least number that it can hold."""
        return -(1 << (8 * self.length - 1)) if self.signed else 0

    @property
    def most(self) -> int:
        """Greatest number that it can hold."""
        return (1 << (8 * self.length - self.signed)) - 1

    def encode(self, value: int) -> bytes:
        """Encode a number from `least` to `most` as bytes."""
        return value.to_bytes(self.length, "little", signed=self.signed)

    def decode(self, data: bytes | bytearray) -> int:
        """Decode the number in `length` bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


MODEL_NUMBER: Final = Register("MODEL_NUMBER", 0, 2)
FIRMWARE_VERSION: Final = Register("FIRMWARE_VERSION", 6, 1)
ID: Final = Register("ID", 7, 1)
BAUD_RATE: Final = Register("BAUD_RATE", 8, 1)
RETURN_DELAY_TIME: Final = Register("RETURN_DELAY_TIME", 9, 1)
DRIVE_MODE: Final = Register("DRIVE_MODE", 10, 1)
OPERATING_MODE: Final = Register("OPERATING_MODE", 11, 1)
SECONDARY_ID: Final = Register("SECONDARY(SHADOW)_ID", 12, 1)
PROTOCOL_TYPE: Final = Register("PROTOCOL_TYPE", 13, 1)
HOMING_OFFSET: Final = Register("HOMING_OFFSET", 20, 4, signed=True)
TEMPERATURE_LIMIT: Final = Register("TEMPERATURE_LIMIT", 31, 1)
MAX_VOLTAGE_LIMIT: Final = Register("MAX_VOLTAGE_LIMIT", 32, 2)
MIN_VOLTAGE_LIMIT: Final = Register("MIN_VOLTAGE_LIMIT", 34, 2)
PWM_LIMIT: Final = Register("PWM_LIMIT", 36, 2)
VELOCITY_LIMIT: Final = Register("VELOCITY_LIMIT", 44, 4)
MAX_POSITION_LIMIT: Final = Register("MAX_POSITION_LIMIT", 48, 4)
MIN_POSITION_LIMIT: Final = Register("MIN_POSITION_LIMIT", 52, 4)
SHUTDOWN: Final = Register("SHUTDOWN", 63, 1)
TORQUE_ENABLE: Final = Register("TORQUE_ENABLE", 64, 1)
STATUS_RETURN_LEVEL: Final = Register("STATUS_RETURN_LEVEL", 68, 1)
HARDWARE_ERROR_STATUS: Final = Register("HARDWARE_ERROR_STATUS", 70, 1)
VELOCITY_I_GAIN: Final = Register("VELOCITY_I_GAIN", 76, 2)
VELOCITY_P_GAIN: Final = Register("VELOCITY_P_GAIN", 78, 2)
BUS_WATCHDOG: Final = Register("BUS_WATCHDOG", 98, 1, signed=True)
GOAL_PWM: Final = Register("GOAL_PWM", 100, 2, signed=True)
GOAL_VELOCITY: Final = Register("GOAL_VELOCITY", 104, 4, signed=True)
PROFILE_ACCELERATION: Final = Register("PROFILE_ACCELERATION", 108, 4)
PROFILE_VELOCITY: Final = Register("PROFILE_VELOCITY", 112, 4)
GOAL_POSITION: Final = Register("GOAL_POSITION", 116, 4, signed=True)
MOVING: Final = Register("MOVING", 122, 1)
PRESENT_LOAD: Final = Register("PRESENT_LOAD", 126, 2, signed=True)
"""Load, 0.1 % of the greatest torque; on models with a current sensor, the current."""
PRESENT_VELOCITY: Final = Register("PRESENT_VELOCITY", 128, 4, signed=True)
PRESENT_POSITION: Final = Register("PRESENT_POSITION", 132, 4, signed=True)
PRESENT_INPUT_VOLTAGE: Final = Register("PRESENT_INPUT_VOLTAGE", 144, 2)
PRESENT_TEMPERATURE: Final = Register("PRESENT_TEMPERATURE", 146, 1)

REGISTERS: Final = tuple(
    one for one in list(globals().values()) if isinstance(one, Register) and one != PRESENT_LOAD
)
"""Registers that each of `MODELS` has, by address."""

EEPROM_END: Final = 64
"""Address after the last register that is locked while torque is on (physical: X series)."""

TICKS_PER_TURN: Final = 4096
"""Encoder ticks per turn (physical: X series)."""
TICK_RAD: Final = 2 * pi / TICKS_PER_TURN
"""Unit of positions, rad (physical: X series)."""
TICK_RAD_S: Final = 0.229 * 2 * pi / 60
"""Unit of velocities, 0.229 rev/min in rad/s (physical: X series)."""
CENTRE_TICKS: Final = 2048
"""Position in the middle of the turn, ticks (physical: X series)."""
FULL_PWM: Final = 885
"""PWM_LIMIT and GOAL_PWM without a limit, in units of 0.113 % (physical: X series)."""
NO_SECONDARY_ID: Final = 253
"""Least SECONDARY_ID of a servo that has none; the factory's is 255 (physical: X series)."""
WATCHDOG_S: Final = 0.02
"""Unit of BUS_WATCHDOG, s (physical: X series)."""
WATCHDOG_MOST: Final = 127
"""Longest watchdog time, in its unit; 0 switches it off (physical: X series)."""
WATCHDOG_TRIPPED: Final = -1
"""BUS_WATCHDOG of a servo stopped for lack of packets; writing 0 clears it (physical: X series)."""

# Values of OPERATING_MODE (physical: X series).
VELOCITY_MODE: Final = 1
POSITION_MODE: Final = 3
EXTENDED_POSITION_MODE: Final = 4

BAUD_RATES: Final = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""Baud rates by the value of BAUD_RATE, bit/s (physical: X series)."""

MODELS: Final = {
    30: "MX-28",
    311: "MX-64",
    321: "MX-106",
    1000: "XH430-W350",
    1001: "XD430-T350",
    1010: "XH430-W210",
    1011: "XD430-T210",
    1020: "XM430-W350",
    1030: "XM430-W210",
    1040: "XH430-V350",
    1050: "XH430-V210",
    1060: "XL430-W250",
    1070: "XC430-W150",
    1080: "XC430-W240",
    1090: "2XL430-W250",
    1100: "XH540-W270",
    1101: "XD540-T270",
    1110: "XH540-W150",
    1111: "XD540-T150",
    1120: "XM540-W270",
    1130: "XM540-W150",
    1140: "XH540-V270",
    1150: "XH540-V150",
    1160: "2XC430-W250",
    1170: "XW540-T260",
    1180: "XW540-T140",
    1190: "XL330-M077",
    1200: "XL330-M288",
    1210: "XC330-T181",
    1220: "XC330-T288",
    1230: "XC330-M181",
    1240: "XC330-M288",
    1270: "XW430-T333",
    1310: "XW540-H260",
}
"""Servos with these registers and units, by MODEL_NUMBER; of MX servos, those with Protocol 2.0.

Users report that on XL330 and XC330 with firmware 51 a tripped BUS_WATCHDOG does not stop the motor
(forum.robotis.com/t/4814).
"""


def model_number(name: str) -> int:
    """MODEL_NUMBER of a servo."""
    for number, known in MODELS.items():
        if known == name:
            return number
    raise ConfigurationError(
        f"servo: expected one of Dynamixel's X series with Protocol 2.0, got {name}"
    )


def factory_velocity_gains(number: int) -> tuple[tuple[int, int], ...]:
    """VELOCITY_I_GAIN and VELOCITY_P_GAIN from the factory: all that ROBOTIS's manuals have had."""
    name = MODELS.get(number, "")
    if name.startswith("XL430"):
        return (1000, 100), (1920, 100)
    if name.startswith("2XL430"):
        return (1000, 100), (1800, 100), (1920, 100)
    if name.startswith(("XL330", "XC330")):
        return (1600, 180), (1200, 40)
    return ((1920, 100),)


REGISTER_SPANS: Final = (
    (0, 14),
    (20, 4),
    (31, 7),
    (44, 4),
    (63, 2),
    (68, 3),
    (76, 4),
    (120, 27),
)
"""Addresses and lengths of the spans that are read; their registers exist without gaps in all
models (physical: Dynamixel X series)."""
MOTION_SPAN: Final = (
    PRESENT_VELOCITY.address,
    PRESENT_VELOCITY.length + PRESENT_POSITION.length,
)
"""Address and length of the present velocity and, directly after it, the present position."""
PRESENT_VALUES_SPAN: Final = REGISTER_SPANS[-1]
"""Span of present load, velocity, position, voltage and temperature. It begins with the servo's own
clock, so that answers of two servos differ even where all else is alike."""
_FAULT_BIT_TEXTS: Final = {
    0: "input voltage",
    2: "overheating",
    3: "motor encoder",
    4: "electrical shock",
    5: "overload",
}
"""Bits of HARDWARE_ERROR_STATUS, after ROBOTIS's manuals."""


class ServoMemory:
    """Copies of spans of a servo's control table: bytes by first address."""

    def __init__(self, spans: dict[int, bytes]) -> None:
        self._spans = spans

    def get(self, register: Register) -> int:
        """Value of a register, which has to lie in one of the spans."""
        for address, data in self._spans.items():
            if address <= register.address and register.end <= address + len(data):
                return register.decode(data[register.address - address : register.end - address])
        raise KeyError(register.name)


def describe_fault_bits(errors: int) -> str:
    """Describe the bits of HARDWARE_ERROR_STATUS in words."""
    bits = [bit for bit in range(8) if errors >> bit & 1]
    return ", ".join(_FAULT_BIT_TEXTS.get(bit, f"unknown fault {bit}") for bit in bits)


def model_name(number: int) -> str:
    """Name of a model, or its number if it is not in `MODELS`."""
    return MODELS.get(number, f"model {number}")
