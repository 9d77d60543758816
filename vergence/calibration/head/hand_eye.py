r"""Head-eye calibration alone: where either camera is in the last link of its eye.

All that the joints carry is believed here, lengths and offsets and the cameras' lenses; an error of
those is made up for as far as head-eye transforms can. Frame by frame, the joint angles give
T_N_6, T_N_9 and the neck's T_0_N, and the images give the board's pose T_C_B in either camera.

One eye by itself (`single_eye`), with the board anywhere at rest, is hand-eye calibration,

    (T_0_N T_N_6)_i X_l = T_0_B inv(T_Cl_B)_i.

Both at once (`both_eyes`) is ITPC-style, reconstructed, see `vergence.triangulation`: with
B_i = inv(T_N_6) T_N_9 and C_i = T_Cl_B inv(T_Cr_B) of frame i,

    B_i X_r = X_l C_i.

Two of them give (B_2 B_1^-1) X_l = X_l (C_2 C_1^-1) and (B_1^-1 B_2) X_r = X_r (C_1^-1 C_2), which
say nothing else. Neither the neck nor where the board stands is in it, and the board may move. It
can see only what changes B. Of its 12 numbers, motions of the article's head leave unseen:

- a common tilt of both eyes: 6, as B stays as it is;
- a common pan (version): 3, a shift of both cameras together;
- opposite pans (vergence), and any exact fixation, as both eyes tilt about one line: 1, a shift of
  both along the axis of pan.

From the last two, rotations follow only by the translation of B, a baseline that turns. A closed
form that begins with rotations cannot use it: where B turns about no axis or one, it is refused. So
the eyes must tilt against each other, too, and look beside the board; those with one common tilt
cannot.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.adjustment import rms
from vergence.calibration.head.adjust import HeadAdjustment
from vergence.calibration.head.fit import fitted
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.pose_equations import BoolArray, solve_poses
from vergence.calibration.head.start import (
    LEAST_CORNERS,
    board_in_cameras,
    camera_rig,
    started,
)
from vergence.calibration.projection import project
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES
from vergence.models.links import inverse_pose
from vergence.models.parts import FloatArray
from vergence.perception.located import orders_alike

_TURN_RAD: Final = 1.0
_SHIFT_M: Final = 0.5
"""Deviations of the head-eye transforms from the start, so large that they do not matter."""


class HeadEye(NamedTuple):
    """Head-eye transforms, and how well they fit."""

    head_eye: FloatArray
    """(2, 4, 4) T_6_Cl and T_9_Cr, see `HeadModel.head_eye`."""
    rms_px: float
    """Root mean square distance of the kept views' corners from where the transforms have them."""
    kept: BoolArray
    """(2, f) the views that went in."""


class _Views(NamedTuple):
    """Poses of the eyes and of the board before them."""

    frames: HeadFrames
    links: FloatArray
    """(2, f, 4, 4) T_N_6 and T_N_9."""
    neck: FloatArray
    """(f, 4, 4) T_0_N."""
    boards: FloatArray
    """(2, f, 4, 4) T_Cl_B and T_Cr_B."""
    seen: BoolArray
    """(2, f) which views show the board."""

    @classmethod
    def of(cls, head: HeadModel, frames: HeadFrames) -> "_Views":
        if len(orders_alike(frames.target)) > 1:
            frames = started(head, frames).frames
        boards = np.tile(np.eye(4), (2, len(frames.time_s), 1, 1))
        for eye, poses in enumerate(board_in_cameras(head, frames)):
            boards[eye, :, :3, :3], boards[eye, :, :3, 3] = poses
        q = frames.positions
        links = np.moveaxis(head.link_poses(q), -3, 0)
        seen = frames.seen.sum(axis=-1) >= LEAST_CORNERS
        return cls(frames, links, head.base_pose(q), boards, seen)

    def rms_px(self, head: HeadModel, predicted: FloatArray, kept: BoolArray) -> float:
        """Corners against measured ones, by the board's predicted poses (2, f, 4, 4)."""
        points = self.frames.corners @ np.swapaxes(predicted[..., :3, :3], -1, -2)
        points = points + predicted[..., None, :3, 3]
        residuals = np.full(self.frames.pixels.shape, np.nan)
        for eye in range(2):
            rig = camera_rig(head, eye)
            seen = project(rig.lenses[0], rig.values[0], points[eye]).pixels
            residuals[eye] = seen - self.frames.pixels[eye]
        return rms(residuals[kept])


def single_eye(head: HeadModel, frames: HeadFrames) -> HeadEye:
    """Find each eye's transform by itself, in closed form, robust to bad views.

    Args:
        head: as its file has it; its own head-eye transforms do not matter.
        frames: what it saw.

    Raises:
        ConfigurationError: too few views of an eye show the board, or its eye does not turn about
            two axes between them.
    """
    views = _Views.of(head, frames)
    found, kept, predicted = [], np.zeros_like(views.seen), np.array(views.boards)
    for eye, name in enumerate(EYE_NAMES):
        mine, place = views.seen[eye], views.frames.placement
        A = views.neck[mine] @ views.links[eye, mine]
        group = np.unique(place[mine], return_inverse=True)[1]
        solved = solve_poses(A, inverse_pose(views.boards[eye, mine]), group, f"the {name} eye")
        found.append(solved.X)
        kept[eye, mine] = solved.kept
        predicted[eye, mine] = inverse_pose(A @ solved.X) @ solved.Y[group]
    return HeadEye(np.stack(found), views.rms_px(head, predicted, kept), kept)


def both_eyes(head: HeadModel, frames: HeadFrames) -> HeadEye:
    """Find both transforms at once, in closed form, robust to bad views: ITPC-style, reconstructed.

    Args:
        head: as its file has it; its own head-eye transforms do not matter.
        frames: what it saw; only those count that show the board to both eyes.

    Raises:
        ConfigurationError: too few frames show the board to both eyes, or the eyes do not turn
            against each other about two axes.
    """
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
    kept[:, both] = solved.kept
    return HeadEye(head_eye, views.rms_px(head, predicted, kept), kept)


def by_reprojection(head: HeadModel, frames: HeadFrames, start: HeadEye) -> HeadEye:
    """Refine both transforms, and nothing else of the head, on the corners of all views.

    The board's pose in frame 0 and the joint angles within the encoders' errors are found along.

    Args:
        head: as its file has it.
        frames: what it saw.
        start: transforms near by, from which rotations are counted.

    Raises:
        ConfigurationError: the frames do not tell where the board is.
    """
    about = head.replace(head_eye=start.head_eye)
    parameters = about.parameters()
    spreads = np.zeros(len(parameters.names))
    for place, (name, unit) in enumerate(zip(parameters.names, parameters.units, strict=True)):
        if ".head_eye." in name:
            spreads[place] = _TURN_RAD if unit == "rad" else _SHIFT_M
    start_of_board = started(about, frames)
    problem = HeadAdjustment(about, spreads, start_of_board.frames)
    fit = fitted(problem, start_of_board.boards, start_of_board.agree)
    residuals = fit.solution.normal.residuals * problem.frames.sigma
    return HeadEye(
        np.asarray(fit.solution.head.head_eye),
        rms(residuals[fit.kept]),
        np.asarray(fit.kept.any(axis=-1)),
    )
