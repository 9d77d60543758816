r"""The reducible part of pixel errors: the part that a head's actuators can remove.

With e the errors of both images, J the eyes' image Jacobian and A the joint angles per actuator
angle, the reducible part is `J A (J A)^+ e`. No motion can reduce the rest of e. For coupled
joints, the best gaze (`HeadModel.fixate`) has this rest as its residual, and a reducible part of
zero.
"""

from math import isfinite, nan

import numpy as np

from vergence.kernels import inlined, subroutine
from vergence.models.fixation import actuator_least_squares, image_rate
from vergence.models.kinematics import PackedHead, camera_of, eye_frames, eye_jacobian
from vergence.models.parts import SLOTS, FloatArray
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors


@subroutine
def image_jacobians(
    p: PackedHead,
    q: FloatArray,
    error: FloatArray,
    depth_m: float,
    left_visible: bool,
    right_visible: bool,
    jacobian: FloatArray,
) -> None:
    """Compute the image Jacobians of the eyes that see the target, at its pixels.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan if not visible.
        depth_m: the target's depth, m; nan to triangulate it.
        left_visible: True if the left eye sees the target.
        right_visible: True if the right eye sees the target.
        jacobian: (2, 2, 2) result by eye, image axis and joint of this eye, px/rad; unchanged for
            an eye that does not see the target.
    """
    eyes = (eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6]))
    depth_l = depth_r = depth_m
    if not isfinite(depth_m):
        ray_l, ray_r = rays_from_pixel_errors(p, eyes[0].camera, eyes[1].camera, error)
        depth_l, depth_r, _found = depths_on_rays(ray_l, ray_r)
    for eye in range(2):
        if right_visible if eye else left_visible:
            camera = camera_of(p, eye)
            u, v = camera.centre_u + error[eye, 0], camera.centre_v + error[eye, 1]
            depth = depth_r if eye else depth_l
            u1, u2, v1, v2 = eye_jacobian(p, eye, eyes[eye], u, v, depth)
            jacobian[eye, 0, 0], jacobian[eye, 0, 1] = u1, u2
            jacobian[eye, 1, 0], jacobian[eye, 1, 1] = v1, v2


@subroutine
def reducible_error_by_jacobian(
    p: PackedHead,
    jacobian: FloatArray,
    error: FloatArray,
    left_visible: bool,
    right_visible: bool,
    out: FloatArray,
) -> None:
    """Compute the reducible part of pixel errors from given image Jacobians.

    Args:
        p: a packed head.
        jacobian: (2, 2, 2) by eye, image axis and joint of this eye, px/rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan if not visible.
        left_visible: True if the left eye sees the target; else its errors are ignored.
        right_visible: True if the right eye sees the target; else its errors are ignored.
        out: (2, 2) result, px; nan for an eye that does not see the target.
    """
    share = np.zeros(SLOTS)
    actuator_least_squares(p, jacobian, error, left_visible, right_visible, share)
    for eye in range(2):
        seen = right_visible if eye else left_visible
        for axis in range(2):
            out[eye, axis] = image_rate(p, jacobian, eye, axis, share) if seen else nan


@inlined
def reducible_error(
    p: PackedHead,
    q: FloatArray,
    error: FloatArray,
    left_visible: bool,
    right_visible: bool,
    out: FloatArray,
) -> None:
    """Compute the reducible part of pixel errors at the triangulated depth.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan if not visible.
        left_visible: True if the left eye sees the target; else its errors are ignored.
        right_visible: True if the right eye sees the target; else its errors are ignored.
        out: (2, 2) result, px; nan for an eye that does not see the target.
    """
    jacobian = np.zeros((2, 2, 2))
    image_jacobians(p, q, error, nan, left_visible, right_visible, jacobian)
    reducible_error_by_jacobian(p, jacobian, error, left_visible, right_visible, out)
