"""How evenly a board's corners lie: what noise of pixels does not tell, and single strays."""

from functools import lru_cache
from math import comb, sqrt
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled

_HIGHEST: Final = 5
_BINOMIALS: Final = np.array(
    [[(-1.0) ** k * comb(n, k) for k in range(_HIGHEST + 1)] for n in range(_HIGHEST + 1)]
)
"""Signs and weights of the n-th difference."""
_BENDS: Final = (3, 6)
"""Degrees of the polynomial that stands for what a homography does not explain: a lens."""
_FREE: Final = 1.6
"""Corners by coefficient of that polynomial, at least."""


@compiled
def unevenness(grid: NDArray[np.float64]) -> float:
    """How far corners lie beside a smooth grid, as a standard deviation of each coordinate, px.

    It is what noise of pixels does not tell: uneven print, the pixel grid, compressed images. The
    n-th difference of n + 1 corners in a row is free of what perspective and lens make of a line, a
    polynomial of degree n - 1 or nearly so, and has (2n)! / n!^2 times the variance of one
    coordinate. The fifth is taken, or that of as many corners as there are; in rows of three the
    second, less that of the next row.

    Args:
        grid: (rows, columns, 2) the corners, nan where there is none.
    """
    squares, count = 0.0, 0
    for axis in range(2):
        along = grid if axis == 1 else grid.transpose(1, 0, 2)
        rows, columns, _ = along.shape
        order = min(columns - 1, _HIGHEST)
        if columns < 3 or rows < 2:
            continue
        norm = sum_ = 0.0
        for n in range(order + 1):
            norm += _BINOMIALS[order, n] ** 2
        for j in range(rows):
            if order == 2 and j + 1 == rows:
                continue
            for i in range(columns - order):
                for k in range(2):
                    sum_ = 0.0
                    for n in range(order + 1):
                        sum_ += _BINOMIALS[order, n] * along[j, i + n, k]
                        if order == 2:
                            sum_ -= _BINOMIALS[order, n] * along[j + 1, i + n, k]
                    if sum_ == sum_:
                        squares += sum_ * sum_ / (2.0 * norm if order == 2 else norm)
                        count += 1
    return sqrt(squares / max(count, 1))


def beside_others(grid: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far each corner lies beside where all the others say that it is.

    The others' say is a homography of the board, and a polynomial for what is left of a lens, of
    the degree with the least generalised cross validation (Golub, Heath and Wahba 1979).

    Args:
        grid: (rows, columns, 2) the corners, px.

    Returns:
        (rows * columns, 2) the differences, px. (rows * columns,) what standard deviation each
        of their coordinates has, by that of one corner's.
    """
    rows, columns, _ = grid.shape
    places, basis, counts = _polynomials(rows, columns)
    outer = np.array([grid[0, 0], grid[0, -1], grid[-1, -1], grid[-1, 0]], np.float32)
    ends = places[[0, columns - 1, len(places) - 1, len(places) - columns]].astype(np.float32)
    transform = cv2.getPerspectiveTransform(ends, outer)
    left = grid.reshape(-1, 2) - cv2.perspectiveTransform(places[None], transform)[0]
    shares = basis.T @ left
    explained = np.cumsum((shares**2).sum(axis=1))[counts - 1]
    unexplained = (left**2).sum() - explained
    count = counts[int(np.argmin(unexplained / (len(left) - counts) ** 2))]
    free = 1.0 - (basis[:, :count] ** 2).sum(axis=1)
    left = (left - basis[:, :count] @ shares[:count]) / free[:, None]
    return left, 1.0 / np.sqrt(free)


@lru_cache(maxsize=32)
def _polynomials(
    rows: int, columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """A board's corners within 1, (n, 2); polynomials over them; how many to each degree's end.

    The polynomials are orthonormal, (n, p), the lower degrees first.
    """
    grid = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    x, y = (each.ravel() for each in grid)
    columns_of: list[NDArray[np.float64]] = []
    counts: list[int] = []
    for degree in range(_BENDS[1] + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if degree > 0 and _FREE * (len(columns_of) + len(more)) > len(x):
            break
        columns_of += more
        if degree >= _BENDS[0]:
            counts.append(len(columns_of))
    basis, _ = np.linalg.qr(np.stack(columns_of, axis=1))
    return np.column_stack([x, y]), basis, np.array(counts or [len(columns_of)])
