"""Checkpoint files: replaced whole, read without running anything, refused when a bit has changed.

A checkpoint is a mapping of tensors, numbers and words, saved by `torch.save`: a ZIP archive. The
archive's comment, the last bytes of the file, is the SHA-256 of all bytes before it. It is read by
`torch.load` with `weights_only=True`, which builds nothing else. A kill at any moment leaves the
old file or the new one.
"""

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Final

import torch

from vergence.errors import ConfigurationError
from vergence.files import write_whole

FORMAT: Final = 4
"""Version of what a checkpoint holds."""
_DIGITS: Final = 64
"""Hexadecimal digits of a SHA-256."""


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint; the file of that name is replaced at once or not at all.

    Args:
        path: the file.
        content: tensors, numbers, words, and lists and dictionaries of these.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, checkpoint_bytes(content))


def checkpoint_bytes(content: Mapping[str, Any]) -> bytes:
    """A checkpoint as the bytes of its file, see `write_checkpoint`."""
    # in memory: on a full disk `torch.save` raises no OSError
    archive = io.BytesIO()
    torch.save({"format": FORMAT, **content}, archive)
    # an archive ends with the length of its comment, which has been 0
    archive.seek(-2, io.SEEK_END)
    archive.write(_DIGITS.to_bytes(2, "little"))
    archive.write(_digits(archive.getvalue()))
    return archive.getvalue()


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        ConfigurationError: there is no such file, or it is not a checkpoint, or not as written.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"expected a checkpoint, got {path}: {error.strerror}") from error
    if data[-_DIGITS:] != _digits(data[:-_DIGITS]):
        raise ConfigurationError(
            f"expected a checkpoint with its checksum, got a damaged or an older file: {path} "
            "(put a whole copy of it back, or begin a new run)"
        )
    try:
        content: Any = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, UnpicklingError, EOFError, ValueError, KeyError) as error:
        raise ConfigurationError(f"expected a checkpoint, got another file: {path}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigurationError(f"expected a checkpoint of format {FORMAT}, got {path}")
    return content


def _digits(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()
