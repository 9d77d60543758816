"""Servos on a serial line: requests, and the matching of answers to them."""

import errno
import logging
import os
import re
import select
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Final, TypeVar

from vergence.errors import ConfigurationError, HardwareError, ServoRefusalError
from vergence.hardware.dynamixel.control_table import (
    EEPROM_END,
    REGISTER_SPANS,
    Register,
    ServoMemory,
)
from vergence.hardware.dynamixel.packets import (
    BROADCAST,
    ERRORS,
    MOST_ID,
    ErrorNumber,
    Instruction,
    PacketParser,
    Status,
    instruction_packet,
)

_LOG: Final = logging.getLogger(__name__)
_T = TypeVar("_T")
CYCLE_TIMEOUT_S: Final = 0.006
"""Timeout of the answers to a sync read, beyond their time on the wire, s (chosen).

Four servos answer within 1.6 ms at 1 Mb/s; a silent one costs at most this much of a period.
"""
SINGLE_TIMEOUT_S: Final = 0.05
"""Timeout of one servo's answer, beyond its time on the wire, s: slow adapters (chosen)."""
EEPROM_TIMEOUT_S: Final = 0.15
"""Timeout of the answer to a write into the EEPROM, beyond its time on the wire, s: more than twice
the 60 ms that servos have been seen to take (chosen)."""
SYNC_READ_BYTES: Final = 14
"""Length of a sync read without its ids, bytes (physical: Protocol 2.0)."""
REQUESTS: Final = 4
"""Requests of the same before an answer counts as missing: where 2 % of the packets are lost each
way, a start with its 200 requests then fails once in 2,000 (chosen)."""
_STATUS_BYTES: Final = 11
"""Length of a status packet without data, bytes (physical: Protocol 2.0)."""
_LINE_LOST_ERRNOS: Final = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF)
_MAX_READ_BYTES: Final = 4096
"""Most bytes of one read: more than the answers to one request (numerical)."""
_MAX_DRAIN_BYTES: Final = 1 << 16
"""Most bytes that `drain` reads, so that it ends on a line that is never silent (chosen)."""


class SerialLine:
    """An open serial port of this process alone, with timeouts on the monotonic clock."""

    def __init__(self, port: str, baud: int = 1_000_000) -> None:
        try:
            import fcntl
            import termios
        except ImportError:
            raise HardwareError(
                f"{port}: expected Linux or macOS for servos on a serial line, got {sys.platform}"
            ) from None
        import serial

        self.port, self.baud = port, baud
        try:
            self._serial = serial.Serial(port, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            if isinstance(error, ValueError):
                raise HardwareError(f"{port}: expected {baud} baud, got {error}") from None
            raise HardwareError(f"{port}: expected {_reason(error)}") from None
        fcntl.ioctl(self._serial, termios.TIOCEXCL)  # against those that take no file lock
        # bytes without delay: FTDI adapters otherwise collect them for 16 ms
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._serial.set_low_latency_mode(True)
        _LOG.info("%s opened at %d baud", port, baud)

    def wire_s(self, count: int) -> float:
        """Time of a number of bytes on the wire, s: ten bits each."""
        return 10.0 * count / self.baud

    def send(self, data: bytes, timeout_s: float = 0.1) -> None:
        """Write all bytes; raise a `HardwareError` if the line does not take them in time."""
        until_s = time.monotonic() + timeout_s
        left = memoryview(data)
        while left:
            try:
                left = left[os.write(self._descriptor(), left) :]
            except BlockingIOError:
                if not self._ready(until_s, to_write=True):
                    raise HardwareError(
                        f"{self.port}: expected to send {len(data)} bytes within "
                        f"{1e3 * timeout_s:.0f} ms, {len(left)} are left"
                    ) from None
            except OSError as error:
                raise self._fault(error) from error

    def receive(self, until_s: float) -> bytes:
        """Wait for the next bytes until a time on `time.monotonic`, s; none after it."""
        if not self._ready(until_s):
            return b""
        try:
            data = os.read(self._descriptor(), _MAX_READ_BYTES)
        except BlockingIOError:  # another reader has taken the bytes
            return b""
        except OSError as error:
            raise self._fault(error) from error
        if not data:  # readable but empty: end of file
            raise self._fault(OSError(errno.EIO, ""))
        return data

    def drain(self) -> bytes:
        """Read all bytes that have arrived, without waiting."""
        drained = b""
        while len(drained) < _MAX_DRAIN_BYTES and (data := self.receive(0.0)):
            drained += data
        return drained

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        if not self._serial.is_open:
            return
        import fcntl
        import termios

        with suppress(OSError):
            fcntl.ioctl(self._serial, termios.TIOCNXCL)
        with suppress(OSError):
            self._serial.close()
        _LOG.info("%s closed", self.port)

    def _descriptor(self) -> int:
        if not self._serial.is_open:
            raise HardwareError(f"{self.port}: expected an open serial line, got a closed one")
        return int(self._serial.fd)

    def _ready(self, until_s: float, *, to_write: bool = False) -> bool:
        """Wait until the line is readable, or writable; False after the time limit."""
        fd = [self._descriptor()]
        left_s = max(until_s - time.monotonic(), 0.0)
        try:
            found = select.select([] if to_write else fd, fd if to_write else [], [], left_s)
        except OSError as error:
            raise self._fault(error) from error
        return bool(found[0] or found[1])

    def _fault(self, error: OSError) -> HardwareError:
        if error.errno in _LINE_LOST_ERRNOS:
            return HardwareError(f"{self.port}: the serial line is gone (was the cable pulled?)")
        return HardwareError(f"{self.port}: {error}")


def _reason(error: OSError) -> str:
    """What was expected of a port that cannot be opened, and what it is."""
    # pyserial gives the number of an error that it meets while it sets the port up in its text
    text = re.search(r"\((\d+), ", str(error))
    number = error.errno or (int(text[1]) if text else None)
    if number in (errno.EBUSY, errno.EAGAIN):
        return "a port that is free, got one that another process has open"
    if number == errno.EACCES:
        return (
            "a serial port, got no permission (on most Linux systems, users of the group dialout "
            "have it)"
        )
    return f"a serial port, got {os.strerror(number) if number else error}"


def ask_again(ask: Callable[[], _T], requests: int = REQUESTS) -> _T:
    """Make a request until it is answered, at most so often; the last one's error is raised."""
    for _ in range(requests - 1):
        with suppress(HardwareError):
            return ask()
    return ask()


class Bus:
    """The servos of one serial line, with one open request at a time.

    An answer counts if it is a status packet of an addressed servo with the requested length. All
    other packets are ignored: the bus's own packets, which adapters for half-duplex lines may echo,
    and answers to earlier requests. Bytes that arrive before a request are discarded. (A late
    answer of the same servo and length that arrives after the next request cannot be distinguished
    from the right one, as the protocol does not number requests.)

    The servos' STATUS_RETURN_LEVEL must be 2, the factory default.
    """

    def __init__(
        self,
        port: str,
        baud: int = 1_000_000,
        *,
        cycle_timeout_s: float = CYCLE_TIMEOUT_S,
        single_timeout_s: float = SINGLE_TIMEOUT_S,
    ) -> None:
        self.line = SerialLine(port, baud)
        self.cycle_timeout_s, self.single_timeout_s = cycle_timeout_s, single_timeout_s
        self.missed_answers = 0
        self.stale: Counter[int] = Counter()  # answers by id without an open request, as late ones
        self.exchange_s = 0.0  # from the last request to the last of its answers
        self.names: dict[int, str] = {}  # of servos by id, for messages
        self.alerts: set[int] = set()  # ids whose last answer announced a hardware error
        self._parser = PacketParser()

    @property
    def port(self) -> str:
        """Device file of the line."""
        return self.line.port

    @property
    def damaged_packets(self) -> int:
        """Number of headers so far that began no valid packet."""
        return self._parser.rejected

    def ping(self, id: int, requests: int = 1) -> int | None:
        """Ping a servo; return its model number, None if none has this id.

        Servos whose answers damage each other give a damaged packet for each request.
        """
        _check_id(id)
        packet = instruction_packet(id, Instruction.PING)
        for _ in range(requests):
            answers, _ = self._ask(packet, [id], 3, self.single_timeout_s)
            if id in answers:
                return int.from_bytes(answers[id].data[:2], "little")
        return None

    def read(self, id: int, register: Register, requests: int = REQUESTS) -> int:
        """Read the value of a register, and ask again if the answer is lost."""
        return ask_again(lambda: self._read(id, register), requests)

    def _read(self, id: int, register: Register) -> int:
        _check_id(id)
        packet = instruction_packet(id, Instruction.READ, _span(register.address, register.length))
        question, timeout_s = f"a read of {register.name}", self.single_timeout_s
        status = self._answer(packet, id, register.length, question, timeout_s)
        return register.decode(status.data)

    def write(self, id: int, register: Register, value: int, requests: int = REQUESTS) -> None:
        """Write a value into a register until the servo confirms it."""
        ask_again(lambda: self._write(id, register, value), requests)

    def _write(self, id: int, register: Register, value: int) -> None:
        _check_id(id)
        params = register.address.to_bytes(2, "little") + _encoded(register, value)
        packet = instruction_packet(id, Instruction.WRITE, params)
        timeout_s = self.single_timeout_s
        if register.address < EEPROM_END:
            timeout_s = max(timeout_s, EEPROM_TIMEOUT_S)
        self._answer(packet, id, 0, f"a write of {value} to {register.name}", timeout_s)

    def sync_read(
        self, ids: Iterable[int], address: int, length: int, *, timeout_s: float | None = None
    ) -> dict[int, bytes]:
        """Read a span of registers from several servos with one request."""
        ids = list(dict.fromkeys(ids))
        for id in ids:
            _check_id(id)
        if not ids:
            return {}
        params = _span(address, length) + bytes(ids)
        packet = instruction_packet(BROADCAST, Instruction.SYNC_READ, params)
        wait_s = self.cycle_timeout_s if timeout_s is None else timeout_s
        answers, _ = self._ask(packet, ids, length, wait_s)
        found = {id: answers[id].data for id in ids if id in answers and not answers[id].error}
        self.missed_answers += len(ids) - len(found)
        return found

    def read_memory(
        self, id: int, spans: Sequence[tuple[int, int]] = REGISTER_SPANS
    ) -> ServoMemory:
        """Read spans of a servo's registers, addresses and lengths."""
        found: dict[int, bytes] = {}
        for address, length in spans:
            for _ in range(REQUESTS):
                answers = self.sync_read([id], address, length, timeout_s=self.single_timeout_s)
                if id in answers:
                    found[address] = answers[id]
                    break
            else:
                raise HardwareError(
                    f"expected an answer of the id {id} to a read of {length} bytes at the address "
                    f"{address}, got none"
                )
        return ServoMemory(found)

    def sync_write(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of several servos at once; they do not answer."""
        params = _span(register.address, register.length)
        for id, value in values.items():
            _check_id(id)
            params += bytes((id,)) + _encoded(register, value)
        self.line.send(instruction_packet(BROADCAST, Instruction.SYNC_WRITE, params))

    def close(self) -> None:
        """Release the line; the servos continue with their last goals."""
        self.line.close()

    def _answer(
        self, packet: bytes, id: int, length: int, question: str, timeout_s: float
    ) -> Status:
        answers, other = self._ask(packet, [id], length, timeout_s)
        name = f"servos: {self.names[id]}: " if id in self.names else ""
        expected = f"{name}id {id} on {self.port}: expected an answer to {question}"
        if id not in answers:
            self.missed_answers += 1
            came = f"one of {other[id]} bytes, not {length}" if id in other else "none"
            raise HardwareError(f"{expected} within {1e3 * timeout_s:.0f} ms, got {came}")
        status = answers[id]
        if status.error:
            raise ServoRefusalError(f"{expected}, got error {_in_words(status.error)}")
        return status

    def _ask(
        self, packet: bytes, ids: list[int], length: int, timeout_s: float
    ) -> tuple[dict[int, Status], dict[int, int]]:
        """Send a request and wait for its answers."""
        self._discard_late()
        self.line.send(packet)
        answers_bytes = len(ids) * (_STATUS_BYTES + length)
        asked_s = time.monotonic()
        until_s = asked_s + timeout_s + self.line.wire_s(len(packet) + answers_bytes)
        answers: dict[int, Status] = {}
        other: dict[int, int] = {}
        while len(answers) < len(ids):
            data = self.line.receive(until_s)
            if not data:
                break
            for status in self._statuses(data):
                # an error answer has no data
                fits = len(status.data) == (0 if status.error else length)
                if status.id in ids and status.id not in answers and fits:
                    answers[status.id] = status
                    self.exchange_s = time.monotonic() - asked_s
                    continue
                self.stale[status.id] += 1
                if status.id in ids:
                    other[status.id] = len(status.data)
            if time.monotonic() > until_s:  # a line that babbles never runs out of data
                break
        return answers, other

    def _discard_late(self) -> None:
        self.stale.update(status.id for status in self._statuses(self.line.drain()))
        self._parser.clear()

    def _statuses(self, data: bytes) -> list[Status]:
        damaged = self.damaged_packets
        packets = self._parser.feed(data)
        if self.damaged_packets > damaged:
            _LOG.debug("%s: packets damaged: %d", self.port, self.damaged_packets - damaged)
        statuses = [status for packet in packets if (status := packet.status) is not None]
        for status in statuses:
            if status.alert:
                self.alerts.add(status.id)
            else:
                self.alerts.discard(status.id)
        return statuses


def _check_id(id: int) -> None:
    if not 0 <= id <= MOST_ID:
        raise ConfigurationError(f"id: expected 0 to {MOST_ID}, got {id}")


def _encoded(register: Register, value: int) -> bytes:
    if not register.least <= value <= register.most:
        raise ConfigurationError(
            f"{register.name}: expected {register.least} to {register.most}, got {value}"
        )
    return register.encode(value)


def _span(address: int, length: int) -> bytes:
    return address.to_bytes(2, "little") + length.to_bytes(2, "little")


def _in_words(error: int) -> str:
    known = error in ErrorNumber.__members__.values()
    return f"{error} ({ERRORS[ErrorNumber(error)]})" if known else f"{error} (not in the protocol)"
