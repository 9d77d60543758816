"""The bend of a tag's sheet: eight polynomials, zero at the corners, and their expected size."""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import factorise, solve
from vergence.vision.tags.normal import hold_near, normal_equations
from vergence.vision.tags.workspace import BOWS, SPREAD, UNKNOWNS, FitBuffers

_WIDEST: Final = 0.1
"""Standard deviation of a weak prior on the spread, px, and on the bend's coefficients, half edges;
any evidence in the pixels outweighs it (numerical)."""
_SURELY: Final = 2.0
"""Ratio to its expectation by noise that the squared Mahalanobis norm of the eight coefficients
must exceed (chosen: noise alone exceeds it in one flat tag of 25)."""


@subroutine
def bend_at(bent: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Displacement (dx, dy) of a point of the tag's plane by the bend; 0 at the corners.

    With c the coefficients, dx = (c1 + c3 x) (1 - x^2) + (c2 + c4 x) (1 - y^2) and
    dy = (c5 + c7 y) (1 - x^2) + (c6 + c8 y) (1 - y^2).

    Args:
        bent: (9,) the spread, then the bend's eight coefficients c1 to c8.
        x: x of the point, half edges.
        y: y of the point, half edges.
    """
    over_x, over_y = 1.0 - x * x, 1.0 - y * y
    dx = (bent[1] + bent[3] * x) * over_x + (bent[2] + bent[4] * x) * over_y
    dy = (bent[5] + bent[7] * y) * over_x + (bent[6] + bent[8] * y) * over_y
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
def size_of_bend(bent: FloatArray) -> float:
    """Root mean square of a bend's coefficients."""
    squares = 0.0
    for k in range(BOWS - SPREAD, UNKNOWNS - SPREAD):
        squares += bent[k] ** 2 / (UNKNOWNS - BOWS)
    return sqrt(squares)


@subroutine
def usual_bow(
    room: FitBuffers, count: int, number: int, bent: FloatArray, variance: float
) -> float:
    """Estimate the prior standard deviation of a bend's coefficients by empirical Bayes.

    Args:
        room: working arrays after a step that kept the sheet flat.
        count: number of pixels.
        number: number of blocks.
        bent: (9,) the spread, and a bend of 0.
        variance: variance of a pixel.

    Returns:
        Root mean square of the coefficients in excess of noise, weighted by how well the pixels
        determine each; 0 if they are no larger than noise makes them.
    """
    matrix, bows = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    normal_equations(room.pixels, count, room.blocks, number, UNKNOWNS, matrix, bows)
    for j in range(UNKNOWNS):
        for i in range(BOWS):
            bows[j] -= matrix[j, i] * room.step[i]
    hold = variance / _WIDEST**2
    hold_near(matrix, bows, bent, 1e-5 * (matrix[8, 8] + matrix[9, 9]), hold, hold, UNKNOWNS)
    if not factorise(matrix, UNKNOWNS):
        return 0.0
    solve(matrix, bows, UNKNOWNS)
    # the factor's last rows are the factor of the bend's normal matrix, other unknowns eliminated
    squares = told = 0.0
    for j in range(BOWS, UNKNOWNS):
        total = 0.0
        for i in range(j, UNKNOWNS):
            total += matrix[i, j] * bows[i]
            told += matrix[i, j] * matrix[i, j]
        squares += total * total
    chance = (UNKNOWNS - BOWS) * variance
    return sqrt((squares - chance) / told) if squares > _SURELY * chance else 0.0
