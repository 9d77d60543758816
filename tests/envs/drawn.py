"""Targets as the trials of a seed draw them."""

import numpy as np
from numpy.typing import NDArray

from vergence.envs.streams import RandomStreams
from vergence.envs.targets import make_target
from vergence.envs.targets.motion import POINT, Board
from vergence.models import HeadModel

Array = NDArray[np.float64]


def draw(
    head: HeadModel,
    target: object,
    num: int = 1,
    seed: int = 0,
    first: int = 0,
    board: Board = POINT,
) -> tuple[Array, Array]:
    """Motions and starting angles of trials of a seed, from the `first` on."""
    streams, ids = RandomStreams(num), np.arange(num)
    trials = (first + ids).astype(np.uint64)
    streams.start(ids, np.full(num, seed, dtype=np.uint64), trials)
    return make_target(target).draw(head, streams, ids, board)


def midpoint_between_eyes(head: HeadModel) -> Array:
    """(3,) the point in the middle of both eyes at rest, in N, m."""
    return head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)


def eccentricity(head: HeadModel, points: Array) -> Array:
    """(...) angles of points from straight ahead, as workspaces count them, rad."""
    aside = np.hypot(*np.moveaxis((points - midpoint_between_eyes(head))[..., :2], -1, 0))
    return np.arctan(aside / points[..., 2])


def inside(head: HeadModel, q: Array, points: Array) -> bool:
    """True if all points are visible to both eyes."""
    pixels = head.project(q, points)
    return bool(((pixels >= 0) & (pixels <= head.cameras.size - 1)).all())
