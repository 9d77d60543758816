r"""The article's law for heads whose actuators couple the eyes' joints, or whose eyes lack a joint.

The image velocities that the law requests are distributed to the actuators by least squares in
pixels (`vergence.models.fixation`). Part of a pixel error may be out of reach: for eyes
with a common tilt, only the common part of the two vertical errors can be removed. A law that acted
on the rest would wind up, or, if its gains differ between axes, settle beside the least error. So
laws act on the reducible part of the error (`vergence.envs.reward`),

    e_r = J A s,   s = argmin |J A s - e|^2

with J the image Jacobian of both eyes and A the joint angles per actuator angle. At the least error
e_r is zero, whatever remains of e.
"""

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.reward import image_jacobians, reducible_error_by_jacobian
from vergence.kernels import inlined, kernel, subroutine
from vergence.models.fixation import actuator_least_squares
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED, PackedHead
from vergence.models.parts import FloatArray


def reducible_pixel_error(
    head: HeadModel, q: ArrayLike, pixel_error: FloatArray, depth: ArrayLike
) -> FloatArray:
    """Compute the part of pixel errors that the head's actuators can remove, to first order.

    Args:
        head: the model of the head.
        q: (..., 7) joint angles at the exposure, rad.
        pixel_error: (..., 2, 2) undistorted pixel minus principal point, px; nan where not visible.
        depth: (...) depth of the target, m; nan to triangulate it.

    Returns:
        (..., 2, 2) px, nan for an eye that does not see the target; the errors themselves for a
        head whose four eye joints each have their own motor.
    """
    if head.actuation.direct:
        return pixel_error
    return np.asarray(reducible_errors(q, pixel_error, depth, head.packed))


@subroutine
def limited_actuator_velocities(
    p: PackedHead,
    q: FloatArray,
    error: FloatArray,
    depth_m: float,
    limit: FloatArray,
    velocities_in_out: FloatArray,
) -> float:
    """Compute actuator velocities that move both images as nearly as possible as wanted.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) pixel errors by eye and image axis, px; an eye with nan does not see the
            target and is ignored.
        depth_m: the target's depth, m; nan to triangulate it.
        limit: (4,) largest speeds of the actuators, rad/s; a command beyond them is scaled down,
            keeping its direction.
        velocities_in_out: (4,) wanted image velocities (u, v) of the left, then the right eye,
            px/s, replaced by the velocities of the actuators, rad/s.

    Returns:
        Factor by which the command exceeded the limits; 1 for not at all.
    """
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = _sees(error, 0), _sees(error, 1)
    image_jacobians(p, q, error, depth_m, left, right, jacobian)
    for k in range(4):
        wanted[k // 2, k % 2] = velocities_in_out[k]
    actuator_least_squares(p, jacobian, wanted, left, right, velocities_in_out)
    return _limited(limit, velocities_in_out)


@inlined
def _limited(limit: FloatArray, out: FloatArray) -> float:
    """Scale velocities down to the limits; return the factor by which they exceeded them."""
    excess = 1.0
    for k in range(4):
        if out[k] != 0.0 and limit[k] > 0.0:
            excess = max(excess, abs(out[k]) / limit[k])
    for k in range(4):
        out[k] = out[k] / excess if isfinite(out[k]) and limit[k] > 0.0 else 0.0
    return excess


@inlined
def _sees(error: FloatArray, eye: int) -> bool:
    return isfinite(error[eye, 0]) and isfinite(error[eye, 1])


@kernel(["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:])"], f"(7),(2,2),(),({PACKED})->(2,2)")
def reducible_errors(
    q: FloatArray, pixel_error: FloatArray, depth_m: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Compute the reducible part of pixel errors; a `depth_m` of nan is triangulated."""
    jacobian = np.zeros((2, 2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, depth_m[0], left, right, jacobian)
    reducible_error_by_jacobian(p, jacobian, pixel_error, left, right, out)


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:])"],
    f"(7),(2,2),(2,2),(),(4),({PACKED})->(4)",
)
def coupled_command(
    q: FloatArray,
    pixel_error: FloatArray,
    gain: FloatArray,
    depth_m: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    out: FloatArray,
) -> None:
    """Compute actuator velocities from pixel errors, see `ibvs_command`."""
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, depth_m[0], left, right, jacobian)
    reducible_error_by_jacobian(p, jacobian, pixel_error, left, right, wanted)
    for eye in range(2):
        for axis in range(2):
            wanted[eye, axis] *= -gain[eye, axis]
    actuator_least_squares(p, jacobian, wanted, left, right, out)
    _limited(limit, out)
