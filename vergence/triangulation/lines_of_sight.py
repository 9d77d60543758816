"""The rays along which two eyes see a target in an image, and how far away it is on them."""

from typing import Final, NamedTuple

from vergence._jit import device
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray
from vergence.models.pose import Pose, out_of
from vergence.triangulation.rays import Ray, nearest

DEFAULT_DEPTH_M: Final = 1.0
"""Depth where triangulation has no answer."""
DEPTH_RANGE_M: Final = (0.1, 10.0)
"""What a triangulated depth is limited to: it scales the small part of J that is translation."""


class Depths(NamedTuple):
    """How far away a target is on both rays, metres, and whether that is triangulated."""

    left: float
    right: float
    found: bool


@device
def ray_of_error(p: PackedHead, eye: int, camera: Pose, error_u: float, error_v: float) -> Ray:
    """The ray of an image's pixel error, in N.

    Args:
        p: a packed head.
        eye: 0 for left, 1 for right.
        camera: the frame of that eye's camera at the exposure.
        error_u: undistorted pixel less principal point, px; nan unseen.
        error_v: the same along v.

    Returns:
        The ray. Its direction has unit z in the camera, so that distance along it is depth.
    """
    lens = camera_of(p, eye)
    tip = out_of(camera, error_u / lens.focal_u, error_v / lens.focal_v, 1.0)
    origin = (camera.x, camera.y, camera.z)
    return Ray(origin, (tip[0] - camera.x, tip[1] - camera.y, tip[2] - camera.z))


@device
def rays_of_image(p: PackedHead, left: Pose, right: Pose, error: FloatArray) -> tuple[Ray, Ray]:
    """The rays of an image's pixel errors, in N.

    Args:
        p: a packed head.
        left: frame of the left camera at the exposure.
        right: of the right.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.

    Returns:
        The left ray and the right one, see `ray_of_error`.
    """
    return (
        ray_of_error(p, 0, left, error[0, 0], error[0, 1]),
        ray_of_error(p, 1, right, error[1, 0], error[1, 1]),
    )


@device
def depths_on_rays(left: Ray, right: Ray) -> Depths:
    """Depths along both rays by triangulation, within the range, or the default."""
    s, t, found = nearest(left, right)
    if not found:
        return Depths(DEFAULT_DEPTH_M, DEFAULT_DEPTH_M, False)
    return Depths(
        min(max(s, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        min(max(t, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1]),
        True,
    )
