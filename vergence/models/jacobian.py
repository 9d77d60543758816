r"""Image Jacobians of both eyes over all joints.

Per eye, `J = J_image J_joint` (spec, section 3.1) with the interaction matrix

    J_image = diag(f_u, f_v) [ -1/Z   0    x/Z   x y    -(1+x^2)   y ]
                             [  0    -1/Z  y/Z  1+y^2   -x y      -x ]

and `J_joint` the camera's twist per joint rate, `(R (z_i x (o_C - o_i)); R z_i)`. The product
of a column of `J_joint` with `J_image` is the derivative of the projection of
`dP_C/dq_i = -R (z_i x (P - o_i))`, which is how the kernel computes it.
"""

from typing import Any

from vergence._jit import device, kernel
from vergence.models.kinematics import (
    CAMERA_STRIDE,
    CAMERAS,
    NECK_POSES,
    POSE,
    compose,
    eye_frames,
    load_pose,
    out_of,
    point_rate,
    rotate_z,
)


@device
def pixel_rate(p: Any, eye: int, x: float, y: float, depth: float, rate: Any) -> Any:
    """Velocity of an ideal pixel at normalised (x, y) for a velocity of its point, camera frame."""
    i = CAMERAS + eye * CAMERA_STRIDE
    return (
        p[i] * (rate[0] - x * rate[2]) / depth,
        p[i + 1] * (rate[1] - y * rate[2]) / depth,
    )


@device
def eye_jacobian(p: Any, eye: int, frames: Any, u: float, v: float, depth: float) -> Any:
    """The 2x2 image Jacobian by one eye's tilt and pan, row by row.

    Args:
        p: a packed head.
        eye: 0 for left, 1 for right.
        frames: what `eye_frames` returned.
        u: ideal pixel, horizontal.
        v: ideal pixel, vertical.
        depth: the point's z in the camera frame, m.

    Returns:
        du/dtilt, du/dpan, dv/dtilt, dv/dpan in px/rad.
    """
    tilted, panned, camera = frames
    i = CAMERAS + eye * CAMERA_STRIDE
    x, y = (u - p[i + 2]) / p[i], (v - p[i + 3]) / p[i + 1]
    px, py, pz = out_of(camera, x * depth, y * depth, depth)
    ut, vt = pixel_rate(p, eye, x, y, depth, point_rate(tilted, camera, px, py, pz))
    up, vp = pixel_rate(p, eye, x, y, depth, point_rate(panned, camera, px, py, pz))
    return ut, up, vt, vp


@device
def _inverse(m: Any) -> Any:
    return (
        m[0], m[4], m[8], -(m[0] * m[3] + m[4] * m[7] + m[8] * m[11]),
        m[1], m[5], m[9], -(m[1] * m[3] + m[5] * m[7] + m[9] * m[11]),
        m[2], m[6], m[10], -(m[2] * m[3] + m[6] * m[7] + m[10] * m[11]),
    )  # fmt: skip


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:,:])"],
    "(j),(e,e),(e),(p)->(e,e,j)",
)
def image_jacobian(q: Any, pixels: Any, depth: Any, p: Any, out: Any) -> None:
    """Pixel velocity per joint velocity of a target at rest in frame 0, both eyes."""
    # the neck's axes seen from N: walk the chain backwards from N to joint 1
    after_pitch = load_pose(p, NECK_POSES + 3 * POSE)
    after_roll = compose(rotate_z(load_pose(p, NECK_POSES + 2 * POSE), q[2]), after_pitch)
    after_yaw = compose(rotate_z(load_pose(p, NECK_POSES + POSE), q[1]), after_roll)
    yaw, roll, pitch = _inverse(after_yaw), _inverse(after_roll), _inverse(after_pitch)
    for eye in range(2):
        frames = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye])
        tilted, panned, camera = frames
        i = CAMERAS + eye * CAMERA_STRIDE
        x = (pixels[eye, 0] - p[i + 2]) / p[i]
        y = (pixels[eye, 1] - p[i + 3]) / p[i + 1]
        z = depth[eye]
        px, py, pz = out_of(camera, x * z, y * z, z)
        for j in range(7):
            out[eye, 0, j] = out[eye, 1, j] = 0.0
        for j, axis in ((0, yaw), (1, roll), (2, pitch)):
            rate = pixel_rate(p, eye, x, y, z, point_rate(axis, camera, px, py, pz))
            out[eye, 0, j], out[eye, 1, j] = rate
        for j, axis in ((3 + 2 * eye, tilted), (4 + 2 * eye, panned)):
            rate = pixel_rate(p, eye, x, y, z, point_rate(axis, camera, px, py, pz))
            out[eye, 0, j], out[eye, 1, j] = rate
