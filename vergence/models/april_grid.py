"""AprilGrids: the calibration boards of Kalibr, AprilTags in rows with small squares between.

Kalibr calls the fields `columns`, `rows`, `tag_m` and `spacing` `tagCols`, `tagRows`, `tagSize` and
`tagSpacing`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.tag_families import TagFamilyCode, tag_family

GRID_FAMILY: Final = "36h11"
GRID_BORDER_BITS: Final = 2
"""Width of each tag's black border, bits; the AprilTag library's own tags have 1 (physical:
Kalibr's boards)."""
_CODE_BITS: Final = 6
"""Bits along a side of the family's code (physical: the AprilTag family 36h11)."""
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
        """Check the counts and the sizes."""
        most = len(self.code.code_words)
        if min(self.columns, self.rows) < 1 or self.columns * self.rows > most:
            raise ConfigurationError(
                f"AprilGrid: expected 1 to {most} tags in columns and rows, "
                f"got {self.columns} columns and {self.rows} rows"
            )
        if not (np.isfinite(self.tag_m) and self.tag_m > 0):
            raise ConfigurationError(
                f"AprilGrid tag_m: expected a positive length, got {self.tag_m}"
            )
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
        return self.tag_m / (_CODE_BITS + 2 * GRID_BORDER_BITS)

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
        bits = _CODE_BITS + 2 * GRID_BORDER_BITS
        gaps = [self.spacing * bits * cells for cells in range(1, _MOST_CELLS_PER_BIT + 1)]
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
        size = fine * (_CODE_BITS + 2 * GRID_BORDER_BITS)
        pitch = size + gap
        out = np.full((self.rows * pitch + 3 * gap, self.columns * pitch + 3 * gap), 255, np.uint8)
        for identity, (row, column) in enumerate(self.tag_cells.tolist()):
            y, x = row * pitch + 2 * gap, column * pitch + 2 * gap
            tag = self.tag_bits(identity).repeat(fine, axis=0).repeat(fine, axis=1)
            out[y : y + size, x : x + size] = tag
        for row in range(self.rows + 1):
            for column in range(self.columns + 1):
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
        square = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return np.asarray(self.tag_m * (tags[:, None] + square).reshape(-1, 2))
