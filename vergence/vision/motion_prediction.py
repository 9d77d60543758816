"""Predict the pixels of a target at rest after a camera motion."""

from math import hypot, isfinite, nan
from typing import Final

from vergence.kernels import compiled
from vergence.models.lens import camera_at, is_distorted, pinhole_ray, ray_to_pixel, undistort_ray
from vergence.models.parts import FloatArray

_DEFAULT_DEPTH_M: Final = 1.0
"""Depth of a target of unknown size, m; scales the image motion by a camera's translation, not by
its rotation (chosen: a usual working distance)."""
_LEAST_DEPTH_RATIO: Final = 0.05
"""Least depth of a predicted corner, as a ratio to the target's; a smaller one is beside or behind
the camera (chosen)."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance on the products of a rotation's rows (chosen: accepts rounded poses)."""


@compiled
def is_rigid_transform(pose: FloatArray) -> bool:
    """True if a (4, 4) matrix has a rotation at its upper left and a finite translation."""
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += pose[i, k] * pose[j, k]
            if not abs(product - (1.0 if i == j else 0.0)) <= _ROTATION_TOLERANCE:
                return False
    handed = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        handed += pose[0, i] * (pose[1, j] * pose[2, k] - pose[1, k] * pose[2, j])
    return handed > 0.0 and isfinite(pose[0, 3] + pose[1, 3] + pose[2, 3])


@compiled
def predict_target_pixels(
    pixels: FloatArray,
    packed_camera: FloatArray,
    T_0_C_before: FloatArray,
    T_0_C_now: FloatArray,
    corners_m: FloatArray,
    out: FloatArray,
) -> bool:
    """Predict the pixels of a target at rest at another camera pose.

    Args:
        pixels: (n + 1, 2) the target's corners, nan where not detected, and its point, px.
        packed_camera: the packed camera, see `pack_camera`.
        T_0_C_before: (4, 4) T_0_C at the exposure of `pixels`, m.
        T_0_C_now: (4, 4) T_0_C to predict for, m.
        corners_m: (n, 2) the corners on the board, m; (0, 2) if its size is unknown.
        out: (n + 1, 2) result: the predicted pixels, px.

    Returns:
        True if the point is predicted inside the lens model and every corner is in front of the
        camera.
    """
    camera = camera_at(packed_camera, 0)
    count = len(pixels)
    for k in range(count):
        x, y = pinhole_ray(camera, pixels[k, 0], pixels[k, 1])
        if is_distorted(camera):
            x, y = undistort_ray(camera, x, y)
        out[k, 0], out[k, 1] = x, y
    depth_m, first, last = _DEFAULT_DEPTH_M, -1, -1
    for k in range(len(corners_m)):
        if isfinite(out[k, 0]):
            first, last = k if first < 0 else first, k
    if first < last:
        apart = hypot(out[last, 0] - out[first, 0], out[last, 1] - out[first, 1])
        apart_m = hypot(
            corners_m[last, 0] - corners_m[first, 0], corners_m[last, 1] - corners_m[first, 1]
        )
        depth_m = apart_m / max(apart, 1e-6)
    for k in range(count):
        if not isfinite(out[k, 0]):
            out[k, 0] = out[k, 1] = nan
            continue
        x, y, z = 0.0, 0.0, 0.0
        for i in range(3):
            a = T_0_C_before[i, 0] * out[k, 0] + T_0_C_before[i, 1] * out[k, 1] + T_0_C_before[i, 2]
            a += (T_0_C_before[i, 3] - T_0_C_now[i, 3]) / depth_m
            x, y, z = x + T_0_C_now[i, 0] * a, y + T_0_C_now[i, 1] * a, z + T_0_C_now[i, 2] * a
        if z < _LEAST_DEPTH_RATIO:
            return False
        out[k, 0], out[k, 1] = ray_to_pixel(camera, x / z, y / z)
    return isfinite(out[count - 1, 0])
