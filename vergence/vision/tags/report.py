"""Report a tag's fit: points and their sigmas in the distorted image, and the cells read."""

from math import hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import subroutine
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray
from vergence.vision.plane import UndistortedView, distorted_pixel, grey_at, transform_point
from vergence.vision.tags.bend import bend_by_coefficient, bend_displacement
from vergence.vision.tags.cholesky import cholesky_solve
from vergence.vision.tags.reading import CellReading, compare_cells
from vergence.vision.tags.stages import TagScale
from vergence.vision.tags.steps import PrintResiduals
from vergence.vision.tags.workspace import (
    BEND_START,
    MAX_UNKNOWNS,
    Blocks,
    FitBuffers,
    FitState,
    SearchRegion,
    TagPrint,
    point_in_half_edges,
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
beyond it the print is not as assumed, and the centre is the crossing, with this distance in its
sigma. Tags bent by 7 mm in 150 have up to 0.086 (measured: tests/vision/tags/test_bent.py)."""
_MAX_OUTSIDE_CELLS: Final = 0.4
"""Largest distance of a corner beyond the image's side, cells: the middle of the border's cells is
still in the image, and the edges' lines give the corner (chosen: tags at the side against cut
ones)."""
_INSIDE_OFFSET_CELLS: Final = 0.5
"""Distance inside a side at which light is sampled, cells (chosen: the middle of the border)."""
_OUTSIDE_OFFSET_CELLS: Final = 0.3
"""Distance outside a side at which light is sampled, cells: a quiet zone that is narrower than a
cell is still white there (chosen: such zones against blur)."""


@subroutine
def report_fit(
    region: SearchRegion,
    camera: CameraRow,
    tag: TagPrint,
    scale: TagScale,
    state: FitState,
    buffers: FitBuffers,
    residuals: PrintResiduals,
    block_count: int,
    unknown_count: int,
    pixel_variance: float,
    extra_corner_variance: float,
    start_corners: FloatArray,
    points: FloatArray,
    sigmas: FloatArray,
) -> TagFit:
    """Report a fit that has converged.

    Args:
        region: the image.
        camera: the eye's camera.
        tag: the print.
        scale: size of the tag in the image.
        state: the tag's pose, blurs and bend.
        buffers: working arrays after the last step.
        residuals: residuals before that step.
        block_count: number of blocks.
        unknown_count: number of unknowns that were sought.
        pixel_variance: variance of a pixel.
        extra_corner_variance: variance of a corner that no unknown models, px^2.
        start_corners: (4, 2) expected corners, px.
        points: (5, 2) result: the corners and the centre, px.
        sigmas: (5, 2) result: their standard deviations, px.

    Returns:
        Quality of the fit; `NO_FIT` if a point is too far outside of the image or undetermined.
    """
    height, width = region.image.shape
    moved = largest = 0.0
    reach = 0.5 + _MAX_OUTSIDE_CELLS * scale.cell_px
    for k in range(5):
        x, y = _before_bend(state.white_spread_and_bend, *point_in_half_edges(k))
        variance, more = pixel_variance, extra_corner_variance
        if k == 4:
            more *= 0.25  # the centre lies between four corners
            if unknown_count == MAX_UNKNOWNS:
                variance *= (
                    1.0 + residuals.pixel_variance / (_SHARPENED_RESIDUAL * residuals.contrast) ** 2
                )
            if hypot(x, y) > _MAX_CENTRE_BEND:
                more += (x * x + y * y) * (0.5 * scale.shortest_edge_px) ** 2
                x = y = 0.0
        u, v = transform_point(state.H, x, y)
        a, b, c = _covariance_of(buffers.normal_matrix, unknown_count, state.G, u, v, x, y)
        a, b, c = variance * a + more, variance * b, variance * c + more
        u, v, sigma_u, sigma_v = _to_image(camera, region.undistorted_view, u, v, a, b, c)
        points[k, 0], points[k, 1], sigmas[k, 0], sigmas[k, 1] = u, v, sigma_u, sigma_v
        if not (-reach < u < width - 1.0 + reach and -reach < v < height - 1.0 + reach):
            return NO_FIT
        if not sigma_u + sigma_v < inf:
            return NO_FIT
        largest = max(largest, max(sigma_u, sigma_v))
        if k < 4:
            moved = max(moved, max(abs(u - start_corners[k, 0]), abs(v - start_corners[k, 1])))
    explained = _explained(buffers.blocks, block_count)
    reading = _read(region, camera, tag, scale, state)
    share = explained / (explained + residuals.unexplained_squares)
    border_step = _step_across_sides(region, camera, tag, state) / residuals.contrast
    return TagFit(residuals.contrast, share, reading, moved, largest, border_step)


@subroutine
def _before_bend(white_spread_and_bend: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Point of the plane that the bend moves to a point of the print, half edges."""
    flat_x, flat_y = x, y
    for _ in range(_BEND_STEPS):
        dx, dy = bend_displacement(white_spread_and_bend, flat_x, flat_y)
        flat_x, flat_y = x - dx, y - dy
    return flat_x, flat_y


@subroutine
def _step_across_sides(
    region: SearchRegion, camera: CameraRow, tag: TagPrint, state: FitState
) -> float:
    """Mean step of the light across the square's sides, positive if its sign is as printed."""
    first, cell = (len(tag.cells) - tag.side_cells) // 2, 2.0 / tag.side_cells
    before, beyond = 1.0 - _INSIDE_OFFSET_CELLS * cell, 1.0 + _OUTSIDE_OFFSET_CELLS * cell
    total = 0.0
    for k in range(tag.side_cells):
        along = (k + 0.5) * cell - 1.0
        for side in (-1.0, 1.0):
            total += _light_at(region, camera, state, side * beyond, along)
            total -= _light_at(region, camera, state, side * before, along)
            total += _light_at(region, camera, state, along, side * beyond)
            total -= _light_at(region, camera, state, along, side * before)
    printed = tag.cells[first - 1, first - 1] - tag.cells[first, first]
    return float(printed * total / (4.0 * tag.side_cells))


@subroutine
def _light_at(
    region: SearchRegion, camera: CameraRow, state: FitState, x: float, y: float
) -> float:
    """Light at a point of the tag's plane, half edges; 0 outside of the image."""
    dx, dy = bend_displacement(state.white_spread_and_bend, x, y)
    u, v = transform_point(state.H, x - dx, y - dy)
    u, v = distorted_pixel(camera, region.undistorted_view, u, v)
    grey = grey_at(region.image, u, v)
    return float(region.light_by_grey[int(grey + 0.5)]) if grey >= 0.0 else 0.0


@subroutine
def _explained(blocks: Blocks, block_count: int) -> float:
    """Weighted sum of squares over all pixels that the print explains."""
    sums, levels, weights, total = blocks.moments, blocks.levels, blocks.weights, 0.0
    for k in range(block_count):
        contrast = levels[k, 1]
        if contrast > 0.0:
            n, t, tt = sums[k, 0], sums[k, 1], sums[k, 2]
            total += weights[k] * contrast * contrast * (tt - t * t / n)
    return total


@subroutine
def _read(
    region: SearchRegion, camera: CameraRow, tag: TagPrint, scale: TagScale, state: FitState
) -> CellReading:
    """Read a tag's cells; without the quiet zone's levels, or by light, if fewer are wrong so.

    Blur averages light: between white cells, black is lighter in grey levels than midway.
    """
    cells, border = tag.cells, float(tag.side_cells)
    offset = 0.5 * (len(cells) - tag.side_cells)
    ring, greys = 1 if len(cells) == tag.side_cells + 2 else 0, np.empty(cells.shape)
    blur = max(state.blurs_px[0], state.blurs_px[1]) / scale.cell_px
    reading = CellReading(0, 0, 0.0)
    levels = np.arange(256.0)
    for way in range(3):
        if way == 1 and ring == 0:
            continue
        if way == 2:
            levels[:] = region.light_by_grey
        other = compare_cells(
            region.image, levels, state.H, state.white_spread_and_bend, camera,
            region.undistorted_view, cells, blur,
            offset,
            offset, border, border, ring, way != 1, greys,
        )  # fmt: skip
        if way == 0 or other.wrong_cells < reading.wrong_cells:
            reading = other
        if reading.wrong_cells == 0:
            break
    return reading


@subroutine
def _to_image(
    camera: CameraRow, view: UndistortedView, u: float, v: float, a: float, b: float, c: float
) -> tuple[float, float, float, float]:
    """Map a point and its standard deviations from the undistorted plane to the image.

    Args:
        camera: the eye's camera.
        view: the undistorted plane.
        u: u of the point, undistorted.
        v: v of the point, undistorted.
        a: variance of u, undistorted.
        b: covariance.
        c: variance of v.

    Returns:
        The pixel, and the standard deviations.
    """
    if view.has_lens:
        left_u, left_v = distorted_pixel(camera, view, u - 0.5, v)
        right_u, right_v = distorted_pixel(camera, view, u + 0.5, v)
        above_u, above_v = distorted_pixel(camera, view, u, v - 0.5)
        below_u, below_v = distorted_pixel(camera, view, u, v + 0.5)
        p, q, r, s = right_u - left_u, below_u - above_u, right_v - left_v, below_v - above_v
        a, c = (
            p * p * a + 2.0 * p * q * b + q * q * c,
            r * r * a + 2.0 * r * s * b + s * s * c,
        )
    u, v = distorted_pixel(camera, view, u, v)
    return u, v, sqrt(a), sqrt(c)


@subroutine
def _covariance_of(
    factor: FloatArray, used: int, G: FloatArray, u: float, v: float, x: float, y: float
) -> tuple[float, float, float]:
    """Covariance J N^-1 J^T of the image of a point of the plane, for pixels of variance 1.

    Args:
        factor: lower Cholesky factor of N.
        used: number of unknowns that were sought.
        G: (3, 3) homography to the tag's plane.
        u: u of the point, undistorted.
        v: v of the point, undistorted.
        x: x of the point in the tag's plane.
        y: y of the point in the tag's plane.

    Returns:
        The variance of u, the covariance, the variance of v.
    """
    J, column = np.empty((2, MAX_UNKNOWNS)), np.empty(MAX_UNKNOWNS)
    g, h = G[2, 0], G[2, 1]
    w = g * u + h * v + G[2, 2]
    # derivatives of the plane's coordinates with respect to pixels
    a, b = (G[0, 0] - x * g) / w, (G[0, 1] - x * h) / w
    c, d = (G[1, 0] - y * g) / w, (G[1, 1] - y * h) / w
    det = a * d - b * c
    for j in range(MAX_UNKNOWNS):
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
    first = across = second = 0.0
    for r in range(2):
        for j in range(MAX_UNKNOWNS):
            column[j] = J[r, j]
        cholesky_solve(factor, column, used)
        for j in range(used):
            if r == 0:
                first += J[0, j] * column[j]
                across += J[1, j] * column[j]
            else:
                second += J[1, j] * column[j]
    return first, across, second
