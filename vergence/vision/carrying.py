"""Where a target at rest appears once the camera has moved."""

from math import hypot, isfinite, nan
from typing import Final

from vergence._jit import compiled
from vergence.models.camera import pinhole_ray, ray_to_pixel
from vergence.models.lens import is_distorted, undistort_ray
from vergence.models.packed import camera_at
from vergence.models.parts import FloatArray

_DEPTH_M: Final = 1.0
"""Of a target whose size is not known; it scales what a camera's translation, not its turning,
does to the image."""
_NEAREST: Final = 0.05
"""Least depth of a predicted corner, by the target's: less is beside the camera or behind it."""
_NO_ROTATION: Final = 1e-3


@compiled
def is_pose(pose: FloatArray) -> bool:
    """Whether the upper left of a (4, 4) matrix is a rotation, and the translation finite."""
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += pose[i, k] * pose[j, k]
            if not abs(product - (1.0 if i == j else 0.0)) <= _NO_ROTATION:
                return False
    handed = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        handed += pose[0, i] * (pose[1, j] * pose[2, k] - pose[1, k] * pose[2, j])
    return handed > 0.0 and isfinite(pose[0, 3] + pose[1, 3] + pose[2, 3])


@compiled
def carry(
    pixels: FloatArray,
    row: FloatArray,
    before: FloatArray,
    now: FloatArray,
    corners_m: FloatArray,
    out: FloatArray,
) -> bool:
    """Carry pixels of a target along with the camera.

    Args:
        pixels: (n + 1, 2) the target's corners, nan where there is none, and its point, px.
        row: the camera, see `pack_camera`.
        before: (4, 4) T_0_C at their exposure, m.
        now: (4, 4) T_0_C.
        corners_m: (n, 2) the corners on the board; (0, 2) where its size is not known.
        out: (n + 1, 2) result: where they appear now.

    Returns:
        Whether the point appears at all.
    """
    camera = camera_at(row, 0)
    count = len(pixels)
    for k in range(count):
        x, y = pinhole_ray(camera, pixels[k, 0], pixels[k, 1])
        if is_distorted(camera):
            x, y = undistort_ray(camera, x, y)
        out[k, 0], out[k, 1] = x, y
    depth_m, first, last = _DEPTH_M, -1, -1
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
            a = before[i, 0] * out[k, 0] + before[i, 1] * out[k, 1] + before[i, 2]
            a += (before[i, 3] - now[i, 3]) / depth_m
            x, y, z = x + now[i, 0] * a, y + now[i, 1] * a, z + now[i, 2] * a
        if z < _NEAREST:
            return False
        out[k, 0], out[k, 1] = ray_to_pixel(camera, x / z, y / z)
    return isfinite(out[count - 1, 0])
