r"""Closed-form solution for two unknown transforms X and Y, from poses with A_i X = Y B_i.

Rotations come first. As unit quaternions they obey a_i x = y b_i up to sign, so that the
least-squares rotations maximise

    y^T K x,    K = sum_i R(b_i)^T L(a_i),    (L(p) q = p q = R(q) p),

which gives the first pair of singular vectors of a 4x4 matrix. If each group of poses has its own
Y, x is the first eigenvector of the sum of K^T K / n over groups of n poses. With known rotations,
A_i X = Y B_i is linear in the translations. Every pose counts once, and all pairs of poses are
used: eliminating Y from two of them gives (A_j^-1 A_i) X = X (B_j^-1 B_i), the equation of hand-eye
calibration.

The A_i must rotate relative to each other about at least two axes. If all rotate about one axis, X
and Y may rotate about it and move along it together.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vergence.errors import ConfigurationError
from vergence.models.geometry import inverse_pose
from vergence.models.parts import FloatArray

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
LEAST_TURN_RAD: Final = np.deg2rad(0.5).item()
"""Least root mean square rotation about the second axis, rad (chosen: 0.5 degrees, as errors are
about 0.1 degrees for a board's pose in an image and 0.03 degrees for an encoder's reading)."""
_LEAST_POSES: Final = 3
"""Fewest poses (physical: geometry, they have two relative rotations, about two axes)."""
_OUTLIER_RATIO: Final = 4.0
"""Ratio of a pose's error to the median above which it is an outlier (chosen: only one normally
distributed error of three coordinates in 10^9 is so large)."""
_ANGLE_ROUNDING_RAD: Final = 1e-7
"""Rounding of angles between quaternions, rad (numerical)."""
_UNRELATED_RAD: Final = 0.1
"""Median mismatch of rotations above which A and B do not belong together, rad (chosen)."""
_MOST_ROUNDS: Final = 20
"""Largest number of rounds of fitting and selecting poses (numerical)."""


class PoseSolution(NamedTuple):
    """The transforms, and the poses that were used."""

    X: FloatArray
    """(4, 4) X."""
    Y: FloatArray
    """(g, 4, 4) Y of each group."""
    kept_poses: BoolArray
    """(n,) True for kept poses, the inliers."""


def solve_poses(A: FloatArray, B: FloatArray, group: IntArray, part_name: str) -> PoseSolution:
    """X and Y with A_i X = Y B_i, (n, 4, 4) in m, for most i; `group` is the index of each Y."""
    if len(A) < _LEAST_POSES:
        raise ConfigurationError(
            f"expected at least {_LEAST_POSES} poses of {part_name}, better 60, got {len(A)}"
        )
    a, b = (Rotation.from_matrix(each[:, :3, :3]) for each in (A, B))
    mismatch = _mismatch(a, b, group)
    usual = float(np.median(mismatch))
    if usual > _UNRELATED_RAD:
        raise ConfigurationError(
            f"expected joint angles that belong to the images, got rotations of {part_name} that "
            f"differ by {np.rad2deg(usual):.0f} degrees from those of the board"
        )
    kept = mismatch <= _OUTLIER_RATIO * usual + _ANGLE_ROUNDING_RAD
    for _ in range(_MOST_ROUNDS):
        _refuse_still(a, group, kept, part_name)
        X, Y = _fitted(A, B, (a, b), group, kept)
        off = inverse_pose(A @ X) @ Y[group] @ B
        turn = np.linalg.norm(Rotation.from_matrix(off[:, :3, :3]).as_rotvec(), axis=1)
        errors = (turn, np.linalg.norm(off[:, :3, 3], axis=1))
        chosen = np.ones_like(kept)
        for error in errors:
            chosen &= error <= _OUTLIER_RATIO * np.median(error[kept]) + _ANGLE_ROUNDING_RAD
        if np.array_equal(chosen, kept):
            break
        kept = chosen
    return PoseSolution(X, Y, kept)


def _mismatch(a: Rotation, b: Rotation, group: IntArray) -> FloatArray:
    """(n,) median difference, rad, of angles between poses by A and B: equal for any X and Y."""
    angles = [
        2.0 * np.arccos(np.clip(np.abs(q @ q.T), 0.0, 1.0)) for q in (a.as_quat(), b.as_quat())
    ]
    apart = np.where(group[:, None] == group, np.abs(angles[0] - angles[1]), np.nan)
    np.fill_diagonal(apart, 0.0)
    return np.asarray(np.nanmedian(apart, axis=1))


def _refuse_still(a: Rotation, group: IntArray, kept: BoolArray, part_name: str) -> None:
    turns = np.zeros((len(kept), 3))
    for each in np.unique(group[kept]):
        mine = kept & (group == each)
        turns[mine] = (a[mine].mean().inv() * a[mine]).as_rotvec()
    spread = np.linalg.svd(turns[kept], compute_uv=False) / np.sqrt(kept.sum())
    if len(spread) < 2 or spread[1] < LEAST_TURN_RAD:
        degrees = np.rad2deg(spread[:2])
        raise ConfigurationError(
            f"expected {part_name} to turn about two axes, by {np.rad2deg(LEAST_TURN_RAD):g} "
            f"degrees or more about each, got {' and '.join(f'{each:.2g}' for each in degrees)}"
        )


def _fitted(
    A: FloatArray, B: FloatArray, turns: tuple[Rotation, Rotation], group: IntArray, kept: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Fit X and Y by least squares: rotations, then translations."""
    groups = int(group.max()) + 1
    x, y = _rotations(turns[0].as_quat(), turns[1].as_quat(), group, kept, groups)
    X, Y = np.eye(4), np.tile(np.eye(4), (groups, 1, 1))
    X[:3, :3], Y[:, :3, :3] = x.as_matrix(), y.as_matrix()
    # R_A t_X - t_Y = R_Y t_B - t_A
    A, B, group = A[kept], B[kept], group[kept]
    rows = np.zeros((len(A), 3, 3 + 3 * groups))
    rows[:, :, :3] = A[:, :3, :3]
    np.put_along_axis(
        rows,
        (3 + 3 * group[:, None] + np.arange(3))[:, :, None],
        np.full((len(A), 3, 1), -1.0),
        axis=2,
    )
    right = np.einsum("nij,nj->ni", Y[group, :3, :3], B[:, :3, 3]) - A[:, :3, 3]
    shifts = np.linalg.lstsq(rows.reshape(-1, 3 + 3 * groups), right.ravel(), rcond=None)[0]
    X[:3, 3], Y[:, :3, 3] = shifts[:3], shifts[3:].reshape(-1, 3)
    return X, Y


def _rotations(
    a: FloatArray, b: FloatArray, group: IntArray, kept: BoolArray, groups: int
) -> tuple[Rotation, Rotation]:
    """Fit the rotations of X, and of Y by group, to quaternions x, y, z, w (n, 4)."""
    K, count = np.zeros((groups, 4, 4)), np.ones(groups)
    for each in np.unique(group[kept]):
        mine = kept & (group == each)
        p, q = a[mine], b[mine]
        # q and -q are the same rotation: choose signs so that relative quaternions agree in A and B
        signs = np.sign(p @ p[0]) * np.sign(q @ q[0])
        K[each] = np.einsum("n,nji,njk->ik", signs, _right(q), _left(p))
        count[each] = mine.sum()
    x = np.linalg.eigh((K.transpose(0, 2, 1) @ K / count[:, None, None]).sum(axis=0))[1][:, -1]
    y = K @ x
    y[np.linalg.norm(y, axis=1) == 0.0] = [0.0, 0.0, 0.0, 1.0]  # a group without poses
    return Rotation.from_quat(x), Rotation.from_quat(y)


def _left(q: FloatArray) -> FloatArray:
    """(n, 4, 4) L(q) of quaternions x, y, z, w."""
    return _product(q, 1.0)


def _right(q: FloatArray) -> FloatArray:
    """(n, 4, 4) R(q)."""
    return _product(q, -1.0)


def _product(q: FloatArray, sign: float) -> FloatArray:
    x, y, z, w = q.T
    u, v, s = sign * x, sign * y, sign * z
    rows = [[w, -s, v, x], [s, w, -u, y], [-v, u, w, z], [-x, -y, -z, w]]
    return np.asarray(np.moveaxis(np.array(rows), -1, 0))
