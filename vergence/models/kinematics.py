r"""Forward kinematics of the head, folded for speed, one kernel for one head and for many.

Between two joints a D-H chain is a constant, so the chain of an eye folds into

    T_N_C = M_0 RotZ(tilt) M_1 RotZ(pan) M_2

and that of the neck into `T_0_N = B_0 RotZ(yaw) B_1 RotZ(roll) B_2 RotZ(pitch) B_3`. The
constants and the cameras of a head lie in one row of numbers, its `packed` array, so that a
head (or a population of heads, one row each) is an ordinary operand of a compiled kernel
that broadcasts by NumPy's rules.
"""

from math import cos, sin
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device, kernel
from vergence.models.packed import PackedHead, eye_link, neck_link, pack
from vergence.models.parts import Cameras, DenavitHartenberg, FloatArray
from vergence.models.pose import Pose, Vector, compose, into, inverse, pose_of, rotate_z, store_pose

T_3_N: Final = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From frame 3 to N: x3 is z_N, y3 is -y_N, z3 is x_N (its own inverse)."""

PAIR: Final = np.zeros(2)
"""Names the dimension "two eyes" (or "u and v") for kernels that have it only in a result."""
QUAD: Final = np.zeros(4)
"""Names the dimension of a homogeneous vector for kernels that have it only in a result."""


def _rot_x(angle: FloatArray) -> FloatArray:
    out = np.zeros((*angle.shape, 4, 4))
    out[..., 0, 0] = out[..., 3, 3] = 1.0
    out[..., 1, 1] = out[..., 2, 2] = np.cos(angle)
    out[..., 2, 1] = np.sin(angle)
    out[..., 1, 2] = -out[..., 2, 1]
    return out


def _rot_z(angle: FloatArray) -> FloatArray:
    out = np.zeros((*angle.shape, 4, 4))
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    return out


def _translation(axis: int, length: FloatArray) -> FloatArray:
    out = np.zeros((*length.shape, 4, 4))
    out[..., range(4), range(4)] = 1.0
    out[..., axis, 3] = length
    return out


def link_transforms(links: DenavitHartenberg, frame: int) -> tuple[FloatArray, FloatArray]:
    """The two constant halves of one link, before and after its rotation about z.

    Args:
        links: the D-H table.
        frame: the link's frame, 1 to 9.

    Returns:
        `RotX(alpha) TransX(a) RotZ(offset)` and `TransZ(d)`, each (..., 4, 4).
    """
    i = frame - 1
    before = _rot_x(links.alpha[..., i]) @ _translation(0, links.a[..., i])
    return before @ _rot_z(links.offset[..., i]), _translation(2, links.d[..., i])


def pack_head(links: DenavitHartenberg, head_eye: FloatArray, cameras: Cameras) -> FloatArray:
    """Fold a head's constants into one row of numbers per head.

    Args:
        links: the D-H table, batched or not.
        head_eye: (..., 2, 4, 4) transforms T_6_Cl and T_9_Cr.
        cameras: the two cameras, batched or not.

    Returns:
        (..., PACKED) read-only array, see `vergence.models.packed`; its leading shape is what
        the parts broadcast to.
    """
    pre, post = zip(*(link_transforms(links, frame) for frame in range(1, 10)), strict=True)
    poses = [pre[0], post[0] @ pre[1], post[1] @ pre[2], post[2] @ T_3_N]
    for eye, tilt in enumerate((3, 6)):
        fixed = post[tilt + 1] @ pre[tilt + 2] @ post[tilt + 2] @ head_eye[..., eye, :, :]
        poses += [T_3_N @ pre[tilt], post[tilt] @ pre[tilt + 1], fixed]
    batch = np.broadcast_shapes(
        links.alpha.shape[:-1],
        links.a.shape[:-1],
        links.d.shape[:-1],
        links.offset.shape[:-1],
        head_eye.shape[:-3],
        cameras.focal.shape[:-2],
        cameras.principal.shape[:-2],
        cameras.distortion.shape[:-2],
    )
    return pack(poses, cameras, batch)


class EyeFrames(NamedTuple):
    """The frames of one eye in N: its joints' axes are the z axes of the first two."""

    tilted: Pose
    panned: Pose
    camera: Pose


@device
def eye_frames(p: PackedHead, eye: int, tilt: float, pan: float) -> EyeFrames:
    """The frames of one eye in N: after its tilt, after its pan, and its camera."""
    tilted = rotate_z(eye_link(p, eye, 0), tilt)
    panned = rotate_z(compose(tilted, eye_link(p, eye, 1)), pan)
    return EyeFrames(tilted, panned, compose(panned, eye_link(p, eye, 2)))


@device
def _unrotate_z(x: float, y: float, angle: float) -> tuple[float, float]:
    c, s = cos(angle), sin(angle)
    return c * x + s * y, c * y - s * x


@device
def point_in_eye(
    p: PackedHead, eye: int, tilt: float, pan: float, x: float, y: float, z: float
) -> Vector:
    """A point of N in one eye's camera frame: the chain of `eye_frames` undone link by link."""
    x, y, z = into(eye_link(p, eye, 0), x, y, z)
    x, y = _unrotate_z(x, y, tilt)
    x, y, z = into(eye_link(p, eye, 1), x, y, z)
    x, y = _unrotate_z(x, y, pan)
    return into(eye_link(p, eye, 2), x, y, z)


@device
def neck_frame(p: PackedHead, yaw: float, roll: float, pitch: float) -> Pose:
    """T_0_N."""
    m = rotate_z(neck_link(p, 0), yaw)
    m = rotate_z(compose(m, neck_link(p, 1)), roll)
    m = rotate_z(compose(m, neck_link(p, 2)), pitch)
    return compose(m, neck_link(p, 3))


@kernel(["(f8[:],f8[:],f8[:],f8[:,:])"], "(j),(p),(h)->(h,h)")
def base_pose(q: FloatArray, p: PackedHead, quad: FloatArray, out: FloatArray) -> None:
    """T_0_N of a packed head."""
    store_pose(out, neck_frame(p, q[0], q[1], q[2]))


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:,:,:])"], "(j),(p),(e),(h)->(e,h,h)")
def camera_poses(
    q: FloatArray, p: PackedHead, pair: FloatArray, quad: FloatArray, out: FloatArray
) -> None:
    """T_N_Cl and T_N_Cr of a packed head."""
    for eye in range(2):
        store_pose(out[eye], eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera)


@kernel(["(f8[:],f8[:],f8[:,:,:],f8[:,:,:])"], "(j),(p),(e,h,h)->(e,h,h)")
def link_poses(q: FloatArray, p: PackedHead, head_eye: FloatArray, out: FloatArray) -> None:
    """T_N_6 and T_N_9 of a packed head and its head-eye transforms."""
    for eye in range(2):
        camera = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera
        store_pose(out[eye], compose(camera, inverse(pose_of(head_eye[eye]))))
