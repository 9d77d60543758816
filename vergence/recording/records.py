"""Reading of MCAP records up to where a file ends or is damaged; its content is untrusted."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, BinaryIO, Final

from vergence.errors import ConfigurationError, UnreadableFileError, how_to_install

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

EXPECTED_FILE: Final = "a log of a robot in MCAP, as vergence deploy writes it"
MAX_CHUNK_BYTES: Final = 64 * 2**20
"""Largest size of an unpacked chunk, bytes (chosen: far above a log's, whose chunks span 50 ms)."""
_MAX_UNPACKING_RATIO: Final = 200
"""Largest ratio of unpacked to packed bytes, beyond a first chunk (chosen: logs have 5 to 15)."""


def read_records(
    path: str | os.PathLike[str], on_truncation: Callable[[str], None] = lambda reason: None
) -> "Iterator[McapRecord]":
    """Yield a file's records in order, with those in chunks, up to its end or to any damage.

    Args:
        path: path of the file.
        on_truncation: called with the reason if the file ends early.

    Raises:
        UnreadableFileError: the file cannot be read, or is no MCAP file.
        ConfigurationError: mcap is not installed.
    """
    require_mcap()
    from mcap.stream_reader import StreamReader

    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        unpacker = ChunkUnpacker()
        unpacker.allow(size)
        reader = iter(StreamReader(file, emit_chunks=True, record_size_limit=size).records)
        begun = False
        while True:
            try:
                inside = unpacker.records_in(next(reader))
            except StopIteration:
                return
            except (Exception, MemoryError) as error:  # damage can make the library raise anything
                if not begun:
                    reason = "it is no MCAP file" if size else "it is empty"
                    raise UnreadableFileError(os.fspath(path), reason, EXPECTED_FILE) from error
                on_truncation(f"{type(error).__name__} {error}".strip())
                return
            begun = True
            yield from inside


def require_mcap() -> None:
    """Check that mcap is installed.

    Raises:
        ConfigurationError: it is not.
    """
    try:
        import mcap.stream_reader  # noqa: F401
    except ImportError as error:
        raise ConfigurationError(
            f"log: expected mcap to be installed: {how_to_install('robot')}"
        ) from error


class ChunkUnpacker:
    """Unpacking of a file's chunks, with limits on the size of each and of all together."""

    def __init__(self) -> None:
        self._left = MAX_CHUNK_BYTES

    def allow(self, size: int) -> None:
        """Allow as much more as this number of bytes of the file may hold when unpacked."""
        self._left += _MAX_UNPACKING_RATIO * size

    def records_in(self, record: "McapRecord") -> "list[McapRecord]":
        """Records in a chunk; the record alone if it is no chunk. Damage can raise anything."""
        from mcap.records import Chunk
        from mcap.stream_reader import breakup_chunk

        if not isinstance(record, Chunk):
            return [record]
        data = _unpacked(record, min(self._left, MAX_CHUNK_BYTES))
        self._left -= len(data)
        return breakup_chunk(replace(record, compression="", data=data), True)


def _unpacked(chunk: "Chunk", most: int) -> bytes:
    """Unpack a chunk, with a limit on its size.

    Args:
        chunk: the chunk.
        most: largest allowed size, bytes.

    Raises:
        ValueError: the size is above the limit or differs from the stated one, or the compression
            is unknown.
    """
    size = chunk.uncompressed_size
    if size > most:
        raise ValueError(f"a chunk of {size} bytes")
    if not chunk.compression:
        return chunk.data
    if chunk.compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            return _whole(reader.read(size + 1), size)
    if chunk.compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        return _whole(data, size)
    raise ValueError(f"a chunk packed by {chunk.compression!r:.40}, not by zstd or lz4")


def _whole(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise ValueError(f"a chunk of other than the {size} bytes that it says")
    return data


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading.

    Raises:
        UnreadableFileError: it cannot be read, or is no regular file.
    """
    if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
        raise UnreadableFileError(os.fspath(path), "no regular file", EXPECTED_FILE)
    try:
        return open(path, "rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UnreadableFileError(os.fspath(path), reason, EXPECTED_FILE) from error
