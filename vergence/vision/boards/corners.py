"""Sub-pixel corners where four squares meet, and their standard deviations."""

from math import exp, nan, sqrt
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled
from vergence.models.parts import FloatArray

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
