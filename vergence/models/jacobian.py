r"""Image Jacobians of both eyes over all joints.

Per eye, `J = J_image J_joint` (spec, section 3.1) with the interaction matrix

    J_image = diag(f_u, f_v) [ -1/Z   0    x/Z   x y    -(1+x^2)   y ]
                             [  0    -1/Z  y/Z  1+y^2   -x y      -x ]

and `J_joint` the camera's twist per joint rate, `(R (z_i x (o_C - o_i)); R z_i)`. The kernel
computes each column of the product as the derivative of the projection for a point that moves by
`dP_C/dq_i = -R (z_i x (P - o_i))`.
"""

from vergence._jit import inlined, kernel
from vergence.models.camera import pinhole_ray
from vergence.models.kinematics import EyeFrames, eye_frames
from vergence.models.lens import CameraRow
from vergence.models.packed import PACKED, PackedHead, camera_of, neck_constant_pose
from vergence.models.parts import FloatArray
from vergence.models.pose import (
    Vector,
    compose,
    inverse,
    point_rate_in_camera,
    point_to_outer,
    rotate_z,
)


@inlined
def pixel_rate(
    camera: CameraRow, x: float, y: float, depth: float, point_velocity: Vector
) -> tuple[float, float]:
    """Velocity of the ideal pixel at normalised (x, y) from the point's velocity in the camera."""
    return (
        camera.focal_u * (point_velocity[0] - x * point_velocity[2]) / depth,
        camera.focal_v * (point_velocity[1] - y * point_velocity[2]) / depth,
    )


@inlined
def eye_jacobian(
    p: PackedHead, eye: int, frames: EyeFrames, ideal_u: float, ideal_v: float, depth: float
) -> tuple[float, float, float, float]:
    """du/dtilt, du/dpan, dv/dtilt, dv/dpan, px/rad, at an ideal pixel and depth z, m."""
    camera = camera_of(p, eye)
    x, y = pinhole_ray(camera, ideal_u, ideal_v)
    px, py, pz = point_to_outer(frames.camera, x * depth, y * depth, depth)
    tilting = point_rate_in_camera(frames.after_first_joint, frames.camera, px, py, pz)
    panning = point_rate_in_camera(frames.after_second_joint, frames.camera, px, py, pz)
    ut, vt = pixel_rate(camera, x, y, depth, tilting)
    up, vp = pixel_rate(camera, x, y, depth, panning)
    return ut, up, vt, vp


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:,:])"],
    f"(7),(2,2),(2),({PACKED})->(2,2,7)",
)
def image_jacobian(
    q: FloatArray, pixels: FloatArray, depth: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Pixel velocity per joint velocity of a target at rest in frame 0, both eyes."""
    # the neck's axes seen from N: walk the chain backwards from N to joint 1
    after_pitch = neck_constant_pose(p, 3)
    after_roll = compose(rotate_z(neck_constant_pose(p, 2), q[2]), after_pitch)
    after_yaw = compose(rotate_z(neck_constant_pose(p, 1), q[1]), after_roll)
    yaw, roll, pitch = inverse(after_yaw), inverse(after_roll), inverse(after_pitch)
    for eye in range(2):
        camera = camera_of(p, eye)
        frames = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye])
        x, y = pinhole_ray(camera, pixels[eye, 0], pixels[eye, 1])
        z = depth[eye]
        px, py, pz = point_to_outer(frames.camera, x * z, y * z, z)
        for j in range(7):
            out[eye, 0, j] = out[eye, 1, j] = 0.0
        for j, axis in (
            (0, yaw),
            (1, roll),
            (2, pitch),
            (3 + 2 * eye, frames.after_first_joint),
            (4 + 2 * eye, frames.after_second_joint),
        ):
            rate = point_rate_in_camera(axis, frames.camera, px, py, pz)
            out[eye, 0, j], out[eye, 1, j] = pixel_rate(camera, x, y, z, rate)
