"""Dynamixel Protocol 2.0: packets as bytes, in both directions, without I/O.

    FF FF FD 00 | id | length (2) | instruction | parameters ... | CRC-16 (2)

Numbers are little-endian; the length counts what follows it. `FF FF FD` among instruction and
parameters is sent as `FF FF FD FD` (byte stuffing), so that a header never occurs inside a packet,
except where the CRC happens to end one.
"""

from collections.abc import Iterator
from enum import IntEnum
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError

HEADER: Final = b"\xff\xff\xfd\x00"
BROADCAST: Final = 0xFE
"""The id that all servos listen to."""
MOST_ID: Final = 252

MOST_LENGTH: Final = 384
"""Largest length field of a packet that is made or accepted.

All 147 bytes of an X-series servo's own registers fit in, and a sync write of 8 bytes to 40 servos.
The protocol allows 65,535: a broken header that announces so much would hold back what follows it.
"""

_SHORTEST: Final = 3  # instruction and CRC
_FRAME: Final = 7  # header, id and length
_UNSTUFFED: Final = b"\xff\xff\xfd"
_STUFFED: Final = b"\xff\xff\xfd\xfd"


class Instruction(IntEnum):
    """The kinds of packets; all but STATUS come from the controller."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class ErrorNumber(IntEnum):
    """Why a servo did not do what it was told, in the lower seven bits of a status's error."""

    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


ERRORS: Final = {
    ErrorNumber.RESULT_FAIL: "the servo could not carry it out",
    ErrorNumber.INSTRUCTION: "an instruction that the servo does not know",
    ErrorNumber.CRC: "the packet came damaged",
    ErrorNumber.DATA_RANGE: "a value outside the register's range",
    ErrorNumber.DATA_LENGTH: "less data than the register takes",
    ErrorNumber.DATA_LIMIT: "a value beyond the servo's configured limit",
    ErrorNumber.ACCESS: "the register is read-only, or locked while torque is on",
}
"""The error numbers in words."""

ALERT: Final = 0x80
"""The bit of a status's error that says that HARDWARE_ERROR_STATUS is not 0."""


class Status(NamedTuple):
    """A servo's answer.

    Attributes:
        id: who answers.
        error: an `ErrorNumber`, or 0 if the instruction was carried out.
        alert: whether the servo has a hardware error, which is no error of the instruction.
        data: what was read; empty for writes.
    """

    id: int
    error: int
    alert: bool
    data: bytes


class Packet(NamedTuple):
    """A packet without its frame, un-stuffed."""

    id: int
    instruction: int
    params: bytes

    @property
    def status(self) -> Status | None:
        """The packet as a servo's answer; None if it is none."""
        if self.instruction != Instruction.STATUS or not self.params:
            return None
        error = self.params[0]
        return Status(self.id, error & ~ALERT, bool(error & ALERT), self.params[1:])


def _crc_of_byte(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = ((crc << 1) ^ 0x8005) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


_CRC_TABLE: Final = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes | bytearray) -> int:
    """CRC-16 with the polynomial x^16 + x^15 + x^2 + 1 (0x8005), starting from 0, not reflected."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC_TABLE[(crc >> 8) ^ byte]
    return crc


def instruction_packet(id: int, instruction: int, params: bytes = b"") -> bytes:
    """A packet as it goes over the wire.

    Args:
        id: the servo's, 0 to 252, or BROADCAST.
        instruction: one of `Instruction`.
        params: parameters as the instruction defines them, not stuffed.

    Raises:
        ConfigurationError: another id, or more parameters than a packet takes.
    """
    if not _is_id(id):
        raise ConfigurationError(f"id: expected 0 to {MOST_ID} or {BROADCAST}, got {id}")
    body = (bytes((instruction,)) + params).replace(_UNSTUFFED, _STUFFED)
    length = len(body) + 2
    if length > MOST_LENGTH:
        raise ConfigurationError(
            f"packet: expected at most {MOST_LENGTH - 3} bytes of parameters, got {len(body) - 1}"
        )
    packet = HEADER + bytes((id,)) + length.to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def status_packet(id: int, params: bytes = b"", error: int = 0) -> bytes:
    """A servo's answer as it goes over the wire: an error, 0 for none, and what was read."""
    return instruction_packet(id, Instruction.STATUS, bytes((error,)) + params)


def _is_id(id: int) -> bool:
    return 0 <= id <= MOST_ID or id == BROADCAST


class Parser:
    """Packets out of a stream of bytes that may be damaged, whatever the pieces it comes in.

    A packet counts if header, id, length and CRC are right. After one that is not, the search for
    a header goes on right behind the rejected header, so a packet inside a broken one is found. A
    header inside a packet that is not yet complete shows that packet to be broken, so a length
    that is too large holds nothing back.

    Attributes:
        rejected: headers so far that began no packet.
        skipped: bytes so far that belonged to no packet.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.skipped = 0
        self._buffer = bytearray()

    def __len__(self) -> int:
        """Bytes that wait for more; at most 6 above MOST_LENGTH."""
        return len(self._buffer)

    def clear(self) -> None:
        """Forget the beginning of a packet that has not been completed."""
        self.skipped += len(self._buffer)
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that are complete with these bytes, in the order in which they came."""
        self._buffer += data
        return list(self._packets())

    def _packets(self) -> Iterator[Packet]:
        buffer = self._buffer
        while self._seek():
            if len(buffer) < _FRAME:
                return
            length = int.from_bytes(buffer[5:7], "little")
            end = _FRAME + length
            if (
                not _is_id(buffer[4])
                or not _SHORTEST <= length <= MOST_LENGTH
                # the CRC may end in what looks like a header: only before it is one a fault
                or buffer.find(HEADER, len(HEADER), end - 2) >= 0
            ):
                self._reject()
            elif len(buffer) < end:
                return
            elif crc16(buffer[: end - 2]) != int.from_bytes(buffer[end - 2 : end], "little"):
                self._reject()
            else:
                body = bytes(buffer[_FRAME : end - 2]).replace(_STUFFED, _UNSTUFFED)
                packet = Packet(buffer[4], body[0], body[1:])
                del buffer[:end]
                yield packet

    def _seek(self) -> bool:
        """Drop what stands before the next header, but not the beginning of one at the end."""
        buffer = self._buffer
        at = buffer.find(HEADER)
        found = at >= 0
        if not found:
            at = len(buffer)
            for kept in (3, 2, 1):
                if buffer.endswith(HEADER[:kept]):
                    at -= kept
                    break
        self.skipped += at
        del buffer[:at]
        return found

    def _reject(self) -> None:
        self.rejected += 1
        self.skipped += len(HEADER)
        del self._buffer[: len(HEADER)]
