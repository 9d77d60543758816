"""Angles at which the eye joints look straight at a target, from its pixels."""

from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray

_ASSUMED_DISTANCE_M: Final = 1.0
"""Assumed distance of the target from each camera, m: a turning camera moves near and far targets
alike in the image (chosen: a usual working distance)."""


def target_eye_angles(head: HeadModel, q: FloatArray, pixels: FloatArray) -> FloatArray:
    """Goals of the four eye joints by one Newton step, which is exact at the goal itself.

    Args:
        head: the model of the head.
        q: (7,) joint angles at the exposure, rad.
        pixels: (2, 2) raw pixels of the target; nan if it is not visible to an eye.

    Returns:
        (4,) goal angles, rad; nan for the joints of an eye to which it is not visible.
    """
    ideal = head.undistort(pixels)
    jacobian = head.image_jacobian(q, ideal, np.full(2, _ASSUMED_DISTANCE_M))
    goals = np.full(4, np.nan)
    for eye in range(2):
        own = slice(EYES.start + 2 * eye, EYES.start + 2 * eye + 2)
        if np.isfinite(pixels[eye]).all():
            missing = head.cameras.principal[eye] - ideal[eye]
            turn, *_ = np.linalg.lstsq(jacobian[eye][:, own], missing)
            goals[2 * eye : 2 * eye + 2] = q[own] + turn
    return goals
