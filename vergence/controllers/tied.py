r"""The article's law where actuators tie the eyes' joints together, or an eye lacks a joint.

What the law asks of both images is then shared out to the actuators by least squares in pixels
(`vergence.models.projection`). Some of a pixel error may be out of reach: of the vertical errors
of eyes with a common tilt, only what they have in common can be taken away. A law that acted on
the rest would wind up on it, or settle beside the least error where its gains differ from axis to
axis. So laws act on the reducible part of the error (`vergence.envs.reducible`),

    e_r = J A s,   s = argmin |J A s - e|^2

with J the image Jacobian of both eyes and A the joints' angles per actuator angle. At the least
error e_r is zero, whatever remains of e.
"""

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from vergence._jit import device, kernel, subroutine
from vergence.envs.reducible import image_jacobians, reducible_part
from vergence.models.head import HeadModel
from vergence.models.packed import PACKED, PackedHead
from vergence.models.parts import FloatArray
from vergence.models.projection import share_of_actuators


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
    return np.asarray(reducible_errors(q, pixel_error, depth, head.packed))


@subroutine
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
    left, right = _sees(error, 0), _sees(error, 1)
    image_jacobians(p, q, error, constant, left, right, jacobian)
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
def _sees(error: FloatArray, eye: int) -> bool:
    return isfinite(error[eye, 0]) and isfinite(error[eye, 1])


@kernel(["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:])"], f"(7),(2,2),(),({PACKED})->(2,2)")
def reducible_errors(
    q: FloatArray, pixel_error: FloatArray, constant: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """The reducible part of pixel errors; `constant` is a depth, nan for the triangulated one."""
    jacobian = np.zeros((2, 2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, constant[0], left, right, jacobian)
    reducible_part(p, jacobian, pixel_error, left, right, out)


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:])"],
    f"(7),(2,2),(2,2),(),(4),({PACKED})->(4)",
)
def tied_command(
    q: FloatArray,
    pixel_error: FloatArray,
    gain: FloatArray,
    constant: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    out: FloatArray,
) -> None:
    """Velocities of the actuators from pixel errors, see `ibvs_command`."""
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, constant[0], left, right, jacobian)
    reducible_part(p, jacobian, pixel_error, left, right, wanted)
    for eye in range(2):
        for axis in range(2):
            wanted[eye, axis] *= -gain[eye, axis]
    share_of_actuators(p, jacobian, wanted, left, right, out)
    _limited(limit, out)
