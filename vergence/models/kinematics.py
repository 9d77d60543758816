"""Kinematics for kernels and arrays: link and camera poses, projection, image Jacobians."""

from math import cos, nan, sin
from typing import Final, NamedTuple

import numpy as np
from numpy import bool_
from numpy.typing import NDArray

from vergence.kernels import inlined, kernel
from vergence.models.actuation import Actuation
from vergence.models.camera import Cameras
from vergence.models.geometry import Links
from vergence.models.lens import (
    CameraRow,
    is_distorted,
    pinhole_pixel,
    pinhole_ray,
    ray_to_pixel,
    undistort_ray,
)
from vergence.models.packed import (
    PACKED,
    PackedHead,
    Pose,
    Vector,
    camera_of,
    compose,
    eye_constant_pose,
    inverse,
    neck_constant_pose,
    pack_constants,
    point_rate_in_camera,
    point_to_local,
    point_to_outer,
    pose_of_matrix,
    rotate_z,
    store_pose,
)
from vergence.models.parts import FloatArray

TWO_ELEMENTS: Final = np.zeros(2)
"""Operand of the dimension "two eyes" (or "u and v"), for kernels with this dimension only in a
result (numerical)."""
FOUR_ELEMENTS: Final = np.zeros(4)
"""Operand of the dimension of a homogeneous vector, for kernels with it only in a result
(numerical)."""


def pack_head(links: Links, cameras: Cameras, actuation: Actuation) -> FloatArray:
    """(..., PACKED) read-only rows of a head's constants, see `vergence.models.packed`."""
    poses = links.constant_poses()
    for eye in range(2):
        poses[6 + 3 * eye] = poses[6 + 3 * eye] @ cameras[eye].pose
    rows = cameras.rows
    batch = np.broadcast_shapes(
        *(value.shape[: value.ndim - own] for value, own in links.arrays().values()),
        cameras.pose.shape[:-3],
        rows.shape[:-2],
    )
    return pack_constants(poses, rows, actuation, batch)


class EyeFrames(NamedTuple):
    """Frames of one eye in N: after each joint, whose axis is that frame's z axis, and camera."""

    after_first_joint: Pose
    after_second_joint: Pose
    camera: Pose


@inlined
def eye_frames(p: PackedHead, eye: int, first_angle: float, second_angle: float) -> EyeFrames:
    """The frames of one eye in N: after its first joint, after its second, and its camera."""
    first = rotate_z(eye_constant_pose(p, eye, 0), first_angle)
    second = rotate_z(compose(first, eye_constant_pose(p, eye, 1)), second_angle)
    return EyeFrames(first, second, compose(second, eye_constant_pose(p, eye, 2)))


@inlined
def _unrotate_z(x: float, y: float, angle: float) -> tuple[float, float]:
    c, s = cos(angle), sin(angle)
    return c * x + s * y, c * y - s * x


@inlined
def point_in_eye(
    p: PackedHead, eye: int, first_angle: float, second_angle: float, x: float, y: float, z: float
) -> Vector:
    """Transform a point from N to one eye's camera frame, link by link."""
    x, y, z = point_to_local(eye_constant_pose(p, eye, 0), x, y, z)
    x, y = _unrotate_z(x, y, first_angle)
    x, y, z = point_to_local(eye_constant_pose(p, eye, 1), x, y, z)
    x, y = _unrotate_z(x, y, second_angle)
    return point_to_local(eye_constant_pose(p, eye, 2), x, y, z)


@inlined
def neck_frame(p: PackedHead, q1: float, q2: float, q3: float) -> Pose:
    """T_0_N: pose of frame N in the base, at the neck's joint angles, rad."""
    m = rotate_z(neck_constant_pose(p, 0), q1)
    m = rotate_z(compose(m, neck_constant_pose(p, 1)), q2)
    m = rotate_z(compose(m, neck_constant_pose(p, 2)), q3)
    return compose(m, neck_constant_pose(p, 3))


@kernel(["(f8[:],f8[:],f8[:],f8[:,:])"], f"(7),({PACKED}),(4)->(4,4)")
def frame_n_in_base(q: FloatArray, p: PackedHead, _four: FloatArray, out: FloatArray) -> None:
    """T_0_N of a packed head; `_four` only sets the result's dimension."""
    store_pose(out, neck_frame(p, q[0], q[1], q[2]))


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:,:,:])"], f"(7),({PACKED}),(2),(4)->(2,4,4)")
def camera_poses(
    q: FloatArray, p: PackedHead, _two: FloatArray, _four: FloatArray, out: FloatArray
) -> None:
    """T_N_Cl and T_N_Cr of a packed head; `_two` and `_four` only set the size of the result."""
    for eye in range(2):
        store_pose(out[eye], eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera)


@kernel(["(f8[:],f8[:],f8[:,:,:],f8[:,:,:])"], f"(7),({PACKED}),(2,4,4)->(2,4,4)")
def last_eye_link_poses(
    q: FloatArray, p: PackedHead, head_eye: FloatArray, out: FloatArray
) -> None:
    """Poses in N of the eyes' last links, of a packed head and its head-eye transforms."""
    for eye in range(2):
        camera = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera
        store_pose(out[eye], compose(camera, inverse(pose_of_matrix(head_eye[eye]))))


@inlined
def point_to_pixel(
    p: PackedHead, eye: int, x: float, y: float, z: float, distorted: bool
) -> tuple[float, float]:
    """The pixel of a point in the camera frame; nan behind the camera or beyond the lens model."""
    if not z > 0.0:
        return nan, nan
    camera = camera_of(p, eye)
    if distorted:
        return ray_to_pixel(camera, x / z, y / z)
    return pinhole_pixel(camera, x / z, y / z)


@inlined
def undistort_pixel(p: PackedHead, eye: int, u: float, v: float) -> tuple[float, float]:
    """The ideal pinhole pixel of a raw pixel; nan if the lens model has no inverse there."""
    camera = camera_of(p, eye)
    if not is_distorted(camera):
        return u, v
    x, y = pinhole_ray(camera, u, v)
    x, y = undistort_ray(camera, x, y)
    return pinhole_pixel(camera, x, y)


@inlined
def pixel_error(p: PackedHead, eye: int, u: float, v: float) -> tuple[float, float]:
    """Offset of an undistorted raw pixel from the principal point, px."""
    camera = camera_of(p, eye)
    u, v = undistort_pixel(p, eye, u, v)
    return u - camera.centre_u, v - camera.centre_v


@inlined
def inside_image(p: PackedHead, eye: int, u: float, v: float) -> bool:
    """True if a raw pixel lies in the image; pixel centres are at integers."""
    camera = camera_of(p, eye)
    # `&`, not `and`: branches on a batch's targets would be mispredicted
    return (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)


@kernel(
    ["(f8[:],f8[:],b1[:],f8[:],f8[:],f8[:,:])"],
    f"(7),(3),(),({PACKED}),(2)->(2,2)",
)
def project(
    q: FloatArray,
    points: FloatArray,
    distorted: NDArray[bool_],
    p: PackedHead,
    _two: FloatArray,
    out: FloatArray,
) -> None:
    """Pixels in both eyes of a point given in N."""
    for eye in range(2):
        tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
        x, y, z = point_in_eye(p, eye, tilt, pan, points[0], points[1], points[2])
        out[eye, 0], out[eye, 1] = point_to_pixel(p, eye, x, y, z, distorted[0])


@kernel(["(f8[:,:],f8[:],f8[:,:])"], f"(2,2),({PACKED})->(2,2)")
def undistort(pixels: FloatArray, p: PackedHead, out: FloatArray) -> None:
    """Ideal pinhole pixels of raw pixels, for both eyes."""
    for eye in range(2):
        out[eye, 0], out[eye, 1] = undistort_pixel(p, eye, pixels[eye, 0], pixels[eye, 1])


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
