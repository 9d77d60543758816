"""Bundles: a trained network and all data needed to run it, in one file without executable code.

A `.vgp` file is a zip of two entries, `manifest.json` and `policy.onnx`, stored or deflated. The
zip's comment is the SHA-256 of `manifest.json` in hexadecimal, and the manifest holds the SHA-256
of `policy.onnx`. See docs/bundles.md.
"""

import hashlib
import io
import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from vergence.controllers.networks.manifest import NETWORK_PART, Manifest, describe_part
from vergence.controllers.networks.onnx_graph import MAX_NETWORK_BYTES, Network, read_network
from vergence.errors import BundleError
from vergence.files import write_atomic

SUFFIX: Final = ".vgp"
MAX_BUNDLE_BYTES: Final = 4 * 2**20
"""Largest size of a bundle's file, bytes (chosen: safety against room for larger networks)."""
MANIFEST_PART: Final = "manifest.json"
MAX_PART_BYTES: Final = {MANIFEST_PART: 2**18, NETWORK_PART: MAX_NETWORK_BYTES}
"""Largest size of each part once unpacked, bytes."""

_PRETRAINED = resources.files("vergence.controllers") / "pretrained"
_ENCRYPTED_FLAG: Final = 0x1
"""Flag of an encrypted entry (physical: ZIP format, general purpose bit 0)."""
_ENTRY_DATE: Final = (1980, 1, 1, 0, 0, 0)
"""Date of each entry, so that equal content gives equal files (physical: earliest of ZIP)."""


@dataclass(frozen=True)
class Bundle:
    """A bundle whose hashes, manifest and network have been checked.

    Attributes:
        source: origin of the bytes, for messages.
        manifest: its manifest.
        network: the checked network.
    """

    source: str
    manifest: Manifest
    network: Network


def read_bundle(path: str | os.PathLike[str]) -> Bundle:
    """Read and check a bundle.

    Args:
        path: a `.vgp` file.

    Returns:
        The bundle.

    Raises:
        BundleError: it cannot be read, is too large, damaged, or not allowed.
    """
    return parse_bundle(read_limited(path, MAX_BUNDLE_BYTES), str(path))


def parse_bundle(data: bytes, source: str) -> Bundle:
    """Check a bundle's bytes.

    Args:
        data: the content of a `.vgp` file.
        source: origin of the bytes, for messages.

    Returns:
        The bundle.

    Raises:
        BundleError: it is too large, damaged, or not allowed.
    """
    with prefix_bundle_errors(source):
        parts, comment = _unpack(data)
        _check_hash("manifest.json (by the zip's comment)", comment, parts[MANIFEST_PART])
        manifest = Manifest.from_json(parts[MANIFEST_PART])
        network = parts[NETWORK_PART]
        stated = manifest.parts.get(NETWORK_PART)
        if manifest.parts.keys() != {NETWORK_PART} or not isinstance(stated, dict):
            raise BundleError(
                f"manifest: parts: expected {NETWORK_PART} alone, got {sorted(manifest.parts)}"
            )
        _check_hash(NETWORK_PART, stated.get("sha256"), network)
        if stated != describe_part(network):
            raise BundleError(
                f"{NETWORK_PART}: expected {describe_part(network)} in the manifest, got {stated}"
            )
        return Bundle(source, manifest, read_network(network))


@contextmanager
def prefix_bundle_errors(source: str) -> Iterator[None]:
    """Prefix the message of a `BundleError` with the origin of the bytes."""
    try:
        yield
    except BundleError as error:
        raise type(error)(f"{source}: {error}") from error


def write_bundle(
    path: str | os.PathLike[str], manifest: Manifest, network: bytes, replace: bool = False
) -> None:
    """Write a bundle, as a whole or not at all; equal content gives equal files.

    Args:
        path: path of the file.
        manifest: manifest of the bundle.
        network: bytes of the ONNX file.
        replace: True to replace an existing file.

    Raises:
        BundleError: the bundle would be refused when read, or the file cannot be written.
    """
    target = Path(path)
    data = _pack({MANIFEST_PART: manifest.to_json(), NETWORK_PART: network})
    parse_bundle(data, str(target))
    if target.exists() and not replace:
        raise BundleError(f"{target}: expected no file of that name, got one")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, data)
    except OSError as error:
        raise BundleError(f"{target}: cannot be written: {error.strerror}") from error


def pretrained_bundles() -> dict[str, Path]:
    """Return the paths of the bundles that ship with the package, by name."""
    folder = Path(str(_PRETRAINED))
    return {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def read_limited(path: str | os.PathLike[str], limit: int) -> bytes:
    """Read a file that must not exceed a limit.

    Args:
        path: the file.
        limit: largest size, bytes.

    Returns:
        The bytes.

    Raises:
        BundleError: it cannot be read, or is larger.
    """
    try:
        if not Path(path).is_file():  # excludes folders and endless devices
            raise BundleError(f"{path}: expected a file, got none of that name")
        with open(path, "rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise BundleError(f"{path}: expected a readable file, got {error.strerror}") from error
    if len(data) > limit:
        raise BundleError(f"{path}: expected at most {limit} bytes, got more")
    return data


def _pack(parts: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in parts.items():
            entry = zipfile.ZipInfo(name, _ENTRY_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            entry.create_system = 3  # fixed, as the default depends on the platform
            archive.writestr(entry, content)
        archive.comment = hashlib.sha256(parts[MANIFEST_PART]).hexdigest().encode()
    return file.getvalue()


def _unpack(data: bytes) -> tuple[dict[str, bytes], str]:
    """Return the parts by name, each within its size limit, and the comment."""
    if len(data) > MAX_BUNDLE_BYTES:
        raise BundleError(f"expected at most {MAX_BUNDLE_BYTES} bytes, got {len(data)}")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            names = sorted(entry.filename for entry in entries)
            if names != sorted(MAX_PART_BYTES):
                raise BundleError(
                    f"expected the entries {', '.join(sorted(MAX_PART_BYTES))}, got {names[:8]}"
                )
            parts = {entry.filename: _read_entry(archive, entry) for entry in entries}
            return parts, archive.comment.decode("ascii", "replace")
    except BundleError:
        raise
    # zipfile raises many kinds of exceptions on damage, such as struct.error and KeyError
    except Exception as error:
        raise BundleError(f"expected a zip, got damage: {error!r:.120}") from error


def _read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    limit = MAX_PART_BYTES[entry.filename]
    if entry.file_size > limit:
        raise BundleError(
            f"{entry.filename}: expected at most {limit} bytes, got {entry.file_size} announced"
        )
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise BundleError(
            f"{entry.filename}: expected it stored or deflated, got method {entry.compress_type}"
        )
    if entry.flag_bits & _ENCRYPTED_FLAG:
        raise BundleError(f"{entry.filename}: expected it in the clear, got it encrypted")
    with archive.open(entry) as file:
        content = file.read(limit + 1)
        # the announced size may be false and zipfile stops there, so the checksum decides
        if len(content) != entry.file_size or zlib.crc32(content) != entry.CRC or file.read(1):
            raise BundleError(
                f"{entry.filename}: expected {entry.file_size} bytes with their checksum, "
                f"got {len(content)} others"
            )
    return content


def _check_hash(what: str, stated: object, content: bytes) -> None:
    actual = hashlib.sha256(content).hexdigest()
    if not stated:
        raise BundleError(f"{what}: expected a SHA-256, got none")
    if stated != actual:
        raise BundleError(f"{what}: expected SHA-256 {stated!s:.64}, got {actual}")
