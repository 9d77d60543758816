"""Reading a board: which cells do not have the grey that is printed there, by the levels around."""

from math import nan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.plane import View, grey_at, seen_at, through
from vergence.vision.tags.bend import bend_at

_LEAST_CONTRAST_GREY: Final = 5.0
"""Between the light and the dark around a cell."""
_LEAST_CELL_CONTRAST: Final = 0.1
"""How far a cell must lie from the middle of both, as a share of the difference."""
_CLEAR_CELL_CONTRAST: Final = 0.25
"""From where on it is clear which of both it is."""
_AROUND: Final = 2
"""Cells to each side whose levels a cell is compared with."""
_PROBE_CELLS: Final = (0.22, 0.36)
"""Least and greatest distance of the samples of a cell from its middle, along both axes: where a
square was found beside its edges, those far from the middle tell."""
_EDGE_BLURS: Final = 1.4
"""Standard deviations of the blur that a sample stays away from the edge of its cell."""


class Reading(NamedTuple):
    """How well a print's cells are read."""

    wrong: int
    """Cells that do not have the grey that is printed there."""
    frame: int
    """Of those, on the rectangle's rim, which is the same for all of a family."""
    unclear: float
    """In the worst quarter, the share of those that are wrong or in the middle between light and
    dark. Many are where a square was found beside its edges: something covers one of its sides."""


@subroutine
def read_cells(
    image: NDArray[np.uint8],
    H: FloatArray,
    bent: FloatArray,
    camera: CameraRow,
    view: View,
    cells: FloatArray,
    blur: float,
    left: float,
    top: float,
    across: float,
    down: float,
    ring: int,
    ring_counts: bool,
    greys: FloatArray,
) -> Reading:
    """How many cells do not have the grey that is printed there.

    Args:
        image: grey levels.
        H: (3, 3) see `back_of`, of the rectangle of cells that the next four say.
        bent: (9,) of the sheet, see `bend_at`.
        camera: the eye's.
        view: the plane that the lens does not bend.
        cells: (rows, columns) 0 black to 1 white, nan not compared.
        blur: standard deviation of the blur, cells.
        left: cells from the print's left edge to the rectangle.
        top: cells from its upper edge.
        across: the rectangle's width in cells.
        down: its height.
        ring: cells around the print that are not compared: a quiet zone may be cut.
        ring_counts: whether the levels of the others are compared with are theirs as well.
        greys: (rows, columns) room to work in.

    Returns:
        How well those are read that are compared and lie in the image.
    """
    rows, columns = cells.shape
    far = min(max(0.5 - _EDGE_BLURS * blur, _PROBE_CELLS[0]), _PROBE_CELLS[1])
    for j in range(rows):
        for i in range(columns):
            greys[j, i] = 0.0
            if cells[j, i] != cells[j, i]:
                continue
            if not ring_counts and min(i, j, columns - 1 - i, rows - 1 - j) < ring:
                greys[j, i] = nan
                continue
            for probe in range(5):
                dx = 0.0 if probe == 0 else (far if probe < 3 else -far)
                dy = 0.0 if probe == 0 else (far if probe % 2 else -far)
                x = 2.0 * (i + 0.5 + dx - left) / across - 1.0
                y = 2.0 * (j + 0.5 + dy - top) / down - 1.0
                dx, dy = bend_at(bent, x, y)
                u, v = through(H, x - dx, y - dy)
                u, v = seen_at(camera, view, u, v)
                greys[j, i] += 0.2 * grey_at(image, u, v)
    wrong = frame = 0
    unclear, compared = np.zeros(4), np.zeros(4)
    sharp = 0.5 - _EDGE_BLURS * blur >= _PROBE_CELLS[0]
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
            quarter = (2 if 2 * j >= rows else 0) + (1 if 2 * i >= columns else 0)
            compared[quarter] += 1.0
            if contrast < _LEAST_CONTRAST_GREY or beyond <= _LEAST_CELL_CONTRAST * contrast:
                wrong += 1
                unclear[quarter] += 1.0
                x, y = i - left, j - top
                on_side = (x == 0.0 or x == across - 1.0) and 0.0 <= y <= down - 1.0
                if on_side or ((y == 0.0 or y == down - 1.0) and 0.0 <= x <= across - 1.0):
                    frame += 1
            elif sharp and beyond <= _CLEAR_CELL_CONTRAST * contrast:
                unclear[quarter] += 1.0
    most = 0.0
    for k in range(4):
        most = max(most, unclear[k] / max(compared[k], 1.0))
    return Reading(wrong, frame, most)
