"""Check that every pixel of an image has a ray under its lens model."""

import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import pixels_to_rays
from vergence.models.cameras import Cameras
from vergence.models.packed import pack_cameras


def has_pixels_without_rays(cameras: Cameras) -> NDArray[np.bool_]:
    """True for each camera whose lens model leaves a part of its image without rays.

    This happens if the model folds the image back on itself inside the image, or if a fisheye
    reaches more than 90 degrees from the optical axis there. `undistort` is nan in that part.

    Args:
        cameras: the two cameras, batched or not.

    Returns:
        (..., 2) by eye.
    """
    rows = pack_cameras(cameras)
    # the rays end at a closed curve around the principal point: if any pixel lies beyond it, a
    # pixel of the image's edge does
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
