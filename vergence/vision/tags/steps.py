"""Gauss-Newton steps of a tag's fit: normal equations, levels, slopes and bend."""

from math import exp, hypot, inf, log, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.optics import square_to_image_homography, transform_point
from vergence.vision.tags.samples import (
    BEND_START,
    CUBIC_START,
    MAX_UNKNOWNS,
    WHITE_SPREAD_INDEX,
    Blocks,
    FitBuffers,
    FitState,
    TagPrint,
    point_in_half_edges,
    sample_print,
)


@subroutine
def cholesky_factorise(matrix: FloatArray, size: int) -> bool:
    """Replace a matrix by its lower Cholesky factor; False if it is not positive definite."""
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-12:
                    return False
                matrix[j, j] = sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@subroutine
def forward_substitute(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a lower triangular system, in place."""
    for i in range(size):
        for k in range(i):
            right_side[i] -= factor[i, k] * right_side[k]
        right_side[i] /= factor[i, i]


@subroutine
def cholesky_solve(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a system given the lower Cholesky factor of its matrix, in place."""
    forward_substitute(factor, right_side, size)
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right_side[i] -= factor[k, i] * right_side[k]
        right_side[i] /= factor[i, i]


@subroutine
def build_normal_equations(
    pixel_rows: FloatArray,
    pixel_count: int,
    blocks: Blocks,
    block_count: int,
    unknown_count: int,
    matrix: FloatArray,
    right_side: FloatArray,
) -> None:
    """Build the normal equations of a step with the levels eliminated, by block and in total.

    Args:
        pixel_rows: (pixels, `COLUMNS`) see `evaluate_print`.
        pixel_count: number of pixels.
        blocks: result: their normal matrices and scores.
        block_count: number of blocks.
        unknown_count: number of unknowns that are sought, the first ones.
        matrix: (unknowns, unknowns) result, the normal matrix of all blocks.
        right_side: (unknowns,) result, the right side.
    """
    levels, weights, sums, slopes = (
        blocks.levels,
        blocks.weights,
        blocks.moments,
        blocks.derivative_sums,
    )
    every_score, every_normal = blocks.scores, blocks.normal_matrices
    for k in range(block_count):
        for j in range(unknown_count):
            every_score[k, j] = 0.0
            for i in range(unknown_count):
                every_normal[k, j, i] = 0.0
    for n in range(pixel_count):
        k = int(pixel_rows[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixel_rows[n, 0] - levels[k, 0] - contrast * pixel_rows[n, 2]
        weight = weights[k] * contrast
        scores, normal = every_score[k], every_normal[k]
        for j in range(unknown_count):
            slope = weight * pixel_rows[n, 3 + j]
            scores[j] += slope * r
            slope *= contrast
            # full rows, not only a triangle: loops of equal length are vectorised
            for i in range(unknown_count):
                normal[j, i] += slope * pixel_rows[n, 3 + i]
    for j in range(unknown_count):
        right_side[j] = 0.0
        for i in range(unknown_count):
            matrix[j, i] = 0.0
    for k in range(block_count):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums[k, 0], sums[k, 1], sums[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(unknown_count):
            one, by_print = slopes[k, 0, j], slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            right_side[j] += every_score[k, j]
            for i in range(unknown_count):
                less = weight * (p * slopes[k, 0, i] + q * slopes[k, 1, i])
                every_normal[k, j, i] -= less
                matrix[j, i] += every_normal[k, j, i]


@subroutine
def add_priors(
    matrix: FloatArray, right_side: FloatArray, white_spread_and_bend: FloatArray,
    blur_weight: float,
    white_spread_weight: float, quadratic_weight: float, cubic_weight: float, unknown_count: int,
) -> None:  # fmt: skip
    """Add Gaussian priors to normal equations: blurs stay, white spread and bend are near 0.

    Each prior adds its weight, pixel variance / prior variance, to the diagonal.
    """
    matrix[8, 8] += blur_weight
    matrix[9, 9] += blur_weight
    for k in range(WHITE_SPREAD_INDEX, unknown_count):
        weight = quadratic_weight if k < CUBIC_START else cubic_weight
        if k == WHITE_SPREAD_INDEX:
            weight = white_spread_weight
        matrix[k, k] += weight
        right_side[k] -= weight * white_spread_and_bend[k - WHITE_SPREAD_INDEX]


@subroutine
def block_squares_and_dof(
    factor: FloatArray, step: FloatArray, blocks: Blocks, block_count: int, unknown_count: int
) -> tuple[float, float]:
    r"""Sum of squares of whole blocks' residuals, and its degrees of freedom.

    Their ratio estimates the variance of a pixel.

    Residuals that are correlated from pixel to pixel add up: their sum over a block of N pixels
    scatters by more than the square root of N. With the blocks' scores s_k and normal matrices N_k,
    and N their sum, ``E s_k^T N^-1 s_k = sigma^2 (tr A_k - tr A_k^2)``, ``A_k = N^-1 N_k``.

    Args:
        factor: lower Cholesky factor of N.
        step: (unknowns,) the last step; the scores are evaluated after it.
        blocks: blocks before that step.
        block_count: number of blocks.
        unknown_count: number of unknowns that are sought.

    Returns:
        Sum of the squares, and the number of independent squares in it: its degrees of freedom.
    """
    scores, normal, levels = blocks.scores, blocks.normal_matrices, blocks.levels
    score, part = np.empty(MAX_UNKNOWNS), np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS))
    squares = free = 0.0
    for k in range(block_count):
        if levels[k, 1] <= 0.0:
            continue
        for j in range(unknown_count):
            score[j] = scores[k, j]
            for i in range(unknown_count):
                score[j] -= normal[k, j, i] * step[i]
                part[i, j] = normal[k, j, i]
        forward_substitute(factor, score, unknown_count)
        # L^-1 N_k L^-T, both sides by rows
        for _ in range(2):
            for j in range(unknown_count):
                forward_substitute(factor, part[j], unknown_count)
            for j in range(unknown_count):
                for i in range(j):
                    part[i, j], part[j, i] = part[j, i], part[i, j]
        for j in range(unknown_count):
            squares += score[j] * score[j]
            free += part[j, j]
            for i in range(unknown_count):
                free -= part[j, i] * part[j, i]
    return squares, max(free, 0.0)


_LEAST_BLOCK_PIXELS: Final = 6
"""Fewest pixels of a block that is used (chosen: small tags against noisy levels)."""
_LEAST_PRINT_VARIANCE: Final = 0.02
"""Variance of the print in a block below which its contrast is undetermined (chosen: as above)."""
_OUTLIER_VARIANCE_RATIO: Final = 4.0
"""Ratio of a block's residual variance to the usual one above which its weight falls (chosen:
robustness against efficiency)."""


@subroutine
def estimate_block_levels(blocks: Blocks, block_count: int) -> float:
    """Estimate the dark level and contrast of each block; return the mean contrast.

    A block of one colour, or with a contrast of the wrong sign, gets contrast 0: it is not used.
    """
    sums, levels, total, pixels = blocks.moments, blocks.levels, 0.0, 0.0
    for k in range(block_count):
        n, t, tt, i, ti = sums[k]
        levels[k, 0] = levels[k, 1] = 0.0
        if n < _LEAST_BLOCK_PIXELS:
            continue
        print_squares = tt - t * t / n
        if print_squares < _LEAST_PRINT_VARIANCE * n:
            continue
        contrast = (ti - t * i / n) / print_squares
        if contrast <= 0.0:
            continue
        levels[k, 0], levels[k, 1] = (i - contrast * t) / n, contrast
        total += n * contrast
        pixels += n
    return total / pixels if pixels > 0.0 else 0.0


@subroutine
def reweight_and_sum_squares(
    pixel_rows: FloatArray, pixel_count: int, blocks: Blocks, block_count: int
) -> float:
    """Set the weight of each block, lower if its residuals are unusually large.

    Return the sum of all squared residuals by these weights.
    """
    sums, levels, weights = blocks.moments, blocks.levels, blocks.weights
    for k in range(block_count):
        weights[k] = 0.0
    for n in range(pixel_count):
        k = int(pixel_rows[n, 1])
        if k >= 0 and levels[k, 1] > 0.0:
            r = pixel_rows[n, 0] - levels[k, 0] - levels[k, 1] * pixel_rows[n, 2]
            weights[k] += r * r
    log_total, total = 0.0, 0.0
    for k in range(block_count):
        if levels[k, 1] > 0.0:
            weights[k] /= sums[k, 0]
            # the geometric mean, which a few bad blocks hardly raise
            log_total += sums[k, 0] * log(weights[k] + 0.05)
            total += sums[k, 0]
    if total == 0.0:
        return 0.0
    usual = exp(log_total / total)
    weighted = 0.0
    for k in range(block_count):
        if levels[k, 1] > 0.0:
            own = weights[k]
            weights[k] = (
                1.0
                if own < _OUTLIER_VARIANCE_RATIO * usual
                else _OUTLIER_VARIANCE_RATIO * usual / own
            )
            weighted += weights[k] * own * sums[k, 0]
    return weighted


_WEAK_SIGMA: Final = 0.1
"""Standard deviation of a weak prior on the spread, px, and on the bend's coefficients, half edges;
any evidence in the pixels outweighs it (numerical)."""
_LEAST_BEND_SIGNIFICANCES: Final = ((8, 2.25), (12, 8.0))
"""Numbers of coefficients, the first ones, and ratios to its expectation by noise of the squared
Mahalanobis norm of so many, of which one must be exceeded (chosen: one flat tag in 16 exceeds the
first; the last four coefficients follow other errors of small tags, too)."""


@subroutine
def bend_displacement(white_spread_and_bend: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Displacement (dx, dy) of a point of the tag's plane by the bend; 0 at the corners.

    With c the coefficients, dx = (c1 + c5 x + c9 y) (1 - x^2) + (c2 + c6 x + c10 y) (1 - y^2) and
    dy = (c3 + c7 y + c11 x) (1 - x^2) + (c4 + c8 y + c12 x) (1 - y^2). Together with a homography
    these are all cubic polynomials.

    Args:
        white_spread_and_bend: (13,) the spread, then the bend's twelve coefficients c1 to c12.
        x: x of the point, half edges.
        y: y of the point, half edges.
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


@subroutine
def rms_bend_coefficients(white_spread_and_bend: FloatArray) -> tuple[float, float]:
    """Root mean squares of a bend's quadratic and cubic coefficients."""
    first, end = CUBIC_START - WHITE_SPREAD_INDEX, MAX_UNKNOWNS - WHITE_SPREAD_INDEX
    return (
        sqrt(np.square(white_spread_and_bend[1:first]).mean()),
        sqrt(np.square(white_spread_and_bend[first:end]).mean()),
    )


@subroutine
def estimate_bend_prior_sigmas(
    buffers: FitBuffers,
    pixel_count: int,
    block_count: int,
    white_spread_and_bend: FloatArray,
    pixel_variance: float,
) -> tuple[float, float]:
    """Estimate prior standard deviations of a bend's coefficients by empirical Bayes.

    Args:
        buffers: working arrays after a step that kept the sheet flat.
        pixel_count: number of pixels.
        block_count: number of blocks.
        white_spread_and_bend: (13,) the spread, and a bend of 0.
        pixel_variance: variance of a pixel.

    Returns:
        Root mean squares of the quadratic and the cubic coefficients, weighted by how well the
        pixels determine each; 0 if they are no larger than noise makes them. Noise is included:
        without it, a coefficient that is as large as its noise would be held at 0.
    """
    matrix, solution = np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS)), np.empty(MAX_UNKNOWNS)
    build_normal_equations(
        buffers.pixel_rows, pixel_count, buffers.blocks, block_count, MAX_UNKNOWNS, matrix, solution
    )
    for j in range(MAX_UNKNOWNS):
        for i in range(BEND_START):
            solution[j] -= matrix[j, i] * buffers.step[i]
    weak_weight = pixel_variance / _WEAK_SIGMA**2
    add_priors(
        matrix,
        solution,
        white_spread_and_bend,
        1e-5 * (matrix[8, 8] + matrix[9, 9]),
        weak_weight,
        weak_weight,
        weak_weight,
        MAX_UNKNOWNS,
    )
    if not cholesky_factorise(matrix, MAX_UNKNOWNS):
        return 0.0, 0.0
    # of a flat sheet these are independent, with a pixel's variance
    forward_substitute(matrix, solution, MAX_UNKNOWNS)
    significant = False
    for count, least in _LEAST_BEND_SIGNIFICANCES:
        squares = np.square(solution[BEND_START : BEND_START + count]).sum()
        significant |= squares > least * count * pixel_variance
    if not significant:
        return 0.0, 0.0
    cubic = _mean_square(matrix, solution, CUBIC_START, MAX_UNKNOWNS, 0.0)
    quadratic = _mean_square(matrix, solution, BEND_START, CUBIC_START, cubic)
    return sqrt(quadratic), sqrt(cubic)


@subroutine
def _mean_square(
    factor: FloatArray, whitened: FloatArray, first: int, end: int, later_mean_square: float
) -> float:
    """Mean square of some unknowns, weighted by their information, given that of later ones."""
    squares = information = 0.0
    for j in range(first, end):
        squares += whitened[j] * whitened[j]
        for i in range(j, MAX_UNKNOWNS):
            if i < end:
                information += factor[i, j] * factor[i, j]
            else:
                squares -= later_mean_square * factor[i, j] * factor[i, j]
    return max(squares / information, 0.0)


@subroutine
def evaluate_print(
    state: FitState, tag: TagPrint, buffers: FitBuffers, pixel_count: int, blocks_per_edge: int
) -> None:
    """Evaluate the print and its derivatives at all pixels, and their sums by block.

    Args:
        state: the tag's current pose, blurs and bend.
        tag: the print.
        buffers: its `samples` are read; its `pixel_rows` and its blocks' `sums` and `slopes` are
            the result. A pixel to which an unknown cell contributes gets block -1.
        pixel_count: number of pixels.
        blocks_per_edge: blocks along an edge.
    """
    G, blurs, spread_and_bend, cells = (
        state.G,
        state.blurs_px,
        state.white_spread_and_bend,
        tag.cells,
    )
    places, pixels, along_x, along_y = (
        buffers.samples,
        buffers.pixel_rows,
        buffers.cell_weights_x,
        buffers.cell_weights_y,
    )
    sums, slopes = buffers.blocks.moments, buffers.blocks.derivative_sums
    half, start = 0.5 * tag.side_cells, 0.5 * (len(cells) - tag.side_cells)
    for k in range(blocks_per_edge * blocks_per_edge):
        for j in range(5):
            sums[k, j] = 0.0
        for j in range(MAX_UNKNOWNS):
            slopes[k, 0, j] = slopes[k, 1, j] = 0.0
    for n in range(pixel_count):
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
        at = sample_print(
            cells, (x + 1.0) * half + start, (y + 1.0) * half + start, s_x, s_y, along_x, along_y
        )
        if not at.cells_known:
            pixels[n, 1] = -1.0
            continue
        by_x, by_y = half * at.by_x, half * at.by_y
        turn = -(by_x * x + by_y * y)
        pixels[n, 0] = grey
        ridge = at.by_white_spread_x / blurs[0] + at.by_white_spread_y / blurs[1]
        value = at.value + spread_and_bend[0] * ridge
        pixels[n, 2] = value
        pixels[n, 3], pixels[n, 4], pixels[n, 5] = by_x * x, by_x * y, by_x
        pixels[n, 6], pixels[n, 7], pixels[n, 8] = by_y * x, by_y * y, by_y
        pixels[n, 9], pixels[n, 10] = turn * x, turn * y
        pixels[n, 11], pixels[n, 12], pixels[n, 13] = at.by_log_blur_x, at.by_log_blur_y, ridge
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
