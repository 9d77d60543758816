"""List the photographs of folders, sorted by the numbers in their names."""

import glob
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from vergence.errors import ConfigurationError
from vergence.vision.image import has_orientation_tag

SUFFIXES: Final = (
    ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm", ".jp2",
)  # fmt: skip
"""Extensions of files that count as photographs; other files of a folder are ignored."""
_MAX_NAMES: Final = 5
"""Most names in a message; further ones are only counted (chosen: completeness against length)."""


def natural_sort_key(path: Path) -> tuple[object, ...]:
    """Sort key that treats numbers in names as numbers: `left2` comes before `left10`."""
    # after the split, texts and numbers alternate, so that only like parts are compared
    parts = re.split(r"(\d+)", path.name)
    return tuple(int(part) if i % 2 else part.lower() for i, part in enumerate(parts)), path.name


def photographs_in_folder(folder: Path) -> list[Path]:
    """List the image files directly in a folder, sorted by `natural_sort_key`."""
    try:
        there = [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise ConfigurationError(f"{folder}: {error.strerror or error}") from error
    found = sorted(
        (path for path in there if path.suffix.lower() in SUFFIXES), key=natural_sort_key
    )
    if not found:
        raise ConfigurationError(
            f"{folder}: expected a folder with images ({', '.join(SUFFIXES)}) right in it, got "
            f"{f'none among {len(there)} files' if there else 'an empty one'}"
        )
    return found


def require_existing(path: Path) -> None:
    """Raise an error if a path does not exist."""
    try:
        there = path.exists()
    except (OSError, ValueError):  # e.g. a name that is too long: reading it raises a clear error
        there = True
    if not there:
        raise ConfigurationError(
            f"{path}: no such file or folder; expected an image, or a folder of images"
        )


def list_photographs(paths: Sequence[Path]) -> list[Path]:
    """List given files, photographs in given folders, and files that match unexpanded patterns."""
    found: list[Path] = []
    for place in paths:
        if glob.has_magic(str(place)) and not place.exists():
            matches = sorted(map(Path, glob.glob(str(place), recursive=True)), key=natural_sort_key)
            if not matches:
                raise ConfigurationError(f"expected images, got none that match {place}")
            found += matches
            continue
        require_existing(place)
        found += photographs_in_folder(place) if place.is_dir() else [place]
    return found


def join_first_names(names: Iterable[str]) -> str:
    """Join names for a message: the first few, and the number of further ones."""
    every = list(names)
    said = ", ".join(every[:_MAX_NAMES])
    return said if len(every) <= _MAX_NAMES else f"{said} and {len(every) - _MAX_NAMES} more"


def remark_on_orientation_tags(paths: Iterable[Path]) -> list[str]:
    """One line if files ask to be shown turned, else none."""
    turned = [path.name for path in paths if has_orientation_tag(path)]
    if not turned:
        return []
    return [
        "pixels are those of the sensor, not turned as the orientation tag asks, in "
        f"{len(turned)} images: {join_first_names(turned)}"
    ]
