r"""Forward kinematics of the head, one kernel for one head and for many.

Between two joints the transform is constant, so the chain of an eye is the product

    T_N_C = M_0 RotZ(q1) M_1 RotZ(q2) M_2

and the chain of the neck is `T_0_N = B_0 RotZ(q1) B_1 RotZ(q2) B_2 RotZ(q3) B_3`. The constants and
the cameras of a head form one row of numbers, its packed array. A head (or a population of heads,
one row each) is thus an ordinary operand of a compiled kernel that broadcasts by NumPy's rules.
"""

from math import cos, sin
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import inlined, kernel
from vergence.models.actuation import Actuation
from vergence.models.cameras import Cameras
from vergence.models.links import Links
from vergence.models.packed import (
    PACKED,
    PackedHead,
    eye_constant_pose,
    neck_constant_pose,
    pack_constants,
)
from vergence.models.parts import FloatArray
from vergence.models.pose import (
    Pose,
    Vector,
    compose,
    inverse,
    point_to_local,
    pose_of_matrix,
    rotate_z,
    store_pose,
)

TWO_ELEMENTS: Final = np.zeros(2)
"""Operand of the dimension "two eyes" (or "u and v"), for kernels with this dimension only in a
result (numerical)."""
FOUR_ELEMENTS: Final = np.zeros(4)
"""Operand of the dimension of a homogeneous vector, for kernels with it only in a result
(numerical)."""


def pack_head(
    links: Links, head_eye: FloatArray, cameras: Cameras, actuation: Actuation
) -> FloatArray:
    """(..., PACKED) read-only rows of a head's constants, see `vergence.models.packed`."""
    poses = links.constant_poses()
    for eye in range(2):
        poses[6 + 3 * eye] = poses[6 + 3 * eye] @ head_eye[..., eye, :, :]
    batch = np.broadcast_shapes(
        *(value.shape[: value.ndim - own] for value, own in links.arrays().values()),
        head_eye.shape[:-3],
        cameras.focal.shape[:-2],
        cameras.principal.shape[:-2],
        cameras.distortion.shape[:-2],
    )
    return pack_constants(poses, cameras, actuation, batch)


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
