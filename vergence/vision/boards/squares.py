"""Check a checkerboard's image: squares that alternate, each compared with its neighbours."""

from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled
from vergence.vision.plane import grey_at

_LEAST_CONTRAST_GREY: Final = 5.0
"""Least contrast between light and dark squares around a square, grey levels (chosen)."""
_LEAST_SQUARE_DEVIATION: Final = 0.15
"""Least deviation of a square from the mean of light and dark, as a fraction of the contrast
(chosen)."""
_PROBE_SQUARES: Final = 0.2
"""Distance of the samples of a square from its centre, in squares (chosen)."""
_MAX_WRONG_FRACTION: Final = 0.05
"""Largest fraction of squares with a wrong colour, such as by glare or dirt (chosen)."""
_OUTER_SHARE: Final = 0.6
"""Fraction of the outermost squares that is sampled (chosen: some boards print only half of them,
lenses bend them, and the image may end in them)."""
_CONTINUING_FRACTION: Final = 0.75
"""Least fraction of the corners on the line beyond a side at which four squares must meet for the
board to continue there (chosen)."""
_LEAST_LINE_CORNERS: Final = 2
"""Least number of corners of such a line inside the image (chosen)."""
_LEAST_OUTER_CONTRAST: Final = 0.4
"""Least contrast between squares beyond the board, as a fraction of the board's own contrast. Of
4,440 parts of boards in public photographs all continue with 0.45, all but two with 0.5; with 0.35
one of 12,496 true sides of boards seems to continue (chosen by these counts)."""
_MAX_SECOND_DIFFERENCE: Final = 0.35
"""Largest second difference of a corner and its two neighbours, as a fraction of the neighbours'
distance (chosen)."""

Grid = NDArray[np.float64]
"""Corners by row and column, shape (rows, columns, 2), px."""


def shortest_square_edge_px(grid: Grid) -> float:
    """Length of the shortest edge of a square in the image, px."""
    along_x, along_y = np.diff(grid, axis=1), np.diff(grid, axis=0)
    shortest = min((along_x**2).sum(axis=-1).min(), (along_y**2).sum(axis=-1).min())
    return float(np.sqrt(shortest))


@compiled
def is_even_unmirrored_grid(grid: Grid) -> bool:
    """Check that corners form an even grid that is not mirrored."""
    rows, columns, _ = grid.shape
    for j in range(rows - 1):
        for i in range(columns - 1):
            u, v = grid[j, i + 1, 0] - grid[j, i, 0], grid[j, i + 1, 1] - grid[j, i, 1]
            x, y = grid[j + 1, i, 0] - grid[j, i, 0], grid[j + 1, i, 1] - grid[j, i, 1]
            if not u * y - v * x > 0.0:  # the image of a board is never mirrored
                return False
    for j in range(rows):
        for i in range(columns):
            for down in range(2):
                across = 1 - down
                if j < down or i < across or j + down >= rows or i + across >= columns:
                    continue
                a, b = grid[j - down, i - across], grid[j + down, i + across]
                bent = hypot(a[0] + b[0] - 2.0 * grid[j, i, 0], a[1] + b[1] - 2.0 * grid[j, i, 1])
                if bent > _MAX_SECOND_DIFFERENCE * hypot(a[0] - b[0], a[1] - b[1]):
                    return False
    return True


def squares_alternate(
    image: NDArray[np.uint8], grid: Grid, *, upper_left_dark: bool = True
) -> bool:
    """Check that squares alternate around the corners, up to a few wrong ones.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        upper_left_dark: true if the upper left square is dark.
    """
    right, seen = _read(image, _extended(grid, 1, _OUTER_SHARE), upper_left_dark)
    return bool((seen & ~right).sum() <= _MAX_WRONG_FRACTION * max(seen.sum(), 1)) and bool(
        seen[1:-1, 1:-1].all()
    )


def board_continues_beyond(
    image: NDArray[np.uint8], grid: Grid, *, upper_left_dark: bool = True
) -> bool:
    """Check for four squares at the next corners beyond a side: a part of a larger board.

    The surroundings of a board may alternate by chance. At a corner they must do so both along the
    line of corners and across it, with nearly the contrast of the board's own squares.

    Args:
        image: grey levels, shape (height, width).
        grid: the corners.
        upper_left_dark: true if the board's upper left square is dark.
    """
    return bool(_continues_beyond(image, grid, upper_left_dark))


def square_centres(grid: Grid) -> NDArray[np.float64]:
    """Centres of the squares between the corners, shape (n, 2), px."""
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
    """Grey level of each square between some corners, and a mask of those inside the image."""
    rows, columns, _ = corners.shape
    greys, seen = np.zeros((rows - 1, columns - 1)), np.empty((rows - 1, columns - 1), np.bool_)
    _sample(image, corners, greys, seen)
    return greys, seen


def _middles(grid: Grid) -> Grid:
    return 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])


def _extended(grid: Grid, rings: int, share: float = 1.0) -> Grid:
    """Corners with rings of extrapolated ones around them, at a fraction of the spacing."""
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
    """Sample the grey levels of squares.

    Args:
        image: grey levels.
        corners: (rows + 1, columns + 1, 2) corners of the squares, px.
        greys: (rows, columns) result, mean grey levels, added to its content.
        seen: (rows, columns) result, mask of the squares inside the image.
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
                s = _PROBE_SQUARES * (1.0 if probe == 1 else -1.0 if probe == 2 else 0.0)
                t = _PROBE_SQUARES * (1.0 if probe == 3 else -1.0 if probe == 4 else 0.0)
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
    """Mark the squares with the correct colour.

    Args:
        greys: (rows, columns) grey levels of the squares.
        seen: (rows, columns) mask of the squares inside the image.
        first_dark: true if the upper left square is dark.
        right: (rows, columns) result, mask of the correct squares.
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
            right[j, i] = (
                contrast >= _LEAST_CONTRAST_GREY and beyond > _LEAST_SQUARE_DEVIATION * contrast
            )


@compiled
def _continues_beyond(image: NDArray[np.uint8], grid: Grid, first_dark: bool) -> bool:
    """Implement `board_continues_beyond`."""
    rows, columns, _ = grid.shape
    for side in range(4):
        across, last = side < 2, side % 2 == 1  # the line is a row; it is below or on the right
        count = columns if across else rows
        depth = rows if across else columns
        # lines of corners with their ends: the second and the first beyond the board, and two of
        # the board; of possible outermost squares only the near part
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
        turned = last and depth % 2 == 1  # true if the colours are exchanged there
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
            if min(along, beyond) > _LEAST_OUTER_CONTRAST * own:
                met += 1
        if corners >= _LEAST_LINE_CORNERS and met >= _CONTINUING_FRACTION * corners:
            return True
    return False
