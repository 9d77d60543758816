"""Joints that swing at speed about a goal that rests.

A half swing is the way between two turns of a joint. It counts if it is long and fast enough, and
the joint's goal has moved less than half as far meanwhile. Laws of this package calm themselves
after two or three; somebody else's may not.
"""

from collections import deque
from math import pi
from typing import Final

import numpy as np

from vergence.models.parts import FloatArray

_LEAST_RAD: Final = 0.02
"""Least half swing, rad: a target that trembles by 10 px moves a webcam's eye less."""
_LEAST_RAD_S: Final = 0.3
"""Least peak speed of a half swing, that of a sinusoid, rad/s."""
_MANY: Final = 8
"""Half swings of one joint in the window that are too many: four whole ones."""
_WINDOW_S: Final = 4.0
"""The window, s."""


class Swings:
    """Half swings of the four eye joints."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Forget all."""
        self._side = np.zeros(4)
        self._turned = np.full(4, np.nan)
        self._turned_s = np.zeros(4)
        self._farthest = np.full(4, np.nan)
        self._least_goal = np.full(4, np.inf)
        self._most_goal = np.full(4, -np.inf)
        self._counted: list[deque[float]] = [deque() for _ in range(4)]

    def take(self, now_s: float, angles: FloatArray, goals: FloatArray) -> int | None:
        """Look at the joints.

        Args:
            now_s: the present, s.
            angles: (4,) of the eyes' joints, rad.
            goals: (4,) where these look straight at the target, rad; nan where that is not known.

        Returns:
            A joint that swings, 0 to 3; None for none.
        """
        self._least_goal = np.fmin(self._least_goal, goals)
        self._most_goal = np.fmax(self._most_goal, goals)
        for joint in range(4):
            self._look(now_s, joint, float(angles[joint]), float(goals[joint]))
            counted = self._counted[joint]
            while counted and now_s - counted[0] > _WINDOW_S:
                counted.popleft()
            if len(counted) >= _MANY:
                return joint
        return None

    def _look(self, now_s: float, joint: int, angle: float, goal: float) -> None:
        side, farthest = self._side[joint], self._farthest[joint]
        if np.isnan(farthest):
            self._turned[joint] = self._farthest[joint] = angle
            return
        if side == 0.0:
            if abs(angle - farthest) > _LEAST_RAD:
                self._side[joint] = np.sign(angle - farthest)
                self._farthest[joint], self._turned_s[joint] = angle, now_s
            return
        if side * (angle - farthest) >= 0.0:
            self._farthest[joint] = angle
            return
        if side * (farthest - angle) < _LEAST_RAD:
            return
        half, time_s = abs(farthest - self._turned[joint]), now_s - self._turned_s[joint]
        went = max(self._most_goal[joint] - self._least_goal[joint], 0.0)
        if 0.5 * pi * half > _LEAST_RAD_S * time_s and went < 0.5 * half:
            self._counted[joint].append(now_s)
        self._side[joint] = -side
        self._turned[joint], self._turned_s[joint] = farthest, now_s
        self._farthest[joint] = angle
        self._least_goal[joint] = self._most_goal[joint] = goal
        if np.isnan(goal):
            self._least_goal[joint], self._most_goal[joint] = np.inf, -np.inf
