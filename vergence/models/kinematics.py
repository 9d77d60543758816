r"""Forward kinematics of the head, folded for speed, one kernel for one head and for many.

Between two joints a D-H chain is a constant, so the chain of an eye folds into

    T_N_C = M_0 RotZ(tilt) M_1 RotZ(pan) M_2

and that of the neck into `T_0_N = B_0 RotZ(yaw) B_1 RotZ(roll) B_2 RotZ(pitch) B_3`. The
constants and the cameras of a head lie in one row of numbers, its `packed` array, so that a
head (or a population of heads, one row each) is an ordinary operand of a compiled kernel
that broadcasts by NumPy's rules.

Poses inside kernels are tuples of twelve floats, the rows of a 3x4 matrix.
"""

from math import cos, sin
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import device, kernel
from vergence.models.parts import Cameras, DenavitHartenberg, FloatArray

T_3_N: Final = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From frame 3 to N: x3 is z_N, y3 is -y_N, z3 is x_N (its own inverse)."""

POSE: Final = 12
NECK_POSES: Final = 0
EYE_POSES: Final = 4 * POSE
EYE_STRIDE: Final = 3 * POSE
CAMERAS: Final = EYE_POSES + 2 * EYE_STRIDE
CAMERA_STRIDE: Final = 12
PACKED: Final = CAMERAS + 2 * CAMERA_STRIDE
"""Length of a packed head."""

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


def link_transforms(
    links: DenavitHartenberg, frame: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        (..., PACKED) read-only array; the leading shape is what the parts broadcast to.
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
    packed = np.zeros((*batch, PACKED))
    for i, pose in enumerate(poses):
        rows = pose[..., :3, :]
        packed[..., i * POSE : (i + 1) * POSE] = rows.reshape(*rows.shape[:-2], POSE)
    for eye in range(2):
        row = packed[..., CAMERAS + eye * CAMERA_STRIDE :]
        row[..., 0:2] = cameras.focal[..., eye, :]
        row[..., 2:4] = cameras.principal[..., eye, :]
        row[..., 4:9] = cameras.distortion[..., eye, :]
        row[..., 9] = cameras.width
        row[..., 10] = cameras.height
        row[..., 11] = _fold_radius_squared(cameras.distortion[..., eye, :])
    packed.flags.writeable = False
    return packed


def _fold_radius_squared(distortion: FloatArray) -> FloatArray:
    """Squared radius at which the radial distortion turns back on itself, inf if never."""
    k1, k2, k3 = distortion[..., 0], distortion[..., 1], distortion[..., 4]
    # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6), as a polynomial in r^2 with its highest power first
    powers = np.stack([7.0 * k3, 5.0 * k2, 3.0 * k1, np.ones_like(k1)], axis=-1).reshape(-1, 4)
    degree = 3 - np.argmax(powers != 0.0, axis=-1)
    out = np.full(len(powers), np.inf)
    for d in range(1, 4):
        rows = np.flatnonzero(degree == d)
        if not rows.size:
            continue
        # the roots of a polynomial are the eigenvalues of its companion matrix
        companion = np.zeros((len(rows), d, d))
        companion[:, range(1, d), range(d - 1)] = 1.0
        companion[:, 0] = -powers[rows, 4 - d :] / powers[rows, 3 - d, None]
        roots = np.linalg.eigvals(companion)
        fit = (np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)
        out[rows] = np.where(fit, roots.real, np.inf).min(axis=-1)
    return out.reshape(k1.shape)


@device
def load_pose(p: Any, i: int) -> Any:
    """The packed pose that begins at index i."""
    return (
        p[i], p[i + 1], p[i + 2], p[i + 3],
        p[i + 4], p[i + 5], p[i + 6], p[i + 7],
        p[i + 8], p[i + 9], p[i + 10], p[i + 11],
    )  # fmt: skip


@device
def rotate_z(m: Any, angle: float) -> Any:
    """The pose m followed by a rotation about its z axis."""
    c, s = cos(angle), sin(angle)
    return (
        m[0] * c + m[1] * s, m[1] * c - m[0] * s, m[2], m[3],
        m[4] * c + m[5] * s, m[5] * c - m[4] * s, m[6], m[7],
        m[8] * c + m[9] * s, m[9] * c - m[8] * s, m[10], m[11],
    )  # fmt: skip


@device
def compose(m: Any, k: Any) -> Any:
    """The product of two poses."""
    return (
        m[0] * k[0] + m[1] * k[4] + m[2] * k[8],
        m[0] * k[1] + m[1] * k[5] + m[2] * k[9],
        m[0] * k[2] + m[1] * k[6] + m[2] * k[10],
        m[0] * k[3] + m[1] * k[7] + m[2] * k[11] + m[3],
        m[4] * k[0] + m[5] * k[4] + m[6] * k[8],
        m[4] * k[1] + m[5] * k[5] + m[6] * k[9],
        m[4] * k[2] + m[5] * k[6] + m[6] * k[10],
        m[4] * k[3] + m[5] * k[7] + m[6] * k[11] + m[7],
        m[8] * k[0] + m[9] * k[4] + m[10] * k[8],
        m[8] * k[1] + m[9] * k[5] + m[10] * k[9],
        m[8] * k[2] + m[9] * k[6] + m[10] * k[10],
        m[8] * k[3] + m[9] * k[7] + m[10] * k[11] + m[11],
    )  # fmt: skip


@device
def into(m: Any, x: float, y: float, z: float) -> Any:
    """A point of the outer frame in the pose's own frame."""
    dx, dy, dz = x - m[3], y - m[7], z - m[11]
    return (
        m[0] * dx + m[4] * dy + m[8] * dz,
        m[1] * dx + m[5] * dy + m[9] * dz,
        m[2] * dx + m[6] * dy + m[10] * dz,
    )


@device
def out_of(m: Any, x: float, y: float, z: float) -> Any:
    """A point of the pose's own frame in the outer frame."""
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


@device
def eye_frames(p: Any, eye: int, tilt: float, pan: float) -> Any:
    """The frames of one eye in N: after its tilt, after its pan, and its camera."""
    i = EYE_POSES + eye * EYE_STRIDE
    tilted = rotate_z(load_pose(p, i), tilt)
    panned = rotate_z(compose(tilted, load_pose(p, i + POSE)), pan)
    return tilted, panned, compose(panned, load_pose(p, i + 2 * POSE))


@device
def _unrotate_z(x: float, y: float, angle: float) -> Any:
    c, s = cos(angle), sin(angle)
    return c * x + s * y, c * y - s * x


@device
def point_in_eye(p: Any, eye: int, tilt: float, pan: float, x: float, y: float, z: float) -> Any:
    """A point of N in one eye's camera frame: the chain of `eye_frames` undone link by link."""
    i = EYE_POSES + eye * EYE_STRIDE
    x, y, z = into(load_pose(p, i), x, y, z)
    x, y = _unrotate_z(x, y, tilt)
    x, y, z = into(load_pose(p, i + POSE), x, y, z)
    x, y = _unrotate_z(x, y, pan)
    return into(load_pose(p, i + 2 * POSE), x, y, z)


@device
def neck_frame(p: Any, yaw: float, roll: float, pitch: float) -> Any:
    """T_0_N."""
    m = rotate_z(load_pose(p, NECK_POSES), yaw)
    m = rotate_z(compose(m, load_pose(p, NECK_POSES + POSE)), roll)
    m = rotate_z(compose(m, load_pose(p, NECK_POSES + 2 * POSE)), pitch)
    return compose(m, load_pose(p, NECK_POSES + 3 * POSE))


@device
def point_rate(axis: Any, camera: Any, x: float, y: float, z: float) -> Any:
    """How a resting point of N moves in a camera's frame per radian about a frame's z axis.

    `-R_C_N (z_i x (P - o_i))`: the camera turns about the axis, the point stays.
    """
    rx, ry, rz = x - axis[3], y - axis[7], z - axis[11]
    wx = axis[10] * ry - axis[6] * rz
    wy = axis[2] * rz - axis[10] * rx
    wz = axis[6] * rx - axis[2] * ry
    return (
        camera[0] * wx + camera[4] * wy + camera[8] * wz,
        camera[1] * wx + camera[5] * wy + camera[9] * wz,
        camera[2] * wx + camera[6] * wy + camera[10] * wz,
    )


@device
def _store(out: Any, m: Any) -> None:
    for row in range(3):
        for column in range(4):
            out[row, column] = m[4 * row + column]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@kernel(["(f8[:],f8[:],f8[:],f8[:,:])"], "(j),(p),(h)->(h,h)")
def base_pose(q: Any, p: Any, quad: Any, out: Any) -> None:
    """T_0_N of a packed head."""
    _store(out, neck_frame(p, q[0], q[1], q[2]))


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:,:,:])"], "(j),(p),(e),(h)->(e,h,h)")
def camera_poses(q: Any, p: Any, pair: Any, quad: Any, out: Any) -> None:
    """T_N_Cl and T_N_Cr of a packed head."""
    for eye in range(2):
        _tilted, _panned, camera = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye])
        _store(out[eye], camera)
