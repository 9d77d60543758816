"""The bend of a tag's sheet: eight polynomials, zero at the corners, and their expected size."""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import factorise, solve
from vergence.vision.tags.normal import add_priors, normal_equations
from vergence.vision.tags.workspace import BEND_START, SPREAD, UNKNOWNS, FitBuffers

_WEAK_SIGMA: Final = 0.1
"""Standard deviation of a weak prior on the spread, px, and on the bend's coefficients, half edges;
any evidence in the pixels outweighs it (numerical)."""
_SURELY: Final = 2.0
"""Ratio to its expectation by noise that the squared Mahalanobis norm of the eight coefficients
must exceed (chosen: noise alone exceeds it in one flat tag of 25)."""


@subroutine
def bend_at(c: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Displacement (dx, dy) of a point of the tag's plane by the bend; 0 at the corners.

    With c the coefficients, dx = (c1 + c3 x) (1 - x^2) + (c2 + c4 x) (1 - y^2) and
    dy = (c5 + c7 y) (1 - x^2) + (c6 + c8 y) (1 - y^2).

    Args:
        c: (9,) the spread, then the bend's eight coefficients c1 to c8.
        x: x of the point, half edges.
        y: y of the point, half edges.
    """
    over_x, over_y = 1.0 - x * x, 1.0 - y * y
    dx = (c[1] + c[3] * x) * over_x + (c[2] + c[4] * x) * over_y
    dy = (c[5] + c[7] * y) * over_x + (c[6] + c[8] * y) * over_y
    return dx, dy


@subroutine
def bend_slopes(
    flat_x: float, flat_y: float, x: float, y: float, by_x: float, by_y: float,
    pixels: FloatArray, n: int,
) -> None:  # fmt: skip
    """Derivatives of the print with respect to the bend's coefficients, see `bend_at`.

    Args:
        flat_x: x of the point before the bend moves it, half edges.
        flat_y: its y.
        x: x of the point after the bend has moved it, half edges.
        y: its y.
        by_x: derivative of the print with respect to x, there.
        by_y: derivative with respect to y.
        pixels: (pixels, `COLUMNS`) result, in the last columns.
        n: index of the pixel.
    """
    over_x, over_y = 1.0 - flat_x * flat_x, 1.0 - flat_y * flat_y
    pixels[n, 14], pixels[n, 15] = by_x * over_x, by_x * over_y
    pixels[n, 16], pixels[n, 17] = pixels[n, 14] * x, pixels[n, 15] * x
    pixels[n, 18], pixels[n, 19] = by_y * over_x, by_y * over_y
    pixels[n, 20], pixels[n, 21] = pixels[n, 18] * y, pixels[n, 19] * y


@subroutine
def rms_of_bend(spread_and_bend: FloatArray) -> float:
    """Root mean square of a bend's coefficients."""
    squares = 0.0
    for k in range(BEND_START - SPREAD, UNKNOWNS - SPREAD):
        squares += spread_and_bend[k] ** 2 / (UNKNOWNS - BEND_START)
    return sqrt(squares)


@subroutine
def estimate_bend_sigma(
    buffers: FitBuffers, count: int, block_count: int, spread_and_bend: FloatArray, variance: float
) -> float:
    """Estimate the prior standard deviation of a bend's coefficients by empirical Bayes.

    Args:
        buffers: working arrays after a step that kept the sheet flat.
        count: number of pixels.
        block_count: number of blocks.
        spread_and_bend: (9,) the spread, and a bend of 0.
        variance: variance of a pixel.

    Returns:
        Root mean square of the coefficients in excess of noise, weighted by how well the pixels
        determine each; 0 if they are no larger than noise makes them.
    """
    matrix, solution = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    normal_equations(buffers.pixels, count, buffers.blocks, block_count, UNKNOWNS, matrix, solution)
    for j in range(UNKNOWNS):
        for i in range(BEND_START):
            solution[j] -= matrix[j, i] * buffers.step[i]
    weak_weight = variance / _WEAK_SIGMA**2
    add_priors(
        matrix,
        solution,
        spread_and_bend,
        1e-5 * (matrix[8, 8] + matrix[9, 9]),
        weak_weight,
        weak_weight,
        UNKNOWNS,
    )
    if not factorise(matrix, UNKNOWNS):
        return 0.0
    solve(matrix, solution, UNKNOWNS)
    # the factor's last rows are the factor of the bend's normal matrix, other unknowns eliminated
    squares = information = 0.0
    for j in range(BEND_START, UNKNOWNS):
        total = 0.0
        for i in range(j, UNKNOWNS):
            total += matrix[i, j] * solution[i]
            information += matrix[i, j] * matrix[i, j]
        squares += total * total
    chance = (UNKNOWNS - BEND_START) * variance
    return sqrt((squares - chance) / information) if squares > _SURELY * chance else 0.0
