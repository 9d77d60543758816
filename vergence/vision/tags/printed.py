r"""Value and derivatives of a blurred print of square cells at a point.

Cells are c_ij, 0 black to 1 white. Blurred by a Gaussian of standard deviations s_x, s_y in cells,

    T(x, y) = sum_ij c_ij w_i(x) w_j(y),    w_i(x) = Phi((i + 1 - x) / s_x) - Phi((i - x) / s_x).

This is exact for a blur whose axes are those of the cells. For a round blur seen at an angle it is
a good approximation, and still exact along the straight edges between cells.
"""

from math import erf, floor, pi, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray

MAX_BLURRED_CELLS: Final = 12
"""Most cells along an axis that a blur covers; cells beyond count as the last one (numerical)."""
_CUTOFF_SIGMAS: Final = 3.0
"""Standard deviations at which the Gaussian is cut off (numerical)."""
_STEPS_PER_SIGMA: Final = 128
"""Entries of the tables per standard deviation. Linear interpolation is accurate to 2e-6 and takes
a fifth of the time of the functions (numerical)."""
_TABLE_Z: Final = np.arange(
    -_CUTOFF_SIGMAS, _CUTOFF_SIGMAS + 1.5 / _STEPS_PER_SIGMA, 1.0 / _STEPS_PER_SIGMA
)
"""Arguments of the tables, standard deviations (numerical)."""
_NORMAL_CDF: Final = np.array([0.5 + 0.5 * erf(z / sqrt(2.0)) for z in _TABLE_Z.tolist()])
"""Standard normal distribution function at `_TABLE_Z` (numerical)."""
_NORMAL_PDF: Final = np.exp(-0.5 * _TABLE_Z**2) / sqrt(2.0 * pi)
"""Standard normal density at `_TABLE_Z` (numerical)."""


class PrintSample(NamedTuple):
    """The print's value at a point, and its derivatives."""

    value: float
    by_x: float
    by_y: float
    by_log_blur_x: float
    """Derivative with respect to the logarithm of the blur along x."""
    by_log_blur_y: float
    by_white_spread_x: float
    """Derivative with respect to the spread of white, by which all edges across x move towards
    black, in standard deviations of the blur."""
    by_white_spread_y: float
    cells_known: bool
    """False if a cell that contributes has an unknown print."""


@subroutine
def _weigh(x: float, s: float, weights: FloatArray) -> tuple[int, int]:
    """Weight of each cell at a point along an axis.

    Args:
        x: the point, cells.
        s: standard deviation of the blur, cells.
        weights: (4, `MAX_BLURRED_CELLS`) result: the weights, and their derivatives with respect to
            x, to log s, and to the position of the edge to the next cell, in standard deviations.

    Returns:
        The first cell, and the number of cells.
    """
    first = floor(x - _CUTOFF_SIGMAS * s)
    count = min(floor(x + _CUTOFF_SIGMAS * s) - first + 1, MAX_BLURRED_CELLS)
    below, by_x, by_log = 0.0, 0.0, 0.0
    for i in range(count):
        height = 0.0
        if i + 1 < count:
            z = (first + i + 1 - x) / s
            place = min(
                max((z + _CUTOFF_SIGMAS) * _STEPS_PER_SIGMA, 0.0),
                2.0 * _CUTOFF_SIGMAS * _STEPS_PER_SIGMA,
            )
            k = int(place)
            share = place - k
            below_next = _NORMAL_CDF[k] + share * (_NORMAL_CDF[k + 1] - _NORMAL_CDF[k])
            height = _NORMAL_PDF[k] + share * (_NORMAL_PDF[k + 1] - _NORMAL_PDF[k])
            by_x_next, by_log_next = -height / s, -height * z
        else:
            below_next, by_x_next, by_log_next = 1.0, 0.0, 0.0
        weights[0, i] = below_next - below
        weights[1, i] = by_x_next - by_x
        weights[2, i] = by_log_next - by_log
        weights[3, i] = height
        below, by_x, by_log = below_next, by_x_next, by_log_next
    return first, count


@subroutine
def sample_print(
    cells: FloatArray,
    x: float,
    y: float,
    blur_x_cells: float,
    blur_y_cells: float,
    cell_weights_x: FloatArray,
    cell_weights_y: FloatArray,
) -> PrintSample:
    """Blurred print at a point.

    Args:
        cells: (rows, columns) 0 black to 1 white, nan unknown; the outermost extend beyond.
        x: the point, cells to the right of the upper left corner of all cells.
        y: the point, cells below that corner.
        blur_x_cells: standard deviation of the blur along x, cells.
        blur_y_cells: along y.
        cell_weights_x: (4, `MAX_BLURRED_CELLS`) scratch array.
        cell_weights_y: (4, `MAX_BLURRED_CELLS`) scratch array.
    """
    rows, columns = cells.shape
    left, across = _weigh(x, blur_x_cells, cell_weights_x)
    top, down = _weigh(y, blur_y_cells, cell_weights_y)
    value = by_x = by_y = blur_x = blur_y = ridge_x = ridge_y = 0.0
    known = True
    for j in range(down):
        row = min(max(top + j, 0), rows - 1)
        below = min(max(top + j + 1, 0), rows - 1) if j + 1 < down else row
        sum_ = sum_x = sum_blur = sum_ridge = sum_below = 0.0
        for i in range(across):
            column = min(max(left + i, 0), columns - 1)
            beside = min(max(left + i + 1, 0), columns - 1) if i + 1 < across else column
            cell, right = cells[row, column], cells[row, beside]
            if cell != cell:
                known = False
            sum_ += cell_weights_x[0, i] * cell
            sum_x += cell_weights_x[1, i] * cell
            sum_blur += cell_weights_x[2, i] * cell
            sum_ridge += cell_weights_x[3, i] * abs(right - cell)
            sum_below += cell_weights_x[0, i] * abs(cells[below, column] - cell)
        value += cell_weights_y[0, j] * sum_
        by_x += cell_weights_y[0, j] * sum_x
        blur_x += cell_weights_y[0, j] * sum_blur
        ridge_x += cell_weights_y[0, j] * sum_ridge
        by_y += cell_weights_y[1, j] * sum_
        blur_y += cell_weights_y[2, j] * sum_
        ridge_y += cell_weights_y[3, j] * sum_below
    return PrintSample(value, by_x, by_y, blur_x, blur_y, ridge_x, ridge_y, known)
