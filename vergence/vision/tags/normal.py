"""Normal equations of a tag's fit, levels eliminated, and the variance from its residuals."""

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import forward
from vergence.vision.tags.workspace import SPREAD, UNKNOWNS, Blocks


@subroutine
def normal_equations(
    pixels: FloatArray,
    count: int,
    blocks: Blocks,
    block_count: int,
    used: int,
    matrix: FloatArray,
    right: FloatArray,
) -> None:
    """Build the normal equations of a step with the levels eliminated, by block and in total.

    Args:
        pixels: (pixels, `COLUMNS`) see `evaluate_print`.
        count: number of pixels.
        blocks: result: their normal matrices and scores.
        block_count: number of blocks.
        used: number of unknowns that are sought, the first ones.
        matrix: (unknowns, unknowns) result, the normal matrix of all blocks.
        right: (unknowns,) result, the right side.
    """
    levels, weights, sums, slopes = blocks.levels, blocks.weights, blocks.sums, blocks.slopes
    every_score, every_normal = blocks.scores, blocks.normal
    for k in range(block_count):
        for j in range(used):
            every_score[k, j] = 0.0
            for i in range(used):
                every_normal[k, j, i] = 0.0
    for n in range(count):
        k = int(pixels[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixels[n, 0] - levels[k, 0] - contrast * pixels[n, 2]
        weight = weights[k] * contrast
        scores, normal = every_score[k], every_normal[k]
        for j in range(used):
            slope = weight * pixels[n, 3 + j]
            scores[j] += slope * r
            slope *= contrast
            # full rows, not only a triangle: loops of equal length are vectorised
            for i in range(used):
                normal[j, i] += slope * pixels[n, 3 + i]
    for j in range(used):
        right[j] = 0.0
        for i in range(used):
            matrix[j, i] = 0.0
    for k in range(block_count):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums[k, 0], sums[k, 1], sums[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(used):
            one, by_print = slopes[k, 0, j], slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            right[j] += every_score[k, j]
            for i in range(used):
                less = weight * (p * slopes[k, 0, i] + q * slopes[k, 1, i])
                every_normal[k, j, i] -= less
                matrix[j, i] += every_normal[k, j, i]


@subroutine
def add_priors(
    matrix: FloatArray, right: FloatArray, spread_and_bend: FloatArray, blur_weight: float,
    spread_weight: float, bend_weight: float, used: int,
) -> None:  # fmt: skip
    """Add the priors of blurs, spread and bend, as weights, to normal equations."""
    matrix[8, 8] += blur_weight
    matrix[9, 9] += blur_weight
    for k in range(SPREAD, used):
        weight = spread_weight if k == SPREAD else bend_weight
        matrix[k, k] += weight
        right[k] -= weight * spread_and_bend[k - SPREAD]


@subroutine
def variance_of_blocks(
    factor: FloatArray, step: FloatArray, blocks: Blocks, block_count: int, used: int
) -> tuple[float, float]:
    r"""Estimate the variance of a pixel from the residuals of whole blocks.

    Residuals that are correlated from pixel to pixel add up: their sum over a block of N pixels
    scatters by more than the square root of N. With the blocks' scores s_k and normal matrices N_k,
    and N their sum, ``E s_k^T N^-1 s_k = sigma^2 (tr A_k - tr A_k^2)``, ``A_k = N^-1 N_k``.

    Args:
        factor: lower Cholesky factor of N.
        step: (unknowns,) the last step; the scores are evaluated after it.
        blocks: blocks before that step.
        block_count: number of blocks.
        used: number of unknowns that are sought.

    Returns:
        Sum of the squares, and the number of independent squares in it: its degrees of freedom.
    """
    scores, normal, levels = blocks.scores, blocks.normal, blocks.levels
    score, part = np.empty(UNKNOWNS), np.empty((UNKNOWNS, UNKNOWNS))
    squares = free = 0.0
    for k in range(block_count):
        if levels[k, 1] <= 0.0:
            continue
        for j in range(used):
            score[j] = scores[k, j]
            for i in range(used):
                score[j] -= normal[k, j, i] * step[i]
                part[i, j] = normal[k, j, i]
        forward(factor, score, used)
        # L^-1 N_k L^-T, both sides by rows
        for _ in range(2):
            for j in range(used):
                forward(factor, part[j], used)
            for j in range(used):
                for i in range(j):
                    part[i, j], part[j, i] = part[j, i], part[i, j]
        for j in range(used):
            squares += score[j] * score[j]
            free += part[j, j]
            for i in range(used):
                free -= part[j, i] * part[j, i]
    return squares, max(free, 0.0)
