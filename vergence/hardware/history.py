"""Joint angles by time, such as those at the exposure of an image."""

import threading
from collections import deque
from typing import Final

import numpy as np

from vergence.models.parts import FloatArray

_KEPT_READINGS: Final = 512
"""Readings that are kept: 4 s at 120 Hz, more than the age of any image (numerical)."""
_MAX_EXTRAPOLATION_S: Final = 0.05
"""Longest extrapolation beyond the newest reading at constant velocity, s (chosen)."""


class JointHistory:
    """Readings of the joints by time; one thread writes, others may read."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque(maxlen=_KEPT_READINGS)
        self._lock = threading.RLock()  # re-entrant: a signal handler may close all in between

    def add(self, time_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """Keep a reading that is newer than all others.

        Args:
            time_s: time of the measurement, s of a monotonic clock.
            positions: (7,) joint angles, rad.
            velocities: (7,) joint velocities, rad/s.
        """
        with self._lock:
            self._rows.append((time_s, positions.copy(), velocities.copy()))

    def newest(self) -> tuple[float, FloatArray, FloatArray]:
        """Time, positions and velocities of the newest reading.

        Raises:
            LookupError: there is none.
        """
        with self._lock:
            if not self._rows:
                raise LookupError("no reading of the joints yet")
            return self._rows[-1]

    def at(self, time_s: float) -> FloatArray:
        """Joint angles at a time.

        They are interpolated linearly between two readings, constant before the first one, and
        extrapolated with the velocities of the newest one for up to 50 ms.

        Args:
            time_s: time of the same clock, s.

        Returns:
            (7,) joint angles, rad.

        Raises:
            LookupError: there is no reading yet.
        """
        with self._lock:
            rows = list(self._rows)
        if not rows:
            raise LookupError("no reading of the joints yet")
        times = [row[0] for row in rows]
        i = int(np.searchsorted(times, time_s))
        if i == 0:
            return rows[0][1].copy()
        before = rows[i - 1]
        if i == len(rows):
            ahead_s = min(time_s - before[0], _MAX_EXTRAPOLATION_S)
            return np.asarray(before[1] + ahead_s * before[2])
        share = (time_s - before[0]) / (times[i] - before[0])
        return np.asarray(before[1] + share * (rows[i][1] - before[1]))
