"""Reading a checkerboard through its corners: whether squares alternate, by those around each."""

from functools import lru_cache
from math import comb, hypot, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled
from vergence.vision.plane import grey_at

_LEAST_CONTRAST_GREY: Final = 5.0
"""Between the light squares and the dark ones around a square."""
_LEAST_SHARE: Final = 0.15
"""How far a square must lie from the middle of both, as a share of the difference."""
_PROBE: Final = 0.2
"""Distance of the samples of a square from its middle."""
_MOST_WRONG: Final = 0.05
"""Share of the squares that glare or dirt may hide."""
_OUTER_SHARE: Final = 0.6
"""Of the outermost squares that is looked at: some boards print them half, lenses bend them, and
the image may end in them."""
_LARGER: Final = 0.75
"""Share of a line of squares beyond the board that alternate where the board goes on."""
_LEAST_LINE: Final = 3
"""Squares of such a line that must lie in the image for it to tell anything."""
_NEAR: Final = 3
_STRAY_PX: Final = 0.5
_STRAY_SQUARES: Final = 0.03
"""The end of a shadow that runs through a corner moves it by less."""
_STRAY: Final = 7.0
"""Times the median by which a corner lies beside the others' prediction, and is none."""
_HIGHEST: Final = 5
_BINOMIALS: Final = np.array(
    [[(-1.0) ** k * comb(n, k) for k in range(_HIGHEST + 1)] for n in range(_HIGHEST + 1)]
)
"""Signs and weights of the n-th difference."""
_MOST_BENT: Final = 0.35
"""How far a corner may lie from the middle of its neighbours, as a share of their distance."""

Grid = NDArray[np.float64]
"""Corners by row and column, shape (rows, columns, 2), px."""


def shortest_square(grid: Grid) -> float:
    """Length of a square's edge in the image where it is shortest, px."""
    along_x, along_y = np.diff(grid, axis=1), np.diff(grid, axis=0)
    shortest = min((along_x**2).sum(axis=-1).min(), (along_y**2).sum(axis=-1).min())
    return float(np.sqrt(shortest))


@compiled
def is_regular(grid: Grid) -> bool:
    """Whether corners follow each other evenly and the right way round, as a board's do."""
    rows, columns, _ = grid.shape
    for j in range(rows - 1):
        for i in range(columns - 1):
            u, v = grid[j, i + 1, 0] - grid[j, i, 0], grid[j, i + 1, 1] - grid[j, i, 1]
            x, y = grid[j + 1, i, 0] - grid[j, i, 0], grid[j + 1, i, 1] - grid[j, i, 1]
            if not u * y - v * x > 0.0:  # the image of a board is never a mirror's
                return False
    for j in range(rows):
        for i in range(columns):
            for down in range(2):
                across = 1 - down
                if j < down or i < across or j + down >= rows or i + across >= columns:
                    continue
                a, b = grid[j - down, i - across], grid[j + down, i + across]
                bent = hypot(a[0] + b[0] - 2.0 * grid[j, i, 0], a[1] + b[1] - 2.0 * grid[j, i, 1])
                if bent > _MOST_BENT * hypot(a[0] - b[0], a[1] - b[1]):
                    return False
    return True


def has_stray_corner(grid: Grid) -> bool:
    """Whether a corner lies beside where the others of its row and of its column say it is.

    A blob on a corner, or a finder's guess where it saw none, moves one corner and leaves its
    squares readable. Each is compared with the polynomial through the nearest others of its line;
    a stray one disagrees with both its lines, and its neighbours with one of theirs.

    Args:
        grid: the corners.
    """
    rows, columns, _ = grid.shape
    if min(rows, columns) <= _NEAR:
        return False
    beside = np.full(grid.shape[:2], np.inf)
    for axis, count in ((0, rows), (1, columns)):
        weights, norm = _from_others(count)
        left = grid - np.moveaxis(np.tensordot(weights, grid, (1, axis)), 0, axis)
        size = np.sqrt((left**2).sum(axis=-1)) / np.moveaxis(norm[:, None], 0, axis)
        beside = np.minimum(beside, size)
    least = max(_STRAY_PX, _STRAY_SQUARES * shortest_square(grid))
    return bool(beside.max() > max(least, _STRAY * float(np.median(beside))))


@lru_cache(maxsize=32)
def _from_others(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lagrange weights that predict each of a line's points from the nearest others.

    Returns:
        (count, count) weights; (count,) how much the difference scatters by a point's own scatter.
    """
    weights = np.zeros((count, count))
    for i in range(count):
        nearest = sorted((k for k in range(count) if k != i), key=lambda k: (abs(k - i), k))
        used = nearest[: min(_NEAR + 1, count - 1)]
        for k in used:
            others = [m for m in used if m != k]
            weights[i, k] = np.prod([(i - m) / (k - m) for m in others])
    return weights, np.sqrt(1.0 + (weights**2).sum(axis=1))


def reads(image: NDArray[np.uint8], grid: Grid, *, first_dark: bool = True) -> bool:
    """Whether squares alternate around the corners.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        first_dark: whether the upper left square is the dark one.
    """
    right, seen = _read(image, _extended(grid, 1, _OUTER_SHARE), first_dark)
    return bool((seen & ~right).sum() <= _MOST_WRONG * max(seen.sum(), 1)) and bool(
        seen[1:-1, 1:-1].all()
    )


def goes_on(image: NDArray[np.uint8], grid: Grid, *, first_dark: bool = True) -> bool:
    """Whether the squares alternate beyond the board: it is a part of a larger one.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        first_dark: whether the board's upper left square is the dark one.
    """
    # two rings on, the first square has the colour of the board's
    right, seen = _read(image, _extended(grid, 2), first_dark)
    for line in (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1]):
        count = int(seen[line].sum())
        if count >= _LEAST_LINE and (right & seen)[line].sum() >= _LARGER * count:
            return True
    return False


@compiled
def unevenness(grid: Grid) -> float:
    """How far corners lie beside a smooth grid, as a standard deviation of each coordinate, px.

    It is what noise of pixels does not tell: uneven print, the pixel grid, compressed images. The
    n-th difference of n + 1 corners in a row is free of what perspective and lens make of a line, a
    polynomial of degree n - 1 or nearly so, and has (2n)! / n!^2 times the variance of one
    coordinate. The fifth is taken, or that of as many corners as there are; in rows of three the
    second, less that of the next row.

    Args:
        grid: the corners, nan where there is none.
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


def middles(grid: Grid) -> NDArray[np.float64]:
    """The middles of the squares between the corners, shape (n, 2), px."""
    return np.asarray(_middles(grid).reshape(-1, 2))


def _read(
    image: NDArray[np.uint8], corners: Grid, first_dark: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    rows, columns, _ = corners.shape
    right, seen = np.empty((2, rows - 1, columns - 1), np.bool_)
    _alternate(image, corners, first_dark, right, seen)
    return right, seen


def _middles(grid: Grid) -> Grid:
    return 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])


def _extended(grid: Grid, rings: int, share: float = 1.0) -> Grid:
    """The corners, and those that would follow around them at a share of their distance."""
    for _ in range(rings):
        rows, columns, _two = grid.shape
        out = np.empty((rows + 2, columns + 2, 2))
        out[1:-1, 1:-1] = grid
        out[0, 1:-1] = (1.0 + share) * grid[0] - share * grid[1]
        out[-1, 1:-1] = (1.0 + share) * grid[-1] - share * grid[-2]
        out[:, 0] = (1.0 + share) * out[:, 1] - share * out[:, 2]
        out[:, -1] = (1.0 + share) * out[:, -2] - share * out[:, -3]
        grid = out
    return grid


@compiled
def _alternate(
    image: NDArray[np.uint8],
    corners: Grid,
    first_dark: bool,
    right: NDArray[np.bool_],
    seen: NDArray[np.bool_],
) -> None:
    """Which squares have their colour, and which lie in the image.

    Args:
        image: grey levels.
        corners: (rows + 1, columns + 1, 2) of the squares.
        first_dark: whether the upper left one is dark.
        right: (rows, columns) result.
        seen: (rows, columns) result.
    """
    height, width = image.shape
    rows, columns = right.shape
    greys = np.zeros((rows, columns))
    for j in range(rows):
        for i in range(columns):
            a, b = corners[j, i], corners[j, i + 1]
            c, d = corners[j + 1, i], corners[j + 1, i + 1]
            u, v = 0.25 * (a[0] + b[0] + c[0] + d[0]), 0.25 * (a[1] + b[1] + c[1] + d[1])
            seen[j, i] = True
            for probe in range(5):
                s = _PROBE * (1.0 if probe == 1 else -1.0 if probe == 2 else 0.0)
                t = _PROBE * (1.0 if probe == 3 else -1.0 if probe == 4 else 0.0)
                x = u + 0.5 * (s * (b[0] + d[0] - a[0] - c[0]) + t * (c[0] + d[0] - a[0] - b[0]))
                y = v + 0.5 * (s * (b[1] + d[1] - a[1] - c[1]) + t * (c[1] + d[1] - a[1] - b[1]))
                if not (-0.5 < x < width - 0.5 and -0.5 < y < height - 0.5):
                    seen[j, i] = False
                    break
                greys[j, i] += 0.2 * grey_at(image, x, y)
    for j in range(rows):
        for i in range(columns):
            right[j, i] = False
            if not seen[j, i]:
                continue
            light = dark = lights = darks = 0.0
            for row in range(max(j - 1, 0), min(j + 2, rows)):
                for column in range(max(i - 1, 0), min(i + 2, columns)):
                    if not seen[row, column]:
                        continue
                    if ((row + column) % 2 == 1) == first_dark:
                        light += greys[row, column]
                        lights += 1.0
                    else:
                        dark += greys[row, column]
                        darks += 1.0
            if lights == 0.0 or darks == 0.0:
                continue
            light, dark = light / lights, dark / darks
            beyond = greys[j, i] - 0.5 * (light + dark)
            if ((j + i) % 2 == 1) != first_dark:
                beyond = -beyond
            contrast = light - dark
            right[j, i] = contrast >= _LEAST_CONTRAST_GREY and beyond > _LEAST_SHARE * contrast
