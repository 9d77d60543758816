"""Views of an image without lens distortion, and the rays of its samples."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.camera import Camera, rays_to_pixels
from vergence.operands import as_operand
from vergence.vision.plane import view_along


def flat_view_about(camera: Camera, pixels: ArrayLike) -> "FlatView":
    """View of a pinhole camera that looks at the mean of some pixels, (n, 2)."""
    x, y = camera.rays(as_operand("pixels", pixels, "n", 2).mean(axis=0)[None])[0].tolist()
    view = view_along(camera.row, x, y)
    return FlatView(camera, view.plane_from_ray, view.ray_from_plane)


@dataclass(frozen=True)
class FlatView:
    """An undistorted plane that agrees with the image to first order at one point, in pixels."""

    camera: Camera
    """Camera of the image."""
    plane_from_ray: NDArray[np.float64]
    """(3, 3) homography from rays (x / z, y / z) to the plane."""
    ray_from_plane: NDArray[np.float64]
    """(3, 3) inverse of it."""

    def to_plane(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the plane for pixels of the image, shape (n, 2)."""
        return _transformed(self.camera.rays(pixels), self.plane_from_ray)

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of the image for points of the plane, the inverse of `to_plane`, shape (n, 2)."""
        rays = _transformed(points, self.ray_from_plane)
        return np.asarray(rays_to_pixels(rays, self.camera.row))


def _transformed(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply a homography to points, shape (n, 2); OpenCV returns None for none of them."""
    return np.asarray(cv2.perspectiveTransform(points[None], matrix)[0]) if len(points) else points


class IdentityView:
    """View of an image without lens distortion: the image itself."""

    def to_plane(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pixels, shape (n, 2)."""
        return pixels

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points, shape (n, 2)."""
        return points


@lru_cache(maxsize=4)
def ray_table(camera: Camera, supersampling: int, margin_px: int) -> NDArray[np.float32]:
    """Rays of every sample of a frame with a margin around it.

    Args:
        camera: camera of the eye.
        supersampling: samples per pixel along each axis.
        margin_px: pixels added on each side of the frame.

    Returns:
        (x / z, y / z) of each sample, shape ((height + 2 margin) * supersampling,
        (width + 2 margin) * supersampling, 2).
    """
    u, v = (
        (np.arange((length + 2 * margin_px) * supersampling) + 0.5) / supersampling
        - 0.5
        - margin_px
        for length in (camera.width, camera.height)
    )
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    table = camera.rays(pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    table.setflags(write=False)
    return table
