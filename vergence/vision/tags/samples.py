"""Samples of a tag's fit: the pixels near its edges, and the blurred print at each of them."""

from math import erf, floor, gcd, hypot, inf, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import inlined, subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.optics import UndistortedView, image_to_square_homography, transform_point

MAX_BLURRED_CELLS: Final = 12
"""Most cells along an axis that a blur covers; cells beyond count as the last one (numerical)."""
_CUTOFF_SIGMAS: Final = 3.0
"""Standard deviations at which the Gaussian is cut off (numerical)."""
_STEPS_PER_SIGMA: Final = 128
"""Entries of the tables per standard deviation: interpolation errs by 2e-6 (numerical)."""
_TABLE_Z: Final = np.arange(
    -_CUTOFF_SIGMAS, _CUTOFF_SIGMAS + 1.5 / _STEPS_PER_SIGMA, 1.0 / _STEPS_PER_SIGMA
)
"""Arguments of the tables, standard deviations (numerical)."""
_NORMAL_CDF: Final = np.array([0.5 + 0.5 * erf(z / sqrt(2.0)) for z in _TABLE_Z.tolist()])
"""Standard normal distribution function at `_TABLE_Z` (numerical)."""
_NORMAL_PDF: Final = np.exp(-0.5 * _TABLE_Z**2) / sqrt(2.0 * pi)
"""Standard normal density at `_TABLE_Z` (numerical)."""


@subroutine
def _weigh(x: float, s: float, weights: FloatArray) -> tuple[int, int]:
    """First cell and number of cells that count at x, cells, with a blur of s.

    The rows of `weights` become their weights, and these by x, by log s, and by the position of the
    edge to the next cell, in s.
    """
    first = floor(x - _CUTOFF_SIGMAS * s)
    count = min(floor(x + _CUTOFF_SIGMAS * s) - first + 1, MAX_BLURRED_CELLS)
    below, by_x, by_log = 0.0, 0.0, 0.0
    for i in range(count):
        height = 0.0
        if i + 1 < count:
            z = (first + i + 1 - x) / s
            place = max((z + _CUTOFF_SIGMAS) * _STEPS_PER_SIGMA, 0.0)
            place = min(place, 2.0 * _CUTOFF_SIGMAS * _STEPS_PER_SIGMA)
            k = int(place)
            share = place - k
            below_next = _NORMAL_CDF[k] + share * (_NORMAL_CDF[k + 1] - _NORMAL_CDF[k])
            height = _NORMAL_PDF[k] + share * (_NORMAL_PDF[k + 1] - _NORMAL_PDF[k])
            by_x_next, by_log_next = -height / s, -height * z
        else:
            below_next, by_x_next, by_log_next = 1.0, 0.0, 0.0
        weights[0, i] = below_next - below
        weights[1, i] = by_x_next - by_x
        weights[2, i] = by_log_next - by_log
        weights[3, i] = height
        below, by_x, by_log = below_next, by_x_next, by_log_next
    return first, count


@subroutine
def _sample_print(
    cells: FloatArray, x: float, y: float, blur_x_cells: float, blur_y_cells: float,
    cell_weights_x: FloatArray, cell_weights_y: FloatArray,
) -> tuple[float, float, float, float, float, float, float, bool]:  # fmt: skip
    """Blurred print at a point, in cells from the upper left corner; outer cells extend beyond.

    Returns its value, derivatives by x and y, by the log blurs, and by the spread of white across x
    and y, in blurs; and False if a cell that contributes has an unknown print.
    """
    rows, columns = cells.shape
    left, across = _weigh(x, blur_x_cells, cell_weights_x)
    top, down = _weigh(y, blur_y_cells, cell_weights_y)
    value = by_x = by_y = blur_x = blur_y = ridge_x = ridge_y = 0.0
    known = True
    for j in range(down):
        row = min(max(top + j, 0), rows - 1)
        below = min(max(top + j + 1, 0), rows - 1) if j + 1 < down else row
        sum_ = sum_x = sum_blur = sum_ridge = sum_below = 0.0
        for i in range(across):
            column = min(max(left + i, 0), columns - 1)
            beside = min(max(left + i + 1, 0), columns - 1) if i + 1 < across else column
            cell, right = cells[row, column], cells[row, beside]
            if cell != cell:
                known = False
            sum_ += cell_weights_x[0, i] * cell
            sum_x += cell_weights_x[1, i] * cell
            sum_blur += cell_weights_x[2, i] * cell
            sum_ridge += cell_weights_x[3, i] * abs(right - cell)
            sum_below += cell_weights_x[0, i] * abs(cells[below, column] - cell)
        value += cell_weights_y[0, j] * sum_
        by_x += cell_weights_y[0, j] * sum_x
        blur_x += cell_weights_y[0, j] * sum_blur
        ridge_x += cell_weights_y[0, j] * sum_ridge
        by_y += cell_weights_y[1, j] * sum_
        blur_y += cell_weights_y[2, j] * sum_
        ridge_y += cell_weights_y[3, j] * sum_below
    return value, by_x, by_y, blur_x, blur_y, ridge_x, ridge_y, known


MAX_UNKNOWNS: Final = 23
"""Unknowns of a fit: eight of the homography, two logarithms of blurs, the spread of white into
black, twelve of a bend (numerical)."""
WHITE_SPREAD_INDEX: Final = 10
"""Index of the spread, px, among the unknowns (numerical)."""
BEND_START: Final = 11
"""Index of the bend's first coefficient, half edges, see `bend_displacement` (numerical)."""
CUBIC_START: Final = 15
"""Index of the first cubic coefficient of the bend, half edges (numerical)."""
POINTS: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.0, 0.0]])
"""Corners and centre in the tag's plane, half edges (numerical)."""


class TagSearch(NamedTuple):
    """What a fit looks at: an image, the print of a tag, and the tag's expected place and size."""

    image: NDArray[np.uint8]
    """Grey levels, shape (height, width)."""
    light_by_grey: FloatArray
    """(256,) light of each grey level."""
    rays: NDArray[np.float32]
    """(height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole."""
    camera: CameraRow
    undistorted_view: UndistortedView
    cells: FloatArray
    """(n, n) print, 0 black to 1 white, nan unknown."""
    side_cells: int
    """Side of the square whose corners are sought, cells; centred in the print."""
    quiet_zone_cells: float
    """Assumed width of the quiet zone around the square, cells."""
    left: int
    """First pixel of the region along u, within the image; the next three are the others."""
    right: int
    top: int
    bottom: int
    shortest_edge_px: float
    """Length of the tag's shortest edge."""
    cell_px: float
    max_blocks_per_edge: int
    max_blur_px: float


class FitState(NamedTuple):
    """The unknowns of a fit: a tag's pose, blurs, spread and bend."""

    corners: FloatArray
    """(4, 2) undistorted, px."""
    G: FloatArray
    """(3, 3) homography from the undistorted image to the tag's plane, see
    `image_to_square_homography`."""
    H: FloatArray
    """(3, 3) its inverse, see `square_to_image_homography`."""
    blurs_px: FloatArray
    """(2,) across the edges along x and along y, px."""
    white_spread_and_bend: FloatArray
    """(13,) the spread, px, and the bend's coefficients, see `bend_displacement`."""


class FitStage(NamedTuple):
    """Pixels and blocks that take part in a stage, and working arrays of its steps."""

    samples: FloatArray
    """(pixels, 3) undistorted position and light of the pixels."""
    pixel_rows: FloatArray
    """(pixels, 3 + unknowns) light, block, print, and its derivatives by the unknowns; block -1 if
    an unknown cell contributes."""
    blocks_per_edge: int
    moments: FloatArray
    """(blocks, 5) sums over the pixels of 1, T, T^2, I, T I."""
    derivative_sums: FloatArray
    """(blocks, 2, unknowns) sums of the derivatives of T, and of T times them."""
    levels: FloatArray
    """(blocks, 2) dark level and contrast; contrast 0 for blocks that are not used."""
    weights: FloatArray
    """(blocks,) weights."""
    normal_matrices: FloatArray
    """(blocks, unknowns, unknowns) normal matrices, levels eliminated."""
    scores: FloatArray
    """(blocks, unknowns) sums of the derivatives times the residuals."""
    normal_matrix: FloatArray
    """(unknowns, unknowns) normal matrix; its lower Cholesky factor after a step."""
    step: FloatArray
    """(unknowns,) right side of the normal equations; the step after it is solved."""
    previous_step: FloatArray
    """(unknowns,) previous step; 0 before the first one of a stage."""
    step_fraction_and_slope: FloatArray
    """(2,) fraction of the previous step that was taken, and the slope along it at its start."""
    dropped_clipped: bool
    """True if pixels of clipped white were left out."""


@subroutine
def side_lengths(corners: FloatArray) -> tuple[float, float, float]:
    """Shortest side between (4, 2) corners, longest, and perimeter; longest inf if undefined."""
    shortest, longest, perimeter = inf, 0.0, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, perimeter = min(shortest, side), perimeter + side
        longest = max(longest, side) if side < inf else inf
    return shortest, longest, perimeter


@subroutine
def bend_displacement(white_spread_and_bend: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Displacement (dx, dy) of a point of the tag's plane by the bend; 0 at the corners.

    With c the coefficients, dx = (c1 + c5 x + c9 y) (1 - x^2) + (c2 + c6 x + c10 y) (1 - y^2) and
    dy = (c3 + c7 y + c11 x) (1 - x^2) + (c4 + c8 y + c12 x) (1 - y^2). Together with a homography
    these are all cubic polynomials. Before c1 to c12 stands the spread; x and y are half edges.
    """
    c, over_x, over_y = white_spread_and_bend, 1.0 - x * x, 1.0 - y * y
    dx = (c[1] + c[5] * x + c[9] * y) * over_x + (c[2] + c[6] * x + c[10] * y) * over_y
    dy = (c[3] + c[7] * y + c[11] * x) * over_x + (c[4] + c[8] * y + c[12] * x) * over_y
    return dx, dy


@subroutine
def bend_by_coefficient(k: int, x: float, y: float) -> tuple[float, float]:
    """Derivative of `bend_displacement` with respect to coefficient k, from 0."""
    by = 1.0 - x * x if k % 2 == 0 else 1.0 - y * y
    term = k // 2
    if term >= 2:
        by *= x if term == 2 or term == 5 else y
    return (by, 0.0) if term % 2 == 0 else (0.0, by)


_LEAST_SCALE: Final = 0.4
"""Least image scale at an edge's far end, by the mean of the shortest (chosen: perspective)."""
_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel may be clipped (chosen: just below the largest level)."""
_MAX_CLIPPED_FRACTION: Final = 0.02
"""Fraction of clipped pixels above which all white is clipped (chosen: bias against pixels)."""
_BESIDE_CLIPPED_GREY: Final = 240
"""Least grey level that is left out beside such white (measured: benchmarks.real_light)."""
_DRAWN_BLACK_GREY: Final = 3
"""Grey level up to which black is a drawing's (chosen: just above 0; file formats round)."""
_LEAST_DRAWN_BLACK_FRACTION: Final = 0.2
"""Fraction of such pixels above which the image is a drawing (chosen: against deep shadows)."""
_INITIAL_BLUR_PX: Final = 0.8
"""Initial blur of the print after the first stage, px; the least in it (chosen: typical)."""
_BAND_HALF_WIDTH_PX: Final = 1.0 + 2.2 * _INITIAL_BLUR_PX
"""Half width of the band along edges, px (chosen: evidence against neighbouring edges)."""
_EXCLUDED_QUIET_PX: Final = 1.8 * _INITIAL_BLUR_PX
"""Outer part of the quiet zone that is left out, px: the background blurs into it (chosen: evidence
against this background)."""
_LEAST_QUIET_FRACTION: Final = 0.45
"""Fraction of the quiet zone that is always used (chosen: evidence against objects behind it)."""


@subroutine
def _gather_edge_pixels(
    search: TagSearch, state: FitState, band_half_width_px: float, whole_square: bool,
    cell_edges: bool, max_pixels: int,
) -> FloatArray:  # fmt: skip
    """Samples near the square's edges, or all in it, or also near those of its cells."""
    samples = np.empty((max_pixels, 3))
    image, light, rays = search.image, search.light_by_grey, search.rays
    view, G = search.undistorted_view, state.G
    cells, border, quiet = search.cells, search.side_cells, search.quiet_zone_cells
    left, half = search.left, 0.5 * border
    shortest, _, perimeter = side_lengths(state.corners)
    expected = 2.0 * band_half_width_px * perimeter
    area = 1.5 * (0.25 * perimeter + 2.0) ** 2
    if cell_edges:
        across, down = cells[:, 1:] - cells[:, :-1], cells[1:] - cells[:-1]
        edges = (np.abs(across) > 0.5).sum() + (np.abs(down) > 0.5).sum()
        expected = min(expected * (edges / (4.0 * border)), area)
    if whole_square:
        expected = max(expected, area)
    stride = int(expected / max_pixels) + 1
    phase = int(0.618 * stride + 0.5)
    while gcd(phase, stride) > 1:  # it would leave out columns, perhaps all beside sharp edges
        phase += 1
    # a cheap bound, loose enough for any perspective, rejects most pixels: they are far from edges
    away = band_half_width_px / (_LEAST_SCALE * 0.5 * shortest)
    nearest, farthest = 0.0 if whole_square or cell_edges else 1.0 - away, 1.0 + away
    start = 0.5 * (len(cells) - border)
    count = 0
    for row in range(search.top, search.bottom + 1):
        first = left + (-(left + phase * row)) % stride
        for column in range(first, search.right + 1, stride):
            u, v = float(column), float(row)
            if view.has_lens:
                x, y = rays[row, column, 0], rays[row, column, 1]
                u, v = transform_point(view.plane_from_ray, x, y)
            w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
            x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
            y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
            # px per unit of the plane, across the edges along x and along y
            if not nearest <= max(abs(x), abs(y)) <= farthest:
                continue
            a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
            c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
            px_x, px_y = abs(w) / sqrt(a * a + b * b), abs(w) / sqrt(c * c + d * d)
            out_x, out_y = (abs(x) - 1.0) * px_x, (abs(y) - 1.0) * px_y
            out = max(out_x, out_y)
            quiet_x, quiet_y = quiet * px_x / half, quiet * px_y / half
            if (
                out_x > max(quiet_x - _EXCLUDED_QUIET_PX, _LEAST_QUIET_FRACTION * quiet_x)
                or out_y > max(quiet_y - _EXCLUDED_QUIET_PX, _LEAST_QUIET_FRACTION * quiet_y)
                or out > band_half_width_px
                or count == max_pixels
            ):
                continue
            if not whole_square and out < -band_half_width_px:
                if not cell_edges:
                    continue
                at_x, at_y = (x + 1.0) * half + start, (y + 1.0) * half + start
                reach_x = band_half_width_px * half / px_x
                reach_y = band_half_width_px * half / px_y
                if not _near_edge(cells, at_x, at_y, reach_x, reach_y):
                    continue
            samples[count, 0], samples[count, 1] = u, v
            samples[count, 2] = light[image[row, column]]
            count += 1
    return samples[:count]


@subroutine
def _drop_clipped_pixels(samples: FloatArray, light_by_grey: FloatArray) -> FloatArray:
    """Samples without those that may be clipped.

    If white is clipped, demosaicking and compression have changed the neighbouring pixels as well.
    Nothing is removed from a drawing, which has the smallest and the largest grey level.
    """
    light = samples[:, 2]
    clipped = (light >= light_by_grey[_CLIPPED_GREY]).sum()
    black = (light <= light_by_grey[_DRAWN_BLACK_GREY]).sum()
    if black > _LEAST_DRAWN_BLACK_FRACTION * len(light):
        return samples
    few = clipped <= _MAX_CLIPPED_FRACTION * len(light)
    limit = light_by_grey[_CLIPPED_GREY if few else _BESIDE_CLIPPED_GREY]
    below: FloatArray = samples[light < limit]
    return below


@subroutine
def _near_edge(cells: FloatArray, x: float, y: float, reach_x: float, reach_y: float) -> bool:
    """True if an edge between cells of different colours is near a point, all in cells."""
    size = len(cells)
    column, row = min(max(int(x), 0), size - 1), min(max(int(y), 0), size - 1)
    edge = int(x + 0.5)
    near = 0 < edge < size and abs(x - edge) <= reach_x
    if near and abs(cells[row, edge] - cells[row, edge - 1]) > 0.5:
        return True
    edge = int(y + 0.5)
    near = 0 < edge < size and abs(y - edge) <= reach_y
    return bool(near and abs(cells[edge, column] - cells[edge - 1, column]) > 0.5)


WIDE, NARROW, ALL, BEND = range(4)
"""Stages: a wide band along the outer edges, a narrow one, the edges of all cells, and a bend
(numerical)."""
_MAX_BAND_HALF_WIDTH_PX: Final = 4.0
"""Largest half width in the first stage, px (chosen: poor starts against other edges)."""
_WIDE_BLUR_PX: Final = 2.0
"""Largest initial blur in the first stage, px: far pixels see edges (chosen: against accuracy)."""
_WIDE_BLUR_CELLS: Final = 0.35
"""Initial blur of the print in the first stage, cells (chosen: as above)."""
_MAX_FIRST_BLOCKS: Final = 3
"""Most blocks along an edge in the first stage, of few pixels (chosen: shadows against noise)."""


@subroutine
def begin_stage(
    stage: int, blurs_known: bool, search: TagSearch, state: FitState, max_pixels: int
) -> FitStage:
    """Begin a stage other than `BEND`, with the homography through the corners, and with blurs."""
    image_to_square_homography(state.corners, state.G)
    blocks_per_edge, blur_px = search.max_blocks_per_edge, _INITIAL_BLUR_PX
    reach_px = _BAND_HALF_WIDTH_PX
    if stage == WIDE:
        blocks_per_edge = min(blocks_per_edge, _MAX_FIRST_BLOCKS)
        reach_px = min(_MAX_BAND_HALF_WIDTH_PX, max(search.cell_px, 2.0))
        blur_px = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * search.cell_px, _INITIAL_BLUR_PX))
    if not blurs_known:
        state.blurs_px[0] = state.blurs_px[1] = blur_px
    whole_square = search.cell_px < reach_px + 2.0 * blur_px
    samples = _gather_edge_pixels(search, state, reach_px, whole_square, stage == ALL, max_pixels)
    gathered, blocks = len(samples), blocks_per_edge * blocks_per_edge
    if stage == ALL:
        samples = _drop_clipped_pixels(samples, search.light_by_grey)
    return FitStage(
        samples, np.empty((len(samples), 3 + MAX_UNKNOWNS)), blocks_per_edge,
        np.empty((blocks, 5)), np.empty((blocks, 2, MAX_UNKNOWNS)),
        np.empty((blocks, 2)), np.empty(blocks),
        np.empty((blocks, MAX_UNKNOWNS, MAX_UNKNOWNS)), np.empty((blocks, MAX_UNKNOWNS)),
        np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS)), np.empty(MAX_UNKNOWNS), np.empty(MAX_UNKNOWNS),
        np.empty(2), len(samples) < gathered,
    )  # fmt: skip


@inlined
def evaluate_print(search: TagSearch, state: FitState, stage: FitStage) -> None:
    """Evaluate the print and its derivatives at all pixels, and their sums by block."""
    G, blurs, spread_and_bend = state.G, state.blurs_px, state.white_spread_and_bend
    cells, places, pixels, blocks_per_edge = (
        search.cells, stage.samples, stage.pixel_rows, stage.blocks_per_edge
    )  # fmt: skip
    along_x, along_y = np.empty((4, MAX_BLURRED_CELLS)), np.empty((4, MAX_BLURRED_CELLS))
    sums, slopes = stage.moments, stage.derivative_sums
    half, start = 0.5 * search.side_cells, 0.5 * (len(cells) - search.side_cells)
    sums[:] = 0.0
    slopes[:] = 0.0
    for n in range(len(places)):
        u, v, grey = places[n, 0], places[n, 1], places[n, 2]
        w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
        x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
        y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
        a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
        c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
        s_x = blurs[0] * half * sqrt(a * a + b * b) / abs(w)
        s_y = blurs[1] * half * sqrt(c * c + d * d) / abs(w)
        flat_x, flat_y = x, y
        dx, dy = bend_displacement(spread_and_bend, flat_x, flat_y)
        x, y = x + dx, y + dy
        at_x, at_y = (x + 1.0) * half + start, (y + 1.0) * half + start
        value, by_x, by_y, blur_x, blur_y, ridge_x, ridge_y, known = _sample_print(
            cells, at_x, at_y, s_x, s_y, along_x, along_y
        )
        if not known:
            pixels[n, 1] = -1.0
            continue
        by_x, by_y = half * by_x, half * by_y
        turn = -(by_x * x + by_y * y)
        pixels[n, 0] = grey
        ridge = ridge_x / blurs[0] + ridge_y / blurs[1]
        value += spread_and_bend[0] * ridge
        pixels[n, 2] = value
        pixels[n, 3], pixels[n, 4], pixels[n, 5] = by_x * x, by_x * y, by_x
        pixels[n, 6], pixels[n, 7], pixels[n, 8] = by_y * x, by_y * y, by_y
        pixels[n, 9], pixels[n, 10] = turn * x, turn * y
        pixels[n, 11], pixels[n, 12], pixels[n, 13] = blur_x, blur_y, ridge
        for k in range(MAX_UNKNOWNS - BEND_START):
            dx, dy = bend_by_coefficient(k, flat_x, flat_y)
            pixels[n, 3 + BEND_START + k] = by_x * dx + by_y * dy
        share = 0.5 * blocks_per_edge / (half + 1.0)
        column = min(max(int((x * half + half + 1.0) * share), 0), blocks_per_edge - 1)
        row = min(max(int((y * half + half + 1.0) * share), 0), blocks_per_edge - 1)
        k = row * blocks_per_edge + column
        pixels[n, 1] = k
        own = sums[k]
        own[0] += 1.0
        own[1] += value
        own[2] += value * value
        own[3] += grey
        own[4] += value * grey
        for j in range(MAX_UNKNOWNS):
            slopes[k, 0, j] += pixels[n, 3 + j]
            slopes[k, 1, j] += value * pixels[n, 3 + j]
