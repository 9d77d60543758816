"""Servos on a serial line: requests, and the matching of answers to them."""

import logging
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Final

from vergence.errors import ConfigurationError, HardwareError, ServoRefusalError
from vergence.hardware.dynamixel.control_table import EEPROM_END, Register
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
from vergence.hardware.dynamixel.serial_line import SerialLine

_LOG: Final = logging.getLogger(__name__)
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
_STATUS_BYTES: Final = 11
"""Length of a status packet without data, bytes (physical: Protocol 2.0)."""


class Bus:
    """The servos of one serial line, with one open request at a time.

    An answer counts if it is a status packet of an addressed servo with the requested length. All
    other packets are ignored: the bus's own packets, which adapters for half-duplex lines may echo,
    and answers to earlier requests. Bytes that arrive before a request are discarded. (A late
    answer of the same servo and length that arrives after the next request cannot be distinguished
    from the right one, as the protocol does not number requests.)

    The servos' STATUS_RETURN_LEVEL must be 2, the factory default.

    Args:
        port: the device file, such as "/dev/ttyUSB0".
        baud: baud rate, bit/s.
        cycle_timeout_s: timeout of the answers to a sync read, beyond their time on the wire, s.
        single_timeout_s: timeout of a single answer, beyond its time on the wire, s; a write into
            the EEPROM has `EEPROM_TIMEOUT_S` at least.

    Attributes:
        line: the serial line.
        names: names of servos by id, for messages.
        exchange_s: time from the last request to the last of its answers, s.
        missed_answers: number of answers that did not arrive.
        stale: number of answers by id that did not match the open request, as late ones.
        alerts: ids of the servos whose last answer announced a hardware error.

    Raises:
        HardwareError: see `SerialLine`.
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
        self.stale: Counter[int] = Counter()
        self.exchange_s = 0.0
        self.names: dict[int, str] = {}
        self.alerts: set[int] = set()
        self._parser = PacketParser()

    @property
    def port(self) -> str:
        """Device file of the line."""
        return self.line.port

    @property
    def damaged_packets(self) -> int:
        """Number of headers so far that began no valid packet."""
        return self._parser.rejected

    def ping(self, id: int) -> int | None:
        """Ping a servo; return its model number, None if none has this id.

        Raises:
            HardwareError: the line is gone.
        """
        _check_id(id)
        packet = instruction_packet(id, Instruction.PING)
        answers, _ = self._ask(packet, [id], 3, self.single_timeout_s)
        return int.from_bytes(answers[id].data[:2], "little") if id in answers else None

    def read(self, id: int, register: Register) -> int:
        """Read the value of a register.

        Raises:
            ServoRefusalError: the servo refuses.
            HardwareError: the servo does not answer, or the line is gone.
        """
        _check_id(id)
        packet = instruction_packet(id, Instruction.READ, _span(register.address, register.length))
        question, timeout_s = f"a read of {register.name}", self.single_timeout_s
        status = self._answer(packet, id, register.length, question, timeout_s)
        return register.decode(status.data)

    def write(self, id: int, register: Register, value: int) -> None:
        """Write a value into a register, and wait for the servo's confirmation.

        Raises:
            ConfigurationError: the register cannot hold the value.
            ServoRefusalError: the servo refuses.
            HardwareError: the servo does not answer, or the line is gone.
        """
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
        """Read a span of registers from several servos with one request.

        Args:
            ids: ids of the servos.
            address: address of the first byte.
            length: number of bytes.
            timeout_s: timeout in place of the bus's `cycle_timeout_s`, s.

        Returns:
            The bytes of the servos that answered, by id.

        Raises:
            HardwareError: the line is gone.
        """
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

    def sync_write(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of several servos at once; they do not answer.

        Args:
            register: the register.
            values: values by id.

        Raises:
            ConfigurationError: the register cannot hold a value.
            HardwareError: the line is gone.
        """
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
        """Send a request and wait for its answers.

        Returns:
            Matching answers by id, and the data lengths of answers with a wrong length by id.
        """
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
