"""Where the board stands, to begin with: each view says so through the head as it is believed."""

from typing import Final

import numpy as np

from vergence.calibration.adjustment import Adjustment, Poses, Rig
from vergence.calibration.cameras import pose_views
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.projection import camera_values
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.perception.located import orders_alike

_MOST_CANDIDATES: Final = 300
"""Views that are compared with each other, of one place of the board."""


def camera_rig(head: HeadModel, eye: int) -> Rig:
    """One eye's camera by itself."""
    cameras = head.cameras
    lens = cameras.lens[eye]
    count = len(camera_values(lens)) - 4
    values = [cameras.focal[eye], cameras.principal[eye], cameras.distortion[eye][:count]]
    return Rig.single(lens, np.concatenate(values))


def board_in_cameras(head: HeadModel, frames: HeadFrames) -> list[Poses]:
    """The board's pose in either camera, frame by frame; without it one that means nothing."""
    found = []
    for eye in range(2):
        only = slice(eye, eye + 1)
        problem = Adjustment(frames.corners, frames.pixels[only], frames.sigma[only])
        width, height = head.cameras.size[eye].tolist()
        found.append(pose_views(problem, camera_rig(head, eye), (width, height)))
    return found


def started(head: HeadModel, frames: HeadFrames) -> tuple[HeadFrames, Poses]:
    """The board's poses in frame 0 on which most views agree.

    A board that looks the same when it is turned is read in the order that agrees as well.

    Args:
        head: as it is believed to be.
        frames: what it saw.

    Returns:
        The frames, their corners in one order, and the poses (b).
    """
    T_0_N = head.base_pose(frames.positions)
    cameras = head.camera_poses(frames.positions)
    orders = orders_alike(frames.target)
    corners = frames.corners
    size = float(np.ptp(corners, axis=0).max())
    enough = frames.seen.sum(axis=-1) >= 4
    placed, turns, shifts = [], [], []
    for eye, seen in enumerate(board_in_cameras(head, frames)):
        T = T_0_N @ cameras[:, eye]
        turn = T[:, :3, :3] @ seen.rotation
        shift = (T[:, :3, :3] @ seen.translation[..., None])[..., 0] + T[:, :3, 3]
        turns.append(turn)
        shifts.append(shift)
        placed.append(corners @ turn.transpose(0, 2, 1) + shift[:, None])
    places = np.stack(placed)
    rotations, translations = [], []
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    for place in range(int(frames.placement.max()) + 1):
        here = np.argwhere(enough & (frames.placement == place))
        some = here[:: -(-len(here) // _MOST_CANDIDATES)]
        sets = places[some[:, 0], some[:, 1]]
        away = np.min(
            [_distance(sets[:, None], sets[None][:, :, order], size) for order in orders], axis=0
        )
        best = some[int(away.mean(axis=1).argmin())]
        chosen = places[best[0], best[1]]
        rotations.append(turns[best[0]][best[1]])
        translations.append(shifts[best[0]][best[1]])
        for eye, frame in here if len(orders) > 1 else ():
            order = min(orders, key=lambda each: _distance(places[eye, frame][each], chosen, size))
            pixels[eye, frame] = frames.pixels[eye, frame][order]
            sigma[eye, frame] = frames.sigma[eye, frame][order]
    same = HeadFrames(
        target=frames.target, time_s=frames.time_s, positions=frames.positions, pixels=pixels,
        sigma=sigma, placement=frames.placement,
    )  # fmt: skip
    return same, Poses(np.array(rotations), np.array(translations))


def _distance(one: FloatArray, other: FloatArray, most: float) -> FloatArray:
    """(...) root mean square distance between corners (..., n, 3), m; `most` at most."""
    away = np.sqrt(((one - other) ** 2).sum(axis=-1).mean(axis=-1))
    return np.asarray(np.minimum(away, most))
