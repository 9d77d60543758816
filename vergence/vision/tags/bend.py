"""The bend of a tag's sheet: eight polynomials, zero at the corners, and their expected size."""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.cholesky import cholesky_factorise, cholesky_solve
from vergence.vision.tags.normal import add_priors, build_normal_equations
from vergence.vision.tags.workspace import BEND_START, MAX_UNKNOWNS, WHITE_SPREAD_INDEX, FitBuffers

_WEAK_SIGMA: Final = 0.1
"""Standard deviation of a weak prior on the spread, px, and on the bend's coefficients, half edges;
any evidence in the pixels outweighs it (numerical)."""
_LEAST_BEND_SIGNIFICANCE: Final = 2.0
"""Ratio to its expectation by noise that the squared Mahalanobis norm of the eight coefficients
must exceed (chosen: noise alone exceeds it in one flat tag of 25)."""


@subroutine
def bend_displacement(white_spread_and_bend: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Displacement (dx, dy) of a point of the tag's plane by the bend; 0 at the corners.

    With c the coefficients, dx = (c1 + c3 x) (1 - x^2) + (c2 + c4 x) (1 - y^2) and
    dy = (c5 + c7 y) (1 - x^2) + (c6 + c8 y) (1 - y^2).

    Args:
        white_spread_and_bend: (9,) the spread, then the bend's eight coefficients c1 to c8.
        x: x of the point, half edges.
        y: y of the point, half edges.
    """
    over_x, over_y = 1.0 - x * x, 1.0 - y * y
    dx = (white_spread_and_bend[1] + white_spread_and_bend[3] * x) * over_x + (
        white_spread_and_bend[2] + white_spread_and_bend[4] * x
    ) * over_y
    dy = (white_spread_and_bend[5] + white_spread_and_bend[7] * y) * over_x + (
        white_spread_and_bend[6] + white_spread_and_bend[8] * y
    ) * over_y
    return dx, dy


@subroutine
def bend_derivatives(
    flat_x: float, flat_y: float, x: float, y: float, print_by_x: float, print_by_y: float,
    pixel_rows: FloatArray, pixel_index: int,
) -> None:  # fmt: skip
    """Derivatives of the print with respect to the bend's coefficients, see `bend_displacement`.

    Args:
        flat_x: x of the point before the bend moves it, half edges.
        flat_y: y of that point, half edges.
        x: x of the point after the bend has moved it, half edges.
        y: its y.
        print_by_x: derivative of the print with respect to x, there.
        print_by_y: derivative with respect to y.
        pixel_rows: (pixels, `COLUMNS`) result, in the last columns.
        pixel_index: index of the pixel.
    """
    over_x, over_y = 1.0 - flat_x * flat_x, 1.0 - flat_y * flat_y
    pixel_rows[pixel_index, 14], pixel_rows[pixel_index, 15] = (
        print_by_x * over_x,
        print_by_x * over_y,
    )
    pixel_rows[pixel_index, 16], pixel_rows[pixel_index, 17] = (
        pixel_rows[pixel_index, 14] * x,
        pixel_rows[pixel_index, 15] * x,
    )
    pixel_rows[pixel_index, 18], pixel_rows[pixel_index, 19] = (
        print_by_y * over_x,
        print_by_y * over_y,
    )
    pixel_rows[pixel_index, 20], pixel_rows[pixel_index, 21] = (
        pixel_rows[pixel_index, 18] * y,
        pixel_rows[pixel_index, 19] * y,
    )


@subroutine
def rms_bend_coefficient(white_spread_and_bend: FloatArray) -> float:
    """Root mean square of a bend's coefficients."""
    squares = 0.0
    for k in range(BEND_START - WHITE_SPREAD_INDEX, MAX_UNKNOWNS - WHITE_SPREAD_INDEX):
        squares += white_spread_and_bend[k] ** 2 / (MAX_UNKNOWNS - BEND_START)
    return sqrt(squares)


@subroutine
def estimate_bend_prior_sigma(
    buffers: FitBuffers,
    pixel_count: int,
    block_count: int,
    white_spread_and_bend: FloatArray,
    pixel_variance: float,
) -> float:
    """Estimate the prior standard deviation of a bend's coefficients by empirical Bayes.

    Args:
        buffers: working arrays after a step that kept the sheet flat.
        pixel_count: number of pixels.
        block_count: number of blocks.
        white_spread_and_bend: (9,) the spread, and a bend of 0.
        pixel_variance: variance of a pixel.

    Returns:
        Root mean square of the coefficients in excess of noise, weighted by how well the pixels
        determine each; 0 if they are no larger than noise makes them.
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
        MAX_UNKNOWNS,
    )
    if not cholesky_factorise(matrix, MAX_UNKNOWNS):
        return 0.0
    cholesky_solve(matrix, solution, MAX_UNKNOWNS)
    # the factor's last rows are the factor of the bend's normal matrix, other unknowns eliminated
    squares = information = 0.0
    for j in range(BEND_START, MAX_UNKNOWNS):
        total = 0.0
        for i in range(j, MAX_UNKNOWNS):
            total += matrix[i, j] * solution[i]
            information += matrix[i, j] * matrix[i, j]
        squares += total * total
    chance = (MAX_UNKNOWNS - BEND_START) * pixel_variance
    return (
        sqrt((squares - chance) / information)
        if squares > _LEAST_BEND_SIGNIFICANCE * chance
        else 0.0
    )
