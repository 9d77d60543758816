"""Comparison of an image with a print, by which a detector accepts or refuses a target.

A print is data: its cells from 0 black to 1 white. There are three measures, by what is known:

- a cell against the levels of both colours around it (`deviation_and_contrast`): all cells of a tag
  (`compare_cells`) and the squares of a checkerboard, whose corners are known already;
- all cells of a marker at once, by correlation (`normalised`): markers in parts of boards;
- the four quadrants around a corner of a square (`corner_contrasts`).
"""

from math import nan
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from vergence.kernels import compiled, subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.corners import Grid
from vergence.vision.optics import Image, UndistortedView, distorted_pixel, grey_at, transform_point
from vergence.vision.tags.samples import bend_displacement

LEAST_CONTRAST_GREY: Final = 5.0
"""Least contrast between light and dark around a cell or a corner that is read, grey levels
(chosen: dim boards against noise)."""

_LEAST_CELL_CONTRAST: Final = 0.1
"""Smallest distance of a correct cell from the middle between light and dark, as a fraction of
their difference (chosen: bad light against wrong cells)."""
_CLEAR_CELL_CONTRAST: Final = 0.25
"""Smallest such distance of a clear cell (chosen: bad light against covered cells)."""
_LEAST_SQUARE_CONTRAST: Final = 0.15
"""Smallest such distance of a correct square of a checkerboard (chosen)."""
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


@subroutine
def deviation_and_contrast(
    greys: FloatArray, cells: FloatArray, j: int, i: int, max_radius: int
) -> tuple[float, float]:
    """Compare the cell of row j and column i with the smallest neighbourhood of both colours.

    The greys are nan where cells are not seen; the neighbourhood has at most `max_radius` cells to
    each side. Returns the distance of the cell towards its printed colour from the middle between
    light and dark, and their difference; both nan if a colour is missing.
    """
    rows, columns = cells.shape
    light = dark = lights = darks = 0.0
    # the smallest neighbourhood with both colours: a shadow may end anywhere
    for around in range(1, max_radius + 1):
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
        return nan, nan
    light, dark = light / lights, dark / darks
    beyond = greys[j, i] - 0.5 * (light + dark)
    return -beyond if cells[j, i] <= 0.5 else beyond, light - dark


class CellReading(NamedTuple):
    """Counts of a print's cells that are read wrong or not clearly."""

    wrong_cells: int
    wrong_rim_cells: int  # on the rectangle's rim, which is common to all tags of a family
    worst_quarter_unclear: float
    """Fraction of the cells in the worst quarter that are wrong or near the middle between light
    and dark: large if something covers a side, and a square was found beside its true edges."""


@subroutine
def compare_cells(
    image: Image,
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
    """Compare the cells of a tag in the image, through its fit and the lens, with the print.

    The homography H, (3, 3), leads to the view from the rectangle that `left_cells`, `top_cells`,
    `width_cells` and `height_cells` define in the print; `white_spread_and_bend` is of its sheet,
    see `bend_displacement`. `light_by_grey` is (256,) the light of each level. The outer
    `ignored_ring_cells` are not compared, since a quiet zone may be cut, but may still give levels
    that others are compared with.
    """
    rows, columns = cells.shape
    reach = 0.5 - _EDGE_BLURS * blur_cells
    sharp = reach >= _PROBE_CELLS[0]
    far = min(max(reach, _PROBE_CELLS[0]), _PROBE_CELLS[1])
    for j in range(rows):
        for i in range(columns):
            greys[j, i] = 0.0
            if cells[j, i] != cells[j, i]:
                continue
            ring = min(i, j, columns - 1 - i, rows - 1 - j)
            if not ring_gives_levels and ring < ignored_ring_cells:
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
    wrong = wrong_rim = 0
    unclear, compared = np.zeros(4), np.zeros(4)
    for j in range(rows):
        for i in range(columns):
            if min(i, j, columns - 1 - i, rows - 1 - j) < ignored_ring_cells:
                continue
            if not (cells[j, i] == cells[j, i] and greys[j, i] == greys[j, i]):
                continue
            beyond, contrast = deviation_and_contrast(greys, cells, j, i, _MAX_LEVEL_RADIUS_CELLS)
            if contrast != contrast:
                continue
            quarter = (2 if 2 * j >= rows else 0) + (1 if 2 * i >= columns else 0)
            compared[quarter] += 1.0
            if contrast < LEAST_CONTRAST_GREY or beyond <= _LEAST_CELL_CONTRAST * contrast:
                wrong += 1
                unclear[quarter] += 1.0
                # cells from the edges of the rectangle: 0 on its rim
                x, y = i - left_cells, j - top_cells
                if min(x, y, width_cells - 1.0 - x, height_cells - 1.0 - y) == 0.0:
                    wrong_rim += 1
            elif sharp and beyond <= _CLEAR_CELL_CONTRAST * contrast:
                unclear[quarter] += 1.0
    most = 0.0
    for k in range(4):
        most = max(most, unclear[k] / max(compared[k], 1.0))
    return CellReading(wrong, wrong_rim, most)


_PROBE_SQUARES: Final = 0.2
"""Distance of the samples of a square from its centre, in squares (chosen)."""
_MAX_WRONG_FRACTION: Final = 0.05
"""Largest fraction of squares with a wrong colour, such as by glare or dirt (chosen)."""
_OUTER_SHARE: Final = 0.6
"""Fraction of the outermost squares that is sampled (chosen: some boards print only half of them,
lenses bend them, and the image may end in them)."""
_CONTINUING_FRACTION: Final = 0.75
"""Least fraction of the corners on the line beyond a side at which four squares must meet for the
board to continue there (chosen)."""
_LEAST_LINE_CORNERS: Final = 2
"""Least number of corners of such a line inside the image (chosen)."""
_LEAST_OUTER_CONTRAST: Final = 0.4
"""Least contrast between squares beyond the board, as a fraction of the board's own contrast. Of
4,440 parts of boards in public photographs all continue with 0.45, all but two with 0.5; with 0.35
one of 12,496 true sides of boards seems to continue (chosen by these counts)."""


@compiled
def squares_alternate(image: Image, grid: Grid, first_dark: bool) -> bool:
    """Check that squares alternate around corners that are all seen, up to a few wrong ones.

    `first_dark` tells the colour of the square before the first corner.
    """
    greys = _square_greys(image, _with_outer_corners(grid))
    rows, columns = greys.shape
    cells = np.empty((rows, columns))
    for j in range(rows):
        for i in range(columns):
            cells[j, i] = 1.0 if ((j + i) % 2 == 1) == first_dark else 0.0
    seen = wrong = 0
    for j in range(rows):
        for i in range(columns):
            if greys[j, i] != greys[j, i]:
                if 0 < j < rows - 1 and 0 < i < columns - 1:
                    return False
                continue
            seen += 1
            beyond, contrast = deviation_and_contrast(greys, cells, j, i, 1)
            if not (contrast >= LEAST_CONTRAST_GREY and beyond > _LEAST_SQUARE_CONTRAST * contrast):
                wrong += 1
    return wrong <= _MAX_WRONG_FRACTION * max(seen, 1)


@subroutine
def _with_outer_corners(grid: Grid) -> Grid:
    """Corners with a line more on each side, extrapolated by a share of the outermost squares."""
    rows, columns, _ = grid.shape
    out = np.empty((rows + 2, columns + 2, 2))
    for n in range(2):
        for i in range(columns):
            for j in range(rows):
                out[j + 1, i + 1, n] = grid[j, i, n]
            first, last = grid[0, i, n], grid[rows - 1, i, n]
            out[0, i + 1, n] = first + _OUTER_SHARE * (first - grid[1, i, n])
            out[rows + 1, i + 1, n] = last + _OUTER_SHARE * (last - grid[rows - 2, i, n])
        for j in range(rows + 2):
            first, last = out[j, 1, n], out[j, columns, n]
            out[j, 0, n] = first + _OUTER_SHARE * (first - out[j, 2, n])
            out[j, columns + 1, n] = last + _OUTER_SHARE * (last - out[j, columns - 1, n])
    return out


@subroutine
def _square_greys(image: Image, corners: Grid) -> FloatArray:
    """Mean grey levels of the squares between corners; nan outside the image."""
    height, width = image.shape
    greys = np.zeros((corners.shape[0] - 1, corners.shape[1] - 1))
    for j in range(greys.shape[0]):
        for i in range(greys.shape[1]):
            a, b = corners[j, i], corners[j, i + 1]
            c, d = corners[j + 1, i], corners[j + 1, i + 1]
            u, v = 0.25 * (a[0] + b[0] + c[0] + d[0]), 0.25 * (a[1] + b[1] + c[1] + d[1])
            for probe in range(5):
                s = _PROBE_SQUARES * (1.0 if probe == 1 else -1.0 if probe == 2 else 0.0)
                t = _PROBE_SQUARES * (1.0 if probe == 3 else -1.0 if probe == 4 else 0.0)
                x = u + 0.5 * (s * (b[0] + d[0] - a[0] - c[0]) + t * (c[0] + d[0] - a[0] - b[0]))
                y = v + 0.5 * (s * (b[1] + d[1] - a[1] - c[1]) + t * (c[1] + d[1] - a[1] - b[1]))
                if not (-0.5 < x < width - 0.5 and -0.5 < y < height - 0.5):
                    greys[j, i] = nan
                    break
                greys[j, i] += 0.2 * grey_at(image, x, y)
    return greys


def board_continues_beyond(image: Image, grid: Grid, first_dark: bool) -> bool:
    """Check for four squares at the next corners beyond a side: a part of a larger board."""
    for inwards in (grid, grid.swapaxes(0, 1)):
        turned = len(inwards) % 2 == 1  # the last side has the colours exchanged
        for (first, second), dark in (
            (inwards[:2], first_dark),
            (inwards[:-3:-1], first_dark != turned),
        ):
            if _continues_beyond(image, np.stack([2.0 * first - second, first, second]), dark):
                return True
    return False


@compiled
def _continues_beyond(image: Image, lines: Grid, first_dark: bool) -> bool:
    """Implement `board_continues_beyond` by the next line of corners and the first two of a side.

    Surroundings may alternate by chance: at a corner they must do so both along the line and across
    it, with nearly the contrast of the board's own squares.
    """
    count = lines.shape[1]
    greys = _square_greys(image, _with_outer_corners(lines)[:4])
    for k in range(3):
        for i in range(count + 1):
            if ((k + i) % 2 == 0) != first_dark:
                greys[k, i] = -greys[k, i]  # of dark squares
    own = 0.0
    for i in range(1, count - 1):
        own += (greys[2, i] + greys[2, i + 1]) / (count - 2)
    corners = met = 0
    for i in range(count):
        four = greys[0, i] + greys[0, i + 1] + greys[1, i] + greys[1, i + 1]
        if four != four:  # not all are in the image
            continue
        corners += 1
        along = min(greys[0, i] + greys[0, i + 1], greys[1, i] + greys[1, i + 1])
        across = min(greys[0, i] + greys[1, i], greys[0, i + 1] + greys[1, i + 1])
        if min(along, across) > _LEAST_OUTER_CONTRAST * own:
            met += 1
    return corners >= _LEAST_LINE_CORNERS and met >= _CONTINUING_FRACTION * corners


LEAST_CONFIRMED_FRACTION: Final = 0.5
"""Least fraction of the markers beside the corners whose print must be confirmed (chosen)."""
MAX_OTHER_FRACTION: Final = 0.1
"""Most markers on the board's grid that the board has elsewhere or not at all, as a fraction of its
own (chosen: stray and misread markers against boards of other counts)."""
_LEAST_RELATIVE_CONTRAST: Final = 0.25
"""Least contrast at a corner, as a fraction of the median of all corners (chosen)."""
CORNER_PROBES: Final = np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]])
"""Directions from a corner to the samples of its quadrants (numerical)."""


def corner_contrasts(greys: FloatArray, signs: FloatArray) -> FloatArray:
    """Contrasts of white to black around corners, (...), from samples as `CORNER_PROBES`, (..., 4).

    A sign is 1 where the quadrant towards the upper left is black as printed, else -1.
    """
    falling = greys[..., 2] + greys[..., 3] - greys[..., 0] - greys[..., 1]
    return np.asarray(0.5 * signs * falling)


def least_corner_contrast(contrasts: FloatArray) -> float:
    """Contrast above which corners of a board alternate as printed, by those of all its corners."""
    return max(LEAST_CONTRAST_GREY, _LEAST_RELATIVE_CONTRAST * float(np.median(contrasts)))


def normalised(levels: FloatArray) -> FloatArray:
    """Levels of each row as a vector without mean, of length 1: products are correlations."""
    levels = levels - levels.mean(axis=1, keepdims=True)
    return np.asarray(levels / np.maximum(np.linalg.norm(levels, axis=1, keepdims=True), 1e-6))


def grey_at_pixels(image: Image, pixels: FloatArray) -> FloatArray:
    """Grey levels (n, m) at pixels (n, m, 2); replicated beyond the border, the first for nan."""
    if not pixels.size:
        return np.zeros(pixels.shape[:-1])
    remap: Any = cv2.remap
    where = np.nan_to_num(pixels, nan=-1e4).astype(np.float32)
    levels = remap(image, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(levels, float)
