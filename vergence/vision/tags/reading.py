"""Reading a board: which cells do not have the grey that is printed there, by the levels around."""

from math import nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.plane import View, grey_at, seen_at, through

_LEAST_CONTRAST_GREY: Final = 5.0
"""Between the light and the dark around a cell."""
_LEAST_CELL_CONTRAST: Final = 0.1
"""How far a cell must lie from the middle of both, as a share of the difference."""
_AROUND: Final = 2
"""Cells to each side whose levels a cell is compared with."""
_PROBE_CELLS: Final = 0.22
"""Distance of the samples of a cell from its middle, along both axes."""


@subroutine
def wrong_cells(
    image: NDArray[np.uint8],
    H: FloatArray,
    camera: CameraRow,
    view: View,
    cells: FloatArray,
    left: float,
    top: float,
    across: float,
    down: float,
    ring: int,
    ring_counts: bool,
    greys: FloatArray,
) -> int:
    """How many cells do not have the grey that is printed there.

    Args:
        image: grey levels.
        H: (3, 3) see `back_of`, of the rectangle of cells that the next four say.
        camera: the eye's.
        view: the plane that the lens does not bend.
        cells: (rows, columns) 0 black to 1 white, nan not compared.
        left: cells from the print's left edge to the rectangle.
        top: cells from its upper edge.
        across: the rectangle's width in cells.
        down: its height.
        ring: cells around the print that are not compared: a quiet zone may be cut.
        ring_counts: whether the levels of the others are compared with are theirs as well.
        greys: (rows, columns) room to work in.

    Returns:
        Of those that are compared and lie in the image.
    """
    rows, columns = cells.shape
    for j in range(rows):
        for i in range(columns):
            greys[j, i] = 0.0
            if cells[j, i] != cells[j, i]:
                continue
            if not ring_counts and min(i, j, columns - 1 - i, rows - 1 - j) < ring:
                greys[j, i] = nan
                continue
            for probe in range(5):
                dx = 0.0 if probe == 0 else (_PROBE_CELLS if probe < 3 else -_PROBE_CELLS)
                dy = 0.0 if probe == 0 else (_PROBE_CELLS if probe % 2 else -_PROBE_CELLS)
                x = 2.0 * (i + 0.5 + dx - left) / across - 1.0
                y = 2.0 * (j + 0.5 + dy - top) / down - 1.0
                u, v = through(H, x, y)
                u, v = seen_at(camera, view, u, v)
                greys[j, i] += 0.2 * grey_at(image, u, v)
    wrong = 0
    for j in range(rows):
        for i in range(columns):
            if min(i, j, columns - 1 - i, rows - 1 - j) < ring:
                continue
            if not (cells[j, i] == cells[j, i] and greys[j, i] == greys[j, i]):
                continue
            light = dark = lights = darks = 0.0
            # as near as both colours are found: a shadow may end anywhere
            for around in range(1, _AROUND + 1):
                light = dark = lights = darks = 0.0
                for row in range(max(j - around, 0), min(j + around + 1, rows)):
                    for column in range(max(i - around, 0), min(i + around + 1, columns)):
                        if greys[row, column] != greys[row, column]:
                            continue
                        if cells[row, column] > 0.5:
                            light += greys[row, column]
                            lights += 1.0
                        elif cells[row, column] <= 0.5:
                            dark += greys[row, column]
                            darks += 1.0
                if lights > 0.0 and darks > 0.0:
                    break
            if lights == 0.0 or darks == 0.0:
                continue
            light, dark = light / lights, dark / darks
            beyond = greys[j, i] - 0.5 * (light + dark)
            if cells[j, i] <= 0.5:
                beyond = -beyond
            contrast = light - dark
            if contrast < _LEAST_CONTRAST_GREY or beyond <= _LEAST_CELL_CONTRAST * contrast:
                wrong += 1
    return wrong
