"""A serial line with timeouts on the monotonic clock, opened exclusively by this process."""

import errno
import logging
import os
import select
import sys
import time
from contextlib import suppress
from typing import Any, Final

from vergence.errors import HardwareError, how_to_install

_LOG: Final = logging.getLogger(__name__)
_LINE_LOST_ERRNOS: Final = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF)
_MAX_READ_BYTES: Final = 4096
"""Most bytes of one read: more than the answers to one request (numerical)."""
_MAX_DRAIN_BYTES: Final = 1 << 16
"""Most bytes that `drain` reads, so that it ends on a line that is never silent (chosen)."""
_ASYNC_LOW_LATENCY: Final = 0x2000  # flag of linux/tty_flags.h (physical: Linux)
_FLAGS_OFFSET: Final = 16  # offset of `flags` in serial_struct of linux/serial.h (physical: Linux)
_SERIAL_STRUCT_BYTES: Final = 128  # bytes, no fewer than serial_struct has (numerical)


class SerialLine:
    """An open serial port in raw mode: 8 data bits, no parity, one stop bit, no flow control.

    Args:
        port: the device file, such as "/dev/ttyUSB0".
        baud: baud rate, bit/s.

    Attributes:
        port: the device file.
        baud: baud rate, bit/s.

    Raises:
        HardwareError: the port does not exist, is not a serial port, is open in another process or
            does not support this rate, or the system is neither Linux nor macOS.
    """

    def __init__(self, port: str, baud: int = 1_000_000) -> None:
        try:
            import termios
        except ImportError:
            raise HardwareError(
                f"{port}: expected Linux or macOS for servos on a serial line, got {sys.platform}"
            ) from None
        self.port, self.baud = port, baud
        self._fd = -1
        self._by_pyserial: Any = None  # owns the descriptor if pyserial has set the rate
        try:
            self._fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            self._claim()
            self._set_up()
        except HardwareError:
            self.close()
            raise
        except (OSError, termios.error) as error:
            self.close()
            raise HardwareError(f"{port}: expected a serial port, got {_reason(error)}") from None
        _LOG.info("%s opened at %d baud", port, baud)

    def wire_s(self, count: int) -> float:
        """Time of a number of bytes on the wire, s: ten bits each."""
        return 10.0 * count / self.baud

    def send(self, data: bytes, timeout_s: float = 0.1) -> None:
        """Write all bytes.

        Raises:
            HardwareError: the line is gone, or does not accept all bytes in time.
        """
        until = time.monotonic() + timeout_s
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(self._descriptor(), left) :]
            except BlockingIOError:
                if not self._ready(until, to_write=True):
                    raise HardwareError(
                        f"{self.port}: expected to send {len(data)} bytes within "
                        f"{1e3 * timeout_s:.0f} ms, {len(left)} are left"
                    ) from None
            except OSError as error:
                raise self._fault(error) from error

    def receive(self, until_s: float) -> bytes:
        """Wait for the next bytes.

        Args:
            until_s: time limit on `time.monotonic`, s.

        Returns:
            One byte or more; none after the time limit.

        Raises:
            HardwareError: the line is gone.
        """
        if not self._ready(until_s):
            return b""
        try:
            data = os.read(self._descriptor(), _MAX_READ_BYTES)
        except BlockingIOError:  # another reader has taken the bytes
            return b""
        except OSError as error:
            raise self._fault(error) from error
        if not data:  # readable but empty: end of file
            raise self._gone()
        return data

    def drain(self) -> bytes:
        """Read all bytes that have arrived, without waiting."""
        drained = b""
        while len(drained) < _MAX_DRAIN_BYTES and (data := self.receive(0.0)):
            drained += data
        return drained

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        fd, self._fd = self._fd, -1
        if fd < 0:
            return
        import fcntl
        import termios

        with suppress(OSError):
            fcntl.ioctl(fd, termios.TIOCNXCL)
        if self._by_pyserial is None:
            with suppress(OSError):
                os.close(fd)
        else:
            with suppress(OSError):
                self._by_pyserial.close()
        _LOG.info("%s closed", self.port)

    def _descriptor(self) -> int:
        if self._fd < 0:
            raise HardwareError(f"{self.port}: expected an open serial line, got a closed one")
        return self._fd

    def _ready(self, until_s: float, *, to_write: bool = False) -> bool:
        """Wait until the line is readable, or writable; False after the time limit."""
        fd = [self._descriptor()]
        left_s = max(until_s - time.monotonic(), 0.0)
        try:
            readable, writable, _ = select.select(
                [] if to_write else fd, fd if to_write else [], [], left_s
            )
        except OSError as error:
            raise self._fault(error) from error
        return bool(readable or writable)

    def _fault(self, error: OSError) -> HardwareError:
        return (
            self._gone()
            if error.errno in _LINE_LOST_ERRNOS
            else HardwareError(f"{self.port}: {error}")
        )

    def _gone(self) -> HardwareError:
        return HardwareError(f"{self.port}: the serial line is gone (was the cable pulled?)")

    def _claim(self) -> None:
        """Lock the port against other processes: by a file lock, and against opening."""
        import fcntl
        import termios

        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise HardwareError(
                f"{self.port}: expected a port that is free, got one that another process has open"
            ) from None
        fcntl.ioctl(self._fd, termios.TIOCEXCL)

    def _set_up(self) -> None:
        import termios
        import tty

        speed = getattr(termios, f"B{self.baud}", None)
        if speed is None:
            self._hand_to_pyserial()
            return
        tty.setraw(self._fd)
        attributes = termios.tcgetattr(self._fd)
        attributes[2] |= termios.CLOCAL | termios.CREAD
        attributes[2] &= ~(termios.CSTOPB | termios.CRTSCTS)
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        self._ask_for_low_latency()
        termios.tcflush(self._fd, termios.TCIOFLUSH)

    def _hand_to_pyserial(self) -> None:
        """Let pyserial open the port: it can set rates without a termios constant on any system."""
        try:
            import serial
        except ImportError:
            raise HardwareError(
                f"{self.port}: expected pyserial for {self.baud} baud, got none: "
                f"{how_to_install('robot')}"
            ) from None
        self.close()  # TIOCEXCL would refuse the second opening
        try:
            self._by_pyserial = serial.Serial(self.port, self.baud, timeout=0, write_timeout=0)
        except (OSError, ValueError) as error:
            raise HardwareError(f"{self.port}: expected {self.baud} baud, got {error}") from None
        self._fd = self._by_pyserial.fileno()
        self._claim()
        self._ask_for_low_latency()

    def _ask_for_low_latency(self) -> None:
        """Request bytes without delay: FTDI adapters otherwise collect them for 16 ms."""
        import fcntl
        import termios

        ask, tell = (getattr(termios, name, None) for name in ("TIOCGSERIAL", "TIOCSSERIAL"))
        if ask is None or tell is None:  # only Linux has them
            return
        state = bytearray(_SERIAL_STRUCT_BYTES)
        with suppress(OSError):  # not all drivers support it, not all users may
            fcntl.ioctl(self._fd, ask, state)
            flags = int.from_bytes(state[_FLAGS_OFFSET : _FLAGS_OFFSET + 4], sys.byteorder)
            flags |= _ASYNC_LOW_LATENCY
            state[_FLAGS_OFFSET : _FLAGS_OFFSET + 4] = flags.to_bytes(4, sys.byteorder)
            fcntl.ioctl(self._fd, tell, state)


def _reason(error: Exception) -> str:
    number = error.args[0] if error.args else None
    if number == errno.EACCES:
        return "no permission (on most Linux systems, users of the group dialout have it)"
    if number == errno.EBUSY:
        return "one that another process has open"
    return os.strerror(number) if isinstance(number, int) else str(error)
