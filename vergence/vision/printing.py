"""Lay out a target on a sheet of paper at true scale, and draw it with a ruler and its name.

Lengths on a sheet are millimetres from its upper left corner, x right and y down.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.files import atomic_file
from vergence.vision.tag_families import AprilGrid
from vergence.vision.targets import (
    AprilTag,
    Checkerboard,
    PlanarTarget,
    TagFamily,
    Target,
    stated_edge_m,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


PAPERS: Final = {
    name: Paper(short_mm, long_mm, name)
    for name, short_mm, long_mm in (
        ("a5", 148.0, 210.0),
        ("a4", 210.0, 297.0),
        ("a3", 297.0, 420.0),
        ("a2", 420.0, 594.0),
        ("a1", 594.0, 841.0),
        ("a0", 841.0, 1189.0),
        ("letter", 215.9, 279.4),
        ("legal", 215.9, 355.6),
        ("tabloid", 279.4, 431.8),
    )
}
"""Named sizes of paper: ISO 216 and ANSI, each series in ascending order."""


def parse_paper(text: str) -> Paper:
    """Parse a name of `PAPERS` in any case, or WIDTHxHEIGHT in mm.

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
    """Return a target unless it is a whole family of tags, or lacks its size, which is refused."""
    if isinstance(target, TagFamily):
        raise ConfigurationError(
            f"target: expected one tag with its number and its edge in mm, such as {target}:0:120, "
            f"got {target}"
        )
    if not target.size_known:
        example = 120 if isinstance(target, AprilTag) else 20
        raise ConfigurationError(
            f"target: expected its size in mm at the end, such as {target}:{example}, got {target}"
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
    the one with more room is taken. `ConfigurationError` if the board does not fit.
    """
    *size_mm, rim_mm = _frame_mm(target)
    places = _places(size_mm, paper)
    if not places:
        raise ConfigurationError(_too_large(target, paper))
    below, _, sheet_mm = max(places, key=lambda place: place[:2])
    # along the direction from the board to the ruler, to the right or down, the ruler is the end
    along = int(below)
    spare = max(0.0, sheet_mm[along] - size_mm[along] - RULER_STRIP_MM)
    ends = [*sheet_mm]
    ends[along] -= RULER_STRIP_MM
    ends[along] -= min(spare / 3.0, _MAX_EXTRA_MARGIN_MM)
    left, top = (0.5 * (end - length) + rim_mm for end, length in zip(ends, size_mm, strict=True))
    width, height = sheet_mm
    zero = (0.5 * (width - RULER_MM), ends[1]) if below else (ends[0], 0.5 * (height + RULER_MM))
    return PrintSheet(target, paper, width, height, (left, top), zero, not below)


def _frame_mm(target: PlanarTarget, scale: float = 1.0) -> tuple[float, float, float]:
    """Width and height of a scaled board with its white margin, and what its cells lack of it."""
    cell = scale * _MM_PER_M * target.cell_m
    rows, columns = target.cells.shape
    y, x = np.nonzero(target.cells == 0)
    white = min(x.min(), y.min(), columns - 1 - x.max(), rows - 1 - y.max())
    shorter = cell * (min(rows, columns) - 2 * white)
    quiet = cell * (_QUIET_ZONE_SQUARES if isinstance(target, Checkerboard) else 1.0)
    rim = max(quiet, _QUIET_ZONE_FRACTION * shorter, _UNPRINTED_MARGIN_MM) - cell * white
    return cell * columns + 2.0 * rim, cell * rows + 2.0 * rim, rim


def _needs_mm(size_mm: Sequence[float], ruler_below: bool) -> tuple[float, float]:
    """Width and height of the smallest sheet for a board with its margin and a ruler."""
    width_mm, height_mm = size_mm
    ruler = RULER_MM + 2.0 * _UNPRINTED_MARGIN_MM
    if ruler_below:
        return max(width_mm, ruler), height_mm + RULER_STRIP_MM
    return width_mm + RULER_STRIP_MM, max(height_mm, ruler)


def _places(
    size_mm: Sequence[float], paper: Paper
) -> list[tuple[bool, float, tuple[float, float]]]:
    """Ways to place a board with its margin: if the ruler is below, slack (mm), sheet (mm)."""
    found = []
    for below in (True, False):
        needs = _needs_mm(size_mm, below)
        for sheet in ((paper.short_mm, paper.long_mm), (paper.long_mm, paper.short_mm)):
            slack = min(sheet[0] - needs[0], sheet[1] - needs[1])
            if slack >= -_SLACK_MM:
                found.append((below, slack, sheet))
    return found


def _too_large(target: PlanarTarget, paper: Paper) -> str:
    size = _frame_mm(target)[:2]
    width, height = min((_needs_mm(size, below) for below in (True, False)), key=math.prod)
    series = [name for name in PAPERS if name.startswith("a") == (paper.name[:1] in ("", "a"))]
    others = [name for name in PAPERS if name not in series]
    larger = next((name for name in (*series, *others) if _places(size, PAPERS[name])), None)
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
        fits = _places(_frame_mm(target, scale)[:2], paper)
        low, high = (scale, high) if fits else (low, scale)
    length_mm = low * _MM_PER_M * stated_edge_m(target)
    if length_mm >= 1.0:
        words = {AprilTag: "an edge", AprilGrid: "tags"}.get(type(target), "squares")
        step = 1.0 if length_mm >= 10.0 else 0.1
        return f", or {words} of at most {step * math.floor(length_mm / step):g} mm"
    return f", or a board of at most {math.floor(100.0 * low)} % of its size" if low > 0.01 else ""


def black_outlines(cells: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
    """Outlines of a board's black cells, in cells; drawn as one path, they have no seams.

    They are closed polygons, each (n, 2) of (x, y) from the upper left corner, without repeating
    the first vertex. With y down they run clockwise around black and counterclockwise around white
    holes, so that both the even-odd and the nonzero winding rule fill the black.
    """
    black = np.pad(np.asarray(cells) == 0, 1).astype(np.int8)
    across, along = np.diff(black, axis=0)[:, 1:-1], np.diff(black, axis=1)[1:-1]
    # directed edges between black and white: end vertices (row, column) by start vertex
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for change, sign, (start_row, start_column), (down, right) in (
        (across, 1, (0, 0), (0, 1)),
        (across, -1, (0, 1), (0, -1)),
        (along, 1, (1, 0), (-1, 0)),
        (along, -1, (0, 0), (1, 0)),
    ):
        for row, column in (np.argwhere(change == sign) + (start_row, start_column)).tolist():
            edges.setdefault((row, column), []).append((row + down, column + right))
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
        vertices = np.array(loop)
        step = vertices - np.roll(vertices, 1, axis=0)
        turns = (step != np.roll(step, -1, axis=0)).any(axis=1)
        loops.append(np.asarray(vertices[turns][:, ::-1], np.float64))
    return loops


_RULER_TEXT: Final = f"print at 100 %, measure this: {RULER_MM:g} mm"
"""Text next to the ruler."""
_MM_PER_INCH: Final = 25.4
"""Millimetres per inch (physical: definition of the inch)."""
_TEXT_PT: Final = 8.0
"""Font size, at which a board's longest text is shorter than the ruler, pt (chosen)."""
_RULER_TOP_MM: Final = 0.6
"""Distance of the ruler from the board's margin, mm (chosen: layout)."""
_TEXT_LINE_OFFSETS_MM: Final = (4.6, 8.2)
"""Distances of the lines of text from the board's margin, mm (chosen: layout)."""
# Number of the ruler's intervals, lengths of its ticks and width of its strokes (chosen).
_RULER_INTERVALS: Final = 10
_TICK_MM: Final = 2.0
_END_TICK_MM: Final = 3.2
_STROKE_MM: Final = 0.2
_RC: Final[Any] = {
    "font.family": "DejaVu Sans",
    "pdf.fonttype": 42,
    "pdf.compression": 6,
    "svg.fonttype": "path",
    "svg.hashsalt": "vergence",
}


def draw_sheet(sheet: PrintSheet, path: Path, dpi: float) -> None:
    """Write a sheet as PDF, SVG or PNG by the suffix, atomically; equal sheets give equal bytes.

    The resolution is that of a PNG. An existing file is replaced; its folder must exist.
    """
    # imported here so that a command that lays out in vain ends sooner
    from matplotlib import style

    # default settings: the user's may crop the sheet or change its font
    with style.context(["default", _RC]), atomic_file(path) as partial:
        figure = _figure(sheet)
        ending = path.suffix.lower()
        if ending == ".pdf":
            _write_pdf(figure, partial, f"{sheet.target}")
        elif ending == ".svg":
            figure.savefig(partial, format="svg", metadata={"Date": None})
        else:
            figure.savefig(partial, format="png", dpi=dpi, metadata={"Software": None})


def _figure(sheet: PrintSheet) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline
    from matplotlib.transforms import Affine2D

    figure = Figure(figsize=(sheet.width_mm / _MM_PER_INCH, sheet.height_mm / _MM_PER_INCH))
    FigureCanvasAgg(figure)
    inches = Affine2D().scale(1.0, -1.0).translate(0.0, sheet.height_mm).scale(1.0 / _MM_PER_INCH)
    page = inches + figure.dpi_scale_trans
    turned = Affine2D().rotate_deg(-90.0 if sheet.ruler_upright else 0.0)
    strip = turned.translate(*sheet.ruler_zero_mm) + page
    for loops, transform in ((sheet.black_outlines_mm, page), (_ruler(), strip)):
        closed = (Outline(np.vstack([loop, loop[:1]]), closed=True) for loop in loops)
        path = Outline.make_compound_path(*closed)  # one path is filled without seams
        patch = PathPatch(path, facecolor="black", linewidth=0.0, transform=transform)
        patch.set_snap(False)  # snapping to whole pixels would move edges by up to half a pixel
        figure.add_artist(patch)
    for text, v in zip((_RULER_TEXT, f"{sheet.target}"), _TEXT_LINE_OFFSETS_MM, strict=True):
        figure.text(
            *(0.0, v, text),
            transform=strip,
            rotation=90.0 if sheet.ruler_upright else 0.0,
            rotation_mode="anchor",
            verticalalignment="top",
            fontsize=_TEXT_PT,
            parse_math=False,
        )
    return figure


def _ruler() -> list[NDArray[np.float64]]:
    """Rectangles of the ruler; its first and last ticks are centred at 0 and 100 mm."""
    half = 0.5 * _STROKE_MM
    boxes = [(-half, _RULER_TOP_MM, RULER_MM + half, _RULER_TOP_MM + _STROKE_MM)]
    for tick in range(_RULER_INTERVALS + 1):
        place = tick * RULER_MM / _RULER_INTERVALS
        length = _END_TICK_MM if tick % _RULER_INTERVALS == 0 else _TICK_MM
        boxes.append((place - half, _RULER_TOP_MM, place + half, _RULER_TOP_MM + length))
    return [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) for x0, y0, x1, y1 in boxes]


def _write_pdf(figure: "Figure", path: Path, title: str) -> None:
    """Write a figure as a PDF page for which printing dialogs default to no scaling."""
    from matplotlib.backends import backend_pdf

    pdf: Any = backend_pdf
    metadata = {"Title": title, "CreationDate": None, "Producer": None, "Creator": "vergence"}
    with pdf.PdfPages(path, metadata=metadata) as pages:
        file = pages._ensure_file()
        catalog = {"Type": pdf.Name("Catalog"), "Pages": file.pagesObject}
        catalog["ViewerPreferences"] = {"PrintScaling": pdf.Name("None")}
        file.writeObject(file.rootObject, catalog)  # replaces the catalog that is already written
        figure.savefig(pages, format="pdf")
