r"""Head-eye calibration alone: the pose of each camera in the last link of its eye.

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

from vergence.calibration.adjustment import rms_length
from vergence.calibration.head.adjust import HeadAdjustment
from vergence.calibration.head.fit import fit_robustly
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.pose_equations import BoolArray, solve_poses
from vergence.calibration.head.start import (
    LEAST_CORNERS,
    board_in_cameras,
    estimate_consensus_board_poses,
    single_camera_rig,
)
from vergence.calibration.projection import project_with_jacobians
from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.located import equivalent_corner_orders

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
    residuals = fit.solution.normal.residuals * problem.frames.sigma
    return HeadEyeFit(
        np.asarray(fit.solution.head.head_eye),
        rms_length(residuals[fit.kept_corners]),
        np.asarray(fit.kept_corners.any(axis=-1)),
    )
