"""Dynamixel Protocol 2.0: encoding and parsing of packets, without I/O.

    FF FF FD 00 | id | length (2) | instruction | parameters ... | CRC-16 (2)

Numbers are little-endian; the length counts the bytes after it. `FF FF FD` among instruction and
parameters is sent as `FF FF FD FD` (byte stuffing), so that a header never occurs inside a packet,
unless bytes of the CRC happen to complete one.
"""

from collections.abc import Iterator
from enum import IntEnum
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError

HEADER: Final = b"\xff\xff\xfd\x00"
BROADCAST: Final = 0xFE
"""Id that addresses all servos (physical: Protocol 2.0)."""
MOST_ID: Final = 252
"""Greatest id of a servo (physical: Protocol 2.0)."""

MOST_LENGTH: Final = 384
"""Largest length field of a packet that is sent or accepted (chosen).

The 147 bytes of an X-series servo's own registers fit in, and a sync write of 8 bytes to 40 servos.
The protocol allows 65,535, but a damaged header with such a length would hold back later packets.
"""

_MIN_LENGTH_FIELD: Final = 3  # least length field: instruction and CRC (physical: Protocol 2.0)
_FRAME_BYTES: Final = 7  # bytes of header, id and length (physical: Protocol 2.0)
_UNSTUFFED: Final = b"\xff\xff\xfd"
_STUFFED: Final = b"\xff\xff\xfd\xfd"


class Instruction(IntEnum):
    """Instructions of packets; all but STATUS come from the controller."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class ErrorNumber(IntEnum):
    """Reason of a refused instruction, in the lower seven bits of a status packet's error."""

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
"""Texts of the error numbers."""

ALERT: Final = 0x80
"""Bit of a status packet's error: HARDWARE_ERROR_STATUS is not 0 (physical: Protocol 2.0)."""


class Status(NamedTuple):
    """A servo's answer."""

    id: int
    error: int
    alert: bool
    data: bytes


class Packet(NamedTuple):
    """A packet without header, length and CRC, and without byte stuffing."""

    id: int
    instruction: int
    params: bytes

    @property
    def status(self) -> Status | None:
        """The packet as a servo's answer; None if it is not one."""
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
    """Encode a packet for the wire."""
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
    """Encode a servo's answer for the wire: its error, 0 for none, and the bytes read."""
    return instruction_packet(id, Instruction.STATUS, bytes((error,)) + params)


def _is_id(id: int) -> bool:
    return 0 <= id <= MOST_ID or id == BROADCAST


class PacketParser:
    """Parser of packets from a stream of bytes that may be damaged and arrives in any pieces.

    A packet is accepted if header, id, length and CRC are right. After a rejected one the search
    continues directly behind its header, so a packet inside a damaged one is found. A header inside
    an incomplete packet shows that this packet is damaged, so a wrong, large length does not hold
    back later packets.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.skipped = 0
        self._buffer = bytearray()

    def __len__(self) -> int:
        """Number of buffered bytes; at most 6 above MOST_LENGTH."""
        return len(self._buffer)

    def clear(self) -> None:
        """Discard the beginning of an incomplete packet."""
        self.skipped += len(self._buffer)
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Packet]:
        """Add bytes; return the packets that they complete, in order of arrival."""
        self._buffer += data
        return list(self._packets())

    def _packets(self) -> Iterator[Packet]:
        buffer = self._buffer
        while self._seek():
            if len(buffer) < _FRAME_BYTES:
                return
            length = int.from_bytes(buffer[5:7], "little")
            end = _FRAME_BYTES + length
            if (
                not _is_id(buffer[4])
                or not _MIN_LENGTH_FIELD <= length <= MOST_LENGTH
                # a header before the CRC is a fault; the CRC itself may complete one
                or buffer.find(HEADER, len(HEADER), end - 2) >= 0
            ):
                self._reject()
            elif len(buffer) < end:
                return
            elif crc16(buffer[: end - 2]) != int.from_bytes(buffer[end - 2 : end], "little"):
                self._reject()
            else:
                body = bytes(buffer[_FRAME_BYTES : end - 2]).replace(_STUFFED, _UNSTUFFED)
                packet = Packet(buffer[4], body[0], body[1:])
                del buffer[:end]
                yield packet

    def _seek(self) -> bool:
        """Drop the bytes before the next header; the beginning of one at the end stays."""
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
