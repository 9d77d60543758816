"""Rays from both eyes to a target in an image, and the target's depth along them."""

from typing import Final, NamedTuple

from vergence.kernels import inlined
from vergence.models.kinematics import PackedHead, Pose, camera_of, point_to_outer
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import Ray, distances_to_perpendicular

DEFAULT_DEPTH_M: Final = 1.0
"""Depth if triangulation fails, m (chosen: the geometric mean of `DEPTH_RANGE_M`)."""
DEPTH_RANGE_M: Final = (0.1, 10.0)
"""Least and greatest triangulated depth, m (chosen: the depth scales only the small translational
part of the image Jacobian)."""


class RayDepths(NamedTuple):
    """Depths of a target along both rays, metres; `valid` is True if they are triangulated."""

    left: float
    right: float
    valid: bool


@inlined
def ray_from_pixel_error(
    p: PackedHead, eye: int, camera: Pose, error_u_px: float, error_v_px: float
) -> Ray:
    """Compute the ray in N of an image's pixel error.

    Args:
        p: a packed head.
        eye: 0 for left, 1 for right.
        camera: pose of that eye's camera in N at the exposure.
        error_u_px: undistorted pixel less principal point along u, px; nan if not visible.
        error_v_px: undistorted pixel less principal point along v, px; nan if not visible.

    Returns:
        The ray. Its direction has unit z in the camera, so the distance along it is the depth.
    """
    lens = camera_of(p, eye)
    tip = point_to_outer(camera, error_u_px / lens.focal_u, error_v_px / lens.focal_v, 1.0)
    origin = (camera.x, camera.y, camera.z)
    return Ray(origin, (tip[0] - camera.x, tip[1] - camera.y, tip[2] - camera.z))


@inlined
def rays_from_pixel_errors(
    p: PackedHead, left: Pose, right: Pose, error: FloatArray
) -> tuple[Ray, Ray]:
    """Compute the rays in N of both images' pixel errors.

    Args:
        p: a packed head.
        left: pose of the left camera in N at the exposure.
        right: pose of the right camera in N at the exposure.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan if not visible.

    Returns:
        The left and the right ray, see `ray_from_pixel_error`.
    """
    return (
        ray_from_pixel_error(p, 0, left, error[0, 0], error[0, 1]),
        ray_from_pixel_error(p, 1, right, error[1, 0], error[1, 1]),
    )


@inlined
def depths_on_rays(left: Ray, right: Ray) -> RayDepths:
    """Triangulate the depths along both rays, clipped to `DEPTH_RANGE_M`; else the default."""
    s, t, found = distances_to_perpendicular(left, right)
    if not found:
        return RayDepths(DEFAULT_DEPTH_M, DEFAULT_DEPTH_M, False)
    return RayDepths(
        min(max(s, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        min(max(t, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        True,
    )
