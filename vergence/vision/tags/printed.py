r"""What a blurred print of square cells looks like at a point, and how that changes.

Cells are c_ij, 0 black to 1 white. Blurred by a Gaussian of standard deviations s_x, s_y in cells,

    T(x, y) = sum_ij c_ij w_i(x) w_j(y),    w_i(x) = Phi((i + 1 - x) / s_x) - Phi((i - x) / s_x),

which is exact for a blur whose axes are the cells', and near enough for a round one seen at an
angle: it is exact there too along the straight edges between cells.
"""

from math import erf, floor, pi, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray

MOST_REACHED: Final = 12
"""Cells along an axis that a blur may reach; what lies beyond counts as the last of them."""
_REACH: Final = 3.0
"""Standard deviations after which a blur ends."""
_STEPS: Final = 128
"""Of a standard deviation between the entries of the tables, which are read with linear
interpolation: to 2e-6, and at a fifth of what the functions take."""
_Z: Final = np.arange(-_REACH, _REACH + 1.5 / _STEPS, 1.0 / _STEPS)
_BELOW: Final = np.array([0.5 + 0.5 * erf(z / sqrt(2.0)) for z in _Z.tolist()])
_HEIGHT: Final = np.exp(-0.5 * _Z**2) / sqrt(2.0 * pi)


class Printed(NamedTuple):
    """The print's value at a point, and its derivatives."""

    value: float
    by_x: float
    by_y: float
    by_blur_x: float
    """By the log of the blur along x."""
    by_blur_y: float
    ridge_x: float
    """By the width of white across the edges along x, in standard deviations of the blur: how much
    all of them move towards black."""
    ridge_y: float
    known: bool
    """False where a cell counts of which it is not known what is printed there."""


@subroutine
def _weigh(x: float, s: float, weights: FloatArray) -> tuple[int, int]:
    """How much each cell counts at a place along an axis.

    Args:
        x: the place, cells.
        s: standard deviation of the blur, cells.
        weights: (4, MOST_REACHED) result: the weights, their derivatives by x and by log s, and by
            the place of the edge to the next cell, in standard deviations.

    Returns:
        The first cell, and how many.
    """
    first = floor(x - _REACH * s)
    count = min(floor(x + _REACH * s) - first + 1, MOST_REACHED)
    below, by_x, by_log = 0.0, 0.0, 0.0
    for i in range(count):
        height = 0.0
        if i + 1 < count:
            z = (first + i + 1 - x) / s
            place = min(max((z + _REACH) * _STEPS, 0.0), 2.0 * _REACH * _STEPS)
            k = int(place)
            share = place - k
            below_next = _BELOW[k] + share * (_BELOW[k + 1] - _BELOW[k])
            height = _HEIGHT[k] + share * (_HEIGHT[k + 1] - _HEIGHT[k])
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
def printed_at(
    cells: FloatArray,
    x: float,
    y: float,
    s_x: float,
    s_y: float,
    along_x: FloatArray,
    along_y: FloatArray,
) -> Printed:
    """The blurred print at a point.

    Args:
        cells: (rows, columns) 0 black to 1 white, nan unknown; the outermost go on beyond.
        x: the point in cells from the upper left corner of all cells.
        y: the same downwards.
        s_x: standard deviation of the blur along x, cells.
        s_y: along y.
        along_x: (4, MOST_REACHED) room to work in.
        along_y: the same.
    """
    rows, columns = cells.shape
    left, across = _weigh(x, s_x, along_x)
    top, down = _weigh(y, s_y, along_y)
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
            sum_ += along_x[0, i] * cell
            sum_x += along_x[1, i] * cell
            sum_blur += along_x[2, i] * cell
            sum_ridge += along_x[3, i] * abs(right - cell)
            sum_below += along_x[0, i] * abs(cells[below, column] - cell)
        value += along_y[0, j] * sum_
        by_x += along_y[0, j] * sum_x
        blur_x += along_y[0, j] * sum_blur
        ridge_x += along_y[0, j] * sum_ridge
        by_y += along_y[1, j] * sum_
        blur_y += along_y[2, j] * sum_
        ridge_y += along_y[3, j] * sum_below
    return Printed(value, by_x, by_y, blur_x, blur_y, ridge_x, ridge_y, known)
