"""Detection of joints that oscillate quickly about a goal at rest.

A half swing is the motion between two reversals of a joint. It counts if it is long and fast
enough, and the joint's goal has moved less than half as far meanwhile. The controllers of this
package settle after two or three; other policies may not.
"""

from collections import deque
from math import pi
from typing import Final

import numpy as np

from vergence.models.parts import FloatArray

_MIN_HALF_SWING_RAD: Final = 0.02
"""Least half swing, rad: a target that jitters by 10 px moves a webcam's eye less (chosen)."""
_MIN_PEAK_SPEED_RAD_S: Final = 0.3
"""Least peak speed of a half swing, taken as a sinusoid, rad/s (chosen)."""
_OSCILLATION_HALF_SWINGS: Final = 8
"""Half swings of one joint in the window that count as an oscillation: four cycles (chosen)."""
_WINDOW_S: Final = 4.0
"""Length of the window, s (chosen)."""


class OscillationDetector:
    """Detector of eye joints that swing to and fro although their goal rests."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Reset all counts."""
        self._side = np.zeros(4)
        self._turned = np.full(4, np.nan)
        self._turned_s = np.zeros(4)
        self._farthest = np.full(4, np.nan)
        self._least_goal = np.full(4, np.inf)
        self._most_goal = np.full(4, -np.inf)
        self._counted: list[deque[float]] = [deque() for _ in range(4)]

    def find_oscillating_joint(
        self, now_s: float, angles: FloatArray, goals: FloatArray
    ) -> int | None:
        """Update the counts with new angles and goals.

        Args:
            now_s: present time, s.
            angles: (4,) angles of the eye joints, rad.
            goals: (4,) angles at which they look straight at the target, rad; nan if unknown.

        Returns:
            Index of a joint that oscillates, 0 to 3; None if there is none.
        """
        self._least_goal = np.fmin(self._least_goal, goals)
        self._most_goal = np.fmax(self._most_goal, goals)
        for joint in range(4):
            self._look(now_s, joint, float(angles[joint]), float(goals[joint]))
            counted = self._counted[joint]
            while counted and now_s - counted[0] > _WINDOW_S:
                counted.popleft()
            if len(counted) >= _OSCILLATION_HALF_SWINGS:
                return joint
        return None

    def _look(self, now_s: float, joint: int, angle: float, goal: float) -> None:
        side, farthest = self._side[joint], self._farthest[joint]
        if np.isnan(farthest):
            self._turned[joint] = self._farthest[joint] = angle
            return
        if side == 0.0:
            if abs(angle - farthest) > _MIN_HALF_SWING_RAD:
                self._side[joint] = np.sign(angle - farthest)
                self._farthest[joint], self._turned_s[joint] = angle, now_s
            return
        if side * (angle - farthest) >= 0.0:
            self._farthest[joint] = angle
            return
        if side * (farthest - angle) < _MIN_HALF_SWING_RAD:
            return
        half, time_s = abs(farthest - self._turned[joint]), now_s - self._turned_s[joint]
        went = max(self._most_goal[joint] - self._least_goal[joint], 0.0)
        if 0.5 * pi * half > _MIN_PEAK_SPEED_RAD_S * time_s and went < 0.5 * half:
            self._counted[joint].append(now_s)
        self._side[joint] = -side
        self._turned[joint], self._turned_s[joint] = farthest, now_s
        self._farthest[joint] = angle
        self._least_goal[joint] = self._most_goal[joint] = goal
        if np.isnan(goal):
            self._least_goal[joint], self._most_goal[joint] = np.inf, -np.inf
