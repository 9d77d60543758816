r"""The article's law where actuators tie the eyes' joints together, or an eye lacks a joint.

What the law asks of both images is then shared out to the actuators by least squares in pixels
(`vergence.models.projection`). Some of a pixel error may be out of reach: of the vertical errors
of eyes with a common tilt, only what they have in common can be taken away. A law that acted on
the rest would wind up on it, or settle beside the least error where its gains differ from axis to
axis. So laws act on the reducible part of the error,

    e_r = J A s,   s = argmin |J A s - e|^2

with J the image Jacobian of both eyes and A the joints' angles per actuator angle. At the least
error e_r is zero, whatever remains of e.
"""

from math import isfinite, nan

import numpy as np
from numpy.typing import ArrayLike

from vergence._jit import device, kernel
from vergence.models.head import HeadModel
from vergence.models.jacobian import eye_jacobian
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray
from vergence.models.projection import image_rate, share_of_actuators
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image


def reducible(
    head: HeadModel, q: ArrayLike, pixel_error: FloatArray, depth: ArrayLike
) -> FloatArray:
    """The part of pixel errors that the head's actuators can take away, to first order.

    Args:
        head: the model of the head.
        q: (..., 7) joint angles at the exposure, rad.
        pixel_error: (..., 2, 2) undistorted pixel less principal point, px; nan unseen.
        depth: (...) of the target, m; nan for the triangulated one.

    Returns:
        (..., 2, 2) px, nan for an eye that does not see; the errors themselves for a head whose
        four eye joints each have a motor of their own.
    """
    if head.actuation.direct:
        return pixel_error
    return np.asarray(reducible_error(q, pixel_error, depth, head.packed))


@device
def image_jacobians(
    p: PackedHead, q: FloatArray, error: FloatArray, constant: float, jacobian: FloatArray
) -> tuple[bool, bool]:
    """The image Jacobians of both eyes at an image.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) pixel errors by eye and image axis, px; nan unseen.
        constant: a depth, m; nan for the triangulated one.
        jacobian: (2, 2, 2) result by eye, image axis and joint of that eye, px/rad.

    Returns:
        Whether the left eye sees the target, and whether the right one does.
    """
    left, right = eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6])
    depth_l = depth_r = constant
    if not isfinite(constant):
        ray_l, ray_r = rays_of_image(p, left.camera, right.camera, error)
        depth_l, depth_r, _found = depths_on_rays(ray_l, ray_r)
    for eye in range(2):
        frames, depth = (left, depth_l) if eye == 0 else (right, depth_r)
        camera = camera_of(p, eye)
        u, v = camera.centre_u + error[eye, 0], camera.centre_v + error[eye, 1]
        u1, u2, v1, v2 = eye_jacobian(p, eye, frames, u, v, depth)
        jacobian[eye, 0, 0], jacobian[eye, 0, 1] = u1, u2
        jacobian[eye, 1, 0], jacobian[eye, 1, 1] = v1, v2
    return (
        isfinite(error[0, 0]) and isfinite(error[0, 1]),
        isfinite(error[1, 0]) and isfinite(error[1, 1]),
    )


@device
def actuators_of_image(
    p: PackedHead,
    q: FloatArray,
    error: FloatArray,
    constant: float,
    limit: FloatArray,
    out: FloatArray,
) -> float:
    """Velocities of the actuators that move both images as nearly as wanted as they can.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) pixel errors by eye and image axis, px; an eye that does not see, nan, has
            no wish.
        constant: a depth, m; nan for the triangulated one.
        limit: (4,) greatest speeds of the actuators, rad/s; a command beyond them is scaled down
            with its direction kept.
        out: (4,) the image's wanted velocities (u, v) of the left, then the right eye, px/s,
            replaced by the velocities of the actuators, rad/s.

    Returns:
        By how much the command went beyond the limits, as a factor; 1 for not at all.
    """
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = image_jacobians(p, q, error, constant, jacobian)
    for k in range(4):
        wanted[k // 2, k % 2] = out[k]
    share_of_actuators(p, jacobian, wanted, left, right, out)
    return _limited(limit, out)


@device
def _limited(limit: FloatArray, out: FloatArray) -> float:
    """Scale velocities down to limits; the factor by which they went beyond."""
    excess = 1.0
    for k in range(4):
        if out[k] != 0.0 and limit[k] > 0.0:
            excess = max(excess, abs(out[k]) / limit[k])
    for k in range(4):
        out[k] = out[k] / excess if isfinite(out[k]) and limit[k] > 0.0 else 0.0
    return excess


@device
def _reduce(
    p: PackedHead,
    jacobian: FloatArray,
    error: FloatArray,
    left: bool,
    right: bool,
    out: FloatArray,
) -> None:
    """The reducible part (2, 2) of errors; nan for an eye that does not see."""
    share = np.zeros(4)
    share_of_actuators(p, jacobian, error, left, right, share)
    for eye in range(2):
        for axis in range(2):
            seen = right if eye else left
            out[eye, axis] = image_rate(p, jacobian, eye, axis, share) if seen else nan


@kernel(["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:])"], "(j),(e,e),(),(p)->(e,e)")
def reducible_error(
    q: FloatArray, error: FloatArray, constant: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """The reducible part of pixel errors; `constant` is a depth, nan for the triangulated one."""
    jacobian = np.zeros((2, 2, 2))
    left, right = image_jacobians(p, q, error, constant[0], jacobian)
    _reduce(p, jacobian, error, left, right, out)


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:])"],
    "(j),(e,e),(e,e),(),(a),(p)->(a)",
)
def tied_command(
    q: FloatArray,
    error: FloatArray,
    gain: FloatArray,
    constant: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    out: FloatArray,
) -> None:
    """Velocities of the actuators from pixel errors, see `ibvs_command`."""
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = image_jacobians(p, q, error, constant[0], jacobian)
    _reduce(p, jacobian, error, left, right, wanted)
    for eye in range(2):
        for axis in range(2):
            wanted[eye, axis] *= -gain[eye, axis]
    share_of_actuators(p, jacobian, wanted, left, right, out)
    _limited(limit, out)
