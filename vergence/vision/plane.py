"""A plane and its image, in kernels: the homography, the lens, and the grey between pixels."""

import numpy as np
from numpy.typing import NDArray

from vergence._jit import subroutine
from vergence.models.camera import ray_to_pixel
from vergence.models.lens import CameraRow
from vergence.models.parts import FloatArray


@subroutine
def plane_of(corners: FloatArray, G: FloatArray) -> None:
    """The homography from the image to the plane of a square, its corners at (-1, -1) to (1, 1).

    Args:
        corners: (4, 2) in the image: of (-1, -1), (1, -1), (1, 1), (-1, 1).
        G: (3, 3) result.
    """
    ax, ay, bx, by = corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]
    cx, cy, dx, dy = corners[2, 0], corners[2, 1], corners[3, 0], corners[3, 1]
    # of the unit square to the four corners (Heckbert 1989)
    ex, ey, fx, fy = bx - cx, by - cy, dx - cx, dy - cy
    sx, sy = ax - bx + cx - dx, ay - by + cy - dy
    det = ex * fy - ey * fx
    g, h = (sx * fy - sy * fx) / det, (ex * sy - ey * sx) / det
    m00, m01, m02 = bx - ax + g * bx, dx - ax + h * dx, ax
    m10, m11, m12 = by - ay + g * by, dy - ay + h * dy, ay
    # its adjoint leads back, to 0..1; twice that less one to -1..1
    i00, i01, i02 = m11 - m12 * h, m02 * h - m01, m01 * m12 - m02 * m11
    i10, i11, i12 = m12 * g - m10, m00 - m02 * g, m02 * m10 - m00 * m12
    i20, i21, i22 = m10 * h - m11 * g, m01 * g - m00 * h, m00 * m11 - m01 * m10
    G[0, 0], G[0, 1], G[0, 2] = 2.0 * i00 - i20, 2.0 * i01 - i21, 2.0 * i02 - i22
    G[1, 0], G[1, 1], G[1, 2] = 2.0 * i10 - i20, 2.0 * i11 - i21, 2.0 * i12 - i22
    G[2, 0], G[2, 1], G[2, 2] = i20, i21, i22


@subroutine
def pixel_of(G: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Where a point of the plane lies in the image, the inverse of `plane_of`."""
    a, b, c = G[0, 0], G[0, 1], G[0, 2]
    d, e, f = G[1, 0], G[1, 1], G[1, 2]
    g, h, i = G[2, 0], G[2, 1], G[2, 2]
    # the adjoint times (x, y, 1)
    u = (e * i - f * h) * x + (c * h - b * i) * y + (b * f - c * e)
    v = (f * g - d * i) * x + (a * i - c * g) * y + (c * d - a * f)
    w = (d * h - e * g) * x + (b * g - a * h) * y + (a * e - b * d)
    return u / w, v / w


@subroutine
def ideal_of(rays: NDArray[np.float32], focal_px: float, u: float, v: float) -> tuple[float, float]:
    """About where a pixel lies in the plane that the lens does not bend, see `EyeCamera.ideal`.

    Args:
        rays: (height, width, 2) of the pixels, or (0, 0, 2) for an image that is such a plane.
        focal_px: what rays are scaled by.
        u: of the pixel, near the image's edges beyond them too.
        v: the same.
    """
    height, width, _ = rays.shape
    if height == 0:
        return u, v
    column, row = min(max(int(u), 0), width - 2), min(max(int(v), 0), height - 2)
    s, t = u - column, v - row
    x = y = 0.0
    for j in range(2):
        for i in range(2):
            share = (s if i else 1.0 - s) * (t if j else 1.0 - t)
            x += share * rays[row + j, column + i, 0]
            y += share * rays[row + j, column + i, 1]
    return focal_px * x, focal_px * y


@subroutine
def seen_at(
    camera: CameraRow, lens: bool, focal_px: float, u: float, v: float
) -> tuple[float, float]:
    """The pixel at which a point of that plane is seen, nan beyond the lens model."""
    if not lens:
        return u, v
    return ray_to_pixel(camera, u / focal_px, v / focal_px)


@subroutine
def grey_at(image: NDArray[np.uint8], u: float, v: float) -> float:
    """The grey level at a place, between the pixels; nan outside of the image."""
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
