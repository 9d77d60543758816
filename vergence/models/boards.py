"""Planar targets: what is printed on the board that the head looks at.

A target is a grid of square cells, black or white. Its frame T has its origin at the measured
point, x right and y down as the viewer of the board sees it, and z into the board, away from
the viewer. A board that faces a camera upright has the identity as rotation of ``T_C_T``.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.april_grid import AprilGrid
from vergence.models.tag_families import UNPRINTED, TagFamilyCode, tag_family

_LEAST_CORNERS: Final = 3
"""Inner corners along a side, below which OpenCV looks for no board."""
_MOST_CELLS: Final = 200
"""Squares along a side of a board: more than any photograph resolves."""
_MOST_CHARUCO_CELLS: Final = 96
"""Cells along a square of a ChArUco board: its markers are drawn to about one of them."""
_SAME_CELLS: Final = 1e-6


@dataclass(frozen=True, kw_only=True)
class AprilTag:
    """An AprilTag, upright as the AprilTag library draws it.

    The measured point, origin of T, is the centre of the square that the library detects: the
    black one of the families 36h11, 36h10, 25h9 and 16h5, which have a white quiet zone of one cell
    around it; the white one in a black ring of the others.

    Raises:
        UnknownNameError: there is no such family.
        ConfigurationError: the identity is not of the family, or the edge is not positive.
    """

    id: int = 0
    """Number of the tag in the family, from 0 on."""
    edge_m: float = 0.12
    """Edge of that square."""
    family: str = "36h11"
    """Of the AprilTag library, see `vergence.models.tag_families`."""
    size_known: bool = field(default=True, compare=False)
    """Whether the edge was stated; where it was not, only directions and ratios mean something."""

    def __post_init__(self) -> None:
        """Check the family, the identity and the size."""
        object.__setattr__(self, "family", tag_family(self.family).name)
        self.code.cells(self.id)
        _check_length("AprilTag edge_m", self.edge_m)

    def __str__(self) -> str:
        size = f":{1000 * self.edge_m:g}" if self.size_known else ""
        return f"tag:{self.family}:{self.id}{size}"

    @property
    def code(self) -> TagFamilyCode:
        """The family's code words."""
        return tag_family(self.family)

    @property
    def cell_m(self) -> float:
        """Edge of one cell in metres."""
        return self.edge_m / self.code.border

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        return (0.5 * self.code.total, 0.5 * self.code.total)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell: 0 black, 255 white; shape (10, 10) for 36h11."""
        cells = self.code.cells(self.id)
        return np.where(cells == UNPRINTED, np.uint8(255), cells)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the detected square in T, shape (4, 2), from the upper left, clockwise."""
        return 0.5 * self.edge_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)


@dataclass(frozen=True, kw_only=True)
class TagFamily:
    """All tags of one family, whatever their numbers: what may be looked for in an image.

    Raises:
        UnknownNameError: there is no such family.
        ConfigurationError: the edge is not positive.
    """

    family: str = "36h11"
    """Of the AprilTag library."""
    edge_m: float = 0.12
    """Edge of the square of each, see `AprilTag`."""
    size_known: bool = field(default=True, compare=False)
    """Whether the edge was stated."""

    def __post_init__(self) -> None:
        """Check the family and the size."""
        object.__setattr__(self, "family", tag_family(self.family).name)
        _check_length("TagFamily edge_m", self.edge_m)

    def __str__(self) -> str:
        return f"tag:{self.family}"

    def tag(self, identity: int) -> AprilTag:
        """One tag of the family."""
        return AprilTag(
            family=self.family, id=identity, edge_m=self.edge_m, size_known=self.size_known
        )


@dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard, drawn with a white rim of one square or without.

    The upper left square is black. Where one count of inner corners is even and the other odd, the
    board differs from itself turned by 180 degrees, and the measured point, origin of T, is its
    upper right inner corner. Any other board is symmetric: which of its corners is the upper
    right one cannot be seen, and the measured point is its middle.

    Raises:
        ConfigurationError: fewer than 3 corners along a side, or a square that is not positive.
    """

    columns: int = 5
    """Inner corners along x."""
    rows: int = 4
    """Inner corners along y."""
    square_m: float = 0.04
    """Edge of one square."""
    rim: bool = True
    """Whether a white rim of one square is printed around it. Detectors need none."""
    size_known: bool = field(default=True, compare=False)
    """Whether the square's edge was stated."""

    def __post_init__(self) -> None:
        """Check the counts and the size."""
        if (
            not _LEAST_CORNERS
            <= min(self.columns, self.rows)
            <= max(self.columns, self.rows)
            <= _MOST_CELLS
        ):
            raise ConfigurationError(
                f"Checkerboard: expected {_LEAST_CORNERS} to {_MOST_CELLS} inner corners a side, "
                f"got {self.columns} columns and {self.rows} rows"
            )
        _check_length("Checkerboard square_m", self.square_m)

    def __str__(self) -> str:
        size = f":{1000 * self.square_m:g}" if self.size_known else ""
        return f"checkerboard:{self.columns}x{self.rows}{size}"

    @property
    def symmetric(self) -> bool:
        """Whether it looks the same turned by 180 degrees."""
        return (self.columns + self.rows) % 2 == 0

    @property
    def cell_m(self) -> float:
        """Edge of one cell, which is a square, in metres."""
        return self.square_m

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        rim = 1.0 if self.rim else 0.0
        if self.symmetric:
            return (0.5 * (self.columns + 1) + rim, 0.5 * (self.rows + 1) + rim)
        return (self.columns + rim, 1.0 + rim)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell, 0 black, 255 white.

        Shape (rows + 3, columns + 3), without a rim (rows + 1, columns + 1).
        """
        y, x = np.mgrid[: self.rows + 1, : self.columns + 1]
        squares = np.where((x + y) % 2 == 0, 0, 255)
        return np.asarray(np.pad(squares, int(self.rim), constant_values=255), np.uint8)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Inner corners in T, shape (rows * columns, 2), row by row from the upper left."""
        y, x = np.mgrid[1 : self.rows + 1, 1 : self.columns + 1].astype(float) + int(self.rim)
        places = np.stack([x.ravel(), y.ravel()], axis=-1)
        return self.square_m * (places - self.origin_cells)


@dataclass(frozen=True, kw_only=True)
class CharucoBoard:
    """A checkerboard with ArUco markers in its white squares, as OpenCV lays it out.

    The measured point, origin of T, is its middle. Since OpenCV 4.6 the upper left square is
    black; before, it was white where the number of rows is even, and many boards on walls are such.

    Raises:
        UnknownNameError: there is no such dictionary.
        ConfigurationError: fewer than 3 squares along a side, more markers than the dictionary has,
            lengths that are not positive, or a marker that is not smaller than its square.
    """

    columns: int = 7
    """Squares along x."""
    rows: int = 5
    """Squares along y."""
    square_m: float = 0.04
    """Edge of one square."""
    marker_m: float = 0.03
    """Edge of one marker."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the markers' dictionary."""
    legacy: bool = False
    """Whether it is laid out as OpenCV did before 4.6."""

    size_known: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the counts, the dictionary and the sizes."""
        object.__setattr__(self, "dictionary", _dictionary_name(self.dictionary))
        if not 3 <= min(self.columns, self.rows) <= max(self.columns, self.rows) <= _MOST_CELLS:
            raise ConfigurationError(
                f"CharucoBoard: expected 3 to {_MOST_CELLS} squares a side, "
                f"got {self.columns} columns and {self.rows} rows"
            )
        _check_length("CharucoBoard square_m", self.square_m)
        _check_length("CharucoBoard marker_m", self.marker_m)
        if self.marker_m >= self.square_m:
            raise ConfigurationError(
                "CharucoBoard marker_m: expected less than a square's "
                f"{1000 * self.square_m:g} mm, got {1000 * self.marker_m:g} mm"
            )
        markers, there = self.columns * self.rows // 2, len(self._markers.bytesList)
        if markers > there:
            raise ConfigurationError(
                f"CharucoBoard dictionary: expected one of at least {markers} markers, "
                f"got {self.dictionary} of {there}"
            )

    def __str__(self) -> str:
        sizes = f"{1000 * self.square_m:g}:{1000 * self.marker_m:g}"
        legacy = ":legacy" if self.legacy else ""
        name = self.dictionary.removeprefix("DICT_")
        return f"charuco:{self.columns}x{self.rows}:{sizes}:{name}{legacy}"

    @property
    def _markers(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    def opencv_board(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV has it, lengths in metres."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, self._markers)
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def cell_m(self) -> float:
        """Edge of one of the cells that `cells` draws it with, in metres."""
        return self.square_m / self._cells_per_square

    @property
    def _cells_per_square(self) -> int:
        """As many as make the markers' bits and their margins whole cells, or nearly so."""
        bits = self._markers.markerSize + 2
        share = self.marker_m / self.square_m
        for cells in range(bits + 1, _MOST_CHARUCO_CELLS):
            bit = round(cells * share / bits)
            exact = bit > 0 and abs(bits * bit - cells * share) < _SAME_CELLS
            if exact and (cells - bits * bit) % 2 == 0:
                return cells
        return _MOST_CHARUCO_CELLS

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        half = 0.5 * self._cells_per_square
        return (half * self.columns, half * self.rows)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell, 0 black, 255 white, as OpenCV draws it."""
        size = self._cells_per_square
        drawn: Any = self.opencv_board().generateImage((size * self.columns, size * self.rows))
        return np.asarray(drawn, np.uint8)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Inner corners of the squares in T, shape ((rows - 1) (columns - 1), 2), by OpenCV's ids.

        Row by row from the upper left.
        """
        y, x = np.mgrid[1 : self.rows, 1 : self.columns].astype(float)
        places = np.stack([x.ravel(), y.ravel()], axis=-1)
        return self.square_m * (places - (0.5 * self.columns, 0.5 * self.rows))


def _dictionary_name(name: str) -> str:
    """OpenCV's name of a dictionary, given with or without `DICT_` and in any case."""
    known = [each for each in dir(cv2.aruco) if each.startswith("DICT_")]
    found = {each.lower(): each for each in known}.get("dict_" + name.lower().removeprefix("dict_"))
    if found is None:
        raise UnknownNameError("ArUco dictionary", name, sorted(known))
    return found


PlanarTarget = AprilTag | Checkerboard | CharucoBoard | AprilGrid
Target = PlanarTarget | TagFamily
"""What may be looked for in an image."""


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


def board_pose(
    point: ArrayLike, facing: Literal["head", "forward"] = "head"
) -> NDArray[np.float64]:
    """The pose of a board whose measured point is at a point of N.

    Args:
        point: (3,) in N, m.
        facing: `head`, square to the line from N's origin; `forward`, parallel to N's xy plane.

    Returns:
        (4, 4) T_N_T: x right and y down as seen from the head, z into the board.
    """
    point = np.asarray(point, dtype=np.float64)
    pose = np.eye(4)
    pose[:3, 3] = point
    if facing == "head":
        z = point / np.sqrt(point @ point)
        x = np.array([z[2], 0.0, -z[0]])
        x /= np.sqrt(x @ x)
        pose[:3, 0], pose[:3, 2] = x, z
        pose[:3, 1] = (z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], -z[1] * x[0])
    return pose


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


def _check_length(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ConfigurationError(f"{name}: expected a positive length, got {value}")
