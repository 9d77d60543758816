"""Kernels for the image of a plane: homographies, lens, and interpolated grey levels."""

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import compiled, subroutine
from vergence.models.lens import CameraRow, camera_at, ray_to_pixel
from vergence.models.parts import FloatArray

_DIFFERENCE_STEP_RAD: Final = 1e-4
"""Step of a difference quotient, rad (numerical)."""


@subroutine
def image_to_square_homography(corners: FloatArray, G: FloatArray) -> None:
    """Compute the homography from the image to the plane of a square of corners (-1, -1) to (1, 1).

    Args:
        corners: (4, 2) images of (-1, -1), (1, -1), (1, 1), (-1, 1).
        G: (3, 3) result.
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
    """Compute the homography from the plane to the image, see `image_to_square_homography`.

    Args:
        G: (3, 3) homography from the image to the plane.
        H: (3, 3) result, the adjugate of G.
    """
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
    """Compute the view around a ray.

    Args:
        camera: camera of the eye.
        x: X / Z of the ray.
        y: Y / Z of the ray.
        view: result, its homographies.
    """
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
def view_along(packed_camera: FloatArray, x: float, y: float) -> UndistortedView:
    """View around a ray, see `set_view_along`, by a packed camera, see `pack_camera`."""
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
    """Approximate point of a view's plane for a pixel, by interpolated rays.

    Args:
        rays: (height, width, 2) rays of the pixels; (0, 0, 2) for an undistorted image.
        view: the plane.
        u: u of the pixel, px; may be slightly outside of the image.
        v: v of the pixel, px, likewise.
    """
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
def grey_at(image: NDArray[np.uint8], u: float, v: float) -> float:
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
