"""Initial poses of the board: each view gives one through the nominal head, and most agree."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses, BundleAdjustment, CameraRig
from vergence.calibration.cameras import estimate_board_poses
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.projection import camera_parameter_names
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.perception.located import equivalent_corner_orders

LEAST_CORNERS: Final = 4
"""Fewest corners of a view (physical: geometry, fewer do not determine the board's pose)."""
_MOST_CANDIDATES: Final = 300
"""Most views of one placement that are compared pairwise (numerical)."""


def single_camera_rig(head: HeadModel, eye: int) -> CameraRig:
    """Make a rig of one eye's camera."""
    cameras = head.cameras
    lens = cameras.lens[eye]
    count = len(camera_parameter_names(lens)) - 4
    values = [cameras.focal[eye], cameras.principal[eye], cameras.distortion[eye][:count]]
    return CameraRig.single(lens, np.concatenate(values))


def board_in_cameras(head: HeadModel, frames: HeadFrames) -> list[BoardPoses]:
    """Find the board's pose in each camera, frame by frame; a placeholder without the board."""
    found = []
    for eye in range(2):
        only = slice(eye, eye + 1)
        problem = BundleAdjustment(frames.corners, frames.pixels[only], frames.sigma[only])
        width, height = head.cameras.size[eye].tolist()
        found.append(estimate_board_poses(problem, single_camera_rig(head, eye), (width, height)))
    return found


class InitialBoardPoses(NamedTuple):
    """Initial poses of the board, on which most views agree."""

    frames: HeadFrames
    """Frames with the corners of rotationally symmetric boards in one order."""
    boards: BoardPoses
    """(b) poses of the board in frame 0."""
    inlier_views: NDArray[np.bool_]
    """(2, f) True for views that agree with these poses."""
    spread_m: float
    """Median rms distance of these views' corners from the poses' corners; median over
    placements."""


def estimate_consensus_board_poses(head: HeadModel, frames: HeadFrames) -> InitialBoardPoses:
    """Find the poses of the board on which most views agree, through a given head."""
    places, turns, shifts = board_corners_and_poses_in_base(head, frames)
    orders = equivalent_corner_orders(frames.target)
    enough = frames.seen.sum(axis=-1) >= LEAST_CORNERS
    enough &= np.isfinite(places).all(axis=(-2, -1))  # pixels outside the lens's range
    rotations, translations, spreads = [], [], []
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    inlier_views = np.zeros(enough.shape, dtype=bool)
    for place in range(int(frames.placement.max()) + 1):
        here = np.argwhere(enough & (frames.placement == place))
        if not len(here):
            raise np.linalg.LinAlgError(
                "expected views that determine where the board is, got none"
            )
        best, away, order = _medoid(places, here, orders)
        rotations.append(turns[best])
        translations.append(shifts[best])
        near = away <= 4.0 * np.quantile(away, 0.25) + 0.25 * _size(frames)
        spreads.append(float(np.median(away[near])))
        for (eye, frame), its, close in zip(here.tolist(), order.tolist(), near, strict=True):
            inlier_views[eye, frame] = close
            pixels[eye, frame] = frames.pixels[eye, frame][orders[its]]
            sigma[eye, frame] = frames.sigma[eye, frame][orders[its]]
    return InitialBoardPoses(
        replace(frames, pixels=pixels, sigma=sigma),
        BoardPoses(np.array(rotations), np.array(translations)),
        inlier_views,
        float(np.median(spreads)),
    )


def board_corners_and_poses_in_base(
    head: HeadModel, frames: HeadFrames
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(2, f, n, 3) corners, m, and pose (2, f, 3, 3), (2, f, 3) in frame 0, or placeholders."""
    T_0_C = head.base_pose(frames.joint_positions)[:, None] @ head.camera_poses(
        frames.joint_positions
    )
    places, turns, shifts = [], [], []
    for eye, seen in enumerate(board_in_cameras(head, frames)):
        T = T_0_C[:, eye]
        turn = T[:, :3, :3] @ seen.rotation
        shift = (T[:, :3, :3] @ seen.translation[..., None])[..., 0] + T[:, :3, 3]
        turns.append(turn)
        shifts.append(shift)
        places.append(frames.corners @ turn.transpose(0, 2, 1) + shift[:, None])
    return np.stack(places), np.stack(turns), np.stack(shifts)


def _medoid(
    places: FloatArray, here: NDArray[np.intp], orders: Sequence[NDArray[np.intp]]
) -> tuple[tuple[int, int], FloatArray, NDArray[np.intp]]:
    """Find the medoid view, the views' distances to it, and their corner orders."""
    some = here[:: -(-len(here) // _MOST_CANDIDATES)]
    sets = places[some[:, 0], some[:, 1]]
    most = np.ptp(sets[0], axis=0).max()
    away = np.min([_distance(sets[:, None], sets[None][:, :, order]) for order in orders], axis=0)
    eye, frame = some[int(np.minimum(away, most).mean(axis=1).argmin())].tolist()
    every = places[here[:, 0], here[:, 1]]
    by_order = np.array([_distance(every[:, order], places[eye, frame]) for order in orders])
    return (eye, frame), by_order.min(axis=0), by_order.argmin(axis=0)


def _size(frames: HeadFrames) -> float:
    return float(np.ptp(frames.corners, axis=0).max())


def _distance(one: FloatArray, other: FloatArray) -> FloatArray:
    """(...) root mean square distance between corners (..., n, 3), m."""
    return np.asarray(np.sqrt(((one - other) ** 2).sum(axis=-1).mean(axis=-1)))
