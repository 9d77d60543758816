"""Planar targets: what is printed on the board that the head looks at.

A target is a grid of square cells, black or white. Its frame T has its origin at the measured
point, x right and y down as the viewer of the board sees it, and z into the board, away from
the viewer. A board that faces a camera upright has the identity as rotation of ``T_C_T``.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, UnknownNameError

_TAG_FAMILY = cv2.aruco.DICT_APRILTAG_36h11
_TAG_CELLS = 8
"""Cells along the black square of a 36h11 tag: 6 of code and a black border of one."""


@dataclass(frozen=True, kw_only=True)
class AprilTag:
    """An AprilTag of the family 36h11 with a white quiet zone of one cell.

    The measured point, origin of T, is the centre of the black square.

    Raises:
        ConfigurationError: the identity is not of the family, or the edge is not positive.
    """

    id: int = 0
    """Number of the tag in the family, 0 to 586."""
    edge_m: float = 0.12
    """Edge of the black square."""

    def __post_init__(self) -> None:
        """Check the identity and the size."""
        count = len(tag_dictionary().bytesList)
        if not 0 <= self.id < count:
            raise ConfigurationError(f"AprilTag id: expected 0 to {count - 1}, got {self.id}")
        _check_length("AprilTag edge_m", self.edge_m)

    @property
    def cell_m(self) -> float:
        """Edge of one cell in metres."""
        return self.edge_m / _TAG_CELLS

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        return (1 + _TAG_CELLS / 2, 1 + _TAG_CELLS / 2)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell, shape (10, 10): 0 black, 255 white."""
        image = cv2.aruco.generateImageMarker(tag_dictionary(), self.id, _TAG_CELLS)
        return np.asarray(np.pad(image, 1, constant_values=255), np.uint8)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the black square in T, shape (4, 2), from the upper left, clockwise."""
        return 0.5 * self.edge_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)


@dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard with a white rim of one square.

    The measured point, origin of T, is the upper right inner corner. One of the two counts of
    inner corners is even and the other odd, so that the board differs from itself turned by
    180 degrees and its upper right corner is one corner only. The upper left square is black.

    Raises:
        ConfigurationError: fewer than 3 corners along a side, both counts even or both odd, or
            a square that is not positive.
    """

    columns: int = 5
    """Inner corners along x."""
    rows: int = 4
    """Inner corners along y."""
    square_m: float = 0.04
    """Edge of one square."""

    def __post_init__(self) -> None:
        """Check the counts and the size."""
        if min(self.columns, self.rows) < 3 or (self.columns + self.rows) % 2 == 0:
            raise ConfigurationError(
                "Checkerboard: expected at least 3 inner corners a side, one count even and one "
                f"odd, got {self.columns} columns and {self.rows} rows"
            )
        _check_length("Checkerboard square_m", self.square_m)

    @property
    def cell_m(self) -> float:
        """Edge of one cell, which is a square, in metres."""
        return self.square_m

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        return (float(self.columns + 1), 2.0)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell, shape (rows + 3, columns + 3): 0 black, 255 white."""
        y, x = np.mgrid[: self.rows + 1, : self.columns + 1]
        squares = np.where((x + y) % 2 == 0, 0, 255)
        return np.asarray(np.pad(squares, 1, constant_values=255), np.uint8)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Inner corners in T, shape (rows * columns, 2), row by row from the upper left."""
        y, x = np.mgrid[: self.rows, : self.columns].astype(float)
        return self.square_m * np.stack([x.ravel() - (self.columns - 1), y.ravel()], axis=-1)


PlanarTarget = AprilTag | Checkerboard


def make_planar_target(name: str) -> PlanarTarget:
    """The target of the given name with its default size.

    Args:
        name: ``"tag"`` or ``"checkerboard"``.

    Raises:
        UnknownNameError: no target has that name.
    """
    if name == "tag":
        return AprilTag()
    if name == "checkerboard":
        return Checkerboard()
    raise UnknownNameError("planar target", name, ["checkerboard", "tag"])


def outline_m(target: PlanarTarget) -> NDArray[np.float64]:
    """Corners of the whole board in T, metres, shape (4, 2), from the upper left, clockwise."""
    rows, columns = target.cells.shape
    outline = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    return (outline - target.origin_cells) * target.cell_m


def texture(
    target: PlanarTarget, texels: int, *, surround: int = 255, rim: int = 0, blur: float = 0.0
) -> NDArray[np.uint8]:
    """The board as an image.

    Args:
        target: the board.
        texels: pixels of the image along a cell.
        surround: grey level around the board.
        rim: pixels of surround on each side.
        blur: standard deviation of a Gaussian blur, in pixels of the image; 0 for none.

    Returns:
        Grey levels, 0 for black and 255 for white, shape
        (rows * texels + 2 rim, columns * texels + 2 rim).
    """
    image = target.cells.repeat(texels, axis=0).repeat(texels, axis=1)
    image = np.pad(image, rim, constant_values=surround)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur) if blur > 0 else image, np.uint8)


def tag_dictionary() -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of the family 36h11."""
    return cv2.aruco.getPredefinedDictionary(_TAG_FAMILY)


def _check_length(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ConfigurationError(f"{name}: expected a positive length, got {value}")
