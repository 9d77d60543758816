"""Sub-pixel corners where four squares meet, and how sure they are."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

_END: Final = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 3e-3)
_BLUR_PX: Final = 0.6
_RIM: Final = 4
"""Pixels around a window that its blur and its steps reach into."""
_LEAST_NOISE_GREY: Final = 0.3
"""That of rounding, 1 / sqrt(12)."""


def refine_corners(
    image: NDArray[np.uint8], corners: NDArray[np.float64], side: int
) -> NDArray[np.float64]:
    """Move corners to where the gradients around them meet, by OpenCV's ``cornerSubPix``.

    It differentiates over two pixels, which aliases on edges as sharp as a good lens makes them
    and pulls corners to the pixel grid. A light blur and twice the samples divide that bias by
    three or four.

    Args:
        image: grey levels, shape (height, width).
        corners: to within a window, px, shape (n, 2).
        side: half the window's side, px. A window that sees another edge is wrong by pixels.

    Returns:
        px, shape (n, 2).
    """
    rim = side + _RIM
    size = 2 * rim + 1
    whole = np.rint(corners).astype(int) - rim
    smooth = cv2.GaussianBlur(_windows(image, whole, size), (3, 3), _BLUR_PX)
    twice = cv2.resize(smooth, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
    # the windows stand side by side: a corner lies as far to the right as its window does
    shift = whole.astype(float)
    shift[:, 0] -= size * np.arange(len(corners))
    start = ((corners - shift + 0.5) * 2 - 0.5).astype(np.float32)
    fine = cv2.cornerSubPix(twice, start, (2 * side, 2 * side), (-1, -1), _END)
    return np.asarray((fine.astype(float) + 0.5) / 2 - 0.5 + shift, float)


def corner_sigmas(
    image: NDArray[np.uint8], corners: NDArray[np.float64], side: int, noise_grey: float
) -> NDArray[np.float64]:
    r"""Standard deviations of refined corners, from the noise of the pixels.

    A corner q solves `sum g g^T (p - q) = 0` over the pixels p of its window with their gradients
    g. At the corner g is square to p - q, so to first order noise n of the gradients moves it by

        dq = A^-1 sum g n^T (p - q),    A = sum g g^T,

    Args:
        image: grey levels, shape (height, width).
        corners: refined, px, shape (n, 2).
        side: half the side of the window that they were refined in, px.
        noise_grey: standard deviation of a pixel's grey level.

    Returns:
        px, shape (n, 2).
    """
    size = 2 * (side + 1) + 1
    whole = np.rint(corners).astype(int) - (side + 1)
    strip = _windows(image, whole, size).astype(np.float32)
    g_x = cv2.Sobel(strip, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    g_y = cv2.Sobel(strip, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)

    def apart(values: NDArray[np.float32]) -> NDArray[np.float32]:
        stacked = values.reshape(size, len(corners), size).transpose(1, 0, 2)
        return stacked[:, 1:-1, 1:-1].reshape(len(corners), -1)

    along = np.arange(1, size - 1)
    x, y = (each.ravel() for each in np.meshgrid(along, along))
    away = (x - (corners[:, :1] - whole[:, :1])) ** 2 + (y - (corners[:, 1:] - whole[:, 1:])) ** 2
    # OpenCV's own weights, over half the window's side
    weights = np.exp(-away / side**2)
    a, b = apart(g_x), apart(g_y)
    xx, xy, yy = ((weights * each).sum(axis=1) for each in (a * a, a * b, b * b))
    # a central difference of white noise has half its variance
    moved = weights**2 * away * (0.5 * noise_grey**2)
    mxx, mxy, myy = ((moved * each).sum(axis=1) for each in (a * a, a * b, b * b))
    det = np.maximum(xx * yy - xy * xy, 1e-9)
    inverse = np.array([[yy, -xy], [-xy, xx]]) / det
    spread = np.einsum("ijn,jkn,kln->nil", inverse, np.array([[mxx, mxy], [mxy, myy]]), inverse)
    return np.sqrt(np.diagonal(spread, axis1=1, axis2=2))


def noise_of(image: NDArray[np.uint8], places: NDArray[np.float64]) -> float:
    """The noise of the pixels, from places in the middle of squares of one colour.

    Args:
        image: grey levels, shape (height, width).
        places: px, shape (n, 2); those at the image's edge are left out.

    Returns:
        Standard deviation of a pixel's grey level, the median over the places.
    """
    height, width = image.shape
    x, y = np.rint(places).astype(int).T
    inside = (x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)
    if not inside.any():
        return _LEAST_NOISE_GREY
    x, y = x[inside], y[inside]
    step = np.array([-1, 0, 1])
    patch = image[y[:, None, None] + step[:, None], x[:, None, None] + step].astype(float)
    # second differences, which a gradient of light does not enter; 36 is their variance
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    second = np.abs((patch * mask).sum(axis=(1, 2)))
    # the mean of |n| is sqrt(2 / pi) of a normal number's standard deviation
    return max(float(np.mean(np.sort(second)[: max(len(second) * 9 // 10, 1)])) / 6.0 / 0.7,
               _LEAST_NOISE_GREY)  # fmt: skip


def _windows(image: NDArray[np.uint8], corners: NDArray[np.int_], size: int) -> NDArray[np.uint8]:
    """Square windows of an image side by side; beyond its edge its last pixels are repeated."""
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
