"""Corners of boards: refinement, their sigma, and checks of their spacing."""

from functools import lru_cache
from math import comb, exp, hypot, nan, sqrt
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled
from vergence.models.parts import FloatArray
from vergence.vision.optics import Image, fit_homography

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
WINDOW_PX: Final = (2, 5)
"""Range of the half side of the refinement window, px (chosen)."""
WINDOW_FRACTION: Final = 0.6
"""Half side of that window as a fraction of the distance to the next edge (chosen: more pixels
against disturbance by that edge)."""
MAX_TRACKED_MOVE_SQUARES: Final = 0.35
"""Largest move of a tracked corner, in squares, before its region is searched again (chosen)."""
DEFAULT_SIGMA_PX: Final = 0.1
"""Standard deviation of corners too few to estimate their noise, px (chosen)."""
MAX_ENLARGED_PIXELS: Final = 2_000_000
"""Largest image that is enlarged if no marker is found, pixels (chosen: search time)."""
_MAX_REMAINING_MOVE_PX: Final = 0.5
"""Largest remaining move of a corner that counts as refined, px (chosen)."""

Grid = FloatArray
"""Corners by row and column, shape (rows, columns, 2), px."""


def in_image(image: Image, corners: FloatArray) -> NDArray[np.bool_]:
    """Mask of the corners, (n, 2), that lie inside the image; nan does not."""
    height, width = image.shape
    return np.asarray(((corners > 0.0) & (corners < (width - 1.0, height - 1.0))).all(axis=1))


def refine_corners(image: Image, corners: FloatArray, half_side_px: int) -> FloatArray:
    """Refine corners to sub-pixel accuracy by OpenCV's ``cornerSubPix``."""
    # OpenCV takes differences over two pixels, which biases corners on edges of a sharp lens
    # towards the pixel grid. A light blur and doubled sampling divide that bias by three or four.
    size = 2 * (half_side_px + _RIM_PX) + 1
    whole = np.rint(corners).astype(int) - size // 2
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


@compiled
def _windows(image: Image, starts: NDArray[np.int_], size: int) -> Image:
    """Square windows of an image side by side; pixels beyond its border repeat the last ones."""
    height, width = image.shape
    out = np.empty((size, size * len(starts)), np.uint8)
    for row in range(size):
        for n in range(len(starts)):
            y = min(max(starts[n, 1] + row, 0), height - 1)
            for column in range(size):
                x = min(max(starts[n, 0] + column, 0), width - 1)
                out[row, n * size + column] = image[y, x]
    return out


def refine_and_check(
    image: Image, start: FloatArray, half_side_px: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
    """Refine corners; also the moves of each, (n,) px, a mask of the settled, and `unit_sigmas`."""
    refined = refine_corners(image, start, half_side_px)
    # OpenCV returns a corner unchanged if it would leave its window; one more move reveals this
    more = _moves(image, refined, half_side_px)
    settled = more[:, 0] <= _MAX_REMAINING_MOVE_PX
    return refined, np.abs(refined - start).max(axis=1), settled, more[:, 1:]


@compiled
def refine_corners_robustly(image: Image, corners: FloatArray, half_side_px: int) -> FloatArray:
    """Refine corners robustly to edges beside them; nan where none cross, or the window is left."""
    # Minimises as `refine_corners` does, but weights a pixel whose edge passes the corner at a
    # distance d by 1 / (1 + (d / s)^2)^2 (Geman and McClure): edges of shadows count for little.
    out = np.empty((len(corners), 2))
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
    return out


def unit_sigmas(image: Image, corners: FloatArray, half_side_px: int) -> FloatArray:
    """(n, 2) standard deviations of refined corners, px, by pixel noise of 1 grey level."""
    return _moves(image, corners, half_side_px)[:, 1:]


@compiled
def _moves(image: Image, corners: FloatArray, half_side_px: int) -> FloatArray:
    """Remaining move of each corner, and its `unit_sigmas`, (n, 3)."""
    # A corner q solves sum g g^T (p - q) = 0 over the pixels p of its window with their gradients
    # g, which are perpendicular to p - q there. To first order, gradient noise n moves q by
    # A^-1 sum g n^T (p - q), with A = sum g g^T.
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
def crossing_asymmetries(image: Image, corners: FloatArray, half_side_px: int) -> FloatArray:
    """Mean square difference around each corner, turned by 180 degrees, over twice the variance."""
    # near 0 where edges cross, 1 where halves are unlike, 4 / 3 at a square's corner, 2 at an edge
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


def pixel_noise_grey(image: Image, flat_points_px: FloatArray) -> float:
    """Standard deviation of a pixel, grey levels, at points in squares of one colour, (n, 2)."""
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
    second = np.sort(np.abs((patch * mask).sum(axis=(1, 2))))
    # 0.7 stands for the mean of the lower 90 % of |n| over sigma (0.66 if n is normal)
    lower = second[: max(len(second) * 9 // 10, 1)]
    return max(float(lower.mean()) / 6.0 / 0.7, _LEAST_NOISE_GREY)


_MAX_SECOND_DIFFERENCE: Final = 0.35
"""Largest second difference of a corner and its two neighbours, as a fraction of the neighbours'
distance (chosen)."""


def window_half_side_px(wanted_px: float, limits_px: tuple[int, int] = WINDOW_PX) -> int:
    """Half side of a window within its limits, px."""
    return int(min(max(round(wanted_px), limits_px[0]), limits_px[1]))


def shortest_square_edge_px(grid: Grid) -> float:
    """Length of the shortest edge of a square in the image, px, with corners of nan unknown."""
    squares = [(np.diff(grid, axis=axis) ** 2).sum(axis=-1).ravel() for axis in (0, 1)]
    return float(np.sqrt(np.fmin.reduce(np.concatenate(squares))))


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


def square_centres(grid: Grid) -> FloatArray:
    """Centres of the squares between the corners, shape (n, 2), px."""
    centres = 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])
    return np.asarray(centres.reshape(-1, 2))


_MAX_DIFFERENCE_ORDER: Final = 5
"""Highest order of differences along a row (chosen: removes lens distortion, needs six corners)."""
_ORDERS: Final = range(_MAX_DIFFERENCE_ORDER + 1)
_BINOMIALS: Final = np.array([[(-1.0) ** k * comb(n, k) for k in _ORDERS] for n in _ORDERS])
"""Coefficients of the n-th difference, row n."""
_SUMS_OF_SQUARES: Final = np.array([float(comb(2 * n, n)) for n in _ORDERS])
"""Sums of the squares of these coefficients."""


@compiled
def corner_scatter_px(grid: FloatArray) -> float:
    """Standard deviation of corners, nan if unknown, about a smooth grid, per coordinate, px."""
    # Perspective and lens turn a line into a polynomial, nearly of degree n - 1, which the n-th
    # difference of n + 1 corners in a row cancels; it has (2n)! / n!^2 times the variance of one
    # coordinate. In rows of three n is two, and the difference of the next row is subtracted.
    squares, count = 0.0, 0
    for axis in range(2):
        along = grid if axis == 1 else grid.transpose(1, 0, 2)
        rows, columns, _ = along.shape
        order = min(columns - 1, _MAX_DIFFERENCE_ORDER)
        if columns < 3 or rows < 2:
            continue
        norm = _SUMS_OF_SQUARES[order]
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


_LEAST_GRID_DEGREE: Final = 3
_MAX_GRID_DEGREE: Final = 6
"""Lowest and highest degree of the polynomial that models lens distortion on top of a homography
of a checkerboard (chosen)."""
_CORNERS_PER_COEFFICIENT: Final = 1.6
"""Least number of corners per coefficient of that polynomial (chosen: avoids overfitting)."""


class _PolynomialFit(NamedTuple):
    """Residuals of corners after the polynomial that explains them best."""

    coefficients: int  # number of its terms, the first ones
    unexplained: float  # sum of the squared residuals
    free: float  # degrees of freedom that are left, of each coordinate
    residuals: FloatArray  # (n, 2) px
    independence: FloatArray  # (n,) ratio of each residual to that from a fit to others


def _fit_polynomial(
    values: FloatArray, basis: FloatArray, counts: NDArray[np.intp], spent: int = 0
) -> _PolynomialFit:
    """Fit the first orthonormal polynomials, (n, p), of one of some counts to values, (n, 2)."""
    # the least generalised cross validation (Golub, Heath, Wahba 1979); an earlier fit has spent
    # some parameters per coordinate
    shares = basis.T @ values
    explained = np.concatenate([[0.0], np.cumsum((shares**2).sum(axis=1))])[counts]
    unexplained = np.maximum((values**2).sum() - explained, 0.0)
    free = np.maximum(len(values) - (counts + spent), 1e-9)
    best = int(np.argmin(unexplained / free**2))
    used = basis[:, : counts[best]]
    return _PolynomialFit(
        int(counts[best]), float(unexplained[best]), float(free[best]),
        values - used @ shares[: counts[best]],
        1.0 - (used**2).sum(axis=1) - spent / len(values),
    )  # fmt: skip


def _allowed_monomials(
    places: FloatArray, highest: int, corners_per_coefficient: float, spent: int = 0
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Monomials (n, p) that corners at places in -1..1 determine; cumulative counts by degree.

    Those of higher degree than there are rows or columns are left out, and so are degrees for which
    there are too few corners beside the `spent` parameters.
    """
    x, y = places.T
    columns, rows = (len(np.unique(np.rint(1e6 * each))) for each in (x, y))
    terms: list[FloatArray] = []
    counts: list[int] = []
    for degree in range(highest + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        needed = corners_per_coefficient * (len(terms) + len(more)) + spent
        if degree > 0 and needed > len(x):
            break
        terms += more
        counts.append(len(terms))
    return np.stack(terms, axis=1), np.array(counts)


def loo_residuals_and_scales(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Residual of each corner from its prediction by all others, (n, 2) px, and its scale, (n,)."""
    # the scale is by how much leaving the corner out raises the residual's standard deviation
    rows, columns, _ = grid.shape
    places, basis, counts = _polynomials(rows, columns)
    outer = [0, columns - 1, len(places) - 1, len(places) - columns]
    corners = grid.reshape(-1, 2)
    transform = cv2.getPerspectiveTransform(
        places[outer].astype(np.float32), corners[outer].astype(np.float32)
    )
    values = corners - cv2.perspectiveTransform(places[None], transform)[0]
    fit = _fit_polynomial(values, basis, counts)
    return fit.residuals / fit.independence[:, None], 1.0 / np.sqrt(fit.independence)


@lru_cache(maxsize=32)
def _polynomials(rows: int, columns: int) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Corners of a board scaled to -1..1, (n, 2); polynomials on them; their count per degree."""
    x, y = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    places = np.column_stack([x.ravel(), y.ravel()])
    terms, counts = _allowed_monomials(places, _MAX_GRID_DEGREE, _CORNERS_PER_COEFFICIENT)
    allowed = counts[_LEAST_GRID_DEGREE:] if len(counts) > _LEAST_GRID_DEGREE else counts[-1:]
    return places, np.linalg.qr(terms)[0], allowed


_COARSE_DEGREE: Final = 3
_FINE_DEGREE: Final = 8
"""Highest degree of the polynomial that models lens distortion on top of a homography of a part of
a board: in the first fit, which finds corners mistaken for others, and in the final one (chosen).
"""
_PART_CORNERS_PER_COEFFICIENT: Final = 2.0
"""Least number of corners per coefficient of that polynomial (chosen: avoids overfitting)."""
_HOMOGRAPHY_PARAMETERS: Final = 4
"""Parameters of a homography per image coordinate (numerical)."""
_OUTLIER_PX: Final = 0.2
_OUTLIER_SIGMAS: Final = 6.0
"""Residual of a corner from the fit above which it is an outlier, px and standard deviations; it
exceeds both (chosen)."""
_MOST_ROUNDS: Final = 8
"""Most rounds of removing outliers (numerical)."""


class SmoothHomographyFit(NamedTuple):
    """Homography of a board plus a smooth lens distortion, fitted to its corners."""

    homography: FloatArray  # from the board's plane to the image
    inliers: NDArray[np.bool_]  # (n,) mask
    residual_sigma_px: float  # of the inliers, of each coordinate; 0 if unknown
    origin_distortion_px: FloatArray  # (2,) at the board's origin, beside the homography
    origin_distortion_sigma_px: float  # of each coordinate


def fit_smooth_homography(
    board_m: FloatArray, pixels: FloatArray, max_residual_px: FloatArray
) -> SmoothHomographyFit | None:
    """Fit corners without outliers; None if they are collinear, or fewer than four are left.

    Each has a largest residual from a coarse fit: less than the distance to another corner.
    """
    good = np.ones(len(pixels), bool)
    places = board_m / np.abs(board_m).max()
    for degree, most_px in ((_COARSE_DEGREE, max_residual_px), (_FINE_DEGREE, None)):
        for _ in range(_MOST_ROUNDS):
            enough = good.sum() >= _HOMOGRAPHY_PARAMETERS
            transform = fit_homography(board_m[good], pixels[good]) if enough else None
            if transform is None:
                return None
            values = (pixels - cv2.perspectiveTransform(board_m[None], transform)[0])[good]
            terms, counts = _allowed_monomials(
                places[good], degree, _PART_CORNERS_PER_COEFFICIENT, _HOMOGRAPHY_PARAMETERS
            )
            basis = np.linalg.qr(terms)[0]
            fit = _fit_polynomial(values, basis, np.append(0, counts), _HOMOGRAPHY_PARAMETERS)
            beside = np.abs(fit.residuals / np.maximum(fit.independence, 0.1)[:, None]).max(axis=1)
            if most_px is None:
                sigma = 1.48 * float(np.median(np.abs(fit.residuals)))
                over = beside / max(_OUTLIER_PX, _OUTLIER_SIGMAS * sigma)
            else:
                over = beside / most_px[good]
            if fit.free < 1.0 or over.max() <= 1.0:
                break
            # an outlier also pulls its neighbours away, so only the worst are removed per round
            good[np.flatnonzero(good)[over > max(1.0, 0.5 * float(over.max()))]] = False
    assert transform is not None
    sigma = float(np.sqrt(fit.unexplained / (2.0 * fit.free))) if fit.free >= 1.0 else 0.0
    # all terms but the constant vanish at the origin
    used = fit.coefficients
    weights = np.linalg.pinv(terms[:, :used])[0] if used else np.zeros(len(values))
    return SmoothHomographyFit(
        transform, good, sigma, weights @ values, sigma * float(np.linalg.norm(weights))
    )
