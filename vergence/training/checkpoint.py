"""Checkpoint files: written atomically, read without executing code, protected by a checksum.

A checkpoint is a mapping of tensors, numbers and strings, saved by `torch.save` as a ZIP archive.
The archive's comment, the last bytes of the file, is the SHA-256 of all bytes before it. It is read
by `torch.load` with `weights_only=True`, which creates no other objects. If the process is killed
at any moment, the file is either the old one or the new one.
"""

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Final

import torch

from vergence.errors import ConfigurationError
from vergence.files import write_atomic

FORMAT_VERSION: Final = 4
"""Version of a checkpoint's content (numerical)."""
_SHA256_HEX_DIGITS: Final = 64
"""Hexadecimal digits of a SHA-256 (physical: the standard FIPS 180-4)."""


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint atomically.

    Args:
        path: the file.
        content: tensors, numbers, strings, and lists and dictionaries of these.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, checkpoint_bytes(content))


def checkpoint_bytes(content: Mapping[str, Any]) -> bytes:
    """Serialise a checkpoint to the bytes of its file, see `write_checkpoint`."""
    # in memory, since `torch.save` raises no OSError on a full disk
    archive = io.BytesIO()
    torch.save({"format": FORMAT_VERSION, **content}, archive)
    # an archive ends with the length of its comment, which is 0 so far
    archive.seek(-2, io.SEEK_END)
    archive.write(_SHA256_HEX_DIGITS.to_bytes(2, "little"))
    archive.write(_digits(archive.getvalue()))
    return archive.getvalue()


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        ConfigurationError: the file does not exist, is not a checkpoint, or is damaged.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"expected a checkpoint, got {path}: {error.strerror}") from error
    if data[-_SHA256_HEX_DIGITS:] != _digits(data[:-_SHA256_HEX_DIGITS]):
        raise ConfigurationError(
            f"expected a checkpoint with its checksum, got a damaged or an older file: {path} "
            "(put a whole copy of it back, or begin a new run)"
        )
    try:
        content: Any = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, UnpicklingError, EOFError, ValueError, KeyError) as error:
        raise ConfigurationError(f"expected a checkpoint, got another file: {path}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT_VERSION:
        raise ConfigurationError(f"expected a checkpoint of format {FORMAT_VERSION}, got {path}")
    return content


def _digits(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()
