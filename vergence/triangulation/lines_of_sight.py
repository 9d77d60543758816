"""The rays along which two eyes see a target in an image, and how far away it is on them."""

from typing import Any, Final

from vergence._jit import device
from vergence.models.kinematics import CAMERA_STRIDE, CAMERAS, out_of
from vergence.triangulation.rays import nearest

DEFAULT_DEPTH_M: Final = 1.0
"""Depth where triangulation has no answer."""
DEPTH_RANGE_M: Final = (0.1, 10.0)
"""What a triangulated depth is limited to: it scales the small part of J that is translation."""


@device
def rays_of_image(p: Any, cl: Any, cr: Any, error: Any) -> Any:
    """The rays of an image's pixel errors, in N.

    Args:
        p: a packed head.
        cl: frame of the left camera at the exposure.
        cr: of the right.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.

    Returns:
        Origin and direction of the left ray, then of the right one. Directions have unit z in
        the camera, so that distance along a ray is depth.
    """
    i, k = CAMERAS, CAMERAS + CAMERA_STRIDE
    ol, orr = (cl[3], cl[7], cl[11]), (cr[3], cr[7], cr[11])
    tip_l = out_of(cl, error[0, 0] / p[i], error[0, 1] / p[i + 1], 1.0)
    tip_r = out_of(cr, error[1, 0] / p[k], error[1, 1] / p[k + 1], 1.0)
    dl = (tip_l[0] - ol[0], tip_l[1] - ol[1], tip_l[2] - ol[2])
    dr = (tip_r[0] - orr[0], tip_r[1] - orr[1], tip_r[2] - orr[2])
    return ol, dl, orr, dr


@device
def depths_on_rays(ol: Any, dl: Any, orr: Any, dr: Any) -> Any:
    """Depths along both rays by triangulation, within the range, or the default.

    Returns:
        The left depth, the right one, m, and whether they are triangulated.
    """
    s, t, found = nearest(ol, dl, orr, dr)
    if not found:
        return DEFAULT_DEPTH_M, DEFAULT_DEPTH_M, False
    depth_l = min(max(s, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1])
    depth_r = min(max(t, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1])
    return depth_l, depth_r, True
