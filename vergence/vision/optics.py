"""Undistorted plane of an eye for images and kernels, and homographies of it."""

from functools import lru_cache
from math import sqrt
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.kernels import compiled, subroutine
from vergence.models.camera import Camera, rays_to_pixels
from vergence.models.lens import CameraRow, camera_at, ray_to_pixel
from vergence.models.parts import FloatArray
from vergence.operands import as_operand

Image = NDArray[np.uint8]
"""Grey levels, shape (height, width)."""
_DIFFERENCE_STEP_RAD: Final = 1e-4
"""Step of a difference quotient, rad (numerical)."""


@subroutine
def image_to_square_homography(corners: FloatArray, G: FloatArray) -> None:
    """Compute the homography G, (3, 3), from the image to the plane of a square.

    The corners, (4, 2), are the images of (-1, -1), (1, -1), (1, 1), (-1, 1).
    """
    ax, ay, bx, by = corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]
    cx, cy, dx, dy = corners[2, 0], corners[2, 1], corners[3, 0], corners[3, 1]
    # the homography from the unit square to the four corners (Heckbert 1989)
    ex, ey, fx, fy = bx - cx, by - cy, dx - cx, dy - cy
    sx, sy = ax - bx + cx - dx, ay - by + cy - dy
    det = ex * fy - ey * fx
    g, h = (sx * fy - sy * fx) / det, (ex * sy - ey * sx) / det
    m00, m01, m02 = bx - ax + g * bx, dx - ax + h * dx, ax
    m10, m11, m12 = by - ay + g * by, dy - ay + h * dy, ay
    # its adjugate is the inverse, to 0..1; 2 x - 1 then leads to -1..1
    i00, i01, i02 = m11 - m12 * h, m02 * h - m01, m01 * m12 - m02 * m11
    i10, i11, i12 = m12 * g - m10, m00 - m02 * g, m02 * m10 - m00 * m12
    i20, i21, i22 = m10 * h - m11 * g, m01 * g - m00 * h, m00 * m11 - m01 * m10
    G[0, 0], G[0, 1], G[0, 2] = 2.0 * i00 - i20, 2.0 * i01 - i21, 2.0 * i02 - i22
    G[1, 0], G[1, 1], G[1, 2] = 2.0 * i10 - i20, 2.0 * i11 - i21, 2.0 * i12 - i22
    G[2, 0], G[2, 1], G[2, 2] = i20, i21, i22


@subroutine
def square_to_image_homography(G: FloatArray, H: FloatArray) -> None:
    """Compute the homography H from the plane to the image: the adjugate of G."""
    a, b, c = G[0, 0], G[0, 1], G[0, 2]
    d, e, f = G[1, 0], G[1, 1], G[1, 2]
    g, h, i = G[2, 0], G[2, 1], G[2, 2]
    H[0, 0], H[0, 1], H[0, 2] = e * i - f * h, c * h - b * i, b * f - c * e
    H[1, 0], H[1, 1], H[1, 2] = f * g - d * i, a * i - c * g, c * d - a * f
    H[2, 0], H[2, 1], H[2, 2] = d * h - e * g, b * g - a * h, a * e - b * d


class UndistortedView(NamedTuple):
    """An undistorted image plane that agrees with the image to first order at one point.

    A tag's projection onto any plane is a homography of the tag. Far off the axis of a wide lens,
    the plane perpendicular to the axis stretches pixels several times, and unequally by direction.
    This plane is perpendicular to the ray of the point; its unit there is one pixel.
    """

    has_lens: bool
    """False if the image itself is undistorted and serves as the plane."""
    plane_from_ray: FloatArray
    """(3, 3) homography from rays (X / Z, Y / Z) to the plane."""
    ray_from_plane: FloatArray
    """(3, 3) inverse of it."""


@subroutine
def set_view_along(camera: CameraRow, x: float, y: float, view: UndistortedView) -> None:
    """Compute the homographies of the view around a ray (x, y, 1)."""
    u, v = ray_to_pixel(camera, x, y)
    # the rotation from the ray to the optical axis (Rodrigues)
    norm = sqrt(x * x + y * y + 1.0)
    cx, cy, cz = x / norm, y / norm, 1.0 / norm
    k = 1.0 / (1.0 + cz)
    A, B = view.plane_from_ray, view.ray_from_plane
    A[0, 0], A[0, 1], A[0, 2] = 1.0 - k * cx * cx, -k * cx * cy, -cx
    A[1, 0], A[1, 1], A[1, 2] = -k * cx * cy, 1.0 - k * cy * cy, -cy
    A[2, 0], A[2, 1], A[2, 2] = cx, cy, cz
    # Jacobian of the pixel with respect to small steps perpendicular to the ray
    h = _DIFFERENCE_STEP_RAD
    left_u, left_v = ray_to_pixel(camera, *_turned_back(A, -h, 0.0))
    right_u, right_v = ray_to_pixel(camera, *_turned_back(A, h, 0.0))
    above_u, above_v = ray_to_pixel(camera, *_turned_back(A, 0.0, -h))
    below_u, below_v = ray_to_pixel(camera, *_turned_back(A, 0.0, h))
    a, b = (right_u - left_u) / (2.0 * h), (below_u - above_u) / (2.0 * h)
    c, d = (right_v - left_v) / (2.0 * h), (below_v - above_v) / (2.0 * h)
    det = a * d - b * c
    for j in range(3):
        r, s, t = A[0, j], A[1, j], A[2, j]
        # inverse: the transposed rotation times the inverse Jacobian
        B[j, 0], B[j, 1] = (d * r - c * s) / det, (a * s - b * r) / det
        B[j, 2] = t - B[j, 0] * u - B[j, 1] * v
        A[0, j], A[1, j] = a * r + b * s + u * t, c * r + d * s + v * t


@compiled
def _view_along(packed_camera: FloatArray, x: float, y: float) -> UndistortedView:
    view = UndistortedView(True, np.empty((3, 3)), np.empty((3, 3)))
    set_view_along(camera_at(packed_camera, 0), x, y, view)
    return view


@subroutine
def _turned_back(A: FloatArray, x: float, y: float) -> tuple[float, float]:
    w = A[0, 2] * x + A[1, 2] * y + A[2, 2]
    return (A[0, 0] * x + A[1, 0] * y + A[2, 0]) / w, (A[0, 1] * x + A[1, 1] * y + A[2, 1]) / w


@subroutine
def interpolate_ray(rays: NDArray[np.float32], u: float, v: float) -> tuple[float, float]:
    """Ray of a pixel by bilinear interpolation, linearly extrapolated beyond the image's edges."""
    height, width, _ = rays.shape
    column, row = min(max(int(u), 0), width - 2), min(max(int(v), 0), height - 2)
    s, t = u - column, v - row
    x = y = 0.0
    for j in range(2):
        for i in range(2):
            share = (s if i else 1.0 - s) * (t if j else 1.0 - t)
            x += share * rays[row + j, column + i, 0]
            y += share * rays[row + j, column + i, 1]
    return x, y


@subroutine
def transform_point(H: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Point transformed by a homography."""
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    return (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w


@subroutine
def undistorted_point(
    rays: NDArray[np.float32], view: UndistortedView, u: float, v: float
) -> tuple[float, float]:
    """Approximate point of a view's plane for a pixel in or near the image, by the pixels' rays."""
    if not view.has_lens:
        return u, v
    x, y = interpolate_ray(rays, u, v)
    return transform_point(view.plane_from_ray, x, y)


@subroutine
def distorted_pixel(
    camera: CameraRow, view: UndistortedView, u: float, v: float
) -> tuple[float, float]:
    """Pixel of a point of a view's plane; nan beyond the lens model."""
    if not view.has_lens:
        return u, v
    x, y = transform_point(view.ray_from_plane, u, v)
    return ray_to_pixel(camera, x, y)


@subroutine
def grey_at(image: Image, u: float, v: float) -> float:
    """Grey level at a pixel position by bilinear interpolation; nan outside of the image."""
    height, width = image.shape
    if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
        return np.nan
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    column, row = min(int(u), width - 2), min(int(v), height - 2)
    s, t = u - column, v - row
    upper = (1.0 - s) * image[row, column] + s * image[row, column + 1]
    lower = (1.0 - s) * image[row + 1, column] + s * image[row + 1, column + 1]
    grey: float = (1.0 - t) * upper + t * lower
    return grey


class FlatView:
    """An undistorted plane that agrees with an image to first order at the mean of some pixels.

    Its unit there is one pixel. Without a lens it is the image itself.

    Args:
        camera: camera of the image; None for an image without lens distortion.
        pixels: (n, 2) these pixels.
    """

    def __init__(self, camera: Camera | None, pixels: ArrayLike) -> None:
        self._camera = camera
        if camera is not None:
            middle = as_operand("pixels", pixels, "n", 2).mean(axis=0)
            self._view = _view_along(camera.row, *camera.rays(middle[None])[0].tolist())

    def to_plane(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the plane for pixels of the image, shape (n, 2)."""
        if self._camera is None:
            return pixels
        return _transformed(self._camera.rays(pixels), self._view.plane_from_ray)

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of the image for points of the plane, the inverse of `to_plane`, shape (n, 2)."""
        if self._camera is None:
            return points
        rays = _transformed(points, self._view.ray_from_plane)
        return np.asarray(rays_to_pixels(rays, self._camera.row))


def _transformed(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply a homography to points, shape (n, 2); OpenCV returns None for none of them."""
    return np.asarray(cv2.perspectiveTransform(points[None], matrix)[0]) if len(points) else points


@lru_cache(maxsize=4)
def ray_table(camera: Camera, supersampling: int, margin_px: int) -> NDArray[np.float32]:
    """Rays (x / z, y / z) of every sample of a frame with a margin, (rows, columns, 2) samples.

    There are some samples per pixel along each axis.
    """
    samples = ((length + 2 * margin_px) * supersampling for length in (camera.width, camera.height))
    u, v = ((np.arange(each) + 0.5) / supersampling - 0.5 - margin_px for each in samples)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    table = camera.rays(pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    table.setflags(write=False)
    return table


def fit_homography(
    board_m: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Homography from corners on a board, (n, 2), to these in the image; None if collinear."""
    transform: Any = cv2.findHomography(board_m, pixels, 0)[0]
    if transform is None or not np.isfinite(transform).all():
        return None
    return np.asarray(transform, float)


def origin_sigma_px(
    homography: NDArray[np.float64], board_m: NDArray[np.float64], sigmas: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Standard deviations, (2,) px, of the board's origin by a homography of corners with sigmas.

    They are large if the corners, (n, 2) m, do not surround the origin.
    """
    scale = 1.0 / np.abs(board_m).max()
    H = homography @ np.diag([1.0 / scale, 1.0 / scale, 1.0])
    x, y = (scale * board_m).T
    both = np.stack([x, y, np.ones_like(x)])
    w = H[2] @ both
    u, v = H[0] @ both / w, H[1] @ both / w
    rows = np.zeros((len(x), 2, 8))
    rows[:, 0, 0:3] = rows[:, 1, 3:6] = (both / w).T
    rows[:, 0, 6:8], rows[:, 1, 6:8] = -(u * both[:2] / w).T, -(v * both[:2] / w).T
    normal = np.einsum("nij,nik,ni->jk", rows, rows, 1.0 / sigmas**2)
    middle = np.zeros((2, 8))
    middle[0, 2] = middle[1, 5] = 1.0
    middle /= H[2, 2]
    spread = middle @ np.linalg.pinv(normal, hermitian=True) @ middle.T
    return np.sqrt(np.diagonal(spread))
