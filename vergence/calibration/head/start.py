"""Where the board stands, to begin with: each view says so through the head as it is believed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import Adjustment, Poses, Rig
from vergence.calibration.cameras import pose_views
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.projection import camera_values
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.perception.located import orders_alike

LEAST_CORNERS: Final = 4
"""Of a view: fewer do not tell where the board is."""
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


class Start(NamedTuple):
    """Where the board stands by itself, as most views have it."""

    frames: HeadFrames
    """With the corners of all views in one order: a board may look the same when it is turned."""
    boards: Poses
    """(b) in frame 0."""
    agree: NDArray[np.bool_]
    """(2, f) the views that have it about there."""
    spread_m: float
    """By how much half of these views have its corners elsewhere."""


def started(head: HeadModel, frames: HeadFrames) -> Start:
    """Find where most views have the board, through the head as it is believed to be.

    Args:
        head: as it is believed to be.
        frames: what it saw.

    Raises:
        LinAlgError: no view tells where the board is.
    """
    places, turns, shifts = board_in_base(head, frames)
    orders = orders_alike(frames.target)
    enough = frames.seen.sum(axis=-1) >= LEAST_CORNERS
    enough &= np.isfinite(places).all(axis=(-2, -1))  # not what no lens can have brought there
    rotations, translations, spreads = [], [], []
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    agree = np.zeros(enough.shape, dtype=bool)
    for place in range(int(frames.placement.max()) + 1):
        here = np.argwhere(enough & (frames.placement == place))
        if not len(here):
            raise np.linalg.LinAlgError("expected views that tell where the board is, got none")
        best, away, order = _middle(places, here, orders)
        rotations.append(turns[best])
        translations.append(shifts[best])
        near = away <= 4.0 * np.quantile(away, 0.25) + 0.25 * _size(frames)
        spreads.append(float(np.median(away[near])))
        for (eye, frame), its, close in zip(here.tolist(), order.tolist(), near, strict=True):
            agree[eye, frame] = close
            pixels[eye, frame] = frames.pixels[eye, frame][orders[its]]
            sigma[eye, frame] = frames.sigma[eye, frame][orders[its]]
    return Start(
        replace(frames, pixels=pixels, sigma=sigma),
        Poses(np.array(rotations), np.array(translations)),
        agree,
        float(np.median(spreads)),
    )


def board_in_base(head: HeadModel, frames: HeadFrames) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where each view by itself has the board in frame 0.

    Returns:
        (2, f, n, 3) its corners, m; (2, f, 3, 3) and (2, f, 3) its pose. They mean nothing where
        the board is not seen.
    """
    T_0_C = head.base_pose(frames.positions)[:, None] @ head.camera_poses(frames.positions)
    places, turns, shifts = [], [], []
    for eye, seen in enumerate(board_in_cameras(head, frames)):
        T = T_0_C[:, eye]
        turn = T[:, :3, :3] @ seen.rotation
        shift = (T[:, :3, :3] @ seen.translation[..., None])[..., 0] + T[:, :3, 3]
        turns.append(turn)
        shifts.append(shift)
        places.append(frames.corners @ turn.transpose(0, 2, 1) + shift[:, None])
    return np.stack(places), np.stack(turns), np.stack(shifts)


def _middle(
    places: FloatArray, here: NDArray[np.intp], orders: Sequence[NDArray[np.intp]]
) -> tuple[tuple[int, int], FloatArray, NDArray[np.intp]]:
    """The view nearest to all others, how far these are from it, and in which order.

    Args:
        places: (2, f, n, 3) see `board_in_base`.
        here: (v, 2) eye and frame of the views in question.
        orders: in which the corners may come.
    """
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
