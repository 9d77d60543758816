"""Gauss-Newton steps of a tag's fit."""

from math import exp, hypot, inf
from typing import Final, NamedTuple

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import square_to_image_homography, transform_point
from vergence.vision.tags.cholesky import cholesky_factorise, cholesky_solve
from vergence.vision.tags.levels import estimate_block_levels, reweight_and_sum_squares
from vergence.vision.tags.normal import add_priors, build_normal_equations
from vergence.vision.tags.slopes import evaluate_print
from vergence.vision.tags.workspace import (
    MAX_UNKNOWNS,
    WHITE_SPREAD_INDEX,
    FitBuffers,
    FitState,
    TagPrint,
    point_in_half_edges,
)

_LEAST_BLUR_PX: Final = 0.3
"""Smallest blur of a fit, px (chosen: sharp images against edges that few pixels show)."""
_LONGEST_BLUR_STEP: Final = 0.7
"""Largest step of a blur's logarithm (numerical)."""
_LEAST_STEP_FRACTION: Final = 0.2
"""Smallest fraction of a step that is taken after an overshoot (numerical)."""
_FRACTION_GROWTH: Final = 1.5
"""Factor by which this fraction grows again after a step without overshoot (numerical)."""


class PrintResiduals(NamedTuple):
    """Residuals of all pixels' light after the print."""

    contrast: float
    """Mean contrast of all blocks; 0 if none has any."""
    unexplained_squares: float
    """Weighted sum of squared residuals."""
    pixel_variance: float
    """Variance of a pixel."""


@subroutine
def compare_print(
    state: FitState, tag: TagPrint, buffers: FitBuffers, pixel_count: int, blocks_per_edge: int
) -> PrintResiduals:
    """Compare the print with the pixels, by blocks.

    Args:
        state: the tag's current pose, blurs and bend.
        tag: the print.
        buffers: its `samples` are read; its `pixel_rows` and its blocks, except for their normal
            equations, are the result.
        pixel_count: number of pixels.
        blocks_per_edge: blocks along an edge.
    """
    blocks, block_count = buffers.blocks, blocks_per_edge * blocks_per_edge
    evaluate_print(state, tag, buffers, pixel_count, blocks_per_edge)
    contrast = estimate_block_levels(blocks, block_count)
    if contrast <= 0.0:
        return PrintResiduals(0.0, 0.0, 0.0)
    unexplained = reweight_and_sum_squares(buffers.pixel_rows, pixel_count, blocks, block_count)
    free = -float(MAX_UNKNOWNS)
    for k in range(block_count):
        if blocks.levels[k, 1] > 0.0:
            free += blocks.weights[k] * blocks.moments[k, 0] - 2.0
    return PrintResiduals(contrast, unexplained, unexplained / max(free, 1.0))


@subroutine
def reset_line_search(buffers: FitBuffers) -> None:
    """Make `gauss_newton_step` take the next step in full, regardless of earlier steps."""
    buffers.step_fraction_and_slope[0], buffers.step_fraction_and_slope[1], last = (
        1.0,
        0.0,
        buffers.previous_step,
    )
    for k in range(MAX_UNKNOWNS):
        last[k] = 0.0


@subroutine
def gauss_newton_step(
    state: FitState,
    buffers: FitBuffers,
    pixel_count: int,
    block_count: int,
    unknown_count: int,
    blur_weight: float,
    white_spread_weight: float,
    quadratic_weight: float,
    cubic_weight: float,
    max_blur_px: float,
) -> tuple[float, float]:
    """Take a Gauss-Newton step, shortened if the previous one overshot.

    A step overshot if the slope along it has changed sign; the secant then gives the right
    fraction. Without this, steps oscillate if edges are sharpened or seen at a low angle.

    Args:
        state: the tag's pose, blurs and bend; also the result.
        buffers: working arrays after `compare_print` and the previous step; the step and the
            Cholesky factor of its normal matrix are the result.
        pixel_count: number of pixels.
        block_count: number of blocks.
        unknown_count: number of unknowns that are sought, the first ones.
        blur_weight: weight that holds the blurs at their last values, see `add_priors`.
        white_spread_weight: weight that holds the spread at 0.
        quadratic_weight: weight that holds the bend's quadratic coefficients at 0.
        cubic_weight: weight that holds its cubic coefficients at 0.
        max_blur_px: largest blur, px.

    Returns:
        Largest move of a corner, px, infinite if the normal matrix is not positive definite; and
        the largest change of a blur's logarithm.
    """
    matrix, step = buffers.normal_matrix, buffers.step
    build_normal_equations(
        buffers.pixel_rows, pixel_count, buffers.blocks, block_count, unknown_count, matrix, step
    )
    add_priors(
        matrix,
        step,
        state.white_spread_and_bend,
        blur_weight,
        white_spread_weight,
        quadratic_weight,
        cubic_weight,
        unknown_count,
    )
    slope, fraction, start_slope, last = (
        0.0,
        buffers.step_fraction_and_slope[0],
        buffers.step_fraction_and_slope[1],
        buffers.previous_step,
    )
    for k in range(unknown_count):
        slope += step[k] * last[k]
        last[k] = step[k]
    if slope < 0.0:
        fraction = max(fraction * start_slope / (start_slope - slope), _LEAST_STEP_FRACTION)
    else:
        fraction = min(_FRACTION_GROWTH * fraction, 1.0)
    if not cholesky_factorise(matrix, unknown_count):
        return inf, inf
    cholesky_solve(matrix, step, unknown_count)
    slope = 0.0
    for k in range(unknown_count):
        step[k] *= fraction
        slope += step[k] * last[k]
        last[k] = step[k]
    buffers.step_fraction_and_slope[0], buffers.step_fraction_and_slope[1] = fraction, slope
    _move_plane(state.G, step)
    sharper = 0.0
    for axis in range(2):
        change = min(max(step[8 + axis], -_LONGEST_BLUR_STEP), _LONGEST_BLUR_STEP)
        sharper = max(sharper, abs(change))
        blur_px = state.blurs_px[axis] * exp(change)
        state.blurs_px[axis] = min(max(blur_px, _LEAST_BLUR_PX), max_blur_px)
    for k in range(unknown_count - WHITE_SPREAD_INDEX):
        state.white_spread_and_bend[k] += step[WHITE_SPREAD_INDEX + k]
    return _move_corners(state), sharper


@subroutine
def _move_plane(G: FloatArray, step: FloatArray) -> None:
    """Update the homography: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


@subroutine
def _move_corners(state: FitState) -> float:
    """Update H and the corners from G; return the largest move of a corner, px."""
    corners, H = state.corners, state.H
    square_to_image_homography(state.G, H)
    far = 0.0
    for k in range(4):
        u, v = transform_point(H, *point_in_half_edges(k))
        far = max(far, hypot(u - corners[k, 0], v - corners[k, 1]))
        corners[k, 0], corners[k, 1] = u, v
    return far
