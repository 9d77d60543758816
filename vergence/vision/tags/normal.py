"""Normal equations of a tag's fit, levels eliminated, and the variance from its residuals."""

import numpy as np

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import forward_substitute
from vergence.vision.tags.workspace import CUBIC_START, MAX_UNKNOWNS, WHITE_SPREAD_INDEX, Blocks


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
