"""A tag's corners, by fitting all edges of its cells to the light of the pixels at once.

A homography with eight unknowns maps the image to the tag's plane; each edge is a step blurred by a
Gaussian. Only pixels near the edges take part. T is the blurred print (`_sample_print`) at the
point of the tag's plane that a pixel shows, p the pixel, I its light by the camera's response. The
fit solves

    I = a_k + b_k (T(G p + d(p)) + e |dT|),    minimise  sum w_k (I - a_k - b_k ...)^2

over the homography G, the blurs across the edges along x and along y, and the spread e by which
white reaches into black on all edges (ink, a wrong response, clipped white). Each block k of the
tag also has its own dark level a_k and contrast b_k, so that shadows and light gradients do not
move edges. These levels are eliminated (variable projection, Golub and Pereyra 1973); Gauss-Newton
steps are composed with G (Baker and Matthews 2004).

If the edges are bowed, as on bent paper, a bend d is fitted as well: twelve polynomials that vanish
at the corners and, with the homography, make up all cubic ones. The quadratic and the cubic
coefficients have a prior variance each (empirical Bayes). Pixels of clipped white are left out.

The covariance of the corners is the inverse of the normal matrix, scaled by a variance that
includes correlation of the residuals within each block (`block_squares_and_dof`).

Corners come from the edges because blur moves the corner of a print inwards, but not the lines that
meet there.
"""

from math import hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled, subroutine
from vergence.models.fixation import forward_substitute
from vergence.models.lens import camera_at
from vergence.models.parts import FloatArray
from vergence.vision.optics import (
    UndistortedView,
    distorted_pixel,
    grey_at,
    interpolate_ray,
    set_view_along,
    transform_point,
    undistorted_point,
)
from vergence.vision.prints import CellReading, compare_cells
from vergence.vision.tags.samples import (
    ALL,
    BEND,
    BEND_START,
    MAX_UNKNOWNS,
    POINTS,
    WHITE_SPREAD_INDEX,
    WIDE,
    FitStage,
    FitState,
    TagSearch,
    begin_stage,
    bend_by_coefficient,
    bend_displacement,
    side_lengths,
)
from vergence.vision.tags.steps import (
    PrintResiduals,
    block_squares_and_dof,
    compare_print,
    estimate_bend_prior_sigmas,
    gauss_newton_step,
    rms_bend_coefficients,
)


class TagFit(NamedTuple):
    """Quality of a fit."""

    contrast: float
    """Mean contrast of all blocks, grey levels of light; 0 if nothing was fitted."""
    explained_fraction: float
    """Fraction of the variance near the edges that the print explains."""
    reading: CellReading
    max_corner_move_px: float
    """Largest distance, along u or v, of a corner from its expected position."""
    max_sigma_px: float
    """Largest standard deviation of a point."""
    relative_border_step: float
    """Mean step of the light across the square's sides, as a fraction of the contrast: 1 for a
    sharp print, 0 if the border is wider than the square."""


NO_FIT: Final = TagFit(0.0, 0.0, CellReading(0, 0, 0.0), 0.0, 0.0, 0.0)
"""Result of a fit that failed (numerical)."""
_BEND_STEPS: Final = 4
"""Steps of a fixed-point iteration that inverts a bend (numerical)."""
_SHARPENED_RESIDUAL: Final = 0.03
"""Residual, as a fraction of the contrast, at which the variance of a bent tag's centre is doubled:
sharpening and compression, which leave large residuals, look like small bends (measured: flat
sheets of tags in public photographs against drawn ones)."""
_MAX_CENTRE_BEND: Final = 0.09
"""Largest distance from the crossing of the diagonals to the middle of a bent tag, half edges;
beyond it the centre is the crossing, with this distance in its sigma. Tags bent by 7 mm in 150 have
up to 0.086 (measured: tests/vision/tags/test_bent.py)."""
_MAX_OUTSIDE_CELLS: Final = 0.4
"""Largest distance of a corner beyond the image, cells: the border's middle is still in it, and the
edges' lines give the corner (chosen: tags at the side against cut ones)."""
_INSIDE_OFFSET_CELLS: Final = 0.5
"""Distance inside a side at which light is sampled, cells (chosen: the middle of the border)."""
_OUTSIDE_OFFSET_CELLS: Final = 0.3
"""Distance outside a side at which light is sampled, cells: a quiet zone that is narrower than a
cell is still white there (chosen: such zones against blur)."""


@subroutine
def _report_fit(
    search: TagSearch, state: FitState, stage: FitStage, residuals: PrintResiduals,
    unknown_count: int, pixel_variance: float, extra_corner_variance: float,
    start_corners: FloatArray, points: FloatArray, sigmas: FloatArray, covariance: FloatArray,
) -> TagFit:  # fmt: skip
    """Report a fit that has converged; no fit if a point is undetermined or too far outside."""
    height, width = search.image.shape
    moved = largest = 0.0
    reach = 0.5 + _MAX_OUTSIDE_CELLS * search.cell_px
    roots, slopes = np.empty((5, 2, MAX_UNKNOWNS)), np.empty((5, 2, 2))
    for k in range(5):
        # the point of the plane that the bend moves to this point of the print
        x, y = POINTS[k, 0], POINTS[k, 1]
        for _ in range(_BEND_STEPS):
            dx, dy = bend_displacement(state.white_spread_and_bend, x, y)
            x, y = POINTS[k, 0] - dx, POINTS[k, 1] - dy
        variance, more = pixel_variance, extra_corner_variance
        if k == 4:
            more *= 0.25  # the centre lies between four corners
            if unknown_count == MAX_UNKNOWNS:
                variance *= (
                    1.0 + residuals.pixel_variance / (_SHARPENED_RESIDUAL * residuals.contrast) ** 2
                )
            if hypot(x, y) > _MAX_CENTRE_BEND:
                more += (x * x + y * y) * (0.5 * search.shortest_edge_px) ** 2
                x = y = 0.0
        u, v, sigma_u, sigma_v = _locate(
            search, state, stage, unknown_count, x, y, variance, more, roots[k], slopes[k]
        )
        points[k, 0], points[k, 1], sigmas[k, 0], sigmas[k, 1] = u, v, sigma_u, sigma_v
        if not (-reach < u < width - 1.0 + reach and -reach < v < height - 1.0 + reach):
            return NO_FIT
        if not sigma_u + sigma_v < inf:
            return NO_FIT
        largest = max(largest, max(sigma_u, sigma_v))
        if k < 4:
            moved = max(moved, max(abs(u - start_corners[k, 0]), abs(v - start_corners[k, 1])))
    # the edges that corners share correlate them
    for j in range(8):
        for i in range(8):
            slope, other = slopes[j // 2, j % 2], slopes[i // 2, i % 2]
            across = 0.0
            for n in range(unknown_count):
                across += roots[j // 2, j % 2, n] * roots[i // 2, i % 2, n]
            covariance[j, i] = pixel_variance * across
            if j // 2 == i // 2:
                more = slope[0] * other[0] + slope[1] * other[1]
                covariance[j, i] += extra_corner_variance * more
    reading = _read(search, state)
    border_step = _step_across_sides(search, state) / residuals.contrast
    share = residuals.explained_fraction
    return TagFit(residuals.contrast, share, reading, moved, largest, border_step)


@subroutine
def _locate(
    search: TagSearch, state: FitState, stage: FitStage, unknown_count: int, x: float, y: float,
    variance: float, more: float, J: FloatArray, slopes: FloatArray,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Pixel of a point of the tag's plane, and its sigmas for pixels of a variance, and some more.

    With J the derivatives of the point in the undistorted plane by the unknowns and N = L L^T, its
    covariance J N^-1 J^T is the product of L^-1 J^T with itself. `slopes`, the derivatives of the
    pixel by that point, and their product with that factor, in `J`, are results too.
    """
    G, camera, view = state.G, search.camera, search.undistorted_view
    u, v = transform_point(state.H, x, y)
    g, h = G[2, 0], G[2, 1]
    w = g * u + h * v + G[2, 2]
    # derivatives of the plane's coordinates with respect to pixels
    a, b = (G[0, 0] - x * g) / w, (G[0, 1] - x * h) / w
    c, d = (G[1, 0] - y * g) / w, (G[1, 1] - y * h) / w
    det = a * d - b * c
    for j in range(unknown_count):
        by_x = x if j == 0 else y if j == 1 else 1.0 if j == 2 else 0.0
        by_y = x if j == 3 else y if j == 4 else 1.0 if j == 5 else 0.0
        if j == 6:
            by_x, by_y = -x * x, -x * y
        if j == 7:
            by_x, by_y = -x * y, -y * y
        if j >= BEND_START:
            by_x, by_y = bend_by_coefficient(j - BEND_START, x, y)
        J[0, j] = -(d * by_x - b * by_y) / det
        J[1, j] = -(a * by_y - c * by_x) / det
    forward_substitute(stage.normal_matrix, J[0], unknown_count)
    forward_substitute(stage.normal_matrix, J[1], unknown_count)
    a = b = c = 0.0
    for j in range(unknown_count):
        a += J[0, j] * J[0, j]
        b += J[0, j] * J[1, j]
        c += J[1, j] * J[1, j]
    a, b, c = variance * a + more, variance * b, variance * c + more
    p, q, r, s = 1.0, 0.0, 0.0, 1.0
    if view.has_lens:
        left_u, left_v = distorted_pixel(camera, view, u - 0.5, v)
        right_u, right_v = distorted_pixel(camera, view, u + 0.5, v)
        above_u, above_v = distorted_pixel(camera, view, u, v - 0.5)
        below_u, below_v = distorted_pixel(camera, view, u, v + 0.5)
        p, q, r, s = right_u - left_u, below_u - above_u, right_v - left_v, below_v - above_v
    slopes[0, 0], slopes[0, 1], slopes[1, 0], slopes[1, 1] = p, q, r, s
    for j in range(unknown_count):
        first, second = J[0, j], J[1, j]
        J[0, j], J[1, j] = p * first + q * second, r * first + s * second
    sigma_u = sqrt(p * p * a + 2.0 * p * q * b + q * q * c)
    sigma_v = sqrt(r * r * a + 2.0 * r * s * b + s * s * c)
    u, v = distorted_pixel(camera, view, u, v)
    return u, v, sigma_u, sigma_v


@subroutine
def _step_across_sides(search: TagSearch, state: FitState) -> float:
    """Mean step of the light across the square's sides, positive if its sign is as printed."""
    first, cell = (len(search.cells) - search.side_cells) // 2, 2.0 / search.side_cells
    before, beyond = 1.0 - _INSIDE_OFFSET_CELLS * cell, 1.0 + _OUTSIDE_OFFSET_CELLS * cell
    total = 0.0
    for k in range(search.side_cells):
        along = (k + 0.5) * cell - 1.0
        for side in (-1.0, 1.0):
            total += _light_at(search, state, side * beyond, along)
            total -= _light_at(search, state, side * before, along)
            total += _light_at(search, state, along, side * beyond)
            total -= _light_at(search, state, along, side * before)
    printed = search.cells[first - 1, first - 1] - search.cells[first, first]
    return float(printed * total / (4.0 * search.side_cells))


@subroutine
def _light_at(search: TagSearch, state: FitState, x: float, y: float) -> float:
    """Light at a point of the tag's plane, half edges; 0 outside of the image."""
    dx, dy = bend_displacement(state.white_spread_and_bend, x, y)
    u, v = transform_point(state.H, x - dx, y - dy)
    u, v = distorted_pixel(search.camera, search.undistorted_view, u, v)
    grey = grey_at(search.image, u, v)
    return float(search.light_by_grey[int(grey + 0.5)]) if grey >= 0.0 else 0.0


@subroutine
def _read(search: TagSearch, state: FitState) -> CellReading:
    """Read a tag's cells; without the quiet zone's levels, or by light, if fewer are wrong so."""
    cells, border = search.cells, float(search.side_cells)
    offset = 0.5 * (len(cells) - search.side_cells)
    ring, greys = 1 if len(cells) == search.side_cells + 2 else 0, np.empty(cells.shape)
    blur = max(state.blurs_px[0], state.blurs_px[1]) / search.cell_px
    reading = CellReading(0, 0, 0.0)
    levels = np.arange(256.0)
    for way in range(3):
        if way == 1 and ring == 0:
            continue
        if way == 2:  # blur averages light: black between white is lighter in grey than midway
            levels[:] = search.light_by_grey
        other = compare_cells(
            search.image, levels, state.H, state.white_spread_and_bend, search.camera,
            search.undistorted_view, cells, blur, offset, offset, border, border, ring, way != 1,
            greys,
        )  # fmt: skip
        if way == 0 or other.wrong_cells < reading.wrong_cells:
            reading = other
        if reading.wrong_cells == 0:
            break
    return reading


_LATER_END_STEP_PX: Final = 0.02
"""Corner step, px, that ends a later stage: a next one would be a tenth of it (numerical)."""
_LATER_END_BLUR_STEP: Final = 0.1
"""Step of a log blur that lets it end: residuals of a wrong blur are no noise (numerical)."""
_FIRST_END_STEP_PX: Final = 0.15
"""Corner step, px, below which the first stage ends (numerical)."""
_LATER_BLUR_WEIGHT: Final = 1e-5
"""Weight of the last blurs in later stages, by that in the first (numerical)."""
_REGION_MARGIN_PX: Final = 8.0
"""Margin of the region around the corners, px, besides a cell (chosen: prediction errors, time)."""
_CONVERGED_STEP_PX: Final = 0.05
"""Largest last corner step of a converged fit, px (numerical)."""
_SPREAD_SIGMA_PX: Final = 0.1
"""Prior standard deviation of the spread, px (measured: benchmarks.real_light)."""
_NO_SPREAD_SIGMA_PX: Final = 1e-6
"""The same in stages with outer edges alone: spread looks like a smaller tag there (numerical)."""
_BENT_VARIANCE_RATIO: Final = 2.5
"""Residual variance of all edges, by that of the outer ones before, above which the sheet is bent
(chosen: bent tags against flat ones with a poor start)."""
_LARGE_BEND_SIGMA: Final = 0.03
"""Prior standard deviation of such a bend's coefficients, half edges (chosen: wide enough)."""
_MAX_INNER_SCALING: Final = 0.06
"""Largest size of both coefficients that scale the tag's inside along x and along y, half edges;
no bend has more. A tag with a border of two cells, taken for one with a border of one, has 0.2
(chosen: between both)."""
_MAX_QUADRATIC_AND_CROSS: Final = 0.016
"""Largest root mean square of both a bend's quadratic and its last four coefficients, half edges:
sheets bent by 4 mm in 150 have 0.010, flat tags with a covered corner mostly 0.017 and more
(measured: drawn cylinders against tests/vision/tags/test_accuracy.py)."""
_LEAST_CROSS_PX: Final = 0.8
"""Least such last coefficients, px, that are no noise (chosen: small bent tags, covered ones)."""
_UNMODELLED_BEND_RATIO: Final = 0.35
"""Sigma of the corners that the polynomials leave, by the expected size of the next order's
coefficients (measured: drawn cylinders and waves)."""
_PRIOR_SQUARES: Final = 4.0
"""Squared residuals of single pixels that join those of the few blocks in the variance (chosen:
steadiness against correlated residuals)."""
_DIVERGED_STEP_PX: Final = 3.0
"""Corner step, px, besides half a cell, that ends a fit (chosen: poor starts, divergence)."""
LEAST_EDGE_PX: Final = 8.0
"""Shortest edge of a tag that is fitted, px (chosen: smaller tags against clutter)."""
_LEAST_BLOCK_SIDE_PX: Final = 8.0
"""Least side of a block, which has its own levels, px (chosen: shadows against noise)."""
_MOST_BLOCKS: Final = 8
"""Most blocks along an edge (chosen: as above)."""
_PIXELS_PER_BLOCK: Final = 24
"""Pixels per block, from which the number of blocks follows (chosen: as above)."""
_MOST_BLUR_PX: Final = 6.0
"""Largest blur of a fit, px (chosen: blurred tags against fits that diverge)."""
_MOST_BLUR_CELLS: Final = 0.7
"""Largest blur of a fit, cells (chosen: as above)."""


class FitEffort(NamedTuple):
    """Stages of a fit, and most of its steps and pixels."""

    first_stage: int
    """`WIDE`, `NARROW` or `ALL`; the later ones follow."""
    wide_steps: int
    """Most steps in the first stage, with a wide band along the outer edges."""
    steps: int
    """Most steps in each other stage."""
    wide_pixels: int
    """Most pixels in the first stage."""
    pixels: int
    """Most pixels in each other stage."""


@compiled
def fit_tag(
    image: NDArray[np.uint8], light_by_grey: FloatArray, rays: NDArray[np.float32],
    packed_camera: FloatArray, cells: FloatArray, side_cells: int, quiet_zone_cells: float,
    first_stage: int, max_wide_steps: int, max_steps: int, max_wide_pixels: int, max_pixels: int,
    start_corners: FloatArray, points: FloatArray, sigmas: FloatArray, covariance: FloatArray,
) -> TagFit:  # fmt: skip
    """Fit a tag's edges, and read its cells; `NO_FIT` if its square is too small or the fit fails.

    The first arguments are as in `TagSearch` and `pack_camera`, the stages as in `FitEffort`. From
    (4, 2) approximate corners, px, clockwise from the upper left, follow (5, 2) `points`, the
    corners and the centre, px, their `sigmas`, and the (8, 8) `covariance` of the corners, px^2.
    """
    shortest, longest, _ = side_lengths(start_corners)
    if not (shortest >= LEAST_EDGE_PX and longest < inf):
        return NO_FIT
    state = FitState(
        np.empty((4, 2)), np.empty((3, 3)), np.empty((3, 3)), np.empty(2),
        np.zeros(MAX_UNKNOWNS - WHITE_SPREAD_INDEX),
    )  # fmt: skip
    search = _look(
        image, light_by_grey, rays, packed_camera, cells, side_cells, quiet_zone_cells, max_pixels,
        start_corners, state.corners,
    )  # fmt: skip
    residuals = PrintResiduals(0.0, 0.0, 0.0)
    corner_step_px = variance = 0.0
    bend_sigmas, unknown_count = (0.0, 0.0), BEND_START
    for which in range(first_stage, BEND + 1):
        fine = which != WIDE
        if which == BEND:
            if max(bend_sigmas) == 0.0:
                break
            unknown_count = MAX_UNKNOWNS
        else:
            blurs_known = which == ALL and first_stage != ALL
            most = max_pixels if fine else max_wide_pixels
            stage = begin_stage(which, blurs_known, search, state, most)
            if len(stage.samples) < 4 * MAX_UNKNOWNS:
                return NO_FIT
        # the first step is taken in full
        stage.step_fraction_and_slope[0], stage.step_fraction_and_slope[1] = 1.0, 0.0
        stage.previous_step[:] = 0.0
        for _ in range(max_steps if fine else max_wide_steps):
            before = residuals.pixel_variance
            residuals = compare_print(search, state, stage)
            if residuals.contrast <= 0.0:
                return NO_FIT
            worse = (
                which == ALL
                and not stage.dropped_clipped
                and residuals.pixel_variance > _BENT_VARIANCE_RATIO * before > 0.0
            )
            if worse and unknown_count == BEND_START:
                # inner edges do not lie where the outer ones predict: the sheet is bent
                bend_sigmas, unknown_count = (_LARGE_BEND_SIGMA, _LARGE_BEND_SIGMA), MAX_UNKNOWNS
            # a weak prior holds blurs near their last values
            hold = _LATER_BLUR_WEIGHT if fine else 1.0
            spread_sigma_px = _SPREAD_SIGMA_PX if which >= ALL else _NO_SPREAD_SIGMA_PX
            prior_weights = (
                hold * residuals.contrast * residuals.contrast * len(stage.samples),
                residuals.pixel_variance / spread_sigma_px**2,
                residuals.pixel_variance / max(bend_sigmas[0], 1e-9) ** 2,
                residuals.pixel_variance / max(bend_sigmas[1], 1e-9) ** 2,
            )
            corner_step_px, blur_step = gauss_newton_step(
                state, stage, unknown_count, prior_weights, search.max_blur_px
            )
            if not corner_step_px < _DIVERGED_STEP_PX + 0.5 * search.cell_px:
                return NO_FIT
            settled = not fine or blur_step < _LATER_END_BLUR_STEP
            if settled and corner_step_px < (_LATER_END_STEP_PX if fine else _FIRST_END_STEP_PX):
                break
        if which >= ALL:
            squares, independent = block_squares_and_dof(stage, unknown_count)
            variance = (squares + _PRIOR_SQUARES * residuals.pixel_variance) / (
                independent + _PRIOR_SQUARES
            )
        if which == ALL and unknown_count == MAX_UNKNOWNS:
            bend_sigmas = rms_bend_coefficients(state.white_spread_and_bend)
        elif which == ALL and corner_step_px < _CONVERGED_STEP_PX:
            bend_sigmas = estimate_bend_prior_sigmas(stage, state.white_spread_and_bend, variance)
    shrunk = min(abs(state.white_spread_and_bend[5]), abs(state.white_spread_and_bend[8]))
    quadratic, cubic = rms_bend_coefficients(state.white_spread_and_bend)
    half_edge_px = 0.5 * search.shortest_edge_px
    cross = sqrt(np.square(state.white_spread_and_bend[9:]).mean())
    covered = shrunk > _MAX_INNER_SCALING or (
        min(quadratic, cross) > _MAX_QUADRATIC_AND_CROSS and cross * half_edge_px > _LEAST_CROSS_PX
    )
    if covered or not corner_step_px < _CONVERGED_STEP_PX:
        return NO_FIT
    # the next order, if each is smaller than the last by one ratio
    quartic = cubic * cubic / max(hypot(quadratic, cubic), 1e-9)
    unmodelled_variance = (_UNMODELLED_BEND_RATIO * quartic * half_edge_px) ** 2
    return _report_fit(
        search, state, stage, residuals, unknown_count, variance, unmodelled_variance,
        start_corners, points, sigmas, covariance,
    )  # fmt: skip


@subroutine
def _look(
    image: NDArray[np.uint8], light_by_grey: FloatArray, rays: NDArray[np.float32],
    packed_camera: FloatArray, cells: FloatArray, side_cells: int, quiet_zone_cells: float,
    max_pixels: int, start: FloatArray, corners: FloatArray,
) -> TagSearch:  # fmt: skip
    """Search around start corners, undistorted into `corners`, with at most so many pixels."""
    height, width = image.shape
    view = UndistortedView(len(rays) > 0, np.empty((3, 3)), np.empty((3, 3)))
    camera = camera_at(packed_camera, 0)
    if view.has_lens:
        u = v = 0.0
        for k in range(4):
            u, v = u + start[k, 0], v + start[k, 1]
        x, y = interpolate_ray(rays, u / 4.0, v / 4.0)
        set_view_along(camera, x, y, view)
    left, top = right, bottom = start[0, 0], start[0, 1]
    for k in range(4):
        u, v = start[k]
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        corners[k, 0], corners[k, 1] = undistorted_point(rays, view, u, v)
    margin = _REGION_MARGIN_PX + max(right - left, bottom - top) / side_cells
    shortest, longest, _ = side_lengths(corners)
    cell_px = shortest / side_cells
    # at most one block per cell of the border: a block of one colour has no contrast
    blocks_per_edge = min(
        max(int(0.5 * (shortest + longest) / _LEAST_BLOCK_SIDE_PX), 1), _MOST_BLOCKS, side_cells,
        1 + max_pixels // (4 * _PIXELS_PER_BLOCK),
    )  # fmt: skip
    return TagSearch(
        image, light_by_grey, rays, camera, view, cells, side_cells, quiet_zone_cells,
        max(int(left - margin), 0), min(int(right + margin), width - 1),
        max(int(top - margin), 0), min(int(bottom + margin), height - 1),
        shortest, cell_px, blocks_per_edge,
        min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _MOST_BLUR_PX),
    )  # fmt: skip
