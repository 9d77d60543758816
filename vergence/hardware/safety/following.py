"""Joints that do not go where their commands take them: stuck, turned the wrong way, or misread.

Let C be the sum of a joint's commands over time. A joint that follows them by any lag and latency
up to D has moved in a window of length W by a mean of `C(t - d) - C(t - W - d)` over delays d from
0 to D. So what it has moved lies between the least and the greatest of these, whatever its lag.
A joint that is told to turn to and fro may have gone nowhere by these alone; so where C has had a
range, a joint has to have had a tenth of it, D later at most.
"""

from collections import deque
from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_WINDOW_S: Final = 0.5
"""Length of the window, s: a joint at 0.3 rad/s goes farther than the tolerance in it."""
_LAGS: Final = 5.0
"""Delays that count, by the joint's lag: an exponential lag has 1 % left then."""
_SPARE_S: Final = 0.1
"""And beyond: commands and answers that were lost, images of a busy line, s."""
_LEAST_RAD: Final = 0.1
"""Least tolerance, rad: play, a gear that bends, an arm that sags."""
_SHARE: Final = 0.3
"""And by what was commanded in the window: a loaded servo is slower than its data sheet."""
_STILL_S: Final = 0.4
"""Length of the window over which a joint that does not move at all is told, s."""
_STILL: Final = 0.1
"""Range of a joint's motion by that of its commands below which it does not move."""
_PROVED_RAD: Final = 0.05
"""Motion as commanded after which a joint is believed to follow, rad."""
_MOST_PAUSE_S: Final = 0.5
"""Longest time between two periods that counts; the servos' watchdog ends a longer one."""


class Following:
    """Motion of the joints beside what they were told.

    Args:
        head: the model of the head.
        most: (7,) greatest speeds, rad/s.

    Attributes:
        proved: (7,) whether each joint has moved as commanded since `begin`.
    """

    def __init__(self, head: HeadModel, most: FloatArray) -> None:
        timing, actuation = head.timing, head.actuation
        ramp_s = most / np.clip(actuation.acceleration, 1.0, None)
        late_s = _LAGS * timing.lag_s * actuation.lag_ratio + ramp_s
        self._delay_s = float(late_s.max()) + timing.command_latency_s + _SPARE_S
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._sum = np.zeros(7)
        self.proved = np.zeros(7, dtype=np.bool_)

    def begin(self) -> None:
        """Forget all: the joints rest, and nothing is proved."""
        self._rows.clear()
        self.proved[:] = False

    def take(self, now_s: float, angles: FloatArray, command: FloatArray) -> FloatArray:
        """Compare the joints' motion with their commands.

        Args:
            now_s: the present, s.
            angles: (7,) measured angles, rad.
            command: (7,) velocities that were in force since the last call, rad/s.

        Returns:
            (7,) distance of each joint from where any delay would have taken it, beyond the
            tolerance, rad; 0 or less where it follows.
        """
        if self._rows:
            self._sum = self._sum + command * min(now_s - self._rows[-1][0], _MOST_PAUSE_S)
        else:
            self._rows.append((now_s - _WINDOW_S - self._delay_s, self._sum, angles.copy()))
        self._rows.append((now_s, self._sum, angles.copy()))
        # one row from before the oldest time that is asked for stays
        while self._rows[1][0] <= now_s - _WINDOW_S - self._delay_s:
            self._rows.popleft()
        times = np.array([row[0] for row in self._rows])
        sums = np.array([row[1] for row in self._rows])
        delayed = times[times >= now_s - self._delay_s]
        told = _at(times, sums, delayed) - _at(times, sums, delayed - _WINDOW_S)
        begin = int(np.searchsorted(times, now_s - _WINDOW_S, side="right")) - 1
        moved = angles - self._rows[begin][2]
        least, greatest = told.min(axis=0), told.max(axis=0)
        spare = _LEAST_RAD + _SHARE * np.maximum(np.abs(least), np.abs(greatest))
        off = np.maximum(least - moved, moved - greatest) - spare
        off = np.maximum(off, self._stillness(now_s, times, sums))
        wanted = told[-1]
        along = np.sign(wanted) * moved
        self.proved |= (np.minimum(np.abs(wanted), along) > _PROVED_RAD) & (off <= 0.0)
        return np.asarray(off)

    def _stillness(self, now_s: float, times: FloatArray, sums: FloatArray) -> FloatArray:
        """(7,) what is missing of the range that each joint's motion has to have, rad."""
        begin_s = now_s - self._delay_s - _STILL_S
        angles = np.array([row[2] for row in self._rows])[times >= begin_s]
        told = sums[(times >= begin_s) & (times <= now_s - self._delay_s)]
        if len(told) == 0:
            return np.full(7, -np.inf)
        wanted = np.ptp(told, axis=0)
        return np.where(wanted > _LEAST_RAD, _STILL * wanted - np.ptp(angles, axis=0), -np.inf)


def _at(times: FloatArray, values: FloatArray, when: FloatArray) -> FloatArray:
    """(k, 7) values of some (n, 7) at times between theirs."""
    right = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    left = right - 1
    share = np.clip((when - times[left]) / (times[right] - times[left]), 0.0, 1.0)[:, None]
    return np.asarray(values[left] + share * (values[right] - values[left]))
