r"""A tag's corners, by fitting all edges of its cells to the light of the pixels at once.

A homography with eight unknowns maps the image to the tag's plane; each edge is a step blurred by a
Gaussian. Only pixels near the edges take part (`stages`). T is the blurred print (`sample_print`)
at the point of the tag's plane that a pixel shows, p the pixel, I its light by the camera's
response. The fit solves

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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled, subroutine
from vergence.models.lens import CameraRow, camera_at
from vergence.models.parts import FloatArray
from vergence.vision.plane import (
    UndistortedView,
    interpolate_ray,
    set_view_along,
    undistorted_point,
)
from vergence.vision.tags.bend import estimate_bend_prior_sigmas, rms_bend_coefficients
from vergence.vision.tags.normal import block_squares_and_dof
from vergence.vision.tags.report import NO_FIT, TagFit, report_fit
from vergence.vision.tags.stages import ALL, BEND, NARROW, WIDE, FitStage, begin_stage, tag_scale
from vergence.vision.tags.steps import (
    PrintResiduals,
    compare_print,
    gauss_newton_step,
    reset_line_search,
)
from vergence.vision.tags.workspace import (
    BEND_START,
    MAX_UNKNOWNS,
    WHITE_SPREAD_INDEX,
    FitState,
    SearchRegion,
    TagPrint,
    allocate_buffers,
    side_lengths,
)

_LATER_END_STEP_PX: Final = 0.02
"""Corner step, px, below which a later stage ends: the next full step would be a tenth of it
(numerical)."""
_LATER_END_BLUR_STEP: Final = 0.1
"""Step of a blur's logarithm below which a later stage may end: residuals of a wrong blur would
count as noise (numerical)."""
_FIRST_END_STEP_PX: Final = 0.15
"""Corner step, px, below which the first stage ends (numerical)."""
_LATER_BLUR_WEIGHT: Final = 1e-5
"""Weight that holds blurs near their last values in later stages, relative to the first stage
(numerical)."""
_REGION_MARGIN_PX: Final = 8.0
"""Margin of the searched region around the corners, px, in addition to a cell (chosen: errors of
the prediction against time)."""
_CONVERGED_STEP_PX: Final = 0.05
"""Largest last corner step of a converged fit, px (numerical)."""
_SPREAD_SIGMA_PX: Final = 0.1
"""Prior standard deviation of the spread, px (measured: benchmarks.real_light)."""
_NO_SPREAD_SIGMA_PX: Final = 1e-6
"""Prior standard deviation of the spread, px, in stages with outer edges only: these cannot
distinguish spread from a smaller tag (numerical)."""
_BENT_VARIANCE_RATIO: Final = 2.5
"""Ratio of the residual variance of all edges to the one before, of the outer edges, above which
the sheet is taken to be bent (chosen: bent tags against flat ones with a poor start)."""
_LARGE_BEND_SIGMA: Final = 0.03
"""Prior standard deviation of such a bend's coefficients, half edges (chosen: wide enough for
bends of this size)."""
_MAX_INNER_SCALING: Final = 0.06
"""Largest size of both coefficients that scale the tag's inside along x and along y, half edges;
no bend has more. A tag with a border of two cells, taken for one with a border of one, has 0.2
(chosen: between both)."""
_MAX_QUADRATIC_AND_CROSS: Final = 0.016
"""Largest root mean square of both a bend's quadratic and its last four coefficients, half edges:
sheets bent by 4 mm in 150 have 0.010, flat tags with a covered corner mostly 0.017 and more
(measured: drawn cylinders against tests/vision/tags/test_accuracy.py)."""
_LEAST_CROSS_PX: Final = 0.8
"""Size of the last four coefficients, px, below which noise may be their cause (chosen: small bent
tags against covered ones)."""
_UNMODELLED_BEND_RATIO: Final = 0.35
"""Standard deviation of the corner error that the bend's polynomials do not model, as a ratio to
the expected size of the next order's coefficients (measured: drawn cylinders and waves)."""
_PRIOR_SQUARES: Final = 4.0
"""Number of squared residuals of single pixels that are added to those of the blocks, which are
few, in the estimate of the variance (chosen: steadiness against correlated residuals)."""
_DIVERGED_STEP_PX: Final = 3.0
"""Corner step, px, beyond which, plus half a cell, a fit is given up (chosen: poor starts against
fits that diverge)."""
_LEAST_EDGE_PX: Final = 8.0
"""Shortest edge of a tag that is fitted, px (chosen: as `acceptance.LEAST_EDGE_PX`)."""


@compiled
def fit_tag(
    image: NDArray[np.uint8],
    light_by_grey: FloatArray,
    rays: NDArray[np.float32],
    packed_camera: FloatArray,
    cells: FloatArray,
    side_cells: int,
    quiet_zone_cells: float,
    max_steps: tuple[int, int, int],
    max_pixels: tuple[int, int],
    start_corners: FloatArray,
    points: FloatArray,
    sigmas: FloatArray,
) -> TagFit:
    """Fit a tag's edges, and read its cells.

    Args:
        image: grey levels, shape (height, width).
        light_by_grey: (256,) light of each grey level, see `light_table`.
        rays: (height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole.
        packed_camera: the camera, see `pack_camera`.
        cells: (n, n) the print, 0 black to 1 white, nan unknown.
        side_cells: side of the square whose corners are sought, cells; centred in the print.
        quiet_zone_cells: assumed width of the quiet zone around the print's border, cells.
        max_steps: most steps in each of the three stages: with a wide band along the outer edges,
            with a narrow band, and with the edges of the cells as well.
        max_pixels: most pixels in the first stage, and in each of the others.
        start_corners: (4, 2) approximate corners, px, from the upper left clockwise.
        points: (5, 2) result: the corners and the centre, px.
        sigmas: (5, 2) result: their standard deviations, px.

    Returns:
        Quality of the fit; `NO_FIT`, with a contrast of 0, if the square is too small or too
        far outside of the image, or if the fit fails.
    """
    shortest, longest, _ = side_lengths(start_corners)
    if not (shortest >= _LEAST_EDGE_PX and longest < inf):
        return NO_FIT
    camera, tag = camera_at(packed_camera, 0), TagPrint(cells, side_cells, quiet_zone_cells)
    region = _look(image, light_by_grey, rays, camera, side_cells, start_corners)
    state = FitState(
        np.empty((4, 2)), np.empty((3, 3)), np.empty((3, 3)), np.empty(2),
        np.zeros(MAX_UNKNOWNS - WHITE_SPREAD_INDEX),
    )  # fmt: skip
    for k in range(4):
        u, v = undistorted_point(
            rays, region.undistorted_view, start_corners[k, 0], start_corners[k, 1]
        )
        state.corners[k, 0], state.corners[k, 1] = u, v
    scale = tag_scale(state.corners, side_cells, max_pixels[1])
    buffers = allocate_buffers(
        max(max_pixels[0], max_pixels[1]), scale.max_blocks_per_edge * scale.max_blocks_per_edge
    )
    stage, residuals = FitStage(0, 0, False), PrintResiduals(0.0, 0.0, 0.0)
    corner_step_px = variance = 0.0
    bend_sigmas = 0.0, 0.0
    used = BEND_START
    for which in range(4):
        if which == BEND:
            if max(bend_sigmas[0], bend_sigmas[1]) == 0.0:
                break
            used = MAX_UNKNOWNS
        elif max_steps[which] == 0:
            continue
        else:
            blurred = which == ALL and max_steps[NARROW] > 0
            few = max_pixels[0] if which == WIDE else max_pixels[1]
            stage = begin_stage(which, blurred, region, tag, scale, state, buffers, few)
            if stage.pixel_count < 4 * MAX_UNKNOWNS:
                return NO_FIT
        fine, block_count = which != WIDE, stage.blocks_per_edge * stage.blocks_per_edge
        reset_line_search(buffers)
        for _ in range(max_steps[min(which, ALL)]):
            before = residuals.pixel_variance
            residuals = compare_print(state, tag, buffers, stage.pixel_count, stage.blocks_per_edge)
            if residuals.contrast <= 0.0:
                return NO_FIT
            worse = (
                which == ALL
                and not stage.dropped_clipped
                and residuals.pixel_variance > _BENT_VARIANCE_RATIO * before > 0.0
            )
            if worse and used == BEND_START:
                # inner edges do not lie where the outer ones predict: the sheet is bent
                bend_sigmas, used = (_LARGE_BEND_SIGMA, _LARGE_BEND_SIGMA), MAX_UNKNOWNS
            # a weak prior holds blurs near their last values
            hold = _LATER_BLUR_WEIGHT if fine else 1.0
            blur_weight = hold * residuals.contrast * residuals.contrast * stage.pixel_count
            spread_sigma_px = _SPREAD_SIGMA_PX if which >= ALL else _NO_SPREAD_SIGMA_PX
            spread_weight = residuals.pixel_variance / spread_sigma_px**2
            quadratic_weight = residuals.pixel_variance / max(bend_sigmas[0], 1e-9) ** 2
            cubic_weight = residuals.pixel_variance / max(bend_sigmas[1], 1e-9) ** 2
            corner_step_px, blur_step = gauss_newton_step(
                state, buffers, stage.pixel_count, block_count, used, blur_weight, spread_weight,
                quadratic_weight, cubic_weight, scale.max_blur_px,
            )  # fmt: skip
            if not corner_step_px < _DIVERGED_STEP_PX + 0.5 * scale.cell_px:
                return NO_FIT
            settled = not fine or blur_step < _LATER_END_BLUR_STEP
            if settled and corner_step_px < (_LATER_END_STEP_PX if fine else _FIRST_END_STEP_PX):
                break
        if which >= ALL:
            squares, independent = block_squares_and_dof(
                buffers.normal_matrix, buffers.step, buffers.blocks, block_count, used
            )
            variance = (squares + _PRIOR_SQUARES * residuals.pixel_variance) / (
                independent + _PRIOR_SQUARES
            )
        if which == ALL and used == MAX_UNKNOWNS:
            bend_sigmas = rms_bend_coefficients(state.white_spread_and_bend)
        elif which == ALL and corner_step_px < _CONVERGED_STEP_PX:
            bend_sigmas = estimate_bend_prior_sigmas(
                buffers, stage.pixel_count, block_count, state.white_spread_and_bend, variance
            )
    shrunk = min(abs(state.white_spread_and_bend[5]), abs(state.white_spread_and_bend[8]))
    quadratic, cubic = rms_bend_coefficients(state.white_spread_and_bend)
    half_edge_px = 0.5 * scale.shortest_edge_px
    cross = sqrt(np.square(state.white_spread_and_bend[9:]).mean())
    covered = shrunk > _MAX_INNER_SCALING or (
        min(quadratic, cross) > _MAX_QUADRATIC_AND_CROSS and cross * half_edge_px > _LEAST_CROSS_PX
    )
    if covered or not corner_step_px < _CONVERGED_STEP_PX:
        return NO_FIT
    # the next order, if each is smaller than the last by one ratio
    quartic = cubic * cubic / max(hypot(quadratic, cubic), 1e-9)
    unmodelled_variance = (_UNMODELLED_BEND_RATIO * quartic * half_edge_px) ** 2
    return report_fit(
        region, camera, tag, scale, state, buffers, residuals,
        stage.blocks_per_edge * stage.blocks_per_edge, used, variance, unmodelled_variance,
        start_corners, points, sigmas,
    )  # fmt: skip


@subroutine
def _look(
    image: NDArray[np.uint8],
    light: FloatArray,
    rays: NDArray[np.float32],
    camera: CameraRow,
    border: int,
    start: FloatArray,
) -> SearchRegion:
    """Image region around the corners, and an undistorted plane across the rays to them."""
    view = UndistortedView(len(rays) > 0, np.empty((3, 3)), np.empty((3, 3)))
    if view.has_lens:
        u = v = 0.0
        for k in range(4):
            u, v = u + start[k, 0], v + start[k, 1]
        x, y = interpolate_ray(rays, u / 4.0, v / 4.0)
        set_view_along(camera, x, y, view)
    left, top = right, bottom = start[0, 0], start[0, 1]
    for k in range(4):
        left, right = min(left, start[k, 0]), max(right, start[k, 0])
        top, bottom = min(top, start[k, 1]), max(bottom, start[k, 1])
    margin = _REGION_MARGIN_PX + max(right - left, bottom - top) / border
    return SearchRegion(
        image, light, rays, view,
        int(left - margin), int(right + margin), int(top - margin), int(bottom + margin),
    )  # fmt: skip
