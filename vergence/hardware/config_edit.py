"""Measured values of a robot, written into its configuration file; its comments stay."""

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from vergence.errors import UnreadableFileError
from vergence.files import write_atomic
from vergence.hardware.config import ServoConfig
from vergence.hardware.config_parts import LoopConfig

_DIGITS: Final = 4
"""Significant digits of the measured values in the file (chosen)."""


def write_servos(path: str | os.PathLike[str], servos: Iterable[ServoConfig]) -> None:
    """Write `sign` and `zero_ticks` of some servos into their file, atomically.

    Args:
        path: the file; it is read again, so other changes in it stay.
        servos: the servos to write, matched by name.

    Raises:
        UnreadableFileError: the file no longer has such a servo, or is not TOML.
        OSError: it cannot be read or written.
    """

    def change(document: Any) -> None:
        tables = {table["name"]: table for table in document["servos"]}
        for servo in servos:
            table = tables[servo.name]
            for key, value in (("sign", servo.sign), ("zero_ticks", servo.zero_ticks)):
                if table[key] != value:  # correct values keep their spelling
                    table[key] = value

    _edit(path, change, "a TOML file with these servos")


def write_loop(
    path: str | os.PathLike[str], loop: LoopConfig, latencies_s: Mapping[str, float]
) -> None:
    """Write the measured loop and the latencies of the cameras, atomically.

    Args:
        path: the file; see `write_servos` for it and for the errors.
        loop: the new content of `[loop]`.
        latencies_s: camera latencies by name, `left` or `right`, s.
    """

    def change(document: Any) -> None:
        import tomlkit

        for name, latency_s in latencies_s.items():
            document["cameras"][name]["latency_s"] = _rounded(latency_s)
        values = {
            name: _rounded(value) if isinstance(value, float) else value
            for name, value in dataclasses.asdict(loop).items()
            if value is not None and name != "sigma"
        }
        table = tomlkit.table()
        table.update(values)
        table["sigma"] = {name: _rounded(value) for name, value in loop.sigma.items()}
        document["loop"] = table

    _edit(path, change, "a TOML file with both cameras")


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _edit(path: str | os.PathLike[str], change: Callable[[Any], None], expected: str) -> None:
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    place = Path(path).resolve()  # a symbolic link stays one
    content = place.read_bytes()
    try:
        document = tomlkit.parse(content.decode("utf-8-sig"))
        change(document)
    except (TOMLKitError, KeyError, TypeError, ValueError) as error:
        raise UnreadableFileError(str(path), f"changed meanwhile ({error})", expected) from error
    mark = b"\xef\xbb\xbf" if content.startswith(b"\xef\xbb\xbf") else b""
    write_atomic(place, mark + tomlkit.dumps(document).encode())
