"""Camera that looks at a head and its target from outside."""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.parts import FloatArray

# direction of the camera from the head (chosen: from its left side and above, where one sees how
# far the eyes turn, the angle between their axes, and the target's pattern)
_AZIMUTH_RAD: Final = np.deg2rad(-10.0)
_ELEVATION_RAD: Final = np.deg2rad(33.0)

_MAX_TURN_RAD: Final = np.deg2rad(60.0)
"""Largest turn of the camera with a target at its side of the head, so that it still sees the
target's front (chosen)."""
_FOCAL: Final = 1.1
"""Focal length by the picture's height (chosen: a camera near enough to see the eyes and the board
from their fronts)."""
_ROOM: Final = (0.92, 0.84)
"""Part of the width and the height that head and target fill (chosen: a margin)."""
_HEAD_BASELINES: Final = 1.2
"""Half size of the part of the head that is kept in view, in baselines (chosen: eyes and skull,
not the stand)."""
_LEAST_HEAD_M: Final = 0.1
"""Least half size of that part, m (chosen: the skull of a head with near eyes)."""


class OutsideCamera(NamedTuple):
    """A camera that looks at a head from outside."""

    rotation: FloatArray
    """(3, 3) its axes in the upright frame: x right, y down, z forward."""
    position: FloatArray
    """(3,) in the upright frame, m."""
    focal: float = _FOCAL
    """Focal length by the picture's height."""


def place_outside_camera(
    frame_n: FloatArray,
    baseline_m: float,
    towards: FloatArray,
    corners: FloatArray,
    aspect: float,
) -> OutsideCamera:
    """Place a camera at a head's left side, with its eyes and a target in view.

    Args:
        frame_n: (4, 4) pose of N in the upright frame.
        baseline_m: baseline of the eyes, m.
        towards: (3,) the target in N, m.
        corners: (k, 3) outline of the target in the upright frame, m.
        aspect: width of the picture by its height.
    """
    turn = np.clip(np.arctan2(-towards[0], abs(towards[2])), 0.0, _MAX_TURN_RAD)
    azimuth = _AZIMUTH_RAD + turn
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    back = np.cos(_ELEVATION_RAD) * level + [0.0, 0.0, np.sin(_ELEVATION_RAD)]
    right = np.cross(-back, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(-back, right), -back])
    around = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    size = max(_HEAD_BASELINES * baseline_m, _LEAST_HEAD_M)
    points = np.concatenate([frame_n[:3, 3] + size * around, corners]) @ rotation
    room = np.array(_ROOM) * [0.5 * aspect / _FOCAL, 0.5 / _FOCAL]
    # Opposite sides of the view are two planes. Each pair touches the points from one distance; the
    # camera is at the larger of the two.
    depth, across = points[:, 2:], points[:, :2]
    low, high = (across + room * depth).min(axis=0), (across - room * depth).max(axis=0)
    centre, z = 0.5 * (low + high), float(((low - high) / (2.0 * room)).min())
    return OutsideCamera(rotation, rotation @ [*centre, z])
