"""The pixels near a tag's edges, and what the blurred print is at each of them."""

from math import hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import View, through
from vergence.vision.tags.printed import printed_at

UNKNOWNS: Final = 19
"""Of a fit: eight of the homography, two logs of blurs, the spread of white, eight of a bend."""
SPREAD: Final = 10
"""Column of how far white reaches into black, px."""
BOWS: Final = 11
"""First column of the bend, in half edges: x is moved by (1 - x^2), (1 - y^2) and x times both, y
by the same and y times both."""
COLUMNS: Final = 3 + UNKNOWNS
"""Of a pixel: its grey, its block, the print, and the derivatives."""
_LEAST_SCALE: Final = 0.4
"""Of an edge's pixels by its length, at its far end, by those of the shortest in the mean."""
_CLIPPED_GREY: Final = 254
"""From which on a pixel may have been brighter than it says."""
_MUCH_CLIPPED: Final = 0.02
"""Numerical: share of the pixels from which on white is clipped, not single pixels."""
_BESIDE_CLIPPED_GREY: Final = 240
"""Measured (`benchmarks.real_light`): from which on pixels are left out then."""
_LEAST_QUIET: Final = 0.45
"""Share of the quiet zone that is looked at in any case."""


class Sums(NamedTuple):
    """Sums over the pixels of each block."""

    plain: FloatArray
    """(K, 5) of 1, T, T^2, I, T I."""
    slopes: FloatArray
    """(K, 2, unknowns) of the derivatives of T, and of T times them."""
    normal: FloatArray
    """(K, unknowns, unknowns) of the derivatives' products, levels eliminated."""
    scores: FloatArray
    """(K, unknowns) of the derivatives times what the print leaves."""


@subroutine
def gather_pixels(
    image: NDArray[np.uint8],
    light: FloatArray,
    rays: NDArray[np.float32],
    view: View,
    G: FloatArray,
    corners: FloatArray,
    bounds: NDArray[np.int64],
    border: int,
    cells: FloatArray,
    reach_px: float,
    unseen_px: float,
    quiet: float,
    whole: bool,
    within: bool,
    most: int,
    places: FloatArray,
) -> int:
    """Take the pixels near the edges, evenly thinned out where there are more than `most`.

    Args:
        image: grey levels.
        light: (256,) of each of them.
        rays: (height, width, 2) undistorted, or (0, 0, 2) for pixels that are such.
        view: the plane that the lens does not bend.
        G: from the undistorted image to the plane.
        corners: (4, 2) undistorted.
        bounds: (4,) first and last pixel along u, and along v, of the raw image.
        border: cells along the square.
        cells: (n, n) the print.
        reach_px: half width of the band.
        unseen_px: how much of the quiet zone's outer part is left out.
        quiet: how wide the quiet zone is, cells.
        whole: whether all pixels within the square take part.
        within: whether the edges of the cells within the square take part.
        most: pixels.
        places: (most, 3) result: undistorted place and light.

    Returns:
        How many.
    """
    height, width = image.shape
    left, right = max(bounds[0], 0), min(bounds[1], width - 1)
    top, bottom = max(bounds[2], 0), min(bounds[3], height - 1)
    half = 0.5 * border
    perimeter, shortest = 0.0, inf
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        perimeter, shortest = perimeter + side, min(shortest, side)
    expected = 2.0 * reach_px * perimeter
    area = 1.5 * (0.25 * perimeter + 2.0) ** 2
    if within:
        expected *= _edges_of(cells) / (4.0 * border)
        expected = min(expected, area)
    if whole:
        expected = max(expected, area)
    stride = int(expected / most) + 1
    phase = int(0.618 * stride + 0.5)
    # most pixels are far from all edges: a bound that perspective does not reach tells them
    away = reach_px / (_LEAST_SCALE * 0.5 * shortest)
    nearest, farthest = 0.0 if whole or within else 1.0 - away, 1.0 + away
    start = 0.5 * (len(cells) - border)
    count = 0
    for row in range(top, bottom + 1):
        first = left + (-(left + phase * row)) % stride
        for column in range(first, right + 1, stride):
            u, v = float(column), float(row)
            if view.lens:
                x, y = rays[row, column, 0], rays[row, column, 1]
                u, v = through(view.plane_from_ray, x, y)
            w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
            x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
            y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
            # px for a unit of the plane across the edges along x, and along y
            if not nearest <= max(abs(x), abs(y)) <= farthest:
                continue
            a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
            c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
            px_x, px_y = abs(w) / sqrt(a * a + b * b), abs(w) / sqrt(c * c + d * d)
            out_x, out_y = (abs(x) - 1.0) * px_x, (abs(y) - 1.0) * px_y
            out = max(out_x, out_y)
            quiet_x, quiet_y = quiet * px_x / half, quiet * px_y / half
            if out_x > max(quiet_x - unseen_px, _LEAST_QUIET * quiet_x):
                continue
            if out_y > max(quiet_y - unseen_px, _LEAST_QUIET * quiet_y):
                continue
            if out > reach_px or count == most:
                continue
            if not whole and out < -reach_px:
                if not within:
                    continue
                at_x, at_y = (x + 1.0) * half + start, (y + 1.0) * half + start
                if not _near_edge(
                    cells, at_x, at_y, reach_px * half / px_x, reach_px * half / px_y
                ):
                    continue
            places[count, 0], places[count, 1], places[count, 2] = u, v, light[image[row, column]]
            count += 1
    return count


@subroutine
def without_clipped(places: FloatArray, count: int, light: FloatArray) -> int:
    """Leave out pixels that may have been brighter than they say; how many are left.

    Where white is clipped, demosaicking and compression have spread that to the pixels beside it.
    """
    clipped = 0
    for n in range(count):
        if places[n, 2] >= light[_CLIPPED_GREY]:
            clipped += 1
    limit = light[_CLIPPED_GREY if clipped <= _MUCH_CLIPPED * count else _BESIDE_CLIPPED_GREY]
    left = 0
    for n in range(count):
        if places[n, 2] < limit:
            for k in range(3):
                places[left, k] = places[n, k]
            left += 1
    return left


@subroutine
def _edges_of(cells: FloatArray) -> float:
    """Length of the edges between cells of different colours, cells."""
    size = len(cells)
    edges = 0.0
    for j in range(size):
        for i in range(size - 1):
            if abs(cells[j, i + 1] - cells[j, i]) > 0.5:
                edges += 1.0
            if abs(cells[i + 1, j] - cells[i, j]) > 0.5:
                edges += 1.0
    return edges


@subroutine
def _near_edge(cells: FloatArray, x: float, y: float, reach_x: float, reach_y: float) -> bool:
    """Whether an edge between cells of different colours passes near a place, all in cells."""
    size = len(cells)
    column, row = min(max(int(x), 0), size - 1), min(max(int(y), 0), size - 1)
    edge = int(x + 0.5)
    if 0 < edge < size and abs(x - edge) <= reach_x:
        near = abs(cells[row, edge] - cells[row, edge - 1]) > 0.5
        if near:
            return True
    edge = int(y + 0.5)
    if 0 < edge < size and abs(y - edge) <= reach_y:
        return bool(abs(cells[edge, column] - cells[edge - 1, column]) > 0.5)
    return False


@subroutine
def bend_at(bent: FloatArray, x: float, y: float) -> tuple[float, float]:
    """How far a bend moves a place of the plane on the sheet; it vanishes at the corners.

    Args:
        bent: (9,) the spread, and the bend's coefficients, see `BOWS`.
        x: of the place, half edges.
        y: the same.
    """
    over_x, over_y = 1.0 - x * x, 1.0 - y * y
    dx = (bent[1] + bent[3] * x) * over_x + (bent[2] + bent[4] * x) * over_y
    dy = (bent[5] + bent[7] * y) * over_x + (bent[6] + bent[8] * y) * over_y
    return dx, dy


@subroutine
def evaluate_print(
    places: FloatArray,
    count: int,
    G: FloatArray,
    blurs: FloatArray,
    bent: FloatArray,
    cells: FloatArray,
    border: int,
    blocks: int,
    pixels: FloatArray,
    along_x: FloatArray,
    along_y: FloatArray,
    sums: Sums,
) -> None:
    """The print and its derivatives at all pixels, and their sums by block."""
    half, start = 0.5 * border, 0.5 * (len(cells) - border)
    for k in range(blocks * blocks):
        for j in range(5):
            sums.plain[k, j] = 0.0
        for j in range(UNKNOWNS):
            sums.slopes[k, 0, j] = sums.slopes[k, 1, j] = 0.0
    for n in range(count):
        u, v, grey = places[n, 0], places[n, 1], places[n, 2]
        w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
        x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
        y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
        a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
        c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
        s_x = blurs[0] * half * sqrt(a * a + b * b) / abs(w)
        s_y = blurs[1] * half * sqrt(c * c + d * d) / abs(w)
        over_x, over_y = 1.0 - x * x, 1.0 - y * y
        dx, dy = bend_at(bent, x, y)
        x, y = x + dx, y + dy
        at = printed_at(
            cells, (x + 1.0) * half + start, (y + 1.0) * half + start, s_x, s_y, along_x, along_y
        )
        if not at.known:
            pixels[n, 1] = -1.0
            continue
        by_x, by_y = half * at.by_x, half * at.by_y
        turn = -(by_x * x + by_y * y)
        pixels[n, 0] = grey
        ridge = at.ridge_x / blurs[0] + at.ridge_y / blurs[1]
        value = at.value + bent[0] * ridge
        pixels[n, 2] = value
        pixels[n, 3], pixels[n, 4], pixels[n, 5] = by_x * x, by_x * y, by_x
        pixels[n, 6], pixels[n, 7], pixels[n, 8] = by_y * x, by_y * y, by_y
        pixels[n, 9], pixels[n, 10] = turn * x, turn * y
        pixels[n, 11], pixels[n, 12], pixels[n, 13] = at.by_blur_x, at.by_blur_y, ridge
        pixels[n, 14], pixels[n, 15] = by_x * over_x, by_x * over_y
        pixels[n, 16], pixels[n, 17] = pixels[n, 14] * x, pixels[n, 15] * x
        pixels[n, 18], pixels[n, 19] = by_y * over_x, by_y * over_y
        pixels[n, 20], pixels[n, 21] = pixels[n, 18] * y, pixels[n, 19] * y
        share = 0.5 * blocks / (half + 1.0)
        column = min(max(int((x * half + half + 1.0) * share), 0), blocks - 1)
        row = min(max(int((y * half + half + 1.0) * share), 0), blocks - 1)
        k = row * blocks + column
        pixels[n, 1] = k
        plain = sums.plain[k]
        plain[0] += 1.0
        plain[1] += value
        plain[2] += value * value
        plain[3] += grey
        plain[4] += value * grey
        for j in range(UNKNOWNS):
            sums.slopes[k, 0, j] += pixels[n, 3 + j]
            sums.slopes[k, 1, j] += value * pixels[n, 3 + j]
