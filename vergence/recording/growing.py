"""Records of an MCAP file that another process still writes; its content is untrusted.

The file is only read, never locked, so the writer does not notice. It is kept open: its number on
the disk cannot be given to another file meanwhile, which shows that it was replaced.
"""

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from vergence.errors import UnreadableFileError
from vergence.recording.records import (
    EXPECTED_FILE,
    MAX_CHUNK_BYTES,
    ChunkUnpacker,
    open_regular,
    require_mcap,
)

if TYPE_CHECKING:
    from mcap.records import McapRecord

MAGIC: Final = b"\x89MCAP0\r\n"
_FRAME: Final = struct.Struct("<BQ")
"""A record's opcode and the size of its content."""
_OPENING: Final = 16
"""Number of bytes of a content that are read at once (numerical: times of chunks and messages)."""


class Place(NamedTuple):
    """Place of one whole record in the file."""

    opcode: int
    start: int
    """Offset of the content, bytes."""
    size: int
    """Size of the content, bytes."""
    opening: bytes
    """The first bytes of the content, at most 16."""


class GrowingFile:
    """A growing MCAP file, open for reading; close it after use.

    Args:
        path: path of the file; it may still be empty.

    Attributes:
        path: see the arguments.

    Raises:
        UnreadableFileError: the file cannot be opened.
        ConfigurationError: mcap is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        require_mcap()
        self.path = Path(path)
        self._file = open_regular(path)
        self._at = 0
        self._unpacker = ChunkUnpacker()

    def close(self) -> None:
        """Close the file; nothing can be read afterwards."""
        self._file.close()

    def places(self) -> Iterator[Place]:
        """Yield the places of records that have become whole since the last call, in order.

        Raises:
            UnreadableFileError: the file has become shorter, is no MCAP file or is damaged.
        """
        size = os.fstat(self._file.fileno()).st_size
        if size < self._at:
            raise self.unreadable("it became shorter while it was followed")
        if not self._at:
            if not MAGIC.startswith(self.part(0, min(size, len(MAGIC)))):
                raise self.unreadable("it is no MCAP file")
            if size < len(MAGIC):
                return
            self._at = len(MAGIC)
        while self._at + _FRAME.size <= size:
            found = self.part(self._at, min(size - self._at, _FRAME.size + _OPENING))
            opcode, length = _FRAME.unpack_from(found)
            start = self._at + _FRAME.size
            if not opcode or length > MAX_CHUNK_BYTES:
                raise self.unreadable(f"it is damaged at byte {self._at}")
            if start + length > size:
                return
            self._at = start + length
            yield Place(opcode, start, length, found[_FRAME.size :][:length])

    def part(self, start: int, size: int) -> bytes:
        """Bytes of the file.

        Raises:
            UnreadableFileError: the file cannot be read, or has become shorter.
        """
        try:
            self._file.seek(start)
            data = self._file.read(size)
        except OSError as error:
            raise self.unreadable(error.strerror or str(error)) from error
        if len(data) != size:
            raise self.unreadable("it became shorter while it was followed")
        return data

    def number(self, place: Place, form: struct.Struct, offset: int = 0) -> int:
        """One number in the opening of a record's content.

        Args:
            place: place of the record.
            form: form of the number.
            offset: offset of the number in the content, bytes.

        Raises:
            UnreadableFileError: the record is too short.
        """
        try:
            number: int = form.unpack_from(place.opening, offset)[0]
        except struct.error as error:
            raise self.damaged(f"a record of kind {place.opcode} and {place.size} bytes") from error
        return number

    def records(self, place: Place) -> "list[McapRecord]":
        """Records at a place: those in a chunk, or a single one.

        Raises:
            UnreadableFileError: the file cannot be read, or is damaged there.
        """
        from mcap.stream_reader import StreamReader

        data = _FRAME.pack(place.opcode, place.size) + self.part(place.start, place.size)
        self._unpacker.allow(len(data))
        reader = StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True)
        try:
            return self._unpacker.records_in(next(iter(reader.records)))
        except (Exception, MemoryError) as error:  # damage can make the library raise anything
            raise self.damaged(f"{type(error).__name__} {error}".strip()) from error

    def lost(self) -> str:
        """Description of the file's loss, such as its deletion; empty while it is at its path."""
        try:
            now = os.stat(self.path)
        except FileNotFoundError:
            return "it was deleted while it was followed"
        except OSError as error:
            return error.strerror or str(error)
        same = os.path.samestat(now, os.fstat(self._file.fileno()))
        return "" if same else "it was replaced by another file while it was followed"

    def unreadable(self, reason: str) -> UnreadableFileError:
        """An error about the file."""
        return UnreadableFileError(os.fspath(self.path), reason, EXPECTED_FILE)

    def damaged(self, reason: str) -> UnreadableFileError:
        """An error about damage before the byte up to which the file has been read."""
        return self.unreadable(f"it is damaged before byte {self._at}: {reason:.200}")
