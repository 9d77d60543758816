"""Emulated servos on a shared line: the addressees of a packet, and their answers.

Nothing here reads a clock or does I/O: `ServoLine.answer` takes a packet and its time of arrival,
and returns the answers of the servos with their return delays.

Servos with the same id answer at the same time. On the line a 0 overrides a 1, so what arrives is
the AND of their bytes: it stays intact if all send the same, as to a ping, and else is damaged. A
servo obeys what is written to its SECONDARY_ID, without an answer.

Not emulated, and answered with an error: registered instructions, fast and bulk reads.
"""

from collections.abc import Iterable, Iterator
from functools import reduce
from itertools import zip_longest
from operator import and_
from typing import Final, NamedTuple

import numpy as np

from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import (
    ALERT,
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    status_packet,
)
from vergence.hardware.emulator.servo import EmulatedServo
from vergence.models.parts import FloatArray

_RETURN_DELAY_UNIT_S: Final = 2e-6
"""Unit of RETURN_DELAY_TIME, s (physical: Dynamixel X series)."""


class TimedAnswer(NamedTuple):
    """A status packet that a servo sends."""

    id: int
    return_delay_s: float
    """Its RETURN_DELAY_TIME and the time that it writes to its EEPROM, from the end of the request
    or of the answer before it, s."""
    data: bytes


class ServoLine:
    """Servos that share a line.

    In a sync read the servos after a silent one answer all the same.

    Args:
        servos: the servos.
    """

    def __init__(self, servos: Iterable[EmulatedServo]) -> None:
        self.servos = tuple(servos)

    @property
    def watchdog_trips(self) -> int:
        """Number of times that watchdogs have stopped servos."""
        return sum(servo.watchdog_trips for servo in self.servos)

    def advance_to(self, now_s: float) -> None:
        """Advance all joints to a time, s; an earlier time than before changes nothing."""
        for servo in self.servos:
            servo.advance_to(now_s)

    def positions(self) -> FloatArray:
        """True angles of the joints, rad, shape (n,)."""
        return np.array([servo.q for servo in self.servos])

    def velocities(self) -> FloatArray:
        """True velocities of the joints, rad/s, shape (n,)."""
        return np.array([servo.v for servo in self.servos])

    def answer(
        self, packet: Packet, now_s: float, baud_rate: int | None = None
    ) -> list[TimedAnswer]:
        """Status packets that answer a packet, in their order.

        Args:
            packet: any packet from the line.
            now_s: time of its arrival, on the clock of `advance_to`, s.
            baud_rate: baud rate at which it was sent; servos with another rate do not receive it.
                None for each servo's own.
        """
        self.advance_to(now_s)
        if packet.instruction == Instruction.STATUS:
            return []
        present = [
            servo
            for servo in self.servos
            if not servo.silent and baud_rate in (None, servo.baud_rate)
        ]
        for servo in present:
            servo.feed_watchdog(now_s)
        if packet.instruction == Instruction.SYNC_READ:
            return _overlapping(_sync_read(present, packet))
        if packet.instruction == Instruction.SYNC_WRITE:
            _sync_write(present, packet)
            return []
        answers = []
        for servo in present:
            if packet.id in (servo.id, BROADCAST):
                answers.append(_execute(servo, packet))
            elif packet.instruction == Instruction.WRITE and _obeys(servo, packet.id):
                _execute(servo, packet)
        return _overlapping(answer for answer in answers if answer is not None)


def _obeys(servo: EmulatedServo, id: int) -> bool:
    """True if a servo carries out what is written to an id."""
    return id == servo.id or (id == servo.get(table.SECONDARY_ID) and id < table.NO_SECONDARY_ID)


def _overlapping(answers: Iterable[TimedAnswer]) -> list[TimedAnswer]:
    """Answers as they arrive, in the order of their ids' first ones."""
    order: dict[int, list[TimedAnswer]] = {}
    for answer in answers:
        order.setdefault(answer.id, []).append(answer)
    return [
        same[0]
        if len(same) == 1
        else TimedAnswer(
            id, max(one.return_delay_s for one in same), _anded(one.data for one in same)
        )
        for id, same in order.items()
    ]


def _anded(packets: Iterable[bytes]) -> bytes:
    """Bytes of packets that are sent at once: after its end a packet leaves the line at 1."""
    columns = zip_longest(*packets, fillvalue=0xFF)
    return bytes(reduce(and_, column) for column in columns)


def _execute(servo: EmulatedServo, packet: Packet) -> TimedAnswer | None:
    """Execute an instruction on one servo; answer it if the servo's return level asks for it."""
    level, id = servo.get(table.STATUS_RETURN_LEVEL), servo.id
    params, data, error, busy_s = packet.params, b"", 0, 0.0
    least_level = 2
    if packet.instruction == Instruction.PING:
        least_level = 0
        data = bytes(servo.memory.bytes[0:2]) + bytes(servo.memory.bytes[6:7])
    elif packet.instruction == Instruction.READ:
        least_level = 1
        if len(params) == 4:
            error, data = servo.read(_number(params, 0), _number(params, 2))
        else:
            error = ErrorNumber.DATA_LENGTH
    elif packet.instruction == Instruction.WRITE:
        short = len(params) < 2
        error = ErrorNumber.DATA_LENGTH if short else servo.write(_number(params, 0), params[2:])
        if not short and not error and _number(params, 0) < table.EEPROM_END:
            busy_s = servo.eeprom_write_s
    elif packet.instruction == Instruction.REBOOT:
        servo.reboot()
    else:
        error = ErrorNumber.INSTRUCTION
    quiet = level < least_level or (packet.id == BROADCAST and least_level > 0)
    return None if quiet else _status(servo, id, data, error, busy_s)


def _sync_read(servos: list[EmulatedServo], packet: Packet) -> Iterator[TimedAnswer]:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    for id in packet.params[4:]:
        for servo in servos:
            if servo.id == id and servo.get(table.STATUS_RETURN_LEVEL) >= 1:
                error, data = servo.read(address, length)
                yield _status(servo, id, data, error)


def _sync_write(servos: list[EmulatedServo], packet: Packet) -> None:
    if packet.id != BROADCAST or len(packet.params) < 4:
        return
    address, length = _number(packet.params, 0), _number(packet.params, 2)
    for at in range(4, len(packet.params) - length, length + 1):
        for servo in servos:
            if _obeys(servo, packet.params[at]):
                servo.write(address, packet.params[at + 1 : at + 1 + length])


def _status(
    servo: EmulatedServo, id: int, data: bytes, error: int, busy_s: float = 0.0
) -> TimedAnswer:
    alert = ALERT if servo.get(table.HARDWARE_ERROR_STATUS) else 0
    delay_s = _RETURN_DELAY_UNIT_S * servo.get(table.RETURN_DELAY_TIME)
    return TimedAnswer(id, busy_s + delay_s, status_packet(id, data, error | alert))


def _number(params: bytes, at: int) -> int:
    return int.from_bytes(params[at : at + 2], "little")
