"""A board that stands before an emulated head, at a place of its own in the world."""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.errors import ConfigurationError
from vergence.models.board_text import parse_target
from vergence.models.boards import PlanarTarget, TagFamily
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_ASIDE_M: Final = (0.03, -0.02)
"""Place of its middle beside the line ahead, right and down, m."""
_TILT_RAD: Final = (0.25, -0.3, 0.05)
"""Rotation vector by which it does not face the head, rad: a tilted board tells focal lengths."""


def parse_standing(text: str) -> PlanarTarget:
    """The board that a text names.

    Args:
        text: see `parse_target`.

    Raises:
        ConfigurationError: it is none, or has no size.
    """
    target = parse_target(text)
    if isinstance(target, TagFamily) or not target.size_known:
        raise ConfigurationError(
            "board: expected one board of a known size, such as checkerboard:9x6:24 (inner "
            f"corners, square in mm), got {text}"
        )
    return target


def standing(head: HeadModel, target: PlanarTarget, distance_m: float) -> FloatArray:
    """The pose of a board that stands ahead of a head at rest, a bit tilted.

    Args:
        head: before which it stands.
        target: the board.
        distance_m: of its middle from N's origin, along N's z axis, m.

    Returns:
        (4, 4) T_0_T, m.
    """
    T_N_T = np.eye(4)
    T_N_T[:3, :3] = Rotation.from_rotvec(_TILT_RAD).as_matrix()
    middle = T_N_T[:3, :2] @ target.corners_m.mean(axis=0)
    T_N_T[:3, 3] = np.array([*_ASIDE_M, distance_m]) - middle
    return np.asarray(head.base_pose(head.rest()) @ T_N_T)
