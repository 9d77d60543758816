"""Reading a checkerboard through its corners: whether squares alternate, by those around each."""

from math import hypot
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
"""Share of the corners beyond the board at which four squares meet where the board goes on."""
_LEAST_LINE: Final = 2
"""Corners of such a line that must lie in the image for it to tell anything."""
_LEAST_STEP: Final = 0.4
"""From light to dark between squares beyond the board, by that between the board's own. Of 4,440
parts of boards in public photographs all go on with 0.45, all but two with 0.5; with 0.35 one of
12,496 sides at which a board ends goes on."""
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
    """Whether four squares meet at the corners that would follow: it is a part of a larger board.

    What is seen beyond a board may well alternate. At a corner it does so along the line and
    across it, by about as much as the board's own squares.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        first_dark: whether the board's upper left square is the dark one.
    """
    return bool(_goes_on(image, grid, first_dark))


def middles(grid: Grid) -> NDArray[np.float64]:
    """The middles of the squares between the corners, shape (n, 2), px."""
    return np.asarray(_middles(grid).reshape(-1, 2))


def _read(
    image: NDArray[np.uint8], corners: Grid, first_dark: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    greys, seen = _sampled(image, corners)
    right = np.empty(seen.shape, np.bool_)
    _alternate(greys, seen, first_dark, right)
    return right, seen


def _sampled(
    image: NDArray[np.uint8], corners: Grid
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The grey level of each square between some corners, and whether it lies in the image."""
    rows, columns, _ = corners.shape
    greys, seen = np.zeros((rows - 1, columns - 1)), np.empty((rows - 1, columns - 1), np.bool_)
    _sample(image, corners, greys, seen)
    return greys, seen


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
def _sample(
    image: NDArray[np.uint8],
    corners: Grid,
    greys: NDArray[np.float64],
    seen: NDArray[np.bool_],
) -> None:
    """Grey levels of squares, and which lie in the image.

    Args:
        image: grey levels.
        corners: (rows + 1, columns + 1, 2) of the squares.
        greys: (rows, columns) result, to which they are added.
        seen: (rows, columns) result.
    """
    height, width = image.shape
    rows, columns = seen.shape
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


@compiled
def _alternate(
    greys: NDArray[np.float64],
    seen: NDArray[np.bool_],
    first_dark: bool,
    right: NDArray[np.bool_],
) -> None:
    """Which squares have their colour.

    Args:
        greys: (rows, columns) of the squares.
        seen: (rows, columns) whether they lie in the image.
        first_dark: whether the upper left one is dark.
        right: (rows, columns) result.
    """
    rows, columns = right.shape
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


@compiled
def _goes_on(image: NDArray[np.uint8], grid: Grid, first_dark: bool) -> bool:
    """See `goes_on`."""
    rows, columns, _ = grid.shape
    for side in range(4):
        across, last = side < 2, side % 2 == 1  # along a row; below or on the right
        count = columns if across else rows
        depth = rows if across else columns
        # the next but one line of corners, the next one, and two of the board, with their ends; of
        # what may be a larger board's outermost squares, the near part
        lines = np.empty((4, count + 2, 2))
        for i in range(count):
            for k in range(2):
                at = depth - 1 - k if last else k
                for n in range(2):
                    lines[2 + k, 1 + i, n] = grid[at, i, n] if across else grid[i, at, n]
            for n in range(2):
                step = lines[2, 1 + i, n] - lines[3, 1 + i, n]
                lines[1, 1 + i, n] = lines[2, 1 + i, n] + step
                lines[0, 1 + i, n] = lines[1, 1 + i, n] + _OUTER_SHARE * step
        for k in range(4):
            for n in range(2):
                step = lines[k, 1, n] - lines[k, 2, n]
                lines[k, 0, n] = lines[k, 1, n] + _OUTER_SHARE * step
                step = lines[k, count, n] - lines[k, count - 1, n]
                lines[k, count + 1, n] = lines[k, count, n] + _OUTER_SHARE * step
        greys, seen = np.zeros((3, count + 1)), np.empty((3, count + 1), np.bool_)
        _sample(image, lines, greys, seen)
        turned = last and depth % 2 == 1  # whether the colours are the other way round there
        for k in range(3):
            for i in range(count + 1):
                if ((k + i) % 2 == 0) != (first_dark != turned):
                    greys[k, i] = -greys[k, i]  # of dark squares
        own = 0.0
        for i in range(1, count - 1):
            own += (greys[2, i] + greys[2, i + 1]) / (count - 2)
        corners = met = 0
        for i in range(count):
            if not (seen[0, i] and seen[0, i + 1] and seen[1, i] and seen[1, i + 1]):
                continue
            corners += 1
            along = min(greys[0, i] + greys[0, i + 1], greys[1, i] + greys[1, i + 1])
            beyond = min(greys[0, i] + greys[1, i], greys[0, i + 1] + greys[1, i + 1])
            if min(along, beyond) > _LEAST_STEP * own:
                met += 1
        if corners >= _LEAST_LINE and met >= _LARGER * corners:
            return True
    return False
