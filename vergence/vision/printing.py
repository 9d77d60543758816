"""Lay out a target on a sheet of paper at true scale, with a ruler to check the print.

Lengths on a sheet are millimetres from its upper left corner, x right and y down.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.vision.targets import AprilTag, Checkerboard, PlanarTarget, TagFamily, Target

RULER_MM: Final = 100.0
"""Length of the ruler beside the board (chosen: long enough to check the scale, fits on A5)."""
RULER_STRIP_MM: Final = 17.0
"""Width of the strip for the ruler and its two lines of text, up to the sheet's edge (chosen)."""
_UNPRINTED_MARGIN_MM: Final = 5.0
"""Unprinted margin along the edges of a sheet (chosen: office printers need up to 4.3 mm)."""
_MAX_EXTRA_MARGIN_MM: Final = 8.0
"""Largest additional margin of the strip if there is room (chosen)."""
_QUIET_ZONE_FRACTION: Final = 0.05
"""Least white margin around a board as a fraction of its shorter side, such as a quarter of a
square for a ChArUco board of 5 squares; one cell is required as well (chosen)."""
_QUIET_ZONE_SQUARES: Final = 0.5
"""Least white margin around a checkerboard, in squares, its cells (chosen)."""
_MAX_SHEET_MM: Final = 5000.0
"""Largest sheet of a PDF, rounded down: 14400 points are 5080 mm (physical: the PDF standard)."""
_MM_PER_M: Final = 1000.0
"""Millimetres per metre (physical)."""
_SLACK_MM: Final = 1e-6
"""Tolerance when lengths are compared (numerical)."""


@dataclass(frozen=True)
class Paper:
    """A size of paper."""

    short_mm: float
    """Length of the shorter edge."""
    long_mm: float
    """Length of the longer edge."""
    name: str = ""
    """Name, such as a4; empty for a size without one."""

    def __str__(self) -> str:
        size = f"{self.short_mm:g} x {self.long_mm:g} mm"
        return f"{self.name} ({size})" if self.name else size


_SIZES_MM: Final = {
    "a5": (148.0, 210.0),
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
"""ISO 216 and ANSI sizes, each series in ascending order."""
PAPERS: Final = {name: Paper(*size, name) for name, size in _SIZES_MM.items()}
"""Named sizes of paper."""


def parse_paper(text: str) -> Paper:
    """Parse a size of paper.

    Args:
        text: a name of `PAPERS` in any case, or WIDTHxHEIGHT in mm.

    Raises:
        UnknownNameError: no paper has that name.
        ConfigurationError: the size is 0 or too large for a PDF.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)[xX×](\d+(?:\.\d+)?)", text.strip())
    if match is None:
        name = text.strip().lower()
        if name in PAPERS:
            return PAPERS[name]
        raise UnknownNameError("paper", text[:100], [*sorted(PAPERS), "WIDTHxHEIGHT in mm"])
    short, long = sorted(float(part) for part in match.groups())
    if not 0.0 < short <= long <= _MAX_SHEET_MM:
        raise ConfigurationError(
            f"paper: expected edges of up to {_MAX_SHEET_MM:g} mm, got {text.strip():.100}"
        )
    return Paper(short, long)


def require_printable(target: Target) -> PlanarTarget:
    """Return a target that is fully specified for printing.

    Raises:
        ConfigurationError: the target is a whole family of tags, or lacks its size.
    """
    if isinstance(target, TagFamily):
        raise ConfigurationError(
            f"target: expected one tag with its number and its edge in mm, such as {target}:0:120, "
            f"got {target}"
        )
    if not target.size_known:
        example = f"{target}:120" if isinstance(target, AprilTag) else f"{target}:20"
        raise ConfigurationError(
            f"target: expected its size in mm at the end, such as {example}, got {target}"
        )
    return target


@dataclass(frozen=True)
class PrintSheet:
    """A board and a ruler on a sheet of paper."""

    target: PlanarTarget
    """The board."""
    paper: Paper
    """The size of paper."""
    width_mm: float
    """Width of the sheet in its orientation."""
    height_mm: float
    """Height of the sheet in its orientation."""
    board_corner_mm: tuple[float, float]
    """Upper left corner of the board's cells, (x, y)."""
    ruler_zero_mm: tuple[float, float]
    """Zero of the ruler, (x, y)."""
    ruler_upright: bool
    """True if the ruler is right of the board and runs up; false if it is below the board."""

    @property
    def landscape(self) -> bool:
        """True if the sheet is wider than high."""
        return self.width_mm > self.height_mm

    @cached_property
    def black_outlines_mm(self) -> list[NDArray[np.float64]]:
        """Outlines of the board's black areas on the sheet, see `black_outlines`, each (n, 2)."""
        cell_mm = _MM_PER_M * self.target.cell_m
        return [cell_mm * loop + self.board_corner_mm for loop in black_outlines(self.target.cells)]


def lay_out_sheet(target: PlanarTarget, paper: Paper) -> PrintSheet:
    """Place a board on paper, upright and at true scale, with the ruler beside its white margin.

    The ruler is below the board if it fits there, else to its right; of portrait and landscape
    the one with more room is taken.

    Args:
        target: the board.
        paper: the size of paper.

    Raises:
        ConfigurationError: the board does not fit.
    """
    frame = _Frame.of(target)
    found = [place for place in _places(paper) if place.slack_mm(frame) >= -_SLACK_MM]
    if not found:
        raise ConfigurationError(_too_large(target, frame, paper))
    place = max(found, key=lambda place: (not place.upright, place.slack_mm(frame)))
    width, height = place.width_mm, place.height_mm
    # lengths along the direction from the board to the ruler: to the right or down
    sheet, board = (width, frame.width_mm) if place.upright else (height, frame.height_mm)
    spare = max(0.0, sheet - board - RULER_STRIP_MM)
    ruler = sheet - RULER_STRIP_MM - min(spare / 3.0, _MAX_EXTRA_MARGIN_MM)
    if place.upright:
        left, top = 0.5 * (ruler - frame.width_mm), 0.5 * (height - frame.height_mm)
        zero = (ruler, 0.5 * (height + RULER_MM))
    else:
        left, top = 0.5 * (width - frame.width_mm), 0.5 * (ruler - frame.height_mm)
        zero = (0.5 * (width - RULER_MM), ruler)
    return PrintSheet(
        target=target,
        paper=paper,
        width_mm=width,
        height_mm=height,
        board_corner_mm=(left + frame.rim_mm, top + frame.rim_mm),
        ruler_zero_mm=zero,
        ruler_upright=place.upright,
    )


@dataclass(frozen=True)
class _Frame:
    """A board with its white margin."""

    width_mm: float
    height_mm: float
    rim_mm: float
    """White margin to add on each side of the board's cells; negative if they have more than
    needed."""

    @classmethod
    def of(cls, target: PlanarTarget, scale: float = 1.0) -> "_Frame":
        """Frame of a board, its lengths multiplied by a scale."""
        cell = scale * _MM_PER_M * target.cell_m
        rows, columns = target.cells.shape
        y, x = np.nonzero(target.cells == 0)
        white = min(x.min(), y.min(), columns - 1 - x.max(), rows - 1 - y.max())
        shorter = cell * (min(rows, columns) - 2 * white)
        quiet = cell * (_QUIET_ZONE_SQUARES if isinstance(target, Checkerboard) else 1.0)
        rim = max(quiet, _QUIET_ZONE_FRACTION * shorter, _UNPRINTED_MARGIN_MM) - cell * white
        return cls(cell * columns + 2.0 * rim, cell * rows + 2.0 * rim, rim)


@dataclass(frozen=True)
class _Place:
    """An orientation of a sheet and a position of its ruler."""

    width_mm: float
    height_mm: float
    upright: bool

    def slack_mm(self, frame: _Frame) -> float:
        """Room left in the tighter direction; negative if the board does not fit."""
        width, height = _needs_mm(frame, self.upright)
        return min(self.width_mm - width, self.height_mm - height)


def _needs_mm(frame: _Frame, upright: bool) -> tuple[float, float]:
    """Width and height of the smallest sheet for a frame and a ruler."""
    ruler = RULER_MM + 2.0 * _UNPRINTED_MARGIN_MM
    if upright:
        return frame.width_mm + RULER_STRIP_MM, max(frame.height_mm, ruler)
    return max(frame.width_mm, ruler), frame.height_mm + RULER_STRIP_MM


def _places(paper: Paper) -> Iterator[_Place]:
    for upright in (False, True):
        yield _Place(paper.short_mm, paper.long_mm, upright)
        yield _Place(paper.long_mm, paper.short_mm, upright)


def _fits(frame: _Frame, paper: Paper) -> bool:
    return any(place.slack_mm(frame) >= -_SLACK_MM for place in _places(paper))


def _too_large(target: PlanarTarget, frame: _Frame, paper: Paper) -> str:
    width, height = min((_needs_mm(frame, upright) for upright in (False, True)), key=math.prod)
    series = [name for name in PAPERS if name.startswith("a") == (paper.name[:1] in ("", "a"))]
    others = [name for name in PAPERS if name not in series]
    larger = next((name for name in (*series, *others) if _fits(frame, PAPERS[name])), None)
    if larger is None:
        larger = f"{math.ceil(width)}x{math.ceil(height)}"
    return (
        f"expected a board that fits on {paper}, got {target} that needs {math.ceil(width)} x "
        f"{math.ceil(height)} mm with its white margin and the ruler: give --paper {larger}"
        f"{_smaller(target, paper)}"
    )


def _smaller(target: PlanarTarget, paper: Paper) -> str:
    """Phrase with the largest size of such a board on the paper; empty if none fits."""
    low, high = 0.0, 1.0
    for _ in range(40):
        scale = 0.5 * (low + high)
        low, high = (scale, high) if _fits(_Frame.of(target, scale), paper) else (low, scale)
    for name, words in (("square_m", "squares"), ("edge_m", "an edge"), ("tag_m", "tags")):
        length_mm = low * _MM_PER_M * float(getattr(target, name, 0.0))
        if length_mm >= 1.0:
            step = 1.0 if length_mm >= 10.0 else 0.1
            return f", or {words} of at most {step * math.floor(length_mm / step):g} mm"
    return f", or a board of at most {math.floor(100.0 * low)} % of its size" if low > 0.01 else ""


def black_outlines(cells: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
    """Outlines of a board's black cells; drawn as one path, they have no seams.

    Args:
        cells: the board, 0 black, 255 white; shape (rows, columns).

    Returns:
        Closed polygons in cells from the upper left corner, each (n, 2) of (x, y) without
        repeating the first vertex. With y down they run clockwise around black and
        counterclockwise around white holes, so that both the even-odd and the nonzero winding
        rule fill the black.
    """
    black = np.pad(np.asarray(cells) == 0, 1).astype(np.int8)
    # directed edges between black and white: end vertices (row, column) by start vertex
    across, along = np.diff(black, axis=0)[:, 1:-1], np.diff(black, axis=1)[1:-1]
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for sign, steps in ((1, (0, 1)), (-1, (0, -1))):
        for row, column in np.argwhere(across == sign).tolist():
            start = (row, column if sign > 0 else column + 1)
            edges.setdefault(start, []).append((start[0], start[1] + steps[1]))
    for sign in (1, -1):
        for row, column in np.argwhere(along == sign).tolist():
            start = (row + 1, column) if sign > 0 else (row, column)
            edges.setdefault(start, []).append((start[0] - sign, start[1]))
    loops = []
    while edges:
        loop = [next(iter(edges))]
        while True:
            ends = edges[loop[-1]]
            end = ends.pop()
            if not ends:
                del edges[loop[-1]]
            if end == loop[0]:
                break
            loop.append(end)
        loops.append(_corners(np.array(loop)))
    return loops


def _corners(loop: NDArray[np.int_]) -> NDArray[np.float64]:
    """Vertices (x, y) at which a closed polygon of (row, column) changes direction."""
    step = loop - np.roll(loop, 1, axis=0)
    turns = (step != np.roll(step, -1, axis=0)).any(axis=1)
    return np.asarray(loop[turns][:, ::-1], np.float64)
