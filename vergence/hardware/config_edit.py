"""Signs and zeros written into a configuration file, which keeps its comments and all else."""

import os
from collections.abc import Iterable
from pathlib import Path

from vergence.errors import UnreadableFileError
from vergence.files import write_whole
from vergence.hardware.config import ServoConfig


def write_servos(path: str | os.PathLike[str], servos: Iterable[ServoConfig]) -> None:
    """Write `sign` and `zero_ticks` of some servos into their file, whole or not at all.

    Args:
        path: the file; it is read anew, so what else has changed in it stays.
        servos: those to write, found by their names.

    Raises:
        UnreadableFileError: the file has no such servo any more, or is no TOML.
        OSError: it cannot be read or written.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    place = Path(path).resolve()  # a link stays one
    content = place.read_bytes()
    try:
        document = tomlkit.parse(content.decode("utf-8-sig"))
        tables = {table["name"]: table for table in document["servos"]}
        for servo in servos:
            table = tables[servo.name]
            for key, value in (("sign", servo.sign), ("zero_ticks", servo.zero_ticks)):
                if table[key] != value:  # what is right stays as it is spelt
                    table[key] = value
    except (TOMLKitError, KeyError, TypeError, ValueError) as error:
        raise UnreadableFileError(
            str(path), f"changed meanwhile ({error})", "a TOML file with these servos"
        ) from error
    mark = b"\xef\xbb\xbf" if content.startswith(b"\xef\xbb\xbf") else b""
    write_whole(place, mark + tomlkit.dumps(document).encode())
