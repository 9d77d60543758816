"""Samples of a tag's fit: working arrays, the print, its pixels, and stages of few and many."""

from math import erf, floor, gcd, hypot, inf, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.optics import UndistortedView, image_to_square_homography, transform_point

MAX_BLURRED_CELLS: Final = 12
"""Most cells along an axis that a blur covers; cells beyond count as the last one (numerical)."""
_CUTOFF_SIGMAS: Final = 3.0
"""Standard deviations at which the Gaussian is cut off (numerical)."""
_STEPS_PER_SIGMA: Final = 128
"""Entries of the tables per standard deviation. Linear interpolation is accurate to 2e-6 and takes
a fifth of the time of the functions (numerical)."""
_TABLE_Z: Final = np.arange(
    -_CUTOFF_SIGMAS, _CUTOFF_SIGMAS + 1.5 / _STEPS_PER_SIGMA, 1.0 / _STEPS_PER_SIGMA
)
"""Arguments of the tables, standard deviations (numerical)."""
_NORMAL_CDF: Final = np.array([0.5 + 0.5 * erf(z / sqrt(2.0)) for z in _TABLE_Z.tolist()])
"""Standard normal distribution function at `_TABLE_Z` (numerical)."""
_NORMAL_PDF: Final = np.exp(-0.5 * _TABLE_Z**2) / sqrt(2.0 * pi)
"""Standard normal density at `_TABLE_Z` (numerical)."""


class PrintSample(NamedTuple):
    """The print's value at a point, and its derivatives."""

    value: float
    by_x: float
    by_y: float
    by_log_blur_x: float
    """Derivative with respect to the logarithm of the blur along x."""
    by_log_blur_y: float
    by_white_spread_x: float
    """Derivative with respect to the spread of white, by which all edges across x move towards
    black, in standard deviations of the blur."""
    by_white_spread_y: float
    cells_known: bool
    """False if a cell that contributes has an unknown print."""


@subroutine
def _weigh(x: float, s: float, weights: FloatArray) -> tuple[int, int]:
    """Weight of each cell at a point along an axis.

    Args:
        x: the point, cells.
        s: standard deviation of the blur, cells.
        weights: (4, `MAX_BLURRED_CELLS`) result: the weights, and their derivatives with respect to
            x, to log s, and to the position of the edge to the next cell, in standard deviations.

    Returns:
        The first cell, and the number of cells.
    """
    first = floor(x - _CUTOFF_SIGMAS * s)
    count = min(floor(x + _CUTOFF_SIGMAS * s) - first + 1, MAX_BLURRED_CELLS)
    below, by_x, by_log = 0.0, 0.0, 0.0
    for i in range(count):
        height = 0.0
        if i + 1 < count:
            z = (first + i + 1 - x) / s
            place = min(
                max((z + _CUTOFF_SIGMAS) * _STEPS_PER_SIGMA, 0.0),
                2.0 * _CUTOFF_SIGMAS * _STEPS_PER_SIGMA,
            )
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
def sample_print(
    cells: FloatArray,
    x: float,
    y: float,
    blur_x_cells: float,
    blur_y_cells: float,
    cell_weights_x: FloatArray,
    cell_weights_y: FloatArray,
) -> PrintSample:
    """Blurred print at a point.

    Args:
        cells: (rows, columns) 0 black to 1 white, nan unknown; the outermost extend beyond.
        x: the point, cells to the right of the upper left corner of all cells.
        y: the point, cells below that corner.
        blur_x_cells: standard deviation of the blur along x, cells.
        blur_y_cells: along y.
        cell_weights_x: (4, `MAX_BLURRED_CELLS`) scratch array.
        cell_weights_y: (4, `MAX_BLURRED_CELLS`) scratch array.
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
    return PrintSample(value, by_x, by_y, blur_x, blur_y, ridge_x, ridge_y, known)


MAX_UNKNOWNS: Final = 23
"""Unknowns of a fit: eight of the homography, two logarithms of blurs, the spread of white into
black, twelve of a bend (numerical)."""
WHITE_SPREAD_INDEX: Final = 10
"""Index of the spread, px, among the unknowns (numerical)."""
BEND_START: Final = 11
"""Index of the bend's first coefficient, half edges, see `bend_displacement` (numerical)."""
CUBIC_START: Final = 15
"""Index of the first cubic coefficient of the bend, half edges (numerical)."""
PIXEL_COLUMNS: Final = 3 + MAX_UNKNOWNS
"""Columns of a pixel: its light, its block, the print, and the derivatives (numerical)."""


class SearchRegion(NamedTuple):
    """The image that a tag is searched in, and the region of the search."""

    image: NDArray[np.uint8]
    """Grey levels, shape (height, width)."""
    light_by_grey: FloatArray
    """(256,) light of each grey level."""
    rays: NDArray[np.float32]
    """(height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole."""
    undistorted_view: UndistortedView
    """The undistorted plane."""
    left: int
    """First pixel of the region along u; it may lie outside of the image, as the next three may."""
    right: int
    top: int
    bottom: int


class TagPrint(NamedTuple):
    """The print of a tag."""

    cells: FloatArray
    """(n, n) 0 black to 1 white, nan unknown."""
    side_cells: int
    """Side of the square whose corners are sought, cells; centred in the print."""
    quiet_zone_cells: float
    """Assumed width of the quiet zone around the square, cells."""


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


class Blocks(NamedTuple):
    """Sums over the pixels of each block, and the levels and weights that follow from them."""

    moments: FloatArray
    """(K, 5) sums of 1, T, T^2, I, T I."""
    derivative_sums: FloatArray
    """(K, 2, unknowns) sums of the derivatives of T, and of T times them."""
    normal_matrices: FloatArray
    """(K, unknowns, unknowns) normal matrices, levels eliminated."""
    scores: FloatArray
    """(K, unknowns) sums of the derivatives times the residuals."""
    levels: FloatArray
    """(K, 2) dark level and contrast; contrast 0 for blocks that are not used."""
    weights: FloatArray
    """(K,) weights."""


class FitBuffers(NamedTuple):
    """Working arrays of the steps."""

    samples: FloatArray
    """(pixels, 3) undistorted position and light of the pixels that take part."""
    pixel_rows: FloatArray
    """(pixels, `PIXEL_COLUMNS`) see `evaluate_print`."""
    cell_weights_x: FloatArray
    """(4, `MAX_BLURRED_CELLS`) see `sample_print`."""
    cell_weights_y: FloatArray
    """(4, `MAX_BLURRED_CELLS`) see `sample_print`."""
    blocks: Blocks
    normal_matrix: FloatArray
    """(unknowns, unknowns) normal matrix; its lower Cholesky factor after a step."""
    step: FloatArray
    """(unknowns,) right side of the normal equations; the step after it is solved."""
    previous_step: FloatArray
    """(unknowns,) previous step; 0 before the first one of a stage."""
    step_fraction_and_slope: FloatArray
    """(2,) fraction of the previous step that was taken, and the slope along it at its start."""


@subroutine
def allocate_buffers(max_pixels: int, max_blocks: int) -> FitBuffers:
    """Allocate working arrays."""
    return FitBuffers(
        np.empty((max_pixels, 3)),
        np.empty((max_pixels, PIXEL_COLUMNS)),
        np.empty((4, MAX_BLURRED_CELLS)),
        np.empty((4, MAX_BLURRED_CELLS)),
        Blocks(
            np.empty((max_blocks, 5)),
            np.empty((max_blocks, 2, MAX_UNKNOWNS)),
            np.empty((max_blocks, MAX_UNKNOWNS, MAX_UNKNOWNS)),
            np.empty((max_blocks, MAX_UNKNOWNS)),
            np.empty((max_blocks, 2)),
            np.empty(max_blocks),
        ),
        np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS)),
        np.empty(MAX_UNKNOWNS),
        np.empty(MAX_UNKNOWNS),
        np.empty(2),
    )


@subroutine
def point_in_half_edges(point_index: int) -> tuple[float, float]:
    """Position of corner k in the tag's plane, half edges; of the centre for k = 4."""
    if point_index == 4:
        return 0.0, 0.0
    return (
        -1.0 if point_index == 0 or point_index == 3 else 1.0,
        -1.0 if point_index < 2 else 1.0,
    )


class SideLengths(NamedTuple):
    """Lengths of the sides of a square in an image."""

    shortest: float
    longest: float
    """Infinite if a corner is not finite."""
    perimeter: float


@subroutine
def side_lengths(corners: FloatArray) -> SideLengths:
    """Lengths of the sides between (4, 2) corners."""
    shortest, longest, perimeter = inf, 0.0, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, perimeter = min(shortest, side), perimeter + side
        longest = max(longest, side) if side < inf else inf
    return SideLengths(shortest, longest, perimeter)


_LEAST_SCALE: Final = 0.4
"""Lower bound of the image scale at the far end of an edge, as a fraction of the mean scale of the
shortest edge (chosen: perspective does not reach it)."""
_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel may be clipped (chosen: just below 255, the largest level)."""
_MAX_CLIPPED_FRACTION: Final = 0.02
"""Fraction of clipped pixels above which white as a whole counts as clipped, not single pixels
(chosen: bias by clipped white against pixels lost)."""
_BESIDE_CLIPPED_GREY: Final = 240
"""Grey level from which on pixels are left out if white is clipped (measured:
benchmarks.real_light)."""
_DRAWN_BLACK_GREY: Final = 3
"""Grey level up to which black is a drawing's (chosen: just above 0; file formats round)."""
_LEAST_DRAWN_BLACK_FRACTION: Final = 0.2
"""Fraction of such pixels above which the image is a drawing (chosen: drawings that are blurred
against photographs with deep shadows)."""
_LEAST_QUIET_FRACTION: Final = 0.45
"""Fraction of the quiet zone's width that is always used (chosen: evidence on the outer edges
against objects behind the zone)."""


@subroutine
def gather_edge_pixels(
    region: SearchRegion,
    tag: TagPrint,
    state: FitState,
    band_half_width_px: float,
    excluded_quiet_px: float,
    whole_square: bool,
    cell_edges: bool,
    max_pixels: int,
    samples: FloatArray,
) -> int:
    """Gather the pixels near the edges, evenly subsampled to at most `max_pixels`.

    Args:
        region: the image.
        tag: the print.
        state: the tag's approximate pose.
        band_half_width_px: half width of the band along the edges, px.
        excluded_quiet_px: width of the outer part of the quiet zone that is left out, px.
        whole_square: True to take all pixels within the square.
        cell_edges: True to take pixels near the edges of the cells within the square.
        max_pixels: most pixels.
        samples: (most, 3) result: undistorted position and light.

    Returns:
        Number of pixels.
    """
    image, light, rays, view = (
        region.image,
        region.light_by_grey,
        region.rays,
        region.undistorted_view,
    )
    G, cells, border, quiet = state.G, tag.cells, tag.side_cells, tag.quiet_zone_cells
    height, width = image.shape
    left, right = max(region.left, 0), min(region.right, width - 1)
    top, bottom = max(region.top, 0), min(region.bottom, height - 1)
    half = 0.5 * border
    shortest, _, perimeter = side_lengths(state.corners)
    expected = 2.0 * band_half_width_px * perimeter
    area = 1.5 * (0.25 * perimeter + 2.0) ** 2
    if cell_edges:
        expected *= _edges_of(cells) / (4.0 * border)
        expected = min(expected, area)
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
    for row in range(top, bottom + 1):
        first = left + (-(left + phase * row)) % stride
        for column in range(first, right + 1, stride):
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
            if out_x > max(quiet_x - excluded_quiet_px, _LEAST_QUIET_FRACTION * quiet_x):
                continue
            if out_y > max(quiet_y - excluded_quiet_px, _LEAST_QUIET_FRACTION * quiet_y):
                continue
            if out > band_half_width_px or count == max_pixels:
                continue
            if not whole_square and out < -band_half_width_px:
                if not cell_edges:
                    continue
                at_x, at_y = (x + 1.0) * half + start, (y + 1.0) * half + start
                if not _near_edge(
                    cells,
                    at_x,
                    at_y,
                    band_half_width_px * half / px_x,
                    band_half_width_px * half / px_y,
                ):
                    continue
            samples[count, 0], samples[count, 1], samples[count, 2] = (
                u,
                v,
                light[image[row, column]],
            )
            count += 1
    return count


@subroutine
def drop_clipped_pixels(samples: FloatArray, pixel_count: int, light_by_grey: FloatArray) -> int:
    """Remove pixels that may be clipped, in place; return the number left.

    If white is clipped, demosaicking and compression have changed the neighbouring pixels as well.
    Nothing is removed from a drawing, which has the smallest and the largest grey level.
    """
    clipped = black = 0
    for n in range(pixel_count):
        if samples[n, 2] >= light_by_grey[_CLIPPED_GREY]:
            clipped += 1
        if samples[n, 2] <= light_by_grey[_DRAWN_BLACK_GREY]:
            black += 1
    if black > _LEAST_DRAWN_BLACK_FRACTION * pixel_count:
        return pixel_count
    limit = light_by_grey[
        _CLIPPED_GREY if clipped <= _MAX_CLIPPED_FRACTION * pixel_count else _BESIDE_CLIPPED_GREY
    ]
    left = 0
    for n in range(pixel_count):
        if samples[n, 2] < limit:
            for k in range(3):
                samples[left, k] = samples[n, k]
            left += 1
    return left


@subroutine
def _edges_of(cells: FloatArray) -> float:
    """Total length of the edges between cells of different colours, cells."""
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
    """True if an edge between cells of different colours is near a point, all in cells."""
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


WIDE, NARROW, ALL, BEND = range(4)
"""Stages: a wide band along the outer edges, a narrow one, the edges of all cells, and a bend
(numerical)."""
_LEAST_BLOCK_SIDE_PX: Final = 8.0
"""Smallest side of a block, which has one dark level and one contrast, px (chosen: shadows and
gradients against noise)."""
_MOST_BLOCKS: Final = 8
"""Most blocks along an edge (chosen: as above)."""
_PIXELS_PER_BLOCK: Final = 24
"""Pixels that take part per block, from which the number of blocks follows (chosen: as above)."""
_BAND_HALF_WIDTH_PX: Final = 1.0
"""Constant part of the half width of the band along the edges, px (chosen: evidence against time
and neighbouring edges)."""
_BAND_HALF_WIDTH_BLURS: Final = 2.2
"""Part of this half width that grows with the blur, in blurs of `_INITIAL_BLUR_PX` (chosen: as
above)."""
_MAX_BAND_HALF_WIDTH_PX: Final = 4.0
"""Largest half width of the band in the first stage, px, for poor initial corners (chosen: reach
against neighbouring edges)."""
_WIDE_BLUR_PX: Final = 2.0
"""Largest initial blur of the print in the first stage, px; so blurred, pixels far from an edge
carry evidence on it (chosen: reach against accuracy)."""
_WIDE_BLUR_CELLS: Final = 0.35
"""Initial blur of the print in the first stage, cells (chosen: as above)."""
_EXCLUDED_QUIET_BLURS: Final = 1.8
"""Width of the outer part of the quiet zone that is left out, in blurs of `_INITIAL_BLUR_PX`: the
background blurs into it (chosen: evidence against this background)."""
_MAX_FIRST_BLOCKS: Final = 3
"""Most blocks along an edge in the first stage, which has few pixels (chosen: shadows against
noise)."""
_INITIAL_BLUR_PX: Final = 0.8
"""Initial blur of the print after the first stage, px; the smallest in it (chosen: a typical
blur)."""
_MOST_BLUR_PX: Final = 6.0
"""Largest blur of a fit, px (chosen: blurred tags against fits that diverge)."""
_MOST_BLUR_CELLS: Final = 0.7
"""Largest blur of a fit, cells (chosen: as above)."""


class TagScale(NamedTuple):
    """Size of a tag in the image, px, and upper bounds of blocks and blur that follow from it."""

    shortest_edge_px: float
    """Length of its shortest edge."""
    cell_px: float
    max_blocks_per_edge: int
    """Most blocks along an edge."""
    max_blur_px: float


@subroutine
def tag_scale(corners: FloatArray, side_cells: int, max_pixels: int) -> TagScale:
    """Scale of a tag.

    Args:
        corners: (4, 2) approximate corners, undistorted, px.
        side_cells: cells along the square between them.
        max_pixels: most pixels that take part.
    """
    shortest, longest, _ = side_lengths(corners)
    cell_px = shortest / side_cells
    # at most one block per cell of the border: a block of one colour has no contrast
    blocks_per_edge = min(
        max(int(0.5 * (shortest + longest) / _LEAST_BLOCK_SIDE_PX), 1), _MOST_BLOCKS, side_cells
    )
    blocks_per_edge = min(blocks_per_edge, 1 + max_pixels // (4 * _PIXELS_PER_BLOCK))
    return TagScale(
        shortest, cell_px, blocks_per_edge, min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _MOST_BLUR_PX)
    )


class FitStage(NamedTuple):
    """Numbers of pixels and blocks that take part in a stage."""

    pixel_count: int
    blocks_per_edge: int
    """Blocks along an edge."""
    dropped_clipped: bool
    """True if pixels of clipped white were left out."""


@subroutine
def begin_stage(
    stage: int,
    blurs_known: bool,
    region: SearchRegion,
    tag: TagPrint,
    scale: TagScale,
    state: FitState,
    buffers: FitBuffers,
    max_pixels: int,
) -> FitStage:
    """Begin a stage other than `BEND`, with the homography through the corners.

    Args:
        stage: the stage, see `WIDE`.
        blurs_known: True if an earlier stage has found the blurs.
        region: the image.
        tag: the print.
        scale: size of the tag in the image.
        state: its corners are read; `G` is a result, and so are the blurs unless `blurs_known`.
        buffers: its `samples` are a result.
        max_pixels: most pixels that take part.
    """
    image_to_square_homography(state.corners, state.G)
    blocks_per_edge, blur_px = scale.max_blocks_per_edge, _INITIAL_BLUR_PX
    reach_px = _BAND_HALF_WIDTH_PX + _BAND_HALF_WIDTH_BLURS * _INITIAL_BLUR_PX
    if stage == WIDE:
        blocks_per_edge = min(blocks_per_edge, _MAX_FIRST_BLOCKS)
        reach_px = min(_MAX_BAND_HALF_WIDTH_PX, max(scale.cell_px, 2.0))
        blur_px = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * scale.cell_px, _INITIAL_BLUR_PX))
    if not blurs_known:
        state.blurs_px[0] = state.blurs_px[1] = blur_px
    count = gathered = gather_edge_pixels(
        region, tag, state, reach_px, _EXCLUDED_QUIET_BLURS * _INITIAL_BLUR_PX,
        scale.cell_px < reach_px + 2.0 * blur_px, stage == ALL, max_pixels, buffers.samples,
    )  # fmt: skip
    if stage == ALL:
        count = drop_clipped_pixels(buffers.samples, count, region.light_by_grey)
    return FitStage(count, blocks_per_edge, count < gathered)
