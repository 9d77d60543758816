"""Draw four figures of a calibration's report as one image.

Run ``python benchmarks/calibration_figures.py FOLDER --out docs/images/calibration`` on a folder
with left1.jpg, right1.jpg and so on of a board. See ``docs/calibration.md``.
"""

import argparse
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from vergence.calibration.calibrate import Calibration, calibrate
from vergence.calibration.observations import parse_board
from vergence.calibration.report import (
    depth_sigma,
    depths_to_plot_m,
    direction_sigma,
    image_coverage,
    residual_field,
)
from vergence.perception.photographs import list_photographs, pair_images
from vergence.reporting.style import figure_style

_DPI = 110
_COLOURS = 128
"""Colours of the palette: few enough for a small file."""


def panels(found: Calibration) -> list[Figure]:
    """Figures of residuals, coverage and direction sigma of the left camera, and of depth sigma."""
    return [
        residual_field(found, 0),
        image_coverage(found, 0),
        direction_sigma(found, 0),
        depth_sigma(found.depth_sigma_at(depths_to_plot_m(found)), in_percent=False),
    ]


def tiled(figures: Sequence[Figure]) -> Image.Image:
    """Image of figures in two columns on white."""
    drawn = [_drawn(figure) for figure in figures]
    rows = [drawn[start : start + 2] for start in range(0, len(drawn), 2)]
    wide = max(image.width for image in drawn)
    heights = [max(image.height for image in row) for row in rows]
    picture = Image.new("RGB", (2 * wide, sum(heights)), "white")
    for top, row in zip(np.cumsum([0, *heights]).tolist(), rows, strict=False):
        for column, image in enumerate(row):
            picture.paste(image, (column * wide, top))
    return picture


def _drawn(figure: Figure) -> Image.Image:
    content = io.BytesIO()
    with figure_style():
        figure.draw_without_rendering()  # panels with equal axes fit only after a second layout
        figure.savefig(content, format="png", dpi=_DPI)
    return Image.open(content).convert("RGB")


def main(arguments: list[str] | None = None) -> int:
    """Draw the image."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--target", default="checkerboard:9x6:24.23")
    parser.add_argument("--out", type=Path, required=True, help="figure, without its suffix")
    options = parser.parse_args(arguments)
    images = list_photographs([options.folder])
    pairs = pair_images(images, images, one_folder=True).pairs
    found = calibrate(
        parse_board(options.target),
        [[pair.left for pair in pairs], [pair.right for pair in pairs]],
    )
    picture = tiled(panels(found)).quantize(_COLOURS, dither=Image.Dither.NONE)
    picture.save(options.out.with_suffix(".png"), optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
