"""A pseudo-terminal in place of the servos' serial line, with a queue of timed answers."""

import heapq
import os
import sys
from math import inf
from typing import Final

from vergence.errors import ConfigurationError
from vergence.hardware.dynamixel.control_table import BAUD_RATES

_MAX_READ_BYTES: Final = 4096
"""Most bytes of one read (numerical)."""


class PseudoTerminal:
    """The servos' end of a serial line.

    Attributes:
        fd: the file descriptor to read from; -1 once the cable is pulled.
        port: the device file of the other end.

    Raises:
        ConfigurationError: the system has no pseudo-terminals.
    """

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise ConfigurationError(
                "emulate: expected Linux or macOS, whose pseudo-terminals stand for a serial line"
            )
        import tty

        self.fd, self._other = os.openpty()
        tty.setraw(self._other)
        self.port = os.ttyname(self._other)
        self._due: list[tuple[float, int, bytes]] = []
        self._count = 0

    @property
    def baud_rate(self) -> int:
        """Baud rate that the other end has set, see `baud_rate_of`."""
        return baud_rate_of(self.fd)

    def read(self) -> bytes:
        """Read the bytes that have arrived."""
        return os.read(self.fd, _MAX_READ_BYTES)

    def send(self, data: bytes, at_s: float) -> None:
        """Queue bytes to be sent at a time, see `flush`."""
        if self.fd < 0:
            return
        self._count += 1  # keeps the order of bytes with equal times
        heapq.heappush(self._due, (at_s, self._count, data))

    @property
    def due_s(self) -> float:
        """Time at which the next bytes are due, s; inf for none."""
        return self._due[0][0] if self._due else inf

    def flush(self, now_s: float) -> None:
        """Send the bytes that are due."""
        while self.due_s <= now_s:
            os.write(self.fd, heapq.heappop(self._due)[2])

    def unplug(self) -> None:
        """Pull the cable: the other end receives nothing more; a second call does nothing."""
        self._due.clear()
        if self.fd >= 0:
            os.close(self.fd)
            os.close(self._other)
            self.fd = self._other = -1


def baud_rate_of(fd: int) -> int:
    """Baud rate set on a terminal, bit/s; 0 for one that servos or the system do not support."""
    import termios

    speed = termios.tcgetattr(fd)[5]
    return next((rate for rate in BAUD_RATES if getattr(termios, f"B{rate}", -1) == speed), 0)
