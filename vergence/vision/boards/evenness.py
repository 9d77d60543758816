"""Deviations of a board's corners from a smooth grid: overall, and of single corners."""

from functools import lru_cache
from math import comb, sqrt
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled

_MAX_DIFFERENCE_ORDER: Final = 5
"""Highest order of differences along a row (chosen: removes lens distortion, needs six corners)."""
_BINOMIALS: Final = np.array(
    [
        [(-1.0) ** k * comb(n, k) for k in range(_MAX_DIFFERENCE_ORDER + 1)]
        for n in range(_MAX_DIFFERENCE_ORDER + 1)
    ]
)
"""Coefficients of the n-th difference, row n."""
_DISTORTION_DEGREES: Final = (3, 6)
"""Lowest and highest degree of the polynomial that models lens distortion on top of a
homography (chosen)."""
_CORNERS_PER_COEFFICIENT: Final = 1.6
"""Least number of corners per coefficient of that polynomial (chosen: avoids overfitting)."""


@compiled
def estimate_corner_scatter_px(grid: NDArray[np.float64]) -> float:
    """Standard deviation of corners about a smooth grid, of each coordinate, px.

    It includes errors beyond pixel noise: uneven print, the pixel grid, compression. Perspective
    and lens turn a line into a polynomial, nearly of degree n - 1, which the n-th difference of
    n + 1 corners in a row cancels. That difference has (2n)! / n!^2 times the variance of one
    coordinate. The order is five, or less if a row has fewer corners; in rows of three it is two,
    and the difference of the next row is subtracted.

    Args:
        grid: (rows, columns, 2) the corners, px; nan for unknown ones.
    """
    squares, count = 0.0, 0
    for axis in range(2):
        along = grid if axis == 1 else grid.transpose(1, 0, 2)
        rows, columns, _ = along.shape
        order = min(columns - 1, _MAX_DIFFERENCE_ORDER)
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


def loo_residuals_and_scales(
    grid: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Residual of each corner from its prediction by all others, and the scale of its sigma.

    Leaving a corner out raises the standard deviation of its residual by that scale.

    The prediction is a homography of the board plus a polynomial for remaining lens distortion,
    of the degree with the least generalised cross validation (Golub, Heath and Wahba 1979).

    Args:
        grid: (rows, columns, 2) the corners, px.

    Returns:
        (rows * columns, 2) the residuals, px. (rows * columns,) ratio of the standard deviation of
        their coordinates to that of a corner.
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
    """Corners of a board scaled to -1..1, (n, 2); polynomials on them; their count per degree.

    The polynomials are orthonormal, (n, p), lower degrees first. The counts are cumulative, for
    each allowed degree.
    """
    grid = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    x, y = (each.ravel() for each in grid)
    columns_of: list[NDArray[np.float64]] = []
    counts: list[int] = []
    for degree in range(_DISTORTION_DEGREES[1] + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if degree > 0 and _CORNERS_PER_COEFFICIENT * (len(columns_of) + len(more)) > len(x):
            break
        columns_of += more
        if degree >= _DISTORTION_DEGREES[0]:
            counts.append(len(columns_of))
    basis, _ = np.linalg.qr(np.stack(columns_of, axis=1))
    return np.column_stack([x, y]), basis, np.array(counts or [len(columns_of)])
