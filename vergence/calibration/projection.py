"""Projection of points into one camera, with Jacobians by the point and by the camera parameters.

The lens models equal those of `vergence.models.lens`, whose kernels project without derivatives by
the coefficients; tests compare both.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.lens import LENSES
from vergence.models.parts import FloatArray

PINHOLE_VALUES = ("f_u", "f_v", "u_0", "v_0")
"""First parameters of a camera, px; the lens's coefficients follow in OpenCV's order."""
_SMALL_RADIUS: Final = 1e-9
"""Least normalised radius, which avoids a division by zero on the axis (numerical)."""


def camera_parameter_names(lens: str) -> tuple[str, ...]:
    """Name a camera's parameters: the pinhole's, then the lens's coefficients."""
    return (*PINHOLE_VALUES, *LENSES[lens])


class ProjectedPoints(NamedTuple):
    """Pixels and their Jacobians."""

    pixels: FloatArray
    """(..., 2) px."""
    point_jacobian: FloatArray
    """(..., 2, 3) Jacobian by the point, px/m."""
    camera_jacobian: FloatArray
    """(..., 2, k) Jacobian by the camera's parameters."""


class _Bent(NamedTuple):
    """Distorted normalised coordinates and their Jacobians."""

    xy: FloatArray
    """(..., 2) distorted normalised coordinates."""
    by_ideal: FloatArray
    """(..., 2, 2) Jacobian by the undistorted coordinates."""
    by_coefficients: FloatArray
    """(..., 2, n) Jacobian by the lens's coefficients."""


def project_with_jacobians(
    lens: str, camera_parameters: FloatArray, points: FloatArray
) -> ProjectedPoints:
    """Project (..., 3) points, m, also beyond the lens's fold; nan behind the camera."""
    z = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
    ideal = points[..., :2] / z
    bend = _bend_by_angle if lens == "fisheye" else _bend_by_radius
    bent = bend(camera_parameters[4:], ideal)
    focal = camera_parameters[:2]
    pixels = camera_parameters[2:4] + focal * bent.xy
    scaled = focal[:, None] * bent.by_ideal
    by_point = np.concatenate(
        [scaled / z[..., None], -(scaled @ ideal[..., None]) / z[..., None]], axis=-1
    )
    by_camera = np.zeros((*pixels.shape, len(camera_parameters)))
    by_camera[..., 0, 0], by_camera[..., 1, 1] = bent.xy[..., 0], bent.xy[..., 1]
    by_camera[..., 0, 2] = by_camera[..., 1, 3] = 1.0
    by_camera[..., 4:] = focal[:, None] * bent.by_coefficients
    return ProjectedPoints(pixels, by_point, by_camera)


def _bend_by_radius(coefficients: FloatArray, ideal: FloatArray) -> _Bent:
    """Distort by the Brown-Conrady lens, or the rational lens if there are 8 coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(coefficients, (0, 8 - len(coefficients))).tolist()
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    below = 1.0 / (1.0 + k4 * r2 + k5 * r4 + k6 * r6)
    radial = (1.0 + k1 * r2 + k2 * r4 + k3 * r6) * below
    slope = (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r4) * below
    slope -= radial * below * (k4 + 2.0 * k5 * r2 + 3.0 * k6 * r4)
    along_x, along_y = r2 + 2.0 * x * x, r2 + 2.0 * y * y
    xy = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * along_x,
            y * radial + p1 * along_y + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )
    by_ideal = np.empty((*ideal.shape, 2))
    by_ideal[..., 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_ideal[..., 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_ideal[..., 0, 1] = by_ideal[..., 1, 0] = 2.0 * (x * y * slope + p1 * x + p2 * y)
    radii = np.stack([r2, r4, r6], axis=-1) * below[..., None]
    by = np.empty((*ideal.shape, 8))
    for axis, ray in ((0, x), (1, y)):
        by[..., axis, [0, 1, 4]] = ray[..., None] * radii
        by[..., axis, 5:] = -(ray * radial)[..., None] * radii
    by[..., 0, 2] = by[..., 1, 3] = 2.0 * x * y
    by[..., 0, 3], by[..., 1, 2] = along_x, along_y
    return _Bent(xy, by_ideal, by[..., : len(coefficients)])


def _bend_by_angle(coefficients: FloatArray, ideal: FloatArray) -> _Bent:
    """Distort by the Kannala-Brandt fisheye lens."""
    r = np.maximum(np.linalg.norm(ideal, axis=-1), _SMALL_RADIUS)
    t = np.arctan(r)
    powers = np.stack([t ** (2 * n) for n in range(5)], axis=-1)
    bent = np.concatenate([[1.0], coefficients])
    scale = t / r * (powers @ bent)
    # along the radius: d(t (1 + k1 t^2 + ...)) / dr
    along = powers @ (bent * (2.0 * np.arange(5) + 1.0)) / (1.0 + r * r)
    unit = ideal / r[..., None]
    outer = unit[..., :, None] * unit[..., None, :]
    by_ideal = scale[..., None, None] * np.eye(2) + (along - scale)[..., None, None] * outer
    by_coefficients = (unit * t[..., None])[..., None] * powers[..., None, 1:]
    return _Bent(ideal * scale[..., None], by_ideal, by_coefficients)
