"""Figures over a camera's image: measured corners and their residuals."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from vergence.calibration.coverage import CELLS, views_in_cells
from vergence.models.parts import FloatArray
from vergence.reporting.style import BLACK, BLUE, GREY, ORANGE, figure_style, new_figure

CAMERA_FIGURE_WIDTH: Final = 5.6
"""Width of a figure of one camera, inches (chosen: two stand side by side, one fills a phone)."""
EYE_STYLES: Final[tuple[dict[str, Any], ...]] = (
    {"color": BLUE, "marker": "o"},
    {"color": ORANGE, "marker": "s"},
)
LEAST_IN_CELL: Final = 3
"""Fewest corners whose mean residual is shown (chosen: a mean of fewer is mostly noise)."""
_CELLS_ACROSS: Final = 14
"""Cells across an image in which residuals are averaged (chosen)."""
_LONG_ARROW_CELLS: Final = 1.0
"""Length of a long mean arrow (90th percentile), in cells (chosen: arrows hardly overlap)."""
_MARGINS_IN: Final = (0.7, 0.85)
"""Width and height of a figure beside its image, inches (measured: labels and title)."""
_MOST_DOTS: Final = 4000
"""Most dots of a scatter plot (chosen: more only fill the page with ink)."""


def draw_residual_arrows(
    pixels: FloatArray, residuals: FloatArray, size: tuple[int, int], name: str
) -> Figure:
    """Draw corners over an image, and arrows of their mean residuals in cells."""
    cell = size[0] / _CELLS_ACROSS
    keys = np.floor((pixels + 0.5) / cell).astype(int)
    cells, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(cells), 2))
    np.add.at(mean, which.ravel(), residuals)
    full = count >= LEAST_IN_CELL
    mean = mean[full] / count[full, None]
    places = (cells[full] + 0.5) * cell - 0.5
    lengths = np.linalg.norm(mean, axis=-1)
    long = max(float(np.quantile(lengths, 0.9)), 1e-6) if len(lengths) else 1.0
    with figure_style():
        figure, panel = new_image_figure(size)
        panel.plot(
            *pixels[thinning_slice(len(pixels))].T, ".", ms=3, mew=0, alpha=0.4, color=GREY,
            rasterized=True,
        )  # fmt: skip
        arrows = panel.quiver(
            *places.T, *mean.T, color=BLACK, width=0.006, headwidth=3.5, angles="xy",
            scale_units="xy", scale=long / (_LONG_ARROW_CELLS * cell),
        )  # fmt: skip
        key = float(f"{long:.1g}")
        above = 1.0 + 0.03 * size[0] / size[1]
        panel.quiverkey(arrows, 0.9, above, key, f"{key:g} px", labelpos="W")
        panel.set_title(name)
    return figure


def draw_corner_coverage(
    views: FloatArray, size: tuple[int, int], name: str, colour: str
) -> Figure:
    """Draw corners over an image, and the number of views with a corner in each part of it."""
    width, height = size
    pixels = views[np.isfinite(views).all(axis=-1)]
    with figure_style():
        figure, panel = new_image_figure(size)
        panel.plot(
            *pixels[thinning_slice(len(pixels))].T, ".", ms=3.5, mew=0, alpha=0.6, color=colour,
            rasterized=True,
        )  # fmt: skip
        cells = views_in_cells(views, size)
        wide, high = width / CELLS, height / CELLS
        for row, column in np.ndindex(cells.shape):
            count = int(cells[row, column])
            corner = (column * wide - 0.5, row * high - 0.5)
            panel.add_patch(
                Rectangle(
                    corner, wide, high, fill=False, ec=GREY, lw=0.8, ls=":",
                    hatch=None if count else "///",
                )
            )  # fmt: skip
            panel.text(
                corner[0] + 0.5 * wide, corner[1] + 0.5 * high, f"{count}", ha="center",
                va="center", fontsize=13, fontweight="bold", color=BLACK,
                bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8},
            )  # fmt: skip
        panel.set_title(f"{name}, views in each part")
    return figure


def thinning_slice(count: int) -> slice:
    """Thin out dots to at most `_MOST_DOTS`."""
    return slice(None, None, -(-count // _MOST_DOTS) or 1)


def new_image_figure(size: tuple[int, int]) -> tuple[Figure, Axes]:
    """Make a figure of an image's shape; its axes are the image's frame, v downwards."""
    width, height = size
    beside, above = _MARGINS_IN
    figure = new_figure(
        CAMERA_FIGURE_WIDTH, (CAMERA_FIGURE_WIDTH - beside) * height / width + above
    )
    panel = figure.add_subplot()
    panel.set(
        xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal",
        xlabel="u (px)", ylabel="v (px)",
    )  # fmt: skip
    panel.grid(False)
    panel.spines[:].set_visible(True)
    return figure, panel
