"""A target laid out on a sheet of paper at true scale, with a ruler to check the print.

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
from vergence.models.boards import AprilTag, Checkerboard, PlanarTarget, TagFamily, Target

RULER_MM: Final = 100.0
"""Length of the ruler beside the board."""
STRIP_MM: Final = 17.0
"""Width of the strip that the ruler and its two lines of text take, up to the sheet's edge."""
_EDGE_MM: Final = 5.0
"""What office printers leave white along the edges of a sheet; some leave up to 4.3 mm."""
_MORE_EDGE_MM: Final = 8.0
"""Most white that the strip is given beyond that where there is room."""
_QUIET_SHARE: Final = 0.05
"""Least white around a board, as a share of its shorter side: a quarter of a square for a ChArUco
board of 5. One cell is the least too."""
_QUIET_SQUARES: Final = 0.5
"""The same around a checkerboard, in squares, which are its cells."""
_MOST_MM: Final = 5000.0
"""Greatest sheet that PDF knows, in round numbers: 14400 points are 5080 mm."""
_MM_PER_M: Final = 1000.0
_SLACK_MM: Final = 1e-6
"""Rounding of lengths that are meant to be equal."""


@dataclass(frozen=True)
class Paper:
    """A size of paper, the shorter edge first."""

    short_mm: float
    """Shorter edge."""
    long_mm: float
    """Longer edge."""
    name: str = ""
    """Its name, such as a4; empty for a size without one."""

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
"""ISO 216 and ANSI sizes; those of a series in their order."""
PAPERS: Final = {name: Paper(*size, name) for name, size in _SIZES_MM.items()}
"""The sizes of paper that have names."""


def parse_paper(text: str) -> Paper:
    """The paper that a text names.

    Args:
        text: a name of `PAPERS` in any case, or WIDTHxHEIGHT in mm.

    Raises:
        UnknownNameError: no paper has that name.
        ConfigurationError: the size is none that a sheet can have.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)[xX×](\d+(?:\.\d+)?)", text.strip())
    if match is None:
        name = text.strip().lower()
        if name in PAPERS:
            return PAPERS[name]
        raise UnknownNameError("paper", text[:100], [*sorted(PAPERS), "WIDTHxHEIGHT in mm"])
    short, long = sorted(float(part) for part in match.groups())
    if not 0.0 < short <= long <= _MOST_MM:
        raise ConfigurationError(
            f"paper: expected edges of up to {_MOST_MM:g} mm, got {text.strip():.100}"
        )
    return Paper(short, long)


def printable(target: Target) -> PlanarTarget:
    """The target, if it says all that a print needs.

    Raises:
        ConfigurationError: it is a whole family of tags, or its size was left out.
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
class Sheet:
    """A board and a ruler on a sheet of paper."""

    target: PlanarTarget
    """The board."""
    paper: Paper
    """Its paper."""
    width_mm: float
    """Width of the sheet as it lies."""
    height_mm: float
    """Height of the sheet as it lies."""
    board_mm: tuple[float, float]
    """Upper left corner of the board's cells, (x, y)."""
    ruler_mm: tuple[float, float]
    """Zero of the ruler, (x, y)."""
    upright: bool
    """Whether the ruler stands at the right of the board and runs up, or lies below it."""

    @property
    def landscape(self) -> bool:
        """Whether the sheet is wider than high."""
        return self.width_mm > self.height_mm

    @cached_property
    def black_mm(self) -> list[NDArray[np.float64]]:
        """Outlines of the board's black, as `black_outlines` has them, each (n, 2)."""
        cell_mm = _MM_PER_M * self.target.cell_m
        return [cell_mm * loop + self.board_mm for loop in black_outlines(self.target.cells)]


def lay_out(target: PlanarTarget, paper: Paper) -> Sheet:
    """Place a board on paper, upright and at true scale, its ruler beside its white margin.

    Args:
        target: the board.
        paper: what it is printed on, in portrait or landscape, whichever has more room; the
            ruler lies below the board if it fits there.

    Raises:
        ConfigurationError: it does not fit.
    """
    frame = _Frame.of(target)
    found = [place for place in _places(paper) if place.slack_mm(frame) >= -_SLACK_MM]
    if not found:
        raise ConfigurationError(_too_large(target, frame, paper))
    place = max(found, key=lambda place: (not place.upright, place.slack_mm(frame)))
    width, height = place.width_mm, place.height_mm
    # the direction from the board to the ruler: to the right or down
    sheet, board = (width, frame.width_mm) if place.upright else (height, frame.height_mm)
    spare = max(0.0, sheet - board - STRIP_MM)
    ruler = sheet - STRIP_MM - min(spare / 3.0, _MORE_EDGE_MM)
    if place.upright:
        left, top = 0.5 * (ruler - frame.width_mm), 0.5 * (height - frame.height_mm)
        zero = (ruler, 0.5 * (height + RULER_MM))
    else:
        left, top = 0.5 * (width - frame.width_mm), 0.5 * (ruler - frame.height_mm)
        zero = (0.5 * (width - RULER_MM), ruler)
    return Sheet(
        target=target,
        paper=paper,
        width_mm=width,
        height_mm=height,
        board_mm=(left + frame.rim_mm, top + frame.rim_mm),
        ruler_mm=zero,
        upright=place.upright,
    )


@dataclass(frozen=True)
class _Frame:
    """A board with its white margin."""

    width_mm: float
    height_mm: float
    rim_mm: float
    """White on each side that the board's cells lack; below zero where they have more."""

    @classmethod
    def of(cls, target: PlanarTarget, scale: float = 1.0) -> "_Frame":
        """The frame of a board, its lengths times a scale."""
        cell = scale * _MM_PER_M * target.cell_m
        rows, columns = target.cells.shape
        y, x = np.nonzero(target.cells == 0)
        white = min(x.min(), y.min(), columns - 1 - x.max(), rows - 1 - y.max())
        shorter = cell * (min(rows, columns) - 2 * white)
        quiet = cell * (_QUIET_SQUARES if isinstance(target, Checkerboard) else 1.0)
        rim = max(quiet, _QUIET_SHARE * shorter, _EDGE_MM) - cell * white
        return cls(cell * columns + 2.0 * rim, cell * rows + 2.0 * rim, rim)


@dataclass(frozen=True)
class _Place:
    """A sheet as it lies, and where its ruler goes."""

    width_mm: float
    height_mm: float
    upright: bool

    def slack_mm(self, frame: _Frame) -> float:
        """Room that is left in the tighter direction; negative where it does not fit."""
        width, height = _needs_mm(frame, self.upright)
        return min(self.width_mm - width, self.height_mm - height)


def _needs_mm(frame: _Frame, upright: bool) -> tuple[float, float]:
    """The width and height of the smallest sheet for a frame and a ruler."""
    ruler = RULER_MM + 2.0 * _EDGE_MM
    if upright:
        return frame.width_mm + STRIP_MM, max(frame.height_mm, ruler)
    return max(frame.width_mm, ruler), frame.height_mm + STRIP_MM


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
    """The greatest size of such a board on the paper, in words; nothing if none fits."""
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
    """The outlines of a board's black cells: drawn as one path, they have no seams.

    Args:
        cells: the board, 0 black, 255 white; shape (rows, columns).

    Returns:
        Closed polygons in cells from the upper left corner, each (n, 2) of (x, y) without its
        first vertex again: with y down, clockwise around black and counterclockwise around white
        in it, so that the rules of even-odd and of nonzero winding both fill the black.
    """
    black = np.pad(np.asarray(cells) == 0, 1).astype(np.int8)
    # vertices (row, column) of the edges with black on one side, by the direction to the next one
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
    """The vertices, (x, y), at which a closed polygon of (row, column) turns."""
    step = loop - np.roll(loop, 1, axis=0)
    turns = (step != np.roll(step, -1, axis=0)).any(axis=1)
    return np.asarray(loop[turns][:, ::-1], np.float64)
