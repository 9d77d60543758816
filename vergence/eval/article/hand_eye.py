"""Head-eye calibration alone: the pose of each camera in the last link of its eye.

The kinematics (lengths, joint offsets) and the cameras' lenses are taken as known here; the
head-eye transforms compensate for their errors as far as they can. In each frame, the joint angles
give T_N_6, T_N_9 and the neck's T_0_N, and the images give the board's pose T_C_B in each camera.

A single eye (`solve_each_eye`), with the board at rest anywhere, is a hand-eye calibration,

    (T_0_N T_N_6)_i X_l = T_0_B inv(T_Cl_B)_i.

Both eyes at once (`solve_both_eyes`) are ITPC-style, reconstructed, see `vergence.triangulation`:
with B_i = inv(T_N_6) T_N_9 and C_i = T_Cl_B inv(T_Cr_B) of frame i,

    B_i X_r = X_l C_i.

Two such frames give (B_2 B_1^-1) X_l = X_l (C_2 C_1^-1) and (B_1^-1 B_2) X_r = X_r (C_1^-1 C_2),
which add no information. The equation contains neither the neck nor the board's position, and the
board may move. It observes only motions that change B. Of its 12 unknowns, the motions of the
article's head leave unobservable:

- a common tilt of both eyes: 6, as B does not change;
- a common pan (version): 3, a translation of both cameras together;
- opposite pans (vergence), and any exact fixation, as both eyes tilt about one line: 1, a
  translation of both cameras along the pan axis.

For the last two, the rotations follow only from the translation of B, a baseline that rotates. A
closed form that begins with rotations cannot use it, so that motions in which B rotates about fewer
than two axes are refused. Therefore the eyes must also tilt against each other and look beside the
board; eyes with a common tilt cannot.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import project_with_jacobians, rms_length
from vergence.calibration.head.adjust import HeadAdjustment
from vergence.calibration.head.fit import (
    board_in_cameras,
    estimate_consensus_board_poses,
    fit_robustly,
    single_camera_rig,
)
from vergence.calibration.head.recording import LEAST_CORNERS, HeadFrames
from vergence.errors import ConfigurationError
from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.locate import equivalent_corner_orders

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
    columns = (3 + 3 * group[:, None] + np.arange(3))[:, :, None]
    np.put_along_axis(rows, columns, np.full((len(A), 3, 1), -1.0), axis=2)
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
        K[each] = np.einsum("n,nji,njk->ik", signs, _product(q, -1.0), _product(p, 1.0))
        count[each] = mine.sum()
    x = np.linalg.eigh((K.transpose(0, 2, 1) @ K / count[:, None, None]).sum(axis=0))[1][:, -1]
    y = K @ x
    y[np.linalg.norm(y, axis=1) == 0.0] = [0.0, 0.0, 0.0, 1.0]  # a group without poses
    return Rotation.from_quat(x), Rotation.from_quat(y)


def _product(q: FloatArray, sign: float) -> FloatArray:
    """(n, 4, 4) L(q) of quaternions x, y, z, w for the sign 1, R(q) for the sign -1."""
    x, y, z, w = q.T
    u, v, s = sign * x, sign * y, sign * z
    rows = [[w, -s, v, x], [s, w, -u, y], [-v, u, w, z], [-x, -y, -z, w]]
    return np.asarray(np.moveaxis(np.array(rows), -1, 0))


_ROTATION_PRIOR_RAD: Final = 1.0
"""Prior standard deviation of a head-eye rotation, rad (chosen: too large to matter)."""
_TRANSLATION_PRIOR_M: Final = 0.5
"""Prior standard deviation of a head-eye translation, m (chosen: too large to matter)."""


class HeadEyeFit(NamedTuple):
    """Head-eye transforms, and their residuals."""

    head_eye: FloatArray
    """(2, 4, 4) T_6_Cl and T_9_Cr, see `HeadModel.head_eye`."""
    rms_px: float
    """Root mean square reprojection error of the kept views' corners, px."""
    kept_views: BoolArray
    """(2, f) True for kept views, the inliers."""


class _Views(NamedTuple):
    """Poses of the eyes, and of the board in their cameras."""

    frames: HeadFrames
    links: FloatArray
    """(2, f, 4, 4) T_N_6 and T_N_9."""
    neck: FloatArray
    """(f, 4, 4) T_0_N."""
    boards: FloatArray
    """(2, f, 4, 4) T_Cl_B and T_Cr_B."""
    seen: BoolArray
    """(2, f) True for views that show the board."""

    @classmethod
    def of(cls, head: HeadModel, frames: HeadFrames) -> "_Views":
        if len(equivalent_corner_orders(frames.target)) > 1:
            frames = estimate_consensus_board_poses(head, frames).frames
        boards = np.tile(np.eye(4), (2, len(frames.time_s), 1, 1))
        for eye, poses in enumerate(board_in_cameras(head, frames)):
            boards[eye, :, :3, :3], boards[eye, :, :3, 3] = poses
        q = frames.joint_positions
        links = np.moveaxis(head.link_poses(q), -3, 0)
        seen = frames.seen.sum(axis=-1) >= LEAST_CORNERS
        return cls(frames, links, head.base_pose(q), boards, seen)

    def rms_px(self, head: HeadModel, predicted: FloatArray, kept: BoolArray) -> float:
        """Compute the rms reprojection error of the board's predicted poses (2, f, 4, 4)."""
        points = self.frames.corners @ np.swapaxes(predicted[..., :3, :3], -1, -2)
        points = points + predicted[..., None, :3, 3]
        residuals = np.full(self.frames.pixels.shape, np.nan)
        for eye in range(2):
            rig = single_camera_rig(head, eye)
            seen = project_with_jacobians(
                rig.lenses[0], rig.camera_parameters[0], points[eye]
            ).pixels
            residuals[eye] = seen - self.frames.pixels[eye]
        return rms_length(residuals[kept])


def solve_each_eye(head: HeadModel, frames: HeadFrames) -> HeadEyeFit:
    """Find each eye's transform separately, in closed form, robust to bad views."""
    views = _Views.of(head, frames)
    found, kept, predicted = [], np.zeros_like(views.seen), np.array(views.boards)
    for eye, name in enumerate(EYE_NAMES):
        mine, place = views.seen[eye], views.frames.placement
        A = views.neck[mine] @ views.links[eye, mine]
        group = np.unique(place[mine], return_inverse=True)[1]
        solved = solve_poses(A, inverse_pose(views.boards[eye, mine]), group, f"the {name} eye")
        found.append(solved.X)
        kept[eye, mine] = solved.kept_poses
        predicted[eye, mine] = inverse_pose(A @ solved.X) @ solved.Y[group]
    return HeadEyeFit(np.stack(found), views.rms_px(head, predicted, kept), kept)


def solve_both_eyes(head: HeadModel, frames: HeadFrames) -> HeadEyeFit:
    """Find both transforms at once, in closed form, robust to bad views (ITPC, reconstructed)."""
    views = _Views.of(head, frames)
    both = views.seen.all(axis=0)
    left, right = views.boards[:, both]
    B = inverse_pose(views.links[0, both]) @ views.links[1, both]
    alone = np.zeros(len(B), dtype=np.intp)
    solved = solve_poses(B, left @ inverse_pose(right), alone, "the eyes against each other")
    head_eye = np.stack([solved.Y[0], solved.X])
    between = inverse_pose(head_eye[0]) @ B @ head_eye[1]
    predicted, kept = np.array(views.boards), np.zeros_like(views.seen)
    predicted[0, both], predicted[1, both] = between @ right, inverse_pose(between) @ left
    kept[:, both] = solved.kept_poses
    return HeadEyeFit(head_eye, views.rms_px(head, predicted, kept), kept)


def refine_by_reprojection(head: HeadModel, frames: HeadFrames, start: HeadEyeFit) -> HeadEyeFit:
    """Refine both transforms alone on all corners, with the board's pose and reading errors."""
    start_head = head.replace(head_eye=start.head_eye)
    parameters = start_head.parameters()
    prior_sigma = np.zeros(len(parameters.names))
    for place, (name, unit) in enumerate(zip(parameters.names, parameters.units, strict=True)):
        if ".head_eye." in name:
            prior_sigma[place] = _ROTATION_PRIOR_RAD if unit == "rad" else _TRANSLATION_PRIOR_M
    start_of_board = estimate_consensus_board_poses(start_head, frames)
    problem = HeadAdjustment(start_head, prior_sigma, start_of_board.frames)
    fit = fit_robustly(problem, start_of_board.boards, start_of_board.inlier_views)
    residuals = fit.normal.residuals * problem.frames.sigma
    kept_views, rms_px = fit.kept_corners.any(axis=-1), rms_length(residuals[fit.kept_corners])
    return HeadEyeFit(np.asarray(fit.head.head_eye), rms_px, np.asarray(kept_views))
