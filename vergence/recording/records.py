"""The records of an MCAP file as far as it goes, without trust in what it holds."""

import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, BinaryIO, Final

from vergence.errors import ConfigurationError, UnreadableFileError, how_to_install

if TYPE_CHECKING:
    from mcap.records import McapRecord

EXPECTED: Final = "a log of a robot in MCAP, as vergence deploy writes it"
_LARGEST_CHUNK: Final = 64 * 2**20
"""Bytes of a chunk beyond which a file is no log: a writer's chunks last for 50 ms."""


def records_of(
    path: str | os.PathLike[str], broken: Callable[[str], None] = lambda reason: None
) -> "Iterator[McapRecord]":
    """The records of a file in their order, those of chunks too, up to where it ends or breaks.

    Args:
        path: of the file.
        broken: told why, where it ends early.

    Raises:
        UnreadableFileError: it cannot be read, or is no MCAP file.
        ConfigurationError: mcap is not installed.
    """
    try:
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk
    except ImportError as error:
        raise ConfigurationError(
            f"log: expected mcap to be installed: {how_to_install('robot')}"
        ) from error
    with _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        reader = iter(StreamReader(file, emit_chunks=True, record_size_limit=size).records)
        begun = False
        while True:
            try:
                record = next(reader)
                if not isinstance(record, Chunk):
                    inside = [record]
                elif record.uncompressed_size > _LARGEST_CHUNK:
                    raise ValueError(f"a chunk of {record.uncompressed_size} bytes")
                else:
                    inside = breakup_chunk(record, validate_crc=True)
            except StopIteration:
                return
            except (Exception, MemoryError) as error:  # whatever damage leads the library to
                reason = f"{type(error).__name__} {error}".strip()
                if not begun:
                    raise UnreadableFileError(os.fspath(path), reason, EXPECTED) from error
                broken(reason)
                return
            begun = True
            yield from inside


def _opened(path: str | os.PathLike[str]) -> BinaryIO:
    try:
        return open(path, "rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UnreadableFileError(os.fspath(path), reason, EXPECTED) from error
