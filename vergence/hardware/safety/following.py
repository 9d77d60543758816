"""Joints that do not go where their commands take them: stuck, turned the wrong way, or misread.

Let C be the sum of a joint's commands over time. A joint that follows them by any lag and latency
up to D has moved in a window of length W by a mean of `C(t - d) - C(t - W - d)` over delays d from
0 to D. So what it has moved lies between the least and the greatest of these, whatever its lag.
A joint that is told to turn to and fro may have gone nowhere by these alone; so where C has had a
range, a joint has to have had a tenth of it, D later at most.
"""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_LAGS: Final = 5.0
"""Delays that count, by the joint's lag: an exponential lag has 1 % left then."""
_SPARE_S: Final = 0.1
"""And beyond: commands and answers that were lost, images of a busy line, s."""
_SHARE: Final = 0.3
"""Tolerance by what was commanded in the window: a loaded servo is slower than its data sheet."""
_TURNED_RAD: Final = 0.1
"""Range of the commands from which on a joint has to have moved at all, rad."""
_STILL: Final = 0.1
"""Range of a joint's motion by that of its commands below which it does not move."""
_STILL_SHARE: Final = 0.8
"""Share of a window over which a joint that does not move at all is told."""
_PROVED_RAD: Final = 0.05
"""Motion as commanded after which a joint is believed to follow, rad."""
_MOST_PAUSE_S: Final = 0.5
"""Longest time between two periods that counts; the servos' watchdog ends a longer one."""


class _Window(NamedTuple):
    """Over which motion and commands are compared."""

    length_s: float
    every_s: float
    """Time between two rows that are kept."""
    least_rad: float
    """Least tolerance: play, a gear that bends, an arm that sags."""


_WINDOWS: Final = (_Window(0.5, 0.0, 0.1), _Window(4.0, 0.03, 0.2))
"""The short one tells a joint at 0.3 rad/s, the long one a joint at 0.1 rad/s, and one that does
not move at all at 0.03 rad/s."""


class Following:
    """Motion of the joints beside what they were told.

    Args:
        head: the model of the head.
        most: (7,) greatest speeds, rad/s.

    Attributes:
        proved: (7,) whether each joint has moved as commanded so far.
    """

    def __init__(self, head: HeadModel, most: FloatArray) -> None:
        timing, actuation = head.timing, head.actuation
        ramp_s = most / np.clip(actuation.acceleration, 1.0, None)
        late_s = _LAGS * timing.lag_s * actuation.lag_ratio + ramp_s
        delay_s = float(late_s.max()) + timing.command_latency_s + _SPARE_S
        self._comparisons = [_Comparison(window, delay_s) for window in _WINDOWS]
        self._sum = np.zeros(7)
        self._last_s = np.nan
        self.proved = np.zeros(7, dtype=np.bool_)

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
        if not np.isnan(self._last_s):
            self._sum = self._sum + command * min(now_s - self._last_s, _MOST_PAUSE_S)
        self._last_s = now_s
        off, went = np.full(7, -np.inf), np.zeros(7)
        for comparison in self._comparisons:
            off = np.maximum(off, comparison.take(now_s, self._sum, angles))
            wanted, moved = comparison.last
            went = np.maximum(went, np.minimum(np.abs(wanted), np.sign(wanted) * moved))
        self.proved |= (went > _PROVED_RAD) & (off <= 0.0)
        return off


class _Comparison:
    """Motion and commands over one window.

    Attributes:
        last: (7,) what was told to the window's joints without delay, and what they moved, rad.
    """

    def __init__(self, window: _Window, delay_s: float) -> None:
        self._window, self._delay_s = window, delay_s
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self.last = np.zeros(7), np.zeros(7)

    def take(self, now_s: float, total: FloatArray, angles: FloatArray) -> FloatArray:
        """See `Following.take`; the total is the commands' sum over time, (7,) rad."""
        length_s, rows = self._window.length_s, self._rows
        oldest_s = now_s - length_s - self._delay_s
        if not rows:
            rows.append((oldest_s, total, angles.copy()))
        if now_s - rows[-1][0] < self._window.every_s:
            return np.full(7, -np.inf)
        rows.append((now_s, total, angles.copy()))
        # one row from before the oldest time that is asked for stays
        while rows[1][0] <= oldest_s:
            rows.popleft()
        times = np.array([row[0] for row in rows])
        totals = np.array([row[1] for row in rows])
        delayed = times[times >= now_s - self._delay_s]
        told = _at(times, totals, delayed) - _at(times, totals, delayed - length_s)
        turned = np.array([row[2] for row in rows])
        moved = angles - _at(times, turned, np.array([now_s - length_s]))[0]
        least, greatest = told.min(axis=0), told.max(axis=0)
        spare = self._window.least_rad + _SHARE * np.maximum(np.abs(least), np.abs(greatest))
        self.last = told[-1], moved
        off = np.maximum(least - moved, moved - greatest) - spare
        return np.asarray(np.maximum(off, self._stillness(now_s, times, totals, turned)))

    def _stillness(
        self, now_s: float, times: FloatArray, totals: FloatArray, turned: FloatArray
    ) -> FloatArray:
        """(7,) what is missing of the range that each joint's motion has to have, rad."""
        begin_s = now_s - self._delay_s - _STILL_SHARE * self._window.length_s
        angles = turned[times >= begin_s]
        told = totals[(times >= begin_s) & (times <= now_s - self._delay_s)]
        if len(told) == 0:
            return np.full(7, -np.inf)
        wanted = np.ptp(told, axis=0)
        return np.where(wanted > _TURNED_RAD, _STILL * wanted - np.ptp(angles, axis=0), -np.inf)


def _at(times: FloatArray, values: FloatArray, when: FloatArray) -> FloatArray:
    """(k, 7) values of some (n, 7) at times between theirs."""
    right = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    left = right - 1
    share = np.clip((when - times[left]) / (times[right] - times[left]), 0.0, 1.0)[:, None]
    return np.asarray(values[left] + share * (values[right] - values[left]))
