"""The bend of a tag's sheet: twelve polynomials, zero at the corners, and their expected size."""

from math import sqrt
from typing import Final

import numpy as np

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import cholesky_factorise, forward_substitute
from vergence.vision.tags.normal import add_priors, build_normal_equations
from vergence.vision.tags.workspace import (
    BEND_START,
    CUBIC_START,
    MAX_UNKNOWNS,
    WHITE_SPREAD_INDEX,
    FitBuffers,
)

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
