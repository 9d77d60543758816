"""Reading a checkerboard through its corners: whether squares alternate, each by those around it."""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

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
_LARGER: Final = 0.9
"""Share of a line of squares beyond the board that alternate where the board goes on."""
_LEAST_LINE: Final = 3
"""Squares of such a line that must lie in the image for it to tell anything."""
_THIRD: Final = 3
_MOST_BENT: Final = 0.35
"""How far a corner may lie from the middle of its neighbours, as a share of their distance."""

Grid = NDArray[np.float64]
"""Corners by row and column, shape (rows, columns, 2), px."""


def shortest_square(grid: Grid) -> float:
    """Length of a square's edge in the image where it is shortest, px."""
    along_x, along_y = np.diff(grid, axis=1), np.diff(grid, axis=0)
    shortest = min((along_x**2).sum(axis=-1).min(), (along_y**2).sum(axis=-1).min())
    return float(np.sqrt(shortest))


def is_regular(grid: Grid) -> bool:
    """Whether corners follow each other evenly and the right way round, as a board's do."""
    across, down = np.diff(grid, axis=1), np.diff(grid, axis=0)
    # the image of a board is never a mirror's
    turn = across[:-1, :, 0] * down[:, :-1, 1] - across[:-1, :, 1] * down[:, :-1, 0]
    if not (turn > 0.0).all():
        return False
    for axis in range(2):
        step = np.diff(grid, axis=axis)
        bent = np.linalg.norm(np.diff(step, axis=axis), axis=-1)
        if (bent > 2.0 * _MOST_BENT * np.linalg.norm(step, axis=-1).mean()).any():
            return False
    return True


def reads(image: NDArray[np.uint8], grid: Grid, *, first_dark: bool = True) -> bool:
    """Whether squares alternate around the corners.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        first_dark: whether the upper left square is the dark one.
    """
    right, seen = _alternate(image, _extended(grid, 1, _OUTER_SHARE), first_dark)
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
    right, seen = _alternate(image, _extended(grid, 2), first_dark)
    for line in (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1]):
        count = int(seen[line].sum())
        if count >= _LEAST_LINE and (right & seen)[line].sum() >= _LARGER * count:
            return True
    return False


def unevenness(grid: Grid) -> float:
    """How far corners lie beside a smooth grid, as a standard deviation of each coordinate, px.

    It is what noise of pixels does not tell: uneven print, the pixel grid, compressed images. Of
    four corners in a row the third difference is free of a slope and of a curve, and has 20 times
    the variance of one; for rows of three it is the second difference, 6 times, less what
    perspective makes of it: that of the neighbouring row.

    Args:
        grid: the corners, nan where there is none.
    """
    squares, count = 0.0, 0
    for axis in range(2):
        if grid.shape[axis] > _THIRD:
            left = np.diff(grid, n=3, axis=axis) / np.sqrt(20.0)
        else:
            left = np.diff(np.diff(grid, n=2, axis=axis), axis=1 - axis) / np.sqrt(12.0)
        squares += float(np.nansum(left**2))
        count += int(np.isfinite(left).sum())
    return float(np.sqrt(squares / max(count, 1)))


def middles(grid: Grid) -> NDArray[np.float64]:
    """The middles of the squares between the corners, shape (n, 2), px."""
    return np.asarray(_middles(grid).reshape(-1, 2))


def _middles(grid: Grid) -> Grid:
    return 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])


def _extended(grid: Grid, rings: int, share: float = 1.0) -> Grid:
    """The corners, and those that would follow around them at a share of their distance."""
    for _ in range(rings):
        for axis in range(2):
            first, second = grid.take([0], axis), grid.take([1], axis)
            last, before = grid.take([-1], axis), grid.take([-2], axis)
            ends = first + share * (first - second), last + share * (last - before)
            grid = np.concatenate([ends[0], grid, ends[1]], axis=axis)
    return grid


def _alternate(
    image: NDArray[np.uint8], corners: Grid, first_dark: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which squares have their colour, and which lie in the image, shape (rows, columns)."""
    centres = _middles(corners)
    rows, columns = centres.shape[:2]
    step_x = _PROBE * 0.5 * (corners[1:, 1:] - corners[1:, :-1] + corners[:-1, 1:] - corners[:-1, :-1])
    step_y = _PROBE * 0.5 * (corners[1:, 1:] - corners[:-1, 1:] + corners[1:, :-1] - corners[:-1, :-1])
    probes = np.stack(
        [centres, centres + step_x, centres - step_x, centres + step_y, centres - step_y]
    )
    height, width = image.shape
    seen = ((probes > -0.5) & (probes < np.array([width, height]) - 0.5)).all(axis=(0, -1))
    remap: Any = cv2.remap
    sampled = remap(
        image, probes.reshape(5, -1, 2).astype(np.float32), None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    grey = sampled.astype(np.float64).mean(axis=0).reshape(rows, columns)
    y, x = np.mgrid[:rows, :columns]
    white = ((x + y) % 2 == 1) == first_dark
    light = _around(np.where(seen & white, grey, 0.0)) / np.maximum(_around(1.0 * (seen & white)), 1e-9)
    dark = _around(np.where(seen & ~white, grey, 0.0)) / np.maximum(_around(1.0 * (seen & ~white)), 1e-9)
    contrast = light - dark
    beyond = (grey - 0.5 * (light + dark)) * np.where(white, 1.0, -1.0)
    right = (contrast >= _LEAST_CONTRAST_GREY) & (beyond > _LEAST_SHARE * contrast)
    return right, seen


def _around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over each square and its eight neighbours."""
    return np.asarray(
        cv2.boxFilter(values, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    )
