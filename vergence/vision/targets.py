"""Planar targets: the pattern printed on the board that the head looks at.

A target is a grid of square cells, black or white. Its frame T has its origin at the measured
point, x right and y down as the viewer of the board sees it, and z into the board, away from
the viewer. For an upright board that faces a camera squarely, ``T_C_T`` has no rotation.
"""

import math
import re
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Final, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.vision.tag_families import (
    SQUARE,
    UNPRINTED,
    AprilGrid,
    TagFamilyCode,
    check_length,
    tag_family,
)

_LEAST_CORNERS: Final = 3
"""Fewest inner corners along a side for which OpenCV detects a board (physical: OpenCV)."""
_MOST_CELLS: Final = 200
"""Most squares along a side of a board (chosen: more than any photograph resolves)."""
_MOST_CHARUCO_CELLS: Final = 96
"""Most cells along a square of a ChArUco board; its markers are drawn to about one cell (chosen:
accuracy against image size)."""
_ROUNDING_CELLS: Final = 1e-6
"""Rounding error of a marker that counts as a whole number of cells, cells (numerical)."""


@dataclass(frozen=True, kw_only=True)
class AprilTag:
    """An AprilTag, upright as the AprilTag library draws it.

    The measured point, the origin of T, is the centre of the square that the library detects. In
    the families 36h11, 36h10, 25h9 and 16h5 it is black, with a white quiet zone of one cell around
    it; in the others it is white, inside a black ring.

    Raises:
        UnknownNameError: there is no such family.
        ConfigurationError: the family has no such id, or the edge is not positive.
    """

    id: int = 0
    """Number of the tag in its family, from 0."""
    edge_m: float = 0.12
    """Edge of the detected square, m."""
    family: str = "36h11"
    """Name of the family in the AprilTag library, see `vergence.vision.tag_families`."""
    size_known: bool = field(default=True, compare=False)
    """True if the edge was stated; if not, only directions and ratios of lengths are valid."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "family", tag_family(self.family).name)
        self.code.cells(self.id)
        check_length("AprilTag edge_m", self.edge_m)

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
        return self.edge_m / self.code.width_at_border

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        return (0.5 * self.code.total_width, 0.5 * self.code.total_width)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell: 0 black, 255 white; shape (10, 10) for 36h11."""
        cells = self.code.cells(self.id)
        return np.where(cells == UNPRINTED, np.uint8(255), cells)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the detected square in T, shape (4, 2), from the upper left, clockwise."""
        return 0.5 * self.edge_m * SQUARE


@dataclass(frozen=True, kw_only=True)
class TagFamily:
    """All tags of one family, whatever their ids, as a target of detection.

    Raises:
        UnknownNameError: there is no such family.
        ConfigurationError: the edge is not positive.
    """

    family: str = "36h11"
    """Name of the family in the AprilTag library."""
    edge_m: float = 0.12
    """Edge of each tag's detected square, m, see `AprilTag`."""
    size_known: bool = field(default=True, compare=False)
    """True if the edge was stated."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "family", tag_family(self.family).name)
        check_length("TagFamily edge_m", self.edge_m)

    def __str__(self) -> str:
        return f"tag:{self.family}"

    def tag(self, identity: int) -> AprilTag:
        """One tag of the family."""
        return AprilTag(
            family=self.family, id=identity, edge_m=self.edge_m, size_known=self.size_known
        )


@dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard, with or without a white rim of one square.

    The upper left square is black. If one count of inner corners is even and the other odd, a turn
    by 180 degrees changes the pattern, and the measured point, the origin of T, is the upper right
    inner corner. Any other board is symmetric: an image cannot tell its upper right corner from its
    lower left one, and the measured point is the centre of the board.

    Raises:
        ConfigurationError: fewer than 3 or more than 200 inner corners along a side, or a square
            that is not positive.
    """

    columns: int = 5
    """Inner corners along x."""
    rows: int = 4
    """Inner corners along y."""
    square_m: float = 0.04
    """Edge of one square, m."""
    white_rim: bool = True
    """True if a white rim of one square surrounds the board. Detectors need none."""
    size_known: bool = field(default=True, compare=False)
    """True if the square's edge was stated."""

    def __post_init__(self) -> None:
        _check_counts(self, "inner corners")
        check_length("Checkerboard square_m", self.square_m)

    def __str__(self) -> str:
        size = f":{1000 * self.square_m:g}" if self.size_known else ""
        return f"checkerboard:{self.columns}x{self.rows}{size}"

    @property
    def symmetric(self) -> bool:
        """True if a turn by 180 degrees leaves the pattern unchanged."""
        return (self.columns + self.rows) % 2 == 0

    @property
    def cell_m(self) -> float:
        """Edge of one cell, here a square of the board, in metres."""
        return self.square_m

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        rim = float(self.white_rim)
        if self.symmetric:
            return (0.5 * (self.columns + 1) + rim, 0.5 * (self.rows + 1) + rim)
        return (self.columns + rim, 1.0 + rim)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board, one byte a cell, 0 black, 255 white.

        Shape (rows + 3, columns + 3) with a rim, (rows + 1, columns + 1) without.
        """
        y, x = np.mgrid[: self.rows + 1, : self.columns + 1]
        squares = np.where((x + y) % 2 == 0, 0, 255)
        return np.asarray(np.pad(squares, int(self.white_rim), constant_values=255), np.uint8)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Inner corners in T, metres, shape (rows * columns, 2), row by row from the upper left."""
        places = _inner_corners(self.columns, self.rows) + int(self.white_rim)
        return self.square_m * (places - self.origin_cells)


@dataclass(frozen=True, kw_only=True)
class CharucoBoard:
    """A checkerboard with ArUco markers in its white squares, as OpenCV lays it out.

    The measured point, the origin of T, is the centre of the board. Since OpenCV 4.6 the upper left
    square is black. Before, it was white if the number of rows is even; many boards in use are of
    that kind.

    Raises:
        UnknownNameError: there is no such dictionary.
        ConfigurationError: fewer than 3 or more than 200 squares along a side, more markers than
            the dictionary has, lengths that are not positive, or a marker that is not smaller than
            its square.
    """

    columns: int = 7
    """Squares along x."""
    rows: int = 5
    """Squares along y."""
    square_m: float = 0.04
    """Edge of one square, m."""
    marker_m: float = 0.03
    """Edge of one marker, m."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the dictionary of markers."""
    legacy: bool = False
    """True for the layout of OpenCV before 4.6."""

    size_known: ClassVar[bool] = True

    def __post_init__(self) -> None:
        known = [each for each in dir(cv2.aruco) if each.startswith("DICT_")]
        wanted = "dict_" + self.dictionary.lower().removeprefix("dict_")
        named = [each for each in known if each.lower() == wanted]
        if not named:
            raise UnknownNameError("ArUco dictionary", self.dictionary, sorted(known))
        object.__setattr__(self, "dictionary", named[-1])
        _check_counts(self, "squares")
        check_length("CharucoBoard square_m", self.square_m)
        check_length("CharucoBoard marker_m", self.marker_m)
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
        """Make the same board as an OpenCV object, lengths in metres."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, self._markers)
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def cell_m(self) -> float:
        """Edge of one cell of `cells`, in metres."""
        return self.square_m / self._cells_per_square

    @property
    def _cells_per_square(self) -> int:
        """Fewest cells that make the markers' bits and margins whole cells; at most the limit."""
        bits = self._markers.markerSize + 2
        share = self.marker_m / self.square_m
        for cells in range(bits + 1, _MOST_CHARUCO_CELLS):
            bit = round(cells * share / bits)
            exact = bit > 0 and abs(bits * bit - cells * share) < _ROUNDING_CELLS
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
        """Inner corners in T, metres, shape ((rows - 1) (columns - 1), 2).

        They are in the order of OpenCV's ids: row by row from the upper left.
        """
        places = _inner_corners(self.columns - 1, self.rows - 1)
        return self.square_m * (places - (0.5 * self.columns, 0.5 * self.rows))


def _check_counts(board: Checkerboard | CharucoBoard, parts: str) -> None:
    counts = board.columns, board.rows
    if not _LEAST_CORNERS <= min(counts) <= max(counts) <= _MOST_CELLS:
        raise ConfigurationError(
            f"{type(board).__name__}: expected {_LEAST_CORNERS} to {_MOST_CELLS} {parts} a side, "
            f"got {board.columns} columns and {board.rows} rows"
        )


def _inner_corners(columns: int, rows: int) -> NDArray[np.float64]:
    """(x, y) of inner corners, row by row, in squares from the upper left square's corner."""
    y, x = np.mgrid[1 : rows + 1, 1 : columns + 1].astype(float)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


PlanarTarget = AprilTag | Checkerboard | CharucoBoard | AprilGrid
Target = PlanarTarget | TagFamily
"""Anything that can be detected in an image."""


def make_planar_target(name: str) -> PlanarTarget:
    """The target of the given name with its default size.

    Args:
        name: ``"tag"`` or ``"checkerboard"``.

    Raises:
        UnknownNameError: no target has that name.
    """
    if name not in ("checkerboard", "tag"):
        raise UnknownNameError("planar target", name, ["checkerboard", "tag"])
    return AprilTag() if name == "tag" else Checkerboard()


def outline_m(target: PlanarTarget) -> NDArray[np.float64]:
    """Corners of the whole board in T, metres, shape (4, 2), from the upper left, clockwise."""
    rows, columns = target.cells.shape
    outline = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    return (outline - target.origin_cells) * target.cell_m


def board_pose(
    point: ArrayLike, facing: Literal["head", "forward"] = "head"
) -> NDArray[np.float64]:
    """(4, 4) T_N_T of a board at a point of N, m, facing N's origin or parallel to N's xy plane."""
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
    target: PlanarTarget,
    texels_per_cell: int,
    *,
    surround: int = 255,
    rim_px: int = 0,
    blur_px: float = 0.0,
) -> NDArray[np.uint8]:
    """Grey levels of the board, (rows * texels + 2 rim, columns * texels + 2 rim), blur in px."""
    image = target.cells.repeat(texels_per_cell, axis=0).repeat(texels_per_cell, axis=1)
    image = np.pad(image, rim_px, constant_values=surround)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px > 0 else image, np.uint8)


_LONGEST: Final = 100
"""Longest text that is parsed, characters (chosen: far above any target, short enough for a
message)."""
_FORMS: Final = {
    "tag": "tag:FAMILY[:ID[:EDGE]], such as tag:36h11:5:120 (black edge in mm) or tag:36h11",
    "checkerboard": "checkerboard:COLUMNSxROWS[:SQUARE], such as checkerboard:9x6:24.23 "
    "(inner corners, square in mm)",
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICT, such as charuco:7x5:40:30:4X4_50 "
    "(squares, lengths in mm), with :legacy at the end for a board of OpenCV before 4.6",
    "aprilgrid": "aprilgrid:COLUMNSxROWS:TAG:SPACING, such as aprilgrid:6x6:88:0.3 (kalibr's "
    "tagCols, tagRows, tagSize in mm and tagSpacing)",
}


PRINTED_KINDS: Final = tuple(_FORMS)
"""First words of the texts of printed targets."""


def parse_target(text: str) -> Target:
    """Parse the text form of a target.

    Args:
        text: `tag:FAMILY[:ID[:EDGE]]`, `checkerboard:COLUMNSxROWS[:SQUARE]`,
            `charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy]` or
            `aprilgrid:COLUMNSxROWS:TAG:SPACING`; lengths in mm. COLUMNS and ROWS count the inner
            corners of a checkerboard, the squares of a ChArUco board, and the tags of an
            AprilGrid. SPACING is the gap between two tags as a fraction of a tag's edge.

    Returns:
        The target. Without a size in the text it has the default size and `size_known` is False.

    Raises:
        ConfigurationError: the text has none of these forms, or a value is invalid.
    """
    text = str(text).strip()
    kind, *parts = [part.strip() for part in text.split(":")]
    form = _FORMS.get(kind.lower())
    if form is None and text.isprintable():
        raise ConfigurationError(
            "target: expected a printed board, such as checkerboard:9x6:24, "
            "charuco:7x5:40:30:4X4_50, aprilgrid:6x6:88:0.3 or tag:36h11:0:120 (lengths in mm; "
            f"`vergence print-target` prints it); got {text!r:.100}"
        )
    if form is None or len(text) > _LONGEST or not text.isprintable():
        raise ConfigurationError(
            f"target: expected {'; or '.join(_FORMS.values())}; got {text!r:.100}"
        )
    try:
        return _target([kind.lower(), *parts])
    except ValueError:
        raise ConfigurationError(f"target: expected {form}; got {text!r:.100}") from None
    except (ConfigurationError, UnknownNameError) as error:
        raise ConfigurationError(f"target {text[:100]}: {error}") from error


def _target(parts: list[str]) -> Target:
    """Target of the parts of its text; ValueError if they do not have its form."""
    match parts:
        case ["tag", family]:
            return TagFamily(family=family, size_known=False)
        case ["tag", family, "" | "*", *edge]:
            return TagFamily(family=family, **_size("edge_m", edge))
        case ["tag", family, number, *edge]:
            return AprilTag(family=family, **_size("edge_m", edge), id=_count(number))
        case ["checkerboard", counts, *square]:
            return Checkerboard(**_counts(counts), **_size("square_m", square))
        case ["charuco", counts, square, marker, dictionary, *legacy] if [
            each.lower() for each in legacy
        ] in ([], ["legacy"]):
            return CharucoBoard(
                **_counts(counts),
                square_m=_length_m(square),
                marker_m=_length_m(marker),
                dictionary=dictionary,
                legacy=bool(legacy),
            )
        case ["aprilgrid", counts, tag, spacing]:
            return AprilGrid(**_counts(counts), tag_m=_length_m(tag), spacing=_positive(spacing))
    raise ValueError


def _size(name: str, parts: list[str]) -> dict[str, Any]:
    """Arguments of a target for the optional last part of its text, a length."""
    if len(parts) > 1:
        raise ValueError
    return {name: _length_m(parts[0])} if parts else {"size_known": False}


def _counts(text: str) -> dict[str, Any]:
    columns, rows = re.split(r"\s*[xX×]\s*", text)
    return {"columns": _count(columns, 4), "rows": _count(rows, 4)}


def _count(text: str, most_digits: int = 9) -> int:
    if not 1 <= len(text) <= most_digits or not text.isdecimal():
        raise ValueError
    return int(text)


def _length_m(text: str) -> float:
    """Metres of a length in millimetres."""
    return _positive(text) / 1000.0


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError
    return value


def stated_edge_m(target: PlanarTarget) -> float:
    """Stated edge of a board's squares, of a grid's tags, or of a tag."""
    if isinstance(target, AprilGrid):
        return target.tag_m
    return target.edge_m if isinstance(target, AprilTag) else target.square_m


@lru_cache(maxsize=64)
def neighbour_pairs(target: PlanarTarget) -> NDArray[np.intp]:
    """(k, 2) pairs of corners that are one edge apart on the board."""
    if isinstance(target, AprilGrid):  # gaps between tags are not edges
        first = np.arange(len(target.corners_m))
        return np.column_stack([first, first - first % 4 + (first + 1) % 4])
    if isinstance(target, AprilTag):
        return np.array([[0, 1], [0, 3], [1, 2], [2, 3]])
    columns = target.columns - isinstance(target, CharucoBoard)  # whose columns are squares
    grid = np.arange(len(target.corners_m)).reshape(-1, columns)
    first = np.concatenate([grid[:, :-1].ravel(), grid[:-1].ravel()])
    second = np.concatenate([grid[:, 1:].ravel(), grid[1:].ravel()])
    return np.column_stack([first, second])[np.lexsort([second, first])]
