"""The photographs of a folder, in the order in which people number them."""

import glob
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from vergence.errors import ConfigurationError

SUFFIXES: Final = (
    ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm", ".jp2",
)  # fmt: skip
"""Endings of the files that count as photographs; other files of a folder are passed over."""
_NAMED: Final = 5
"""Names that a sentence holds before it only counts."""


def in_order(path: Path) -> tuple[object, ...]:
    """A key to sort by: numbers in names count as numbers, `left2` before `left10`."""
    # split by digits, texts and numbers alternate: like is always compared with like
    parts = re.split(r"(\d+)", path.name)
    return tuple(int(part) if i % 2 else part.lower() for i, part in enumerate(parts)), path.name


def photographs_in(folder: Path) -> list[Path]:
    """The image files right in a folder, in their order.

    Args:
        folder: a folder.

    Raises:
        ConfigurationError: there is none in it, or it cannot be read.
    """
    try:
        there = [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise ConfigurationError(f"{folder}: {error.strerror or error}") from error
    found = sorted((path for path in there if path.suffix.lower() in SUFFIXES), key=in_order)
    if not found:
        raise ConfigurationError(
            f"{folder}: expected a folder with images ({', '.join(SUFFIXES)}) right in it, got "
            f"{f'none among {len(there)} files' if there else 'an empty one'}"
        )
    return found


def check_there(place: Path) -> None:
    """Refuse a place that is not there, before any other is looked at.

    Raises:
        ConfigurationError: it is not.
    """
    try:
        there = place.exists()
    except (OSError, ValueError):  # such as a name that is too long: reading it says so
        there = True
    if not there:
        raise ConfigurationError(
            f"{place}: no such file or folder; expected an image, or a folder of images"
        )


def photographs_of(places: Sequence[Path]) -> list[Path]:
    """Files as they are given, the photographs of folders, and what patterns match.

    Args:
        places: files, folders, and patterns such as `photos/*.jpg` that no shell has expanded.

    Raises:
        ConfigurationError: a folder has none, a place is not there, or nothing matches a pattern.
    """
    found: list[Path] = []
    for place in places:
        if glob.has_magic(str(place)) and not place.exists():
            matches = sorted(map(Path, glob.glob(str(place), recursive=True)), key=in_order)
            if not matches:
                raise ConfigurationError(f"expected images, got none that match {place}")
            found += matches
            continue
        check_there(place)
        found += photographs_in(place) if place.is_dir() else [place]
    return found


def some_of(names: Iterable[str]) -> str:
    """Names in a sentence, the first few and how many more there are."""
    every = list(names)
    said = ", ".join(every[:_NAMED])
    return said if len(every) <= _NAMED else f"{said} and {len(every) - _NAMED} more"
