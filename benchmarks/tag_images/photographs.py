"""Photographs with lists of the tags in them.

A text file beside a photograph has a line for each tag, in the format of the tests of the AprilTag
library: ``id, (x y), (x y), (x y), (x y)``, counter-clockwise from the lower left corner, where
(0, 0) is the corner of the upper left pixel. All other coordinates here have (0, 0)
at that pixel's centre.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import VergenceError

LIBRARY_OFFSET_PX = 0.5
"""Offset of the AprilTag library's coordinates from those with integer pixel centres, px."""
_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".ppm", ".tif", ".tiff")
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_CORNER = rf"\s*\(\s*{_NUMBER}\s+{_NUMBER}\s*\)\s*"
_LINE = re.compile(rf"\s*(\d+)\s*,{_CORNER},{_CORNER},{_CORNER},{_CORNER}")


@dataclass(frozen=True)
class KnownTag:
    """A tag of a photograph."""

    id: int
    corners_px: NDArray[np.float64]
    """Upper left, upper right, lower right, lower left of the upright tag, shape (4, 2)."""
    centre_px: NDArray[np.float64]
    """Crossing of the diagonals, invariant under homographies; shape (2,)."""

    @property
    def edge_px(self) -> float:
        """Edge of the square of the same area, px."""
        return edge(self.corners_px)


@dataclass(frozen=True)
class Photograph:
    """An image and the known tags in it."""

    name: str
    image: NDArray[np.uint8]
    """Grey, shape (height, width)."""
    tags: tuple[KnownTag, ...]


def edge(corners_px: NDArray[np.float64]) -> float:
    """Edge of the square that has the area of a quadrilateral of shape (4, 2)."""
    x, y = corners_px.T
    return float(np.sqrt(0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))))


def crossing(corners_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Crossing of the diagonals of a quadrilateral of shape (4, 2), shape (2,)."""
    a, b, c, d = corners_px
    along, _ = np.linalg.solve(np.stack([c - a, b - d], axis=1), b - a)
    return np.asarray(a + along * (c - a))


def tags_from(text: str) -> tuple[KnownTag, ...]:
    """Tags listed in a text file.

    Raises:
        VergenceError: a line does not list a tag.
    """
    tags = []
    for line in filter(None, map(str.strip, text.splitlines())):
        found = _LINE.fullmatch(line)
        if found is None:
            raise VergenceError(
                f"expected a line 'id, (x y), (x y), (x y), (x y)' for each tag, got {line!r}"
            )
        listed = np.array(found.groups()[1:], dtype=float).reshape(4, 2) - LIBRARY_OFFSET_PX
        corners = listed[::-1]
        tags.append(KnownTag(int(found[1]), corners, crossing(corners)))
    return tuple(tags)


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file in grey.

    Raises:
        VergenceError: the file is no image.
    """
    try:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:  # such as a header with sizes of millions of pixels
        raise VergenceError(f"expected an image, got {path}: {error}") from error
    if image is None:
        raise VergenceError(f"expected an image, got {path}")
    return np.asarray(image, dtype=np.uint8)


def image_paths(folder: Path) -> list[Path]:
    """Image files in a folder and all its subfolders, sorted.

    Raises:
        VergenceError: there are none.
    """
    # `rglob` does not enter linked folders, which folders of data often are
    paths = sorted(
        path
        for name in (folder, *(one for one in folder.rglob("*") if one.is_symlink()))
        for path in (name.rglob("*") if name.is_dir() else ())
        if path.suffix.lower() in _SUFFIXES
    )
    if not paths:
        raise VergenceError(f"expected a folder with images, got {folder}")
    return paths


def read_photographs(folder: Path) -> list[Photograph]:
    """Read the photographs of a folder that have a list of tags.

    Raises:
        VergenceError: there are none, or a file cannot be read.
    """
    listed = [path for path in image_paths(folder) if path.with_suffix(".txt").is_file()]
    if not listed:
        raise VergenceError(f"expected images with a text file of corners each in {folder}")
    return [
        Photograph(
            path.relative_to(folder).as_posix(),
            read_image(path),
            tags_from(path.with_suffix(".txt").read_text(encoding="utf-8")),
        )
        for path in listed
    ]
