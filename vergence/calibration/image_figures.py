"""Figures over a camera's image: measured corners and their residuals."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from vergence.calibration.coverage import CELLS, views_in_cells
from vergence.eval.reporting.style import BLACK, BLUE, GREY, ORANGE, figure_style, new_figure
from vergence.models.parts import FloatArray

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
_LONG_ARROW_CELLS: Final = 0.9
"""Length of a long mean arrow (95th percentile), in cells (chosen: arrows hardly overlap)."""
_MAGNIFICATIONS: Final = tuple(digit * 10**power for power in range(5) for digit in (1, 2, 5))
"""Round magnifications of arrows (chosen)."""
_MOST_DOTS: Final = 4000
"""Most dots of a scatter plot (chosen: more only fill the page with ink)."""


def draw_residual_arrows(
    pixels: FloatArray, residuals: FloatArray, size: tuple[int, int], name: str
) -> Figure:
    """Draw residuals over an image as magnified arrows, per corner and averaged in cells."""
    width, height = size
    cell = width / _CELLS_ACROSS
    keys = np.floor((pixels + 0.5) / cell).astype(int)
    cells, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(cells), 2))
    np.add.at(mean, which.ravel(), residuals)
    full = count >= LEAST_IN_CELL
    mean = mean[full] / count[full, None]
    places = (cells[full] + 0.5) * cell - 0.5
    lengths = np.linalg.norm(mean, axis=-1)
    long = float(np.quantile(lengths, 0.95)) if len(lengths) else 1.0
    wanted = max(_LONG_ARROW_CELLS * cell / max(long, 1e-6), 1.0)
    factor = max(each for each in _MAGNIFICATIONS if each <= wanted)
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, CAMERA_FIGURE_WIDTH * height / width + 0.7)
        panel = figure.add_subplot()
        every = thinning_slice(len(pixels))
        arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0 / factor}
        usual = float(np.median(np.linalg.norm(residuals, axis=-1))) if len(residuals) else 0.0
        if factor * usual > cell:
            # arrows of single corners would be a tangle
            panel.plot(*pixels[every].T, ".", ms=2, mew=0, alpha=0.5, color=GREY, rasterized=True)
        else:
            panel.quiver(
                *pixels[every].T, *residuals[every].T, color=GREY, alpha=0.2, width=0.0015,
                rasterized=True, **arrows,
            )  # fmt: skip
        panel.quiver(*places.T, *mean.T, color=BLACK, width=0.0045, headwidth=4, **arrows)
        set_image_axes(panel, size)
        panel.set_title(f"{name}, arrows {factor:g} times as long")
    return figure


def draw_corner_coverage(
    views: FloatArray, size: tuple[int, int], name: str, colour: str
) -> Figure:
    """Draw corners over an image, and the number of views with a corner in each part of it."""
    width, height = size
    pixels = views[np.isfinite(views).all(axis=-1)]
    with figure_style():
        figure = new_figure(CAMERA_FIGURE_WIDTH, CAMERA_FIGURE_WIDTH * height / width + 0.7)
        panel = figure.add_subplot()
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
        set_image_axes(panel, size)
        panel.set_title(f"{name}, views in each part")
    return figure


def thinning_slice(count: int) -> slice:
    """Thin out dots to at most `_MOST_DOTS`."""
    return slice(None, None, -(-count // _MOST_DOTS) or 1)


def set_image_axes(panel: Axes, size: tuple[int, int]) -> None:
    """Set a panel's axes to an image's frame, v downwards."""
    width, height = size
    panel.set(
        xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal",
        xlabel="u (px)", ylabel="v (px)",
    )  # fmt: skip
    panel.grid(False)
    panel.spines[:].set_visible(True)
