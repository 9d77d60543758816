"""Requests to one servo that are repeated if the answer is lost."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final, TypeVar

from vergence.errors import HardwareError
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.control_table import Register

REQUESTS: Final = 4
"""Requests of the same before an answer counts as missing: where 2 % of the packets are lost each
way, a start with its 200 requests then fails once in 2,000 (chosen)."""
_T = TypeVar("_T")


def read_register(bus: Bus, id: int, register: Register) -> int:
    """Read the value of a servo's register.

    Raises:
        ServoRefusalError: the servo refuses.
        HardwareError: it does not answer, or the line is gone.
    """
    return ask_again(partial(bus.read, id, register))


def write_register(bus: Bus, id: int, register: Register, value: int) -> None:
    """Write a value into a servo's register, and wait for its confirmation.

    Raises:
        ServoRefusalError: the servo refuses.
        HardwareError: it does not answer, or the line is gone.
    """
    ask_again(partial(bus.write, id, register, value))


def ping_again(bus: Bus, id: int) -> int | None:
    """Ping a servo; return its model number, None if none with this id answers.

    Servos whose answers damage each other give `REQUESTS` damaged packets.

    Raises:
        HardwareError: the line is gone.
    """
    for _ in range(REQUESTS):
        model = bus.ping(id)
        if model is not None:
            return model
    return None


def ask_again(ask: Callable[[], _T], requests: int = REQUESTS) -> _T:
    """Make a request until it is answered.

    Args:
        ask: makes the request; raises an error without an answer.
        requests: most calls; the error of the last one is raised.

    Raises:
        HardwareError: no request was answered.
    """
    for _ in range(requests - 1):
        with suppress(HardwareError):
            return ask()
    return ask()
