"""Poses of a target in a camera frame."""

import cv2
import numpy as np
from numpy.typing import NDArray


def pose(
    x: float, y: float, z: float, turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """T_C_T from a position and a rotation vector."""
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array(turn_rad))[0]
    matrix[:3, 3] = (x, y, z)
    return matrix
