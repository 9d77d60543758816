"""The bend of a tag's sheet: eight polynomials that vanish at the corners, and their usual size."""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import factorise, solve
from vergence.vision.tags.normal import hold_near, normal_equations
from vergence.vision.tags.workspace import BOWS, SPREAD, UNKNOWNS, Room

_WIDEST: Final = 0.1
"""Numerical: standard deviation, px of the spread and half edges of the bend, that leaves them to
the pixels where these tell anything."""
_SURELY: Final = 2.0
"""Numerical: times what chance makes of it that the squares of eight coefficients, by their
covariance, must be: by chance in one tag of 25."""


@subroutine
def bend_at(bent: FloatArray, x: float, y: float) -> tuple[float, float]:
    """How far a bend moves a place of the plane on the sheet; it vanishes at the corners.

    Args:
        bent: (9,) the spread, and the bend's coefficients: x is moved by (1 - x^2), (1 - y^2) and x
            times both, y by the same and y times both.
        x: of the place, half edges.
        y: the same.
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
    """The derivatives of the print by the coefficients of a bend, as in `bend_at`.

    Args:
        flat_x: of the place before it is moved, half edges.
        flat_y: the same.
        x: after that.
        y: the same.
        by_x: derivative of the print there.
        by_y: the same.
        pixels: (pixels, `COLUMNS`) result, the last columns.
        n: the pixel.
    """
    over_x, over_y = 1.0 - flat_x * flat_x, 1.0 - flat_y * flat_y
    pixels[n, 14], pixels[n, 15] = by_x * over_x, by_x * over_y
    pixels[n, 16], pixels[n, 17] = pixels[n, 14] * x, pixels[n, 15] * x
    pixels[n, 18], pixels[n, 19] = by_y * over_x, by_y * over_y
    pixels[n, 20], pixels[n, 21] = pixels[n, 18] * y, pixels[n, 19] * y


@subroutine
def size_of_bend(bent: FloatArray) -> float:
    """The root of the mean square of a bend's coefficients."""
    squares = 0.0
    for k in range(BOWS - SPREAD, UNKNOWNS - SPREAD):
        squares += bent[k] ** 2 / (UNKNOWNS - BOWS)
    return sqrt(squares)


@subroutine
def usual_bow(room: Room, count: int, number: int, bent: FloatArray, variance: float) -> float:
    """The standard deviation of a bend's coefficients, after a step without one: empirical Bayes.

    Args:
        room: after that step.
        count: pixels.
        number: of blocks.
        bent: (9,) the spread, and no bend yet.
        variance: of a pixel.

    Returns:
        The root of the mean of their squares beyond chance, those counting most of which the pixels
        tell most; 0 where they are no more than chance.
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
    # the last rows of the factor are that of the bend's own normal matrix, all else eliminated
    squares = told = 0.0
    for j in range(BOWS, UNKNOWNS):
        total = 0.0
        for i in range(j, UNKNOWNS):
            total += matrix[i, j] * bows[i]
            told += matrix[i, j] * matrix[i, j]
        squares += total * total
    chance = (UNKNOWNS - BOWS) * variance
    return sqrt((squares - chance) / told) if squares > _SURELY * chance else 0.0
