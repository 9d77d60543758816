r"""The part of measured pixel errors that a head's actuators can take away.

With e the errors of both images, J the eyes' image Jacobian and A the joints' angles per actuator
angle, it is `J A (J A)^+ e`. What is left of e, no motion can reduce: where actuators tie joints,
that is the residual of the gaze that `HeadModel.fixate` calls best, at which this part is zero.
"""

import numpy as np

from vergence._jit import device
from vergence.models.actuation import SLOTS
from vergence.models.jacobian import eye_jacobian
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray
from vergence.models.projection import image_rate, share_of_actuators
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image


@device
def reducible_error(
    p: PackedHead, q: FloatArray, error: FloatArray, left: bool, right: bool, out: FloatArray
) -> None:
    """The part of pixel errors that the actuators can take away.

    Args:
        p: a packed head.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        left: whether the left eye sees the target; its errors count for nothing else.
        right: whether the right one does.
        out: (2, 2) result, px; nan for an eye that does not see.
    """
    eyes = (eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6]))
    ray_l, ray_r = rays_of_image(p, eyes[0].camera, eyes[1].camera, error)
    depth_l, depth_r, _found = depths_on_rays(ray_l, ray_r)
    jacobian, share = np.zeros((2, 2, 2)), np.zeros(SLOTS)
    for eye in range(2):
        if right if eye else left:
            camera = camera_of(p, eye)
            u, v = camera.centre_u + error[eye, 0], camera.centre_v + error[eye, 1]
            depth = depth_r if eye else depth_l
            ut, up, vt, vp = eye_jacobian(p, eye, eyes[eye], u, v, depth)
            jacobian[eye, 0, 0], jacobian[eye, 0, 1] = ut, up
            jacobian[eye, 1, 0], jacobian[eye, 1, 1] = vt, vp
    share_of_actuators(p, jacobian, error, left, right, share)
    for eye in range(2):
        seen = right if eye else left
        for axis in range(2):
            out[eye, axis] = image_rate(p, jacobian, eye, axis, share) if seen else np.nan
