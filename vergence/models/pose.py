"""Poses inside kernels: the 3x4 matrix of a rigid transform as a tuple with named elements."""

from math import cos, sin
from typing import NamedTuple

from vergence._jit import inlined
from vergence._runs import make_tuple_reader
from vergence.models.parts import FloatArray

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
def pose_of_matrix(matrix: FloatArray) -> Pose:
    """The pose of a (4, 4) matrix."""
    a, b, c = matrix[0], matrix[1], matrix[2]
    return Pose(a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3], c[0], c[1], c[2], c[3])


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
def compose(m: Pose, k: Pose) -> Pose:
    """The product of two poses: T_A_C from T_A_B and T_B_C."""
    return Pose(
        m.xx * k.xx + m.xy * k.yx + m.xz * k.zx,
        m.xx * k.xy + m.xy * k.yy + m.xz * k.zy,
        m.xx * k.xz + m.xy * k.yz + m.xz * k.zz,
        m.xx * k.x + m.xy * k.y + m.xz * k.z + m.x,
        m.yx * k.xx + m.yy * k.yx + m.yz * k.zx,
        m.yx * k.xy + m.yy * k.yy + m.yz * k.zy,
        m.yx * k.xz + m.yy * k.yz + m.yz * k.zz,
        m.yx * k.x + m.yy * k.y + m.yz * k.z + m.y,
        m.zx * k.xx + m.zy * k.yx + m.zz * k.zx,
        m.zx * k.xy + m.zy * k.yy + m.zz * k.zy,
        m.zx * k.xz + m.zy * k.yz + m.zz * k.zz,
        m.zx * k.x + m.zy * k.y + m.zz * k.z + m.z,
    )


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
    return (
        m.xx * x + m.xy * y + m.xz * z + m.x,
        m.yx * x + m.yy * y + m.yz * z + m.y,
        m.zx * x + m.zy * y + m.zz * z + m.z,
    )


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
