"""AprilTag families: their code words, and grids of tags."""

import ctypes
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, UnknownNameError

UNPRINTED: Final = 128
"""Value of a cell outside all bits and borders, where anything may be printed (numerical)."""

CORRECTED_BITS: Final = {
    "36h11": 2,
    "36h10": 2,
    "25h9": 1,
    "16h5": 0,
    "Circle21h7": 0,
    "Circle49h12": 1,
    "Custom48h12": 1,
    "Standard41h12": 1,
    "Standard52h13": 1,
}
"""By family: the number of wrong bits of a tag that are corrected.

The probability that random bits of a square decode as a tag grows steeply with this number: it is
2e-5 for 36h11 with two bits, and would be 0.03 for 16h5 with one. For families of 40,000 tags and
more, the table of corrected codes would take gigabytes with two bits."""


SQUARE: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Corners of a square from the upper left, clockwise, half edges (numerical)."""


def check_length(name: str, value: float) -> None:
    """Raise `ConfigurationError` unless a value of a name is a positive length."""
    if not (np.isfinite(value) and value > 0):
        raise ConfigurationError(f"{name}: expected a positive length, got {value}")


@dataclass(frozen=True, eq=False)
class TagFamilyCode:
    """One family: its code words and the layout of their bits.

    Attributes:
        name: name without the library's prefix `tag`, such as 36h11.
        code_words: code words, shape (n,); the most significant of `bits` bits belongs to the first
            place.
        bit_cells: (x, y) of each bit, in cells from the upper left corner of the square that the
            library detects, shape (bits, 2).
        width_at_border: cells along a side of that square.
        total_width: cells along a side of the printed pattern, including a quiet zone of one
            cell if the family has one.
        dark_inside: True if the square is dark on a white surround, as in the families with a
            plain black border; the families named Standard, Custom and Circle have a white square
            in a black ring, with bits outside the ring.
    """

    name: str
    code_words: NDArray[np.uint64]
    bit_cells: NDArray[np.int_]
    width_at_border: int
    total_width: int
    dark_inside: bool

    def cells(self, identity: int) -> NDArray[np.uint8]:
        """Cells of a tag, (total, total): 0 black, 255 white, `UNPRINTED` outside bits, borders."""
        if not 0 <= identity < len(self.code_words):
            raise ConfigurationError(
                f"AprilTag id: expected 0 to {len(self.code_words) - 1} in the family {self.name}, "
                f"got {identity}"
            )
        cells = np.full((self.total_width, self.total_width), UNPRINTED, np.uint8)
        start = (self.total_width - self.width_at_border) // 2
        end = start + self.width_at_border
        inner, outer = (0, 255) if self.dark_inside else (255, 0)
        for more, value in ((1, outer), (0, inner), (-1, UNPRINTED)):
            cells[start - more : end + more, start - more : end + more] = value
        bits = len(self.bit_cells)
        word = int(self.code_words[identity])
        for i, (x, y) in enumerate(self.bit_cells.tolist()):
            cells[y + start, x + start] = 255 if word >> (bits - i - 1) & 1 else 0
        return cells


@cache
def tag_family(name: str) -> TagFamilyCode:
    """Load the family of a name such as 36h11, tag36h11 or Standard41h12, in any letter case."""
    known = {each.lower(): each for each in CORRECTED_BITS}
    proper = known.get(name.lower().removeprefix("tag"))
    if proper is None:
        raise UnknownNameError("AprilTag family", name, sorted(CORRECTED_BITS))
    library = load_library()
    family = library_family(library, proper)
    code = family.contents
    bits = [np.ctypeslib.as_array(each, (int(code.nbits),)) for each in (code.bit_x, code.bit_y)]
    made = TagFamilyCode(
        name=proper,
        code_words=np.ctypeslib.as_array(code.codes, (int(code.ncodes),)).copy(),
        bit_cells=np.stack(bits, axis=-1).astype(int),
        width_at_border=int(code.width_at_border),
        total_width=int(code.total_width),
        dark_inside=not code.reversed_border,
    )
    getattr(library, f"tag{proper}_destroy")(family)
    return made


@cache
def load_library() -> ctypes.CDLL:
    """Load the AprilTag library that the Python binding contains."""
    # a detector without families costs nothing and declares the return types of the functions
    library = pyapriltags.Detector(families="").libc
    assert library is not None
    return library


def library_family(library: ctypes.CDLL, name: str) -> Any:
    """Create the library's description of a family; the caller must destroy it."""
    create = getattr(library, f"tag{name}_create")
    plain = library.tag36h11_create  # the binding does not declare 36h10
    create.restype = plain.restype
    return create()


GRID_FAMILY: Final = "36h11"
GRID_BORDER_BITS: Final = 2
"""Width of each tag's black border, bits; the AprilTag library's own tags have 1 (physical:
Kalibr's boards)."""
_CODE_BITS: Final = 6
"""Bits along a side of the family's code (physical: the AprilTag family 36h11)."""
_TAG_BITS: Final = _CODE_BITS + 2 * GRID_BORDER_BITS
"""Bits along a side of a tag (physical: as above)."""
_MOST_CELLS_PER_BIT: Final = 16
"""Most cells along a bit. Kalibr's vector drawing has no cells; cells reproduce it to 1 / 320 of a
tag, mostly exactly (chosen: accuracy against image size)."""
_ROUNDING_BITS: Final = 1e-6
"""Rounding error of a gap that counts as a whole number of cells, in bits (numerical)."""


@dataclass(frozen=True, kw_only=True)
class AprilGrid:
    """A grid of AprilTags 36h11 as Kalibr prints it, each tag with a border of two bits.

    Tag 0 is the lower left one; ids increase to the right, then row by row upwards. A black
    square as wide as the gap between two tags touches each corner of each tag, also at the edge of
    the board, so black and white alternate around a tag. The measured point, the origin of T, is
    the centre of the grid.

    Raises:
        ConfigurationError: a count that is not positive, more tags than the family has, an edge
            that is not positive, or a spacing that is not between 0 and 1.
    """

    columns: int = 6
    """Tags along x."""
    rows: int = 6
    """Tags along y."""
    tag_m: float = 0.088
    """Edge of the black square of a tag, m."""
    spacing: float = 0.3
    """Gap between two tags, as a fraction of a tag's edge."""

    size_known: ClassVar[bool] = True

    def __post_init__(self) -> None:
        most = len(self.code.code_words)
        if min(self.columns, self.rows) < 1 or self.columns * self.rows > most:
            raise ConfigurationError(
                f"AprilGrid: expected 1 to {most} tags in columns and rows, "
                f"got {self.columns} columns and {self.rows} rows"
            )
        check_length("AprilGrid tag_m", self.tag_m)
        if not 0.0 < self.spacing < 1.0:
            raise ConfigurationError(
                "AprilGrid spacing: expected the gap between two tags by the edge of one, between "
                f"0 and 1, got {self.spacing}"
            )

    def __str__(self) -> str:
        return f"aprilgrid:{self.columns}x{self.rows}:{1000 * self.tag_m:g}:{self.spacing:g}"

    @property
    def code(self) -> TagFamilyCode:
        """The family's code words."""
        return tag_family(GRID_FAMILY)

    @property
    def bit_m(self) -> float:
        """Edge of one bit of a tag in metres."""
        return self.tag_m / _TAG_BITS

    @property
    def cell_m(self) -> float:
        """Edge of one cell of `cells`, in metres."""
        return self.bit_m / self._cells_per_bit[0]

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the board's upper left corner, (x, y)."""
        rows, columns = self.cells.shape
        return (0.5 * columns, 0.5 * rows)

    @cached_property
    def _cells_per_bit(self) -> tuple[int, int]:
        """Cells along a bit and along a gap: the fewest that make the gap a whole number of cells.

        If no number up to the limit does, the one with the least error.
        """
        gaps = [self.spacing * _TAG_BITS * cells for cells in range(1, _MOST_CELLS_PER_BIT + 1)]
        off = [abs(max(round(gap), 1) - gap) / cells for cells, gap in enumerate(gaps, 1)]
        best = next((i for i, each in enumerate(off) if each < _ROUNDING_BITS), int(np.argmin(off)))
        return best + 1, max(round(gaps[best]), 1)

    def tag_bits(self, identity: int) -> NDArray[np.uint8]:
        """One tag without the squares at its corners, 0 black, 255 white, shape (10, 10)."""
        start = (self.code.total_width - _CODE_BITS) // 2
        bits = self.code.cells(identity)[start : start + _CODE_BITS, start : start + _CODE_BITS]
        return np.pad(bits, GRID_BORDER_BITS)

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """The board with a white margin as wide as a gap; one byte a cell, 0 black, 255 white."""
        fine, gap = self._cells_per_bit
        size = fine * _TAG_BITS
        pitch = size + gap
        out = np.full((self.rows * pitch + 3 * gap, self.columns * pitch + 3 * gap), 255, np.uint8)
        for identity, (row, column) in enumerate(self.tag_cells.tolist()):
            y, x = row * pitch + 2 * gap, column * pitch + 2 * gap
            tag = self.tag_bits(identity).repeat(fine, axis=0).repeat(fine, axis=1)
            out[y : y + size, x : x + size] = tag
        for row, column in np.ndindex(self.rows + 1, self.columns + 1):
            y, x = row * pitch + gap, column * pitch + gap
            out[y : y + gap, x : x + gap] = 0
        return out

    @cached_property
    def tag_cells(self) -> NDArray[np.intp]:
        """Row (from the top) and column of each tag by its id, shape (rows * columns, 2)."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        return np.stack([self.rows - 1 - row, column], axis=-1)

    @cached_property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the tags in T, metres, shape (4 rows columns, 2), in the order of tag ids.

        Each tag's corners start at the upper left and go clockwise on the upright board.
        """
        middle = 0.5 * np.array([self.columns - 1, self.rows - 1])
        tags = (1.0 + self.spacing) * (self.tag_cells[:, ::-1] - middle)
        return np.asarray(self.tag_m * (tags[:, None] + 0.5 * SQUARE).reshape(-1, 2))


_LEAST_SIDE_PX: Final = 24
"""Smallest side of an image that is searched, px: the library fails on images of a few pixels
(chosen: with a margin)."""
_SHARPENING: Final = 0.25
"""Strength of sharpening, the library's default; it helps with small tags, and the binding would
round it down to 0 (chosen: by the library)."""


class FoundSquare(NamedTuple):
    """A square that reads as a tag."""

    id: int
    wrong_bits: int
    corners: NDArray[np.float64]
    """Corners from the tag's upper left one, clockwise in the image, in OpenCV's pixels, shape
    (4, 2)."""
    border_fraction: float = 1.0
    """Fraction of the border's cells that have its colour; 1 if the cells were not read."""


_DETECTORS: Final = threading.local()
"""The library's detectors of this thread by name; they keep state during a search."""


def find_squares(image: NDArray[np.uint8], family: str, border_bits: int = 1) -> list[FoundSquare]:
    """All squares of grey levels (height, width) that read as tags, by number and wrong bits.

    Their black border is `border_bits` cells wide.
    """
    # the library's origin is the corner of the first pixel; its corners begin at the lower left
    found = [
        FoundSquare(each.tag_id, each.hamming, np.asarray(each.corners, float)[::-1] - 0.5)
        for each in _detect(image, family, {family: CORRECTED_BITS[family]}, border_bits)
    ]
    return sorted(found, key=lambda each: (each.id, each.wrong_bits))


def families_in(image: NDArray[np.uint8]) -> list[str]:
    """Families that seem to have tags in grey levels (height, width), from one search for all.

    They have at least one square that reads as a tag without a wrong bit, the most frequent first.
    """
    found = _detect(image, "all", dict.fromkeys(CORRECTED_BITS, 0))
    names = (each.tag_family.decode() for each in found)
    return [name.removeprefix("tag") for name, _ in Counter(names).most_common()]


def _detect(
    image: NDArray[np.uint8], name: str, corrected: Mapping[str, int], border_bits: int = 1
) -> list[Any]:
    """Squares found by this thread's detector of a name, given each family's corrected bits.

    The binding itself lacks some families, and adds the others with two corrected bits each,
    regardless of the cost.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return []
    name, wider = f"{name} {border_bits}", border_bits - 1
    detector: Any = vars(_DETECTORS).get(name)
    if detector is None:
        detector = pyapriltags.Detector(families="", nthreads=1, quad_decimate=1.0)
        for family, bits in corrected.items():
            made = library_family(detector.libc, family)
            made.contents.width_at_border += 2 * wider
            made.contents.total_width += 2 * wider
            for bit in range(int(made.contents.nbits)):
                made.contents.bit_x[bit] += wider
                made.contents.bit_y[bit] += wider
            detector.libc.apriltag_detector_add_family_bits(detector.tag_detector_ptr, made, bits)
        if not wider:
            detector.tag_detector_ptr.contents.decode_sharpening = _SHARPENING
        vars(_DETECTORS)[name] = detector
    return list(detector.detect(image))
