"""AprilTag families: the printed pattern of each id, read from the AprilTag library.

The code words and the positions of their bits come from the library itself, so a tag is drawn
upright as the library draws it; OpenCV's dictionaries hold the same tags upside down.
"""

import ctypes
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

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

    @cached_property
    def _blank(self) -> NDArray[np.uint8]:
        """The tag without bits: both rings of the border; all other cells are `UNPRINTED`."""
        cells = np.full((self.total_width, self.total_width), UNPRINTED, np.uint8)
        start = (self.total_width - self.width_at_border) // 2
        inner, outer = (0, 255) if self.dark_inside else (255, 0)
        cells[
            start - 1 : start + self.width_at_border + 1,
            start - 1 : start + self.width_at_border + 1,
        ] = outer
        cells[start : start + self.width_at_border, start : start + self.width_at_border] = inner
        core = slice(start + 1, start + self.width_at_border - 1)
        cells[core, core] = UNPRINTED
        return cells

    def cells(self, identity: int) -> NDArray[np.uint8]:
        """Cells of a tag, (total, total): 0 black, 255 white, `UNPRINTED` outside bits, borders."""
        if not 0 <= identity < len(self.code_words):
            raise ConfigurationError(
                f"AprilTag id: expected 0 to {len(self.code_words) - 1} in the family {self.name}, "
                f"got {identity}"
            )
        cells = self._blank.copy()
        start = (self.total_width - self.width_at_border) // 2
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
    bits = int(code.nbits)
    x, y = (
        np.ctypeslib.as_array(each, shape=(bits,)).astype(int) for each in (code.bit_x, code.bit_y)
    )
    words = np.ctypeslib.as_array(code.codes, shape=(int(code.ncodes),)).copy()
    made = TagFamilyCode(
        name=proper,
        code_words=words,
        bit_cells=np.stack([x, y], axis=-1),
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
