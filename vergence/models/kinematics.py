"""Kinematics of packed heads in kernels: poses, frames, projection, image Jacobians.

A row holds ten poses, which are the constants between the joints, two cameras, and the linear map
between the eyes' actuators and joints. Operands of kernels stay flat rows of floats. Inside a
kernel, `camera_of`, `neck_constant_pose` and `eye_constant_pose` return the parts as tuples with
named fields, at no cost in time.
"""

from collections.abc import Sequence
from math import cos, nan, sin
from typing import Final, NamedTuple

import numpy as np
from numpy import bool_
from numpy.typing import NDArray

from vergence.kernels import inlined, kernel, make_tuple_reader
from vergence.models.lens import (
    CAMERA_LENGTH,
    CameraRow,
    camera_at,
    is_distorted,
    pinhole_pixel,
    pinhole_ray,
    ray_to_pixel,
    undistort_ray,
)
from vergence.models.parts import SLOTS, Actuation, FloatArray

Vector = tuple[float, float, float]
"""x, y and z."""


class Pose(NamedTuple):
    """T_A_B, the pose of frame B in A: B's axes are the columns, (x, y, z) is its origin, m."""

    xx: float
    xy: float
    xz: float
    x: float
    yx: float
    yy: float
    yz: float
    y: float
    zx: float
    zy: float
    zz: float
    z: float


_pose_run = make_tuple_reader(len(Pose._fields))


@inlined
def pose_at(row: FloatArray, i: int) -> Pose:
    """Read the pose whose twelve numbers begin at index i of a row."""
    return Pose(*_pose_run(row, i))


@inlined
def store_pose(out: FloatArray, m: Pose) -> None:
    """Write a pose to a (4, 4) matrix."""
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = m.xx, m.xy, m.xz, m.x
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = m.yx, m.yy, m.yz, m.y
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = m.zx, m.zy, m.zz, m.z
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@inlined
def rotate_z(m: Pose, angle: float) -> Pose:
    """The pose m followed by a rotation about its own z axis."""
    c, s = cos(angle), sin(angle)
    return Pose(
        m.xx * c + m.xy * s, m.xy * c - m.xx * s, m.xz, m.x,
        m.yx * c + m.yy * s, m.yy * c - m.yx * s, m.yz, m.y,
        m.zx * c + m.zy * s, m.zy * c - m.zx * s, m.zz, m.z,
    )  # fmt: skip


@inlined
def inverse(m: Pose) -> Pose:
    """The inverse of a pose: T_B_A from T_A_B."""
    return Pose(
        m.xx, m.yx, m.zx, -(m.xx * m.x + m.yx * m.y + m.zx * m.z),
        m.xy, m.yy, m.zy, -(m.xy * m.x + m.yy * m.y + m.zy * m.z),
        m.xz, m.yz, m.zz, -(m.xz * m.x + m.yz * m.y + m.zz * m.z),
    )  # fmt: skip


@inlined
def direction_to_outer(m: Pose, x: float, y: float, z: float) -> Vector:
    """Rotate a direction from the pose's own frame to the outer frame."""
    return (
        m.xx * x + m.xy * y + m.xz * z,
        m.yx * x + m.yy * y + m.yz * z,
        m.zx * x + m.zy * y + m.zz * z,
    )


@inlined
def direction_to_local(m: Pose, x: float, y: float, z: float) -> Vector:
    """Rotate a direction from the outer frame to the pose's own frame."""
    return (
        m.xx * x + m.yx * y + m.zx * z,
        m.xy * x + m.yy * y + m.zy * z,
        m.xz * x + m.yz * y + m.zz * z,
    )


@inlined
def point_to_local(m: Pose, x: float, y: float, z: float) -> Vector:
    """Transform a point from the outer frame to the pose's own frame."""
    return direction_to_local(m, x - m.x, y - m.y, z - m.z)


@inlined
def point_to_outer(m: Pose, x: float, y: float, z: float) -> Vector:
    """Transform a point from the pose's own frame to the outer frame."""
    x, y, z = direction_to_outer(m, x, y, z)
    return x + m.x, y + m.y, z + m.z


@inlined
def compose(m: Pose, k: Pose) -> Pose:
    """The product of two poses: T_A_C from T_A_B and T_B_C."""
    x, y = direction_to_outer(m, k.xx, k.yx, k.zx), direction_to_outer(m, k.xy, k.yy, k.zy)
    z, origin = direction_to_outer(m, k.xz, k.yz, k.zz), point_to_outer(m, k.x, k.y, k.z)
    return Pose(
        x[0], y[0], z[0], origin[0],
        x[1], y[1], z[1], origin[1],
        x[2], y[2], z[2], origin[2],
    )  # fmt: skip


@inlined
def point_rate_in_camera(
    joint_frame: Pose, camera_pose: Pose, x: float, y: float, z: float
) -> Vector:
    """`-R_C_N (z_i x (P - o_i))`: motion of a fixed point in the camera per radian of a joint."""
    rx, ry, rz = x - joint_frame.x, y - joint_frame.y, z - joint_frame.z
    wx = joint_frame.zz * ry - joint_frame.yz * rz
    wy = joint_frame.xz * rz - joint_frame.zz * rx
    wz = joint_frame.yz * rx - joint_frame.xz * ry
    return direction_to_local(camera_pose, wx, wy, wz)


PackedHead = FloatArray
"""(PACKED,) one head."""

# Lengths of the parts, and indices of their first elements, in the row of a head (numerical).
_POSE_LENGTH: Final = 12
_CAMERAS_START: Final = 10 * _POSE_LENGTH
_DIRECT: Final = _CAMERAS_START + 2 * CAMERA_LENGTH
_TO_JOINTS: Final = _DIRECT + 1
_OFFSET: Final = _TO_JOINTS + SLOTS * SLOTS
_TO_ACTUATORS: Final = _OFFSET + SLOTS
PACKED: Final = _TO_ACTUATORS + SLOTS * SLOTS
"""Length of a packed head (numerical)."""


def pack_constants(
    poses: Sequence[FloatArray], cameras: FloatArray, actuation: Actuation
) -> FloatArray:
    """(..., PACKED) read-only rows; from ten (..., 4, 4) poses and (..., 2, 17) cameras."""
    batch = np.broadcast_shapes(*(pose.shape[:-2] for pose in poses), cameras.shape[:-2])
    packed = np.zeros((*batch, PACKED))
    for i, pose in enumerate(poses):
        start = i * _POSE_LENGTH
        rows = pose[..., :3, :].reshape(*pose.shape[:-2], _POSE_LENGTH)
        packed[..., start : start + _POSE_LENGTH] = rows
    packed[..., _CAMERAS_START:_DIRECT] = cameras.reshape(*cameras.shape[:-2], 2 * CAMERA_LENGTH)
    packed[..., _DIRECT] = actuation.direct
    packed[..., _TO_JOINTS:_OFFSET] = actuation.to_joints.ravel()
    packed[..., _OFFSET:_TO_ACTUATORS] = actuation.offset
    packed[..., _TO_ACTUATORS:] = actuation.to_actuators.ravel()
    packed.flags.writeable = False
    return packed


@inlined
def camera_of(p: PackedHead, eye: int) -> CameraRow:
    """The camera of an eye, 0 for left, 1 for right."""
    return camera_at(p, _CAMERAS_START + eye * CAMERA_LENGTH)


@inlined
def neck_constant_pose(p: PackedHead, index: int) -> Pose:
    """One of the neck's four constants B_0 (before its first joint) to B_3 (after its third)."""
    return pose_at(p, index * _POSE_LENGTH)


@inlined
def eye_constant_pose(p: PackedHead, eye: int, index: int) -> Pose:
    """One of an eye's three constants M_0 (before its first joint) to M_2 (after its second)."""
    return pose_at(p, (4 + 3 * eye + index) * _POSE_LENGTH)


@inlined
def has_motor_per_joint(p: PackedHead) -> bool:
    """True if each of the four eye joints has its own motor, in joint order."""
    return bool(p[_DIRECT] > 0.5)


@inlined
def joint_per_actuator(p: PackedHead, joint: int, actuator: int) -> float:
    """Angle of an eye joint (0 to 3) per angle of an actuator of the eyes (0 to 3)."""
    return float(p[_TO_JOINTS + SLOTS * joint + actuator])


@inlined
def _add_product(total: float, p: PackedHead, i: int, motions: FloatArray) -> float:
    """Add the product of the row of (4,) numbers that begins at index i, and (4,) motions."""
    for k in range(SLOTS):
        total += p[i + k] * motions[k]
    return total


@inlined
def eye_joint_angle(p: PackedHead, joint: int, actuators: FloatArray) -> float:
    """Angle of an eye joint, rad, from the actuators' angles (4,)."""
    return _add_product(p[_OFFSET + joint], p, _TO_JOINTS + SLOTS * joint, actuators)


@inlined
def eye_joint_velocity(p: PackedHead, joint: int, actuators: FloatArray) -> float:
    """Velocity of an eye joint, rad/s, from the actuators' velocities (4,)."""
    return _add_product(0.0, p, _TO_JOINTS + SLOTS * joint, actuators)


@inlined
def eye_actuator_velocity(p: PackedHead, actuator: int, joints: FloatArray) -> float:
    """Velocity of an actuator of the eyes, rad/s, from the eye joints' velocities (4,)."""
    return _add_product(0.0, p, _TO_ACTUATORS + SLOTS * actuator, joints)


@inlined
def eye_actuator_angle(p: PackedHead, actuator: int, joints: FloatArray) -> float:
    """Angle of an actuator of the eyes, rad, from the eye joints' angles (4,)."""
    i = _TO_ACTUATORS + SLOTS * actuator
    angle = 0.0
    for j in range(SLOTS):
        angle += p[i + j] * (joints[j] - p[_OFFSET + j])
    return angle


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
def base_pose(q: FloatArray, p: PackedHead, _four: FloatArray, out: FloatArray) -> None:
    """T_0_N of a packed head; `_four` only sets the result's dimension."""
    store_pose(out, neck_frame(p, q[0], q[1], q[2]))


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:,:,:])"], f"(7),({PACKED}),(2),(4)->(2,4,4)")
def camera_poses(
    q: FloatArray, p: PackedHead, _two: FloatArray, _four: FloatArray, out: FloatArray
) -> None:
    """T_N_Cl and T_N_Cr of a packed head; `_two` and `_four` only set the size of the result."""
    for eye in range(2):
        store_pose(out[eye], eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera)


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
