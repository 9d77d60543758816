"""Search for a lost target: both eyes follow a spiral about the straight-ahead direction."""

from math import cos, pi, sin, sqrt, tan
from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray

_FIXATION_DISTANCE_M: Final = 1.0
"""Distance of the fixation point along z, m (chosen)."""
_SPIRAL_PITCH_RAD: Final = 0.15
"""Distance between two turns of the spiral, rad: a quarter of a webcam's height (chosen)."""
_MAX_RADIUS_RAD: Final = 0.7
"""Radius at which the spiral restarts at its centre, rad (chosen)."""
_SPIRAL_SPEED_RAD_S: Final = 0.4
"""Speed along the spiral, rad/s: a short exposure still shows the target (chosen)."""
_GAIN: Final = 4.0
"""Gain of the joints towards the point of the spiral, 1/s (chosen)."""


class SpiralSearch:
    """A slow spiral of the gaze.

    Args:
        head: the model of the head.
    """

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._goal = head.actuation.actuators_of(head.rest())

    def velocities(self, time_s: float, angles: FloatArray, joints: FloatArray) -> FloatArray:
        """Velocities along the spiral.

        Args:
            time_s: time since the search began, s.
            angles: (7,) present angles of neck and actuators, rad.
            joints: (7,) present joint angles, rad.

        Returns:
            (7,) requested velocities, rad/s.
        """
        # an Archimedean spiral r = c phi: its arc is about c phi^2 / 2
        pitch = _SPIRAL_PITCH_RAD / (2.0 * pi)
        phi = sqrt(2.0 * _SPIRAL_SPEED_RAD_S * time_s / pitch) % (_MAX_RADIUS_RAD / pitch)
        across, along = pitch * phi * cos(phi), pitch * phi * sin(phi)
        point = _FIXATION_DISTANCE_M * np.array([tan(across), tan(along), 1.0])
        goal = self._head.fixate(point, joints[NECK], warn=False)
        if np.isfinite(goal).all():
            self._goal = self._head.actuation.actuators_of(goal)
        requested = np.clip(
            _GAIN * (self._goal - angles), -2.0 * _SPIRAL_SPEED_RAD_S, 2.0 * _SPIRAL_SPEED_RAD_S
        )
        requested[NECK] = 0.0
        return np.asarray(requested)
