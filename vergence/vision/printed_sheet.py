"""Printable sheets: a board, a ruler, and the text that names the board in commands."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import style
from matplotlib.backends import backend_pdf
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from vergence.files import atomic_file
from vergence.vision.printing import RULER_MM, PrintSheet

RULER_TEXT: Final = f"print at 100 %, measure this: {RULER_MM:g} mm"
"""Text next to the ruler."""
_MM_PER_INCH: Final = 25.4
"""Millimetres per inch (physical: definition of the inch)."""
_POINTS_PER_INCH: Final = 72.0
"""Points per inch, the unit of PDF pages (physical: definition of the point)."""
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
    """Write a sheet as PDF, SVG or PNG, atomically; equal sheets give equal bytes.

    Args:
        sheet: the sheet.
        path: the file, whose suffix selects the format; replaced if it exists. Its folder must
            exist.
        dpi: resolution of a PNG, pixels per inch.

    Raises:
        OSError: the file cannot be written.
    """
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


def _figure(sheet: PrintSheet) -> Figure:
    figure = Figure(figsize=(sheet.width_mm / _MM_PER_INCH, sheet.height_mm / _MM_PER_INCH))
    FigureCanvasAgg(figure)
    inches = Affine2D().scale(1.0, -1.0).translate(0.0, sheet.height_mm).scale(1.0 / _MM_PER_INCH)
    page = inches + figure.dpi_scale_trans
    turned = Affine2D().rotate_deg(-90.0 if sheet.ruler_upright else 0.0)
    strip = turned.translate(*sheet.ruler_zero_mm) + page
    for loops, transform in ((sheet.black_outlines_mm, page), (_ruler(), strip)):
        patch = PathPatch(_compound(loops), facecolor="black", linewidth=0.0, transform=transform)
        patch.set_snap(False)  # snapping to whole pixels would move edges by up to half a pixel
        figure.add_artist(patch)
    for text, v in zip((RULER_TEXT, f"{sheet.target}"), _TEXT_LINE_OFFSETS_MM, strict=True):
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


def _compound(loops: list[NDArray[np.float64]]) -> Outline:
    """Join closed polygons into one path, which is filled without seams."""
    return Outline.make_compound_path(
        *(Outline(np.vstack([loop, loop[:1]]), closed=True) for loop in loops)
    )


def _ruler() -> list[NDArray[np.float64]]:
    """Rectangles of the ruler; its first and last ticks are centred at 0 and 100 mm."""
    half = 0.5 * _STROKE_MM
    boxes = [(-half, _RULER_TOP_MM, RULER_MM + half, _RULER_TOP_MM + _STROKE_MM)]
    for tick in range(_RULER_INTERVALS + 1):
        place = tick * RULER_MM / _RULER_INTERVALS
        length = _END_TICK_MM if tick % _RULER_INTERVALS == 0 else _TICK_MM
        boxes.append((place - half, _RULER_TOP_MM, place + half, _RULER_TOP_MM + length))
    return [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) for x0, y0, x1, y1 in boxes]


def _write_pdf(figure: Figure, path: Path, title: str) -> None:
    """Write a figure as a PDF page for which printing dialogs default to no scaling.

    This is a preference in the document's catalog, which `Figure.savefig` cannot set.
    """
    pdf: Any = backend_pdf
    metadata = {"Title": title, "CreationDate": None, "Producer": None, "Creator": "vergence"}
    file = pdf.PdfFile(path, metadata=metadata)
    try:
        wish = {"PrintScaling": pdf.Name("None")}
        catalog = {
            "Type": pdf.Name("Catalog"),
            "Pages": file.pagesObject,
            "ViewerPreferences": wish,
        }
        file.writeObject(file.rootObject, catalog)  # replaces the catalog that is already written
        figure.dpi = _POINTS_PER_INCH  # the unit of a page
        width, height = (float(edge) for edge in figure.get_size_inches())
        file.newPage(width, height)
        renderer = pdf.RendererPdf(file, _POINTS_PER_INCH, height, width)
        figure.draw(renderer)
        renderer.finalize()
        file.finalize()
    finally:
        file.close()
