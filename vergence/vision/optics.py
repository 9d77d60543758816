"""Pinhole and lens of one eye: conversion between rays and pixels by the models' kernels.

Pixels follow OpenCV: the centre of the upper left pixel is (0, 0), a pixel covers half a pixel
to each side of its centre, and u = u0 + f_u x / z.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.cameras import BROWN_CONRADY, LENSES, CameraResponse, parse_response
from vergence.models.head import HeadModel
from vergence.models.kinematics import pixels_to_rays, rays_to_pixels
from vergence.models.lens import distort, is_distorted
from vergence.models.packed import camera_at, pack_camera
from vergence.operands import as_operand
from vergence.vision.plane import view_along


@dataclass(frozen=True, kw_only=True)
class EyeCamera:
    """Intrinsics of one eye, hashable.

    Raises:
        ConfigurationError: a size or focal length is not positive, the lens or the response is
            unknown, or the number of distortion coefficients does not match the lens.
    """

    width: int
    """Image width, in pixels."""
    height: int
    """Image height, in pixels."""
    focal_px: tuple[float, float]
    """Focal lengths (f_u, f_v) in pixels."""
    principal_px: tuple[float, float]
    """Principal point (u0, v0) in pixels."""
    distortion: tuple[float, ...] = ()
    """Coefficients of the lens in OpenCV's order, see `vergence.models.cameras.LENSES`; empty for
    zeros."""
    lens: str = BROWN_CONRADY
    """The lens model."""
    response: CameraResponse | None = None
    """Light by grey level, see `parse_response`; None if unknown."""

    def __post_init__(self) -> None:
        """Convert sequences to tuples of float, for hashing, and check the values."""
        if self.response is not None:
            object.__setattr__(self, "response", parse_response(self.response))
        if self.lens not in LENSES:
            raise ConfigurationError(
                f"lens: expected one of {', '.join(LENSES)}, got {self.lens!r:.80}"
            )
        coefficients = len(LENSES[self.lens])
        if len(self.distortion) == 0:
            object.__setattr__(self, "distortion", (0.0,) * coefficients)
        for name, length in (("focal_px", 2), ("principal_px", 2), ("distortion", coefficients)):
            values = tuple(float(value) for value in getattr(self, name))
            if len(values) != length:
                raise ConfigurationError(f"{name}: expected {length} numbers, got {len(values)}")
            object.__setattr__(self, name, values)
        if min(self.width, self.height, *self.focal_px) <= 0:
            raise ConfigurationError(
                "EyeCamera: expected a positive size and focal length, got "
                f"{self.width} x {self.height} and {self.focal_px}"
            )

    @classmethod
    def of(cls, head: HeadModel, eye: int) -> "EyeCamera":
        """Camera of one eye of one head, 0 for left, 1 for right.

        Raises:
            ConfigurationError: the head or the eye is invalid.
        """
        if not isinstance(head, HeadModel):
            raise ConfigurationError(f"head: expected a head, see load_head; got {head!r:.80}")
        if eye not in (0, 1):
            raise ConfigurationError(f"eye: expected 0 for left or 1 for right, got {eye!r:.80}")
        cameras = head.cameras
        width, height = cameras.size[eye].tolist()
        lens = cameras.lens[eye]
        return cls(
            width=width,
            height=height,
            focal_px=tuple(cameras.focal[eye]),
            principal_px=tuple(cameras.principal[eye]),
            distortion=tuple(cameras.distortion[eye, : len(LENSES[lens])]),
            lens=lens,
            response=cameras.response[eye],
        )

    @cached_property
    def packed_camera(self) -> NDArray[np.float64]:
        """Packed camera for kernels, see `pack_camera`."""
        return pack_camera(
            (self.width, self.height),
            np.array(self.focal_px),
            np.array(self.principal_px),
            self.lens,
            np.array(self.distortion),
        )

    @cached_property
    def distorts(self) -> bool:
        """True if the lens distorts."""
        return is_distorted(camera_at(self.packed_camera, 0))

    @cached_property
    def bends_boards(self) -> bool:
        """True if the lens bends a board's straight lines and changes its scale considerably.

        The Brown-Conrady model is for moderate angles, over which a board is small: for the search
        for cells its image is close enough to a pinhole's.
        """
        return self.lens != BROWN_CONRADY and self.distorts

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix K, shape (3, 3)."""
        (f_u, f_v), (u_0, v_0) = self.focal_px, self.principal_px
        return np.array([[f_u, 0, u_0], [0, f_v, v_0], [0, 0, 1]])

    @cached_property
    def inverse_matrix(self) -> NDArray[np.float64]:
        """Inverse of K, shape (3, 3)."""
        (f_u, f_v), (u_0, v_0) = self.focal_px, self.principal_px
        return np.array([[1 / f_u, 0, -u_0 / f_u], [0, 1 / f_v, -v_0 / f_v], [0, 0, 1]])

    def flat_view_about(self, pixels: ArrayLike) -> "FlatView":
        """View of a pinhole camera that looks at the mean of some pixels, (n, 2)."""
        x, y = self.rays(as_operand("pixels", pixels, "n", 2).mean(axis=0)[None])[0].tolist()
        view = view_along(self.packed_camera, x, y)
        return FlatView(self, view.plane_from_ray, view.ray_from_plane)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixels of points in front of the camera, distorted by the lens.

        Args:
            points: points in the camera frame, metres, shape (n, 3), z > 0.

        Returns:
            Pixels, shape (n, 2); nan beyond the radius at which the lens model folds back.
        """
        array = as_operand("points", points, "n", 3)
        return np.asarray(rays_to_pixels(array[:, :2] / array[:, 2:], self.packed_camera))

    def distortion_jacobian(self, x: float, y: float) -> NDArray[np.float64]:
        """Jacobian of the lens distortion at a ray.

        Args:
            x: x / z of the ray.
            y: y / z of the ray.

        Returns:
            The derivative of distorted with respect to ideal normalised coordinates, shape (2, 2).
        """
        distorted = distort(camera_at(self.packed_camera, 0), x, y)
        return np.array([[distorted.dxx, distorted.dxy], [distorted.dxy, distorted.dyy]])

    def rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Undistorted rays (x / z, y / z) of distorted pixels, shape (n, 2) for (n, 2).

        Rays are nan where the lens model has no inverse.
        """
        return np.asarray(pixels_to_rays(pixels, self.packed_camera))


@dataclass(frozen=True)
class FlatView:
    """An undistorted plane that agrees with the image to first order at one point, in pixels."""

    camera: EyeCamera
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
        return np.asarray(rays_to_pixels(rays, self.camera.packed_camera))


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
def ray_table(camera: EyeCamera, supersampling: int, margin_px: int) -> NDArray[np.float32]:
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
