"""Gauss-Newton steps of a tag's fit: normal equations without the levels, and their solution."""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import through
from vergence.vision.tags.pixels import BOWS, SPREAD, UNKNOWNS, Sums

_WIDEST: Final = 0.1
"""Numerical: standard deviation, px of the spread and half edges of the bend, that leaves them to
the pixels where these tell anything."""
_SURELY: Final = 2.5
"""Numerical: times their variance that the squares of eight coefficients must have in the mean: by
chance in one tag of a hundred."""


@subroutine
def normal_equations(
    pixels: FloatArray,
    count: int,
    sums: Sums,
    levels: FloatArray,
    blocks: int,
    weights: FloatArray,
    used: int,
    matrix: FloatArray,
    right: FloatArray,
) -> None:
    """The normal equations of a step in the first unknowns, levels eliminated, by block and all."""
    for k in range(blocks):
        for j in range(used):
            sums.scores[k, j] = 0.0
            for i in range(used):
                sums.normal[k, j, i] = 0.0
    for n in range(count):
        k = int(pixels[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixels[n, 0] - levels[k, 0] - contrast * pixels[n, 2]
        weight = weights[k] * contrast
        scores, normal = sums.scores[k], sums.normal[k]
        for j in range(used):
            slope = weight * pixels[n, 3 + j]
            scores[j] += slope * r
            slope *= contrast
            # all of the row: loops of one length run several numbers at once
            for i in range(used):
                normal[j, i] += slope * pixels[n, 3 + i]
    for j in range(used):
        right[j] = 0.0
        for i in range(used):
            matrix[j, i] = 0.0
    for k in range(blocks):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums.plain[k, 0], sums.plain[k, 1], sums.plain[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(used):
            one, by_print = sums.slopes[k, 0, j], sums.slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            right[j] += sums.scores[k, j]
            for i in range(used):
                less = weight * (p * sums.slopes[k, 0, i] + q * sums.slopes[k, 1, i])
                sums.normal[k, j, i] -= less
                matrix[j, i] += sums.normal[k, j, i]


@subroutine
def variance_of_blocks(
    factor: FloatArray, step: FloatArray, sums: Sums, levels: FloatArray, blocks: int, used: int
) -> tuple[float, float]:
    r"""The variance of a pixel by what the pixels of each block leave together.

    Where what is left is alike from pixel to pixel it adds up: sums over a block of N pixels
    scatter by more than the square root of N. With the blocks' scores s_k and normal matrices N_k,
    and N their sum, ``E s_k^T N^-1 s_k = sigma^2 (tr A_k - tr A_k^2)``, ``A_k = N^-1 N_k``.

    Args:
        factor: lower Cholesky factor of N.
        step: (unknowns,) the last one, after which the scores are wanted.
        sums: of the blocks, before it.
        levels: of the blocks.
        blocks: how many.
        used: unknowns that are sought.

    Returns:
        The sum of independent squares, and how many they are.
    """
    score, part = np.empty(UNKNOWNS), np.empty((UNKNOWNS, UNKNOWNS))
    squares = free = 0.0
    for k in range(blocks):
        if levels[k, 1] <= 0.0:
            continue
        for j in range(used):
            score[j] = sums.scores[k, j]
            for i in range(used):
                score[j] -= sums.normal[k, j, i] * step[i]
                part[i, j] = sums.normal[k, j, i]
        _forward(factor, score, used)
        # L^-1 N_k L^-T, both sides by rows
        for _ in range(2):
            for j in range(used):
                _forward(factor, part[j], used)
            for j in range(used):
                for i in range(j):
                    part[i, j], part[j, i] = part[j, i], part[i, j]
        for j in range(used):
            squares += score[j] * score[j]
            free += part[j, j]
            for i in range(used):
                free -= part[j, i] * part[j, i]
    return squares, max(free, 0.0)


@subroutine
def _forward(factor: FloatArray, right: FloatArray, size: int) -> None:
    """Solve with a lower triangle, in place."""
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]


@subroutine
def factorise(matrix: FloatArray, size: int) -> bool:
    """The lower Cholesky factor in place; False where the matrix is not positive definite."""
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
def solve(factor: FloatArray, right: FloatArray, size: int) -> None:
    """Solve with a lower Cholesky factor, in place."""
    _forward(factor, right, size)
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@subroutine
def move_plane(G: FloatArray, step: FloatArray) -> None:
    """Move the plane: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


@subroutine
def covariances_of(
    factor: FloatArray,
    used: int,
    G: FloatArray,
    H: FloatArray,
    variance: float,
    covariances: FloatArray,
) -> None:
    """The covariances of corners and centre: J N^-1 J^T times the variance that is left."""
    J, column = np.empty((2, UNKNOWNS)), np.empty(UNKNOWNS)
    for r in range(2):
        for j in range(UNKNOWNS):
            J[r, j] = 0.0
    g, h, i = G[2, 0], G[2, 1], G[2, 2]
    for point in range(5):
        x = -1.0 if point == 0 or point == 3 else 1.0
        y = -1.0 if point < 2 else 1.0
        if point == 4:
            x = y = 0.0
        u, v = through(H, x, y)
        w = g * u + h * v + i
        # the plane's coordinates by pixels
        a, b = (G[0, 0] - x * g) / w, (G[0, 1] - x * h) / w
        c, d = (G[1, 0] - y * g) / w, (G[1, 1] - y * h) / w
        det = a * d - b * c
        for j in range(8):
            by_x = x if j == 0 else y if j == 1 else 1.0 if j == 2 else 0.0
            by_y = x if j == 3 else y if j == 4 else 1.0 if j == 5 else 0.0
            if j == 6:
                by_x, by_y = -x * x, -x * y
            if j == 7:
                by_x, by_y = -x * y, -y * y
            J[0, j] = -(d * by_x - b * by_y) / det
            J[1, j] = -(a * by_y - c * by_x) / det
        for r in range(2):
            for j in range(UNKNOWNS):
                column[j] = J[r, j]
            solve(factor, column, used)
            for s in range(2):
                total = 0.0
                for j in range(UNKNOWNS):
                    total += J[s, j] * column[j]
                covariances[point, r, s] = variance * total


@subroutine
def hold_near(
    matrix: FloatArray, right: FloatArray, bent: FloatArray, blur: float, spread: float,
    bow: float, used: int,
) -> None:  # fmt: skip
    """Add to normal equations what is known of blurs, spread and bows without the pixels."""
    matrix[8, 8] += blur
    matrix[9, 9] += blur
    for k in range(SPREAD, used):
        hold = spread if k == SPREAD else bow
        matrix[k, k] += hold
        right[k] -= hold * bent[k - SPREAD]


@subroutine
def usual_bow(
    pixels: FloatArray,
    count: int,
    sums: Sums,
    levels: FloatArray,
    blocks: int,
    weights: FloatArray,
    step: FloatArray,
    bent: FloatArray,
    variance: float,
) -> float:
    """The standard deviation of a bend's coefficients, after a step: empirical Bayes.

    Args:
        pixels: see `evaluate_print`.
        count: the same.
        sums: of the blocks.
        levels: of the blocks.
        blocks: how many.
        weights: of the blocks.
        step: (unknowns,) the last one, none of a bend in it.
        bent: (9,) the spread and the bend.
        variance: of a pixel.

    Returns:
        The mean of their squares beyond their variance, as a root; 0 where they are no more than
        chance.
    """
    matrix, bows = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    normal_equations(pixels, count, sums, levels, blocks, weights, UNKNOWNS, matrix, bows)
    for j in range(UNKNOWNS):
        for i in range(BOWS):
            bows[j] -= matrix[j, i] * step[i]
    hold = variance / _WIDEST**2
    hold_near(matrix, bows, bent, 1e-5 * (matrix[8, 8] + matrix[9, 9]), hold, hold, UNKNOWNS)
    if not factorise(matrix, UNKNOWNS):
        return 0.0
    solve(matrix, bows, UNKNOWNS)
    squares = unsure = 0.0
    for k in range(BOWS, UNKNOWNS):
        squares += bows[k] ** 2 / (UNKNOWNS - BOWS)
        # the last columns of the inverse need the last rows of the factor's alone
        unsure += variance / (UNKNOWNS - BOWS) * inverse_diagonal(matrix, k, UNKNOWNS)
    return sqrt(squares - unsure) if squares > _SURELY * unsure else 0.0


@subroutine
def inverse_diagonal(factor: FloatArray, place: int, size: int) -> float:
    """An entry of the diagonal of the inverse, by a lower Cholesky factor."""
    column = np.zeros(UNKNOWNS)
    total = 0.0
    for i in range(place, size):
        value = 1.0 if i == place else 0.0
        for k in range(place, i):
            value -= factor[i, k] * column[k]
        column[i] = value / factor[i, i]
        total += column[i] * column[i]
    return total
