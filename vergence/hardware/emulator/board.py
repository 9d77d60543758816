"""A board at a fixed pose in the world before an emulated head."""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.targets import PlanarTarget, TagFamily, parse_target

_BOARD_OFFSET_M: Final = (0.03, -0.02)
"""Offset of its centre from the line straight ahead, right and down, m (chosen)."""
_TILT_RAD: Final = (0.25, -0.3, 0.05)
"""Rotation vector away from facing the head, rad: a tilted board makes focal lengths observable
(chosen)."""


def parse_sized_board(text: str) -> PlanarTarget:
    """Parse the description of a board of known size.

    Args:
        text: the description, see `parse_target`.

    Raises:
        ConfigurationError: it does not describe one board, or gives no size.
    """
    target = parse_target(text)
    if isinstance(target, TagFamily) or not target.size_known:
        raise ConfigurationError(
            "board: expected one board of a known size, such as checkerboard:9x6:24 (inner "
            f"corners, square in mm), got {text}"
        )
    return target


def tilted_board_pose(head: HeadModel, target: PlanarTarget, distance_m: float) -> FloatArray:
    """Pose of a board ahead of a head at rest, slightly tilted.

    Args:
        head: the head that looks at the board.
        target: the board.
        distance_m: distance of its centre from N's origin along N's z axis, m.

    Returns:
        (4, 4) pose T_0_T of the board in the fixed frame 0, m.
    """
    T_N_T = np.eye(4)
    T_N_T[:3, :3] = Rotation.from_rotvec(_TILT_RAD).as_matrix()
    middle = T_N_T[:3, :2] @ target.corners_m.mean(axis=0)
    T_N_T[:3, 3] = np.array([*_BOARD_OFFSET_M, distance_m]) - middle
    return np.asarray(head.base_pose(head.rest()) @ T_N_T)
