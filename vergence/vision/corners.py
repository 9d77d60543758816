"""Corners of boards: refinement, their sigma, and checks of squares and of spacing."""

from functools import lru_cache
from math import comb, exp, hypot, nan, sqrt
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled
from vergence.models.parts import FloatArray
from vergence.vision.optics import grey_at

_TERMINATION: Final = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 3e-3)
"""Termination of `cornerSubPix`: iterations, and a step in pixels of the enlarged window
(numerical)."""
_BLUR_PX: Final = 0.6
"""Standard deviation of the blur before refinement, px (chosen: less bias by aliasing)."""
_RIM_PX: Final = 4
"""Rim of pixels around a window for its blur and the moves of a corner, px (numerical)."""
_QUARTER_WEIGHT_PX: Final = 0.8
"""Distance of an edge from a corner at which its weight is a quarter, px (chosen)."""
_ITERATIONS: Final = 40
"""Most iterations (numerical)."""
_CONVERGED_STEP_PX: Final = 2e-3
"""Convergence tolerance of a step, px (numerical)."""
_LEAST_SQUARED_GRADIENT: Final = 1.0
"""Least squared gradient of a pixel on an edge, (grey levels / px)^2 (chosen: noise)."""
_LEAST_DETERMINANT_RATIO: Final = 0.01
"""Least ratio of determinant to squared trace of the normal matrix; edges that do not cross have a
smaller one (numerical)."""
_LEAST_NOISE_GREY: Final = 0.3
"""Least noise, that of rounding, 1 / sqrt(12), standard deviation in grey levels (numerical)."""


def refine_corners(
    image: NDArray[np.uint8], corners: NDArray[np.float64], half_side_px: int
) -> NDArray[np.float64]:
    """Refine corners to sub-pixel accuracy by OpenCV's ``cornerSubPix``.

    OpenCV takes differences over two pixels, which causes aliasing on edges of a sharp lens and
    biases corners towards the pixel grid. A light blur and doubled sampling divide that bias by
    three or four.

    Args:
        image: grey levels, shape (height, width).
        corners: initial corners, accurate to the window, px, shape (n, 2).
        half_side_px: half the window's side, px. Another edge in the window causes errors of
            pixels.

    Returns:
        Refined corners, px, shape (n, 2).
    """
    rim = half_side_px + _RIM_PX
    size = 2 * rim + 1
    whole = np.rint(corners).astype(int) - rim
    smooth = cv2.GaussianBlur(_windows(image, whole, size), (3, 3), _BLUR_PX)
    twice = cv2.resize(smooth, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
    # the windows are side by side in one image: corners are shifted by their windows
    shift = whole.astype(float)
    shift[:, 0] -= size * np.arange(len(corners))
    start = ((corners - shift + 0.5) * 2 - 0.5).astype(np.float32)
    fine = cv2.cornerSubPix(
        twice, start, (2 * half_side_px, 2 * half_side_px), (-1, -1), _TERMINATION
    )
    return np.asarray((fine.astype(float) + 0.5) / 2 - 0.5 + shift, float)


def remaining_move_px(
    image: NDArray[np.uint8], corners: NDArray[np.float64], half_side_px: int
) -> NDArray[np.float64]:
    """Remaining move of refined corners by one more iteration, shape (n,), px.

    OpenCV returns a corner unchanged if it would leave its window; the remaining move reveals
    this.

    Args:
        image: grey levels, shape (height, width).
        corners: refined corners, px, shape (n, 2).
        half_side_px: half the side of the window of refinement, px.
    """
    return _moves(image, corners, half_side_px)[:, 0]


def refine_corners_robustly(
    image: NDArray[np.uint8], corners: NDArray[np.float64], half_side_px: int
) -> NDArray[np.float64]:
    r"""Refine corners by the edges that meet at them, robust to other edges in the window.

    This minimises as `refine_corners` does, but weights a pixel whose edge passes the corner at a
    distance d by 1 / (1 + (d / s)^2)^2 (Geman and McClure). Edges of shadows and of the next
    squares so have little influence.

    Args:
        image: grey levels, shape (height, width).
        corners: initial corners, accurate to a pixel or two, px, shape (n, 2).
        half_side_px: half the window's side, px.

    Returns:
        Refined corners, px, shape (n, 2); nan if no two edges cross or the window is left.
    """
    out = np.empty(corners.shape)
    _refine_corners_robustly(image, np.ascontiguousarray(corners), half_side_px, out)
    return out


@compiled
def _refine_corners_robustly(
    image: NDArray[np.uint8], corners: FloatArray, half_side_px: int, out: FloatArray
) -> None:
    height, width = image.shape
    for n in range(len(corners)):
        u, v = corners[n, 0], corners[n, 1]
        out[n, 0] = out[n, 1] = nan
        for _ in range(_ITERATIONS):
            a = b = c = p = q = 0.0
            x, y = int(u + 0.5), int(v + 0.5)
            for row in range(max(y - half_side_px, 1), min(y + half_side_px, height - 2) + 1):
                for column in range(max(x - half_side_px, 1), min(x + half_side_px, width - 2) + 1):
                    g = h = 0.0
                    for k in range(-1, 2):  # Sobel's
                        share = 0.25 if k == 0 else 0.125
                        right, left = image[row + k, column + 1], image[row + k, column - 1]
                        below, above = image[row + 1, column + k], image[row - 1, column + k]
                        g += share * (float(right) - float(left))
                        h += share * (float(below) - float(above))
                    steep = g * g + h * h
                    if steep < _LEAST_SQUARED_GRADIENT:
                        continue
                    dx, dy = column - u, row - v
                    along = g * dx + h * dy
                    weight = exp(-(dx * dx + dy * dy) / half_side_px**2)
                    weight /= (1.0 + along * along / steep / _QUARTER_WEIGHT_PX**2) ** 2
                    a, b, c = a + weight * g * g, b + weight * g * h, c + weight * h * h
                    p, q = p + weight * g * along, q + weight * h * along
            det = a * c - b * b
            if not det > _LEAST_DETERMINANT_RATIO * (a + c) ** 2:
                break
            du, dv = (c * p - b * q) / det, (a * q - b * p) / det
            u, v = u + du, v + dv
            if max(abs(u - corners[n, 0]), abs(v - corners[n, 1])) > half_side_px:
                break
            if du * du + dv * dv < _CONVERGED_STEP_PX**2:
                out[n, 0], out[n, 1] = u, v
                break


def corner_sigmas(
    image: NDArray[np.uint8], corners: NDArray[np.float64], half_side_px: int, noise_grey: float
) -> NDArray[np.float64]:
    r"""Standard deviations of refined corners due to pixel noise.

    A corner q solves `sum g g^T (p - q) = 0` over the pixels p of its window with their gradients
    g. At the corner g is perpendicular to p - q. To first order, gradient noise n moves q by

        dq = A^-1 sum g n^T (p - q),    A = sum g g^T,

    Args:
        image: grey levels, shape (height, width).
        corners: refined corners, px, shape (n, 2).
        half_side_px: half the side of the window of refinement, px.
        noise_grey: standard deviation of a pixel's grey level.

    Returns:
        Standard deviations, px, shape (n, 2).
    """
    return noise_grey * _moves(image, corners, half_side_px)[:, 1:]


@compiled
def _moves(image: NDArray[np.uint8], corners: FloatArray, half_side_px: int) -> FloatArray:
    """Remaining move of each corner, and standard deviations by noise of 1 grey level, (n, 3)."""
    height, width = image.shape
    out = np.empty((len(corners), 3))
    for n in range(len(corners)):
        u, v = corners[n, 0], corners[n, 1]
        a = b = c = d = e = p = q = r = 0.0
        x, y = int(u + 0.5), int(v + 0.5)
        for row in range(max(y - half_side_px, 1), min(y + half_side_px, height - 2) + 1):
            for column in range(max(x - half_side_px, 1), min(x + half_side_px, width - 2) + 1):
                g = 0.5 * (float(image[row, column + 1]) - float(image[row, column - 1]))
                h = 0.5 * (float(image[row + 1, column]) - float(image[row - 1, column]))
                dx, dy = column - u, row - v
                away = dx * dx + dy * dy
                weight = exp(-away / half_side_px**2)  # OpenCV's weight
                along = g * dx + h * dy
                a, b, c = a + weight * g * g, b + weight * g * h, c + weight * h * h
                d, e = d + weight * g * along, e + weight * h * along
                # a central difference of white noise has half the variance of the noise
                moved = 0.5 * weight * weight * away
                p, q, r = p + moved * g * g, q + moved * g * h, r + moved * h * h
        det = max(a * c - b * b, 1e-9)
        out[n, 0] = sqrt((c * d - b * e) ** 2 + (a * e - b * d) ** 2) / det
        out[n, 1] = sqrt(max(c * c * p - 2.0 * b * c * q + b * b * r, 0.0)) / det
        out[n, 2] = sqrt(max(b * b * p - 2.0 * a * b * q + a * a * r, 0.0)) / det
    return out


@compiled
def crossing_asymmetries(
    image: NDArray[np.uint8], corners: FloatArray, half_side_px: int
) -> FloatArray:
    """Differences of the image around each corner from its reverse, turned by 180 degrees.

    Args:
        image: grey levels, shape (height, width).
        corners: corners, px, shape (n, 2).
        half_side_px: half the side of the window, px.

    Returns:
        (n,) mean square difference over twice the variance: near 0 where two edges cross, 1 where
        the halves have nothing in common, 4 / 3 at the corner of a square, 2 at an edge.
    """
    height, width = image.shape
    out = np.empty(len(corners))
    for n in range(len(corners)):
        x2, y2 = int(2.0 * corners[n, 0] + 0.5), int(2.0 * corners[n, 1] + 0.5)
        x, y = x2 // 2, y2 // 2
        count = sum_ = squares = differences = 0.0
        for row in range(max(y - half_side_px, 0), min(y + half_side_px, height - 1) + 1):
            for column in range(max(x - half_side_px, 0), min(x + half_side_px, width - 1) + 1):
                if 0 <= y2 - row < height and 0 <= x2 - column < width:
                    level = float(image[row, column])
                    difference = level - float(image[y2 - row, x2 - column])
                    count, sum_, squares = count + 1.0, sum_ + level, squares + level * level
                    differences += difference * difference
        spread = squares - sum_ * sum_ / max(count, 1.0)
        out[n] = differences / max(2.0 * spread, 1e-9)
    return out


def estimate_noise_grey(image: NDArray[np.uint8], flat_points_px: NDArray[np.float64]) -> float:
    """Estimate the pixel noise at points inside squares of one colour.

    Args:
        image: grey levels, shape (height, width).
        flat_points_px: these points, px, shape (n, 2); those at the image's edge are left out.

    Returns:
        Standard deviation of a pixel's grey level, from a trimmed mean over the points; at least
        that of rounding.
    """
    height, width = image.shape
    x, y = np.rint(flat_points_px).astype(int).T
    inside = (x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)
    if not inside.any():
        return _LEAST_NOISE_GREY
    x, y = x[inside], y[inside]
    step = np.array([-1, 0, 1])
    patch = image[y[:, None, None] + step[:, None], x[:, None, None] + step].astype(float)
    # second differences, which cancel a gradient of light; 36 is their variance
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    second = np.abs((patch * mask).sum(axis=(1, 2)))
    # 0.7 stands for the mean of the lower 90 % of |n| over sigma (0.66 if n is normal)
    return max(float(np.mean(np.sort(second)[: max(len(second) * 9 // 10, 1)])) / 6.0 / 0.7,
               _LEAST_NOISE_GREY)  # fmt: skip


def _windows(image: NDArray[np.uint8], corners: NDArray[np.int_], size: int) -> NDArray[np.uint8]:
    """Square windows of an image side by side; pixels beyond its border repeat the last ones."""
    height, width = image.shape
    out = np.empty((size, size * len(corners)), np.uint8)
    for i, (x, y) in enumerate(corners.tolist()):
        place = out[:, i * size : (i + 1) * size]
        if x >= 0 and y >= 0 and x + size <= width and y + size <= height:
            place[:] = image[y : y + size, x : x + size]
        else:
            rows = np.clip(np.arange(y, y + size), 0, height - 1)
            columns = np.clip(np.arange(x, x + size), 0, width - 1)
            place[:] = image[np.ix_(rows, columns)]
    return out


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
