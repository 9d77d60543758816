"""Read a board's cells: compare each with its print, by the levels of the cells around it."""

from math import nan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.plane import UndistortedView, distorted_pixel, grey_at, transform_point
from vergence.vision.tags.bend import bend_displacement

_LEAST_CONTRAST_GREY: Final = 5.0
"""Smallest contrast between light and dark around a cell that is read, grey levels (chosen: dim
boards against noise)."""
_LEAST_CELL_CONTRAST: Final = 0.1
"""Smallest distance of a correct cell from the middle between light and dark, as a fraction of
their difference (chosen: bad light against wrong cells)."""
_CLEAR_CELL_CONTRAST: Final = 0.25
"""Smallest such distance of a clear cell (chosen: bad light against covered cells)."""
_MAX_LEVEL_RADIUS_CELLS: Final = 2
"""Cells to each side, at most, that give the levels for a cell (chosen: both colours present
against shadows)."""
_PROBE_CELLS: Final = (0.22, 0.36)
"""Smallest and largest distance of a cell's samples from its centre, along both axes, cells. If a
square was found beside its true edges, the samples far from the centre show it (chosen: this
against blur)."""
_EDGE_BLURS: Final = 1.4
"""Distance of the samples from the edge of their cell, standard deviations of the blur (chosen: as
above)."""


class CellReading(NamedTuple):
    """Counts of a print's cells that are read wrong or not clearly."""

    wrong_cells: int
    """Cells that do not have the colour that is printed there."""
    wrong_rim_cells: int
    """Wrong cells on the rectangle's rim, which is common to all tags of a family."""
    worst_quarter_unclear: float
    """Fraction of the cells in the worst quarter that are wrong or near the middle between light
    and dark. It is large if a square was found beside its true edges, because something covers one
    of its sides."""


@subroutine
def compare_cells(
    image: NDArray[np.uint8],
    light_by_grey: FloatArray,
    H: FloatArray,
    white_spread_and_bend: FloatArray,
    camera: CameraRow,
    view: UndistortedView,
    cells: FloatArray,
    blur_cells: float,
    left_cells: float,
    top_cells: float,
    width_cells: float,
    height_cells: float,
    ignored_ring_cells: int,
    ring_gives_levels: bool,
    greys: FloatArray,
) -> CellReading:
    """Compare the cells in the image with the print.

    Args:
        image: grey levels.
        light_by_grey: (256,) light of each grey level, or that level to compare these.
        H: (3, 3) homography to the image, see `square_to_image_homography`, from the
            rectangle that `left_cells`, `top_cells`, `width_cells` and `height_cells` define.
        white_spread_and_bend: (13,) the sheet's spread and bend, see `bend_displacement`.
        camera: the eye's camera.
        view: the undistorted plane.
        cells: (rows, columns) 0 black to 1 white, nan not compared.
        blur_cells: standard deviation of the blur, cells.
        left_cells: cells from the print's left edge to the rectangle.
        top_cells: cells from the print's upper edge to the rectangle.
        width_cells: the rectangle's width, cells.
        height_cells: the rectangle's height, cells.
        ignored_ring_cells: width of the print's outer ring that is not compared, cells: a quiet
            zone may be cut.
        ring_gives_levels: True if that ring still gives levels that other cells are compared with.
        greys: (rows, columns) scratch array.

    Returns:
        Counts over the cells that are compared and lie in the image.
    """
    rows, columns = cells.shape
    far = min(max(0.5 - _EDGE_BLURS * blur_cells, _PROBE_CELLS[0]), _PROBE_CELLS[1])
    for j in range(rows):
        for i in range(columns):
            greys[j, i] = 0.0
            if cells[j, i] != cells[j, i]:
                continue
            if (
                not ring_gives_levels
                and min(i, j, columns - 1 - i, rows - 1 - j) < ignored_ring_cells
            ):
                greys[j, i] = nan
                continue
            for probe in range(5):
                dx = 0.0 if probe == 0 else (far if probe < 3 else -far)
                dy = 0.0 if probe == 0 else (far if probe % 2 else -far)
                x = 2.0 * (i + 0.5 + dx - left_cells) / width_cells - 1.0
                y = 2.0 * (j + 0.5 + dy - top_cells) / height_cells - 1.0
                dx, dy = bend_displacement(white_spread_and_bend, x, y)
                u, v = transform_point(H, x - dx, y - dy)
                u, v = distorted_pixel(camera, view, u, v)
                grey = grey_at(image, u, v)
                level = int(grey) if grey < 255.0 else 254
                light, next_light = light_by_grey[level], light_by_grey[level + 1]
                greys[j, i] += 0.2 * (light + (grey - level) * (next_light - light))
    wrong = frame = 0
    unclear, compared = np.zeros(4), np.zeros(4)
    sharp = 0.5 - _EDGE_BLURS * blur_cells >= _PROBE_CELLS[0]
    for j in range(rows):
        for i in range(columns):
            if min(i, j, columns - 1 - i, rows - 1 - j) < ignored_ring_cells:
                continue
            if not (cells[j, i] == cells[j, i] and greys[j, i] == greys[j, i]):
                continue
            light = dark = lights = darks = 0.0
            # the smallest neighbourhood with both colours: a shadow may end anywhere
            for around in range(1, _MAX_LEVEL_RADIUS_CELLS + 1):
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
                x, y = i - left_cells, j - top_cells
                on_side = (x == 0.0 or x == width_cells - 1.0) and 0.0 <= y <= height_cells - 1.0
                if on_side or (
                    (y == 0.0 or y == height_cells - 1.0) and 0.0 <= x <= width_cells - 1.0
                ):
                    frame += 1
            elif sharp and beyond <= _CLEAR_CELL_CONTRAST * contrast:
                unclear[quarter] += 1.0
    most = 0.0
    for k in range(4):
        most = max(most, unclear[k] / max(compared[k], 1.0))
    return CellReading(wrong, frame, most)
