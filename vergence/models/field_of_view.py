"""What an eye's image covers: whether every pixel of it has a ray."""

import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import pixels_to_rays
from vergence.models.cameras import Cameras
from vergence.models.packed import pack_cameras


def folds_inside(cameras: Cameras) -> NDArray[np.bool_]:
    """Whether a lens model leaves a part of its own image without rays.

    It does where it folds the image back on itself inside, or, as a fisheye, has more than a
    right angle from the optical axis there. `undistort` is nan in that part.

    Args:
        cameras: the two cameras, batched or not.

    Returns:
        (..., 2) by eye.
    """
    rows = pack_cameras(cameras)
    # rays end along a closed line around the principal point: where it crosses the image, it
    # crosses the edge
    sides = [np.isnan(_rays_at_edge(rows[..., eye, :], cameras.size[eye])) for eye in range(2)]
    return np.stack([side.any(axis=(-2, -1)) for side in sides], axis=-1)


def _rays_at_edge(row: NDArray[np.float64], size: NDArray[np.int64]) -> NDArray[np.float64]:
    width, height = size - 0.5
    u, v = np.arange(-0.5, width + 0.5), np.arange(-0.5, height + 0.5)
    edge = np.concatenate(
        [np.stack(np.broadcast_arrays(u, at), axis=-1) for at in (-0.5, height)]
        + [np.stack(np.broadcast_arrays(at, v), axis=-1) for at in (-0.5, width)]
    )
    return np.asarray(pixels_to_rays(edge, row[..., None, :]))
