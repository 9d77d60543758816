"""Copies of a servo's registers, and its faults in words."""

from typing import Final

from vergence.errors import HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.control_table import Register
from vergence.hardware.dynamixel.repeated import REQUESTS

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
    table.PRESENT_VELOCITY.address,
    table.PRESENT_VELOCITY.length + table.PRESENT_POSITION.length,
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
    """Copies of spans of a servo's control table.

    Args:
        spans: bytes of each span by its first address.
    """

    def __init__(self, spans: dict[int, bytes]) -> None:
        self._spans = spans

    def get(self, register: Register) -> int:
        """Value of a register, which has to lie in one of the spans."""
        for address, data in self._spans.items():
            if address <= register.address and register.end <= address + len(data):
                return register.decode(data[register.address - address : register.end - address])
        raise KeyError(register.name)


def read_memory(
    bus: Bus, id: int, spans: tuple[tuple[int, int], ...] = REGISTER_SPANS
) -> ServoMemory:
    """Read a servo's registers.

    Args:
        bus: the servo's line.
        id: id of the servo.
        spans: addresses and lengths to read.

    Raises:
        HardwareError: the servo does not answer, or the line is gone.
    """
    found: dict[int, bytes] = {}
    for address, length in spans:
        for _ in range(REQUESTS):
            answers = bus.sync_read([id], address, length, timeout_s=bus.single_timeout_s)
            if id in answers:
                found[address] = answers[id]
                break
        else:
            raise HardwareError(
                f"expected an answer of the id {id} to a read of {length} bytes at the address "
                f"{address}, got none"
            )
    return ServoMemory(found)


def describe_fault_bits(errors: int) -> str:
    """Describe the bits of HARDWARE_ERROR_STATUS in words."""
    bits = [bit for bit in range(8) if errors >> bit & 1]
    return ", ".join(_FAULT_BIT_TEXTS.get(bit, f"unknown fault {bit}") for bit in bits)


def model_name(number: int) -> str:
    """Name of a model, or its number if it is not in `control_table.MODELS`."""
    return table.MODELS.get(number, f"model {number}")
