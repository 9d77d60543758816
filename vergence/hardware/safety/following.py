"""Detection of joints that do not follow their commands: stuck, turning the wrong way, or misread.

Let C be the time integral of a joint's velocity commands. In a window of length W a joint that
follows them with any lag and latency up to D moves by a weighted mean of `C(t - d) - C(t - W - d)`
over the delays d from 0 to D. So its motion lies between the least and the greatest of these,
whatever its lag. For commands that turn to and fro this alone would accept a joint that does not
move. So the range of a joint's motion also has to be a tenth of the range of C, at most D later.

These tests accept any lag, and take most of a second. A joint whose encoder is blind or whose motor
is inverted runs far in that time, so two quick tests find what no sluggish joint does: an angle
that stays the same, to a few steps of the encoder, while the commands themselves and the head's
model, undelayed and up to `_LATE_S` late, all demand motion to one side; and a speed that grows
although no command of the last 0.15 s asks for it.
"""

from collections import deque
from typing import Final

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_MAX_DELAY_LAGS: Final = 5.0
"""Longest delay D, in lags of the joint: an exponential lag has 1 % left then (chosen)."""
_EXTRA_DELAY_S: Final = 0.1
"""Further delay, s, for lost commands and answers on a busy line (chosen)."""
_MOTION_TOLERANCE: Final = 0.3
"""Tolerance as a fraction of the range of C in the window: a loaded servo is slower than its data
sheet (chosen)."""
_LEAST_ACCELERATION_RATIO: Final = 0.35
"""Least acceleration of a loaded joint, by the head file's (chosen: 80 rad/s^2 of an unloaded servo
may be 28 with what it carries)."""
_MIN_INTERVAL_S: Final = 1e-3
"""Least time between two rows in a quotient, s (numerical)."""
_MIN_TESTED_RANGE_RAD: Final = 0.1
"""Range of C above which the range of the motion is tested, rad (chosen)."""
_MIN_RANGE_RATIO: Final = 0.1
"""Least range of a joint's motion as a fraction of the range of C (chosen)."""
_RANGE_WINDOW_FRACTION: Final = 0.8
"""Part of a window over which the ranges are compared, as a fraction (chosen)."""
_PROVED_RAD: Final = 0.05
"""Commanded and measured motion that proves that a joint follows, rad (chosen)."""
_MOST_PAUSE_S: Final = 0.1
"""Longest time between two calls, s; after a longer one, in which the servos' watchdog may have
stopped the joints, the comparison begins anew (chosen)."""


_WINDOWS: Final = ((0.5, 0.0, 0.1), (4.0, 0.03, 0.2))
"""Windows over which motion and commands are compared: length, s, least time between two rows, s,
and least tolerance, rad, for backlash, elastic gears and sagging arms (chosen). The short one
detects a joint that does not follow commands of 0.3 rad/s; the long one those of 0.1 rad/s, or of
0.03 rad/s if the joint does not move at all."""
_LATE_S: Final = (0.0, 0.035, 0.07)
"""Delays of a joint beyond its model that the quick test accepts, s (chosen)."""
_STILL_WINDOWS: Final = ((0.035, 0.12), (0.06, 0.06), (0.2, 0.05), (0.5, 0.05))
"""Windows of the quick test for a still angle: length, s, and the least demanded motion, rad
(chosen: they find it from 3.4, 1, 0.25 and 0.1 rad/s on; with `_LATE_S` the last demands are more
than the integral of a servo's loop needs to overcome 8 % of friction)."""
_STILL_RAD: Final = 0.004
"""Range of an angle that counts as still, rad: two steps of an encoder of 4,096 (chosen)."""
_RUNAWAY_WINDOW_S: Final = 0.035
"""Window over which a speed that grows is measured, s: two periods at 60 Hz (chosen)."""
_RUNAWAY_RAD: Final = 0.03
"""Motion in that window beyond the commands that no joint makes by itself, rad (chosen: 0.9 rad/s,
which a person's hand seldom reaches)."""
_RUNAWAY_SPARE: Final = (1.3, 0.3)
"""Accepted motion by the greatest recent command to its side, and by the greatest to either: a
servo's loop may overshoot (chosen)."""
_RUNAWAY_PAST_S: Final = (0.12, 0.3)
"""Times over which these commands are looked for, s (chosen)."""


class FollowingMonitor:
    """Detector of joints that do not follow their commands, up to speeds of (7,) rad/s.

    `proved_joints` is True for those that have been seen to follow.
    """

    def __init__(self, head: HeadModel, max_speed: FloatArray) -> None:
        timing, actuation = head.timing, head.actuation
        self._period_s = timing.period_s
        self._acceleration = np.clip(actuation.acceleration, 1.0, None)
        ramp_s = max_speed / self._acceleration
        late_s = _MAX_DELAY_LAGS * timing.lag_s * actuation.lag_ratio + ramp_s
        self._delay_s = float(late_s.max()) + timing.command_latency_s + _EXTRA_DELAY_S
        self.proved_joints = np.zeros(7, dtype=np.bool_)
        self._begin()

    def _begin(self) -> None:
        self._comparisons = [
            _Comparison(*window, self._delay_s, self._acceleration) for window in _WINDOWS
        ]
        self._quick = _QuickTests(self._period_s)
        self._sum, self._expected = np.zeros(7), np.zeros(7)
        self._last_s: float | None = None

    def update(
        self,
        now_s: float,
        angles: FloatArray,
        command: FloatArray,
        expected: FloatArray,
        fresh: BoolArray,
    ) -> FloatArray:
        """Compare the joints' motion with their commands.

        All arrays are (7,): measured angles, rad; the commanded velocities since the last call, and
        those that the model of the joints expects, rad/s; True for angles that are measured, not
        extrapolated. Returned is the error of each joint's motion beyond the range of all delays
        and the tolerance, rad; 0 or less for a joint that follows.
        """
        passed_s = 0.0 if self._last_s is None else now_s - self._last_s
        if passed_s > max(_MOST_PAUSE_S, 3.0 * self._period_s):
            self._begin()
        else:
            self._sum = self._sum + command * passed_s
            self._expected = self._expected + expected * passed_s
        self._last_s = now_s
        off, went = np.full(7, -np.inf), np.zeros(7)
        for comparison in self._comparisons:
            off = np.maximum(off, comparison.update(now_s, self._sum, angles))
            wanted, moved = comparison.last
            went = np.maximum(went, np.minimum(np.abs(wanted), np.sign(wanted) * moved))
        quick = self._quick.update(now_s, self._sum, self._expected, angles, command)
        off = np.maximum(off, np.where(fresh, quick, -np.inf))
        self.proved_joints |= (went > _PROVED_RAD) & (off <= 0.0)
        return np.asarray(off)

    def describe(self, slot: int) -> str:
        """Motion of a joint that does not follow, its likeliest causes, and a cure."""
        wanted, moved = (float(values[slot]) for values in self._comparisons[0].last)
        if abs(moved) < max(2.0 * _STILL_RAD, 0.1 * abs(wanted)):
            return (
                "stands still: it is stuck, or its encoder is blind or misread; cure: see with "
                "`vergence jog` whether it turns freely"
            )
        if moved * wanted > 0.0 or abs(wanted) < _STILL_RAD:
            return (
                "turns otherwise than it is told: its load, or the unit of its speeds; cure: see "
                "with `vergence jog` whether it turns as far as it is told to"
            )
        return (
            "turns the wrong way: its motor is inverted, or the sign of its speeds; cure: look at "
            "the motor's wires, and at DRIVE_MODE"
        )


class _QuickTests:
    """Quick tests for an angle that stays the same, and for a speed that nothing asks for."""

    def __init__(self, period_s: float) -> None:
        self._kept_s = _STILL_WINDOWS[-1][0] + _LATE_S[-1] + period_s
        self._rows: deque[FloatArray] = deque()  # time, and four times seven values
        self._begun_s = np.nan

    def update(self, now_s: float, *values: FloatArray) -> FloatArray:
        """See `FollowingMonitor.update`.

        Values are the integrals of commands and expected velocities, angles, and commands, (7,).
        """
        rows = self._rows
        row = np.concatenate(((now_s,), *values))
        if not rows:  # nothing was demanded before
            before_s = now_s - self._kept_s - _STILL_WINDOWS[-1][0]
            rows.append(np.concatenate(((before_s,), row[1:22], np.zeros(7))))
            self._begun_s = now_s
        rows.append(row)
        while rows[1][0] <= now_s - self._kept_s:
            rows.popleft()
        off = np.full(7, -np.inf)
        table = np.array(rows)
        times, turned = table[:, 0], table[:, 15:22]
        begins = now_s - np.add.outer([0.0, *(one[0] for one in _STILL_WINDOWS)], _LATE_S)
        past = _at(times, table[:, 1:15], begins.ravel()).reshape(*begins.shape, 14)
        for place, (length_s, least_rad) in enumerate(_STILL_WINDOWS, 1):
            models = past[0, :, 7:] - past[place, :, 7:]
            demands = np.vstack([models, row[1:8] - past[place, 0, :7]])
            demanded = np.maximum(demands.min(axis=0), -demands.max(axis=0))
            still = np.ptp(turned[times >= now_s - length_s], axis=0) < _STILL_RAD
            off = np.where(still, np.maximum(off, demanded - least_rad), off)
        read = times >= self._begun_s
        grows = runaway(now_s, times[read], turned[read], table[read, 22:])
        return np.asarray(np.maximum(off, grows))


def runaway(
    now_s: float, times: FloatArray, turned: FloatArray, commands: FloatArray
) -> FloatArray:
    """(n,) motion of speeds that grow without a command, beyond what is accepted, rad.

    It is computed from the times of the last readings, (k,) s, the angles, (k, n) rad, and the
    commands before each, (k, n) rad/s; 0 or less for joints without.
    """
    ends = now_s - _RUNAWAY_WINDOW_S * np.array([0.0, 1.0, 2.0])
    if len(times) < 2 or times[0] > ends[-1]:
        return np.full(turned.shape[1], -np.inf)
    moved, before = -np.diff(_at(times, turned, ends), axis=0)
    side = np.sign(moved)
    recent = commands[times >= ends[1] - _RUNAWAY_PAST_S[0]]
    to_side = np.maximum((side * recent).max(axis=0), 0.0)
    either = np.abs(commands[times >= ends[1] - _RUNAWAY_PAST_S[1]]).max(axis=0)
    asked = _RUNAWAY_SPARE[0] * to_side + _RUNAWAY_SPARE[1] * either
    grows = side * (moved - before) > _STILL_RAD
    beyond = np.abs(moved) - _RUNAWAY_RAD - _RUNAWAY_WINDOW_S * asked
    return np.asarray(np.where(grows, beyond, -np.inf))


class _Comparison:
    """Comparison of motion and commands over one window; `last` has both, without delay, rad."""

    def __init__(
        self,
        length_s: float,
        every_s: float,
        least_rad: float,
        delay_s: float,
        acceleration: FloatArray,
    ) -> None:
        self._length_s, self._every_s, self._least_rad = length_s, every_s, least_rad
        self._delay_s, self._acceleration = delay_s, acceleration
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self.last = np.zeros(7), np.zeros(7)

    def update(self, now_s: float, total: FloatArray, angles: FloatArray) -> FloatArray:
        """See `FollowingMonitor.update`; `total` is C, the integral of the commands, (7,) rad."""
        rows, begin_s = self._rows, now_s - self._delay_s
        oldest_s = now_s - self._length_s - self._delay_s
        if not rows:
            rows.append((oldest_s, total, angles.copy()))
        if now_s - rows[-1][0] < self._every_s:
            return np.full(7, -np.inf)
        rows.append((now_s, total, angles.copy()))
        # the last row before the oldest time stays, for the interpolation
        while rows[1][0] <= oldest_s:
            rows.popleft()
        times, totals, turned = map(np.array, zip(*rows, strict=True))
        delayed = times[times >= begin_s]
        commanded = _at(times, totals, delayed) - _at(times, totals, delayed - self._length_s)
        moved = angles - _at(times, turned, np.array([now_s - self._length_s]))[0]
        least, greatest = commanded.min(axis=0), commanded.max(axis=0)
        # at each change of its command a joint with less acceleration coasts on, by v^2 / (2 a)
        passed_s = np.maximum(np.diff(times), _MIN_INTERVAL_S)[:, np.newaxis]
        speeds = np.diff(totals, axis=0) / passed_s
        changes = np.abs(np.diff(speeds * np.abs(speeds), axis=0, prepend=0.0, append=0.0))
        coast = 0.25 * changes.sum(axis=0) / (_LEAST_ACCELERATION_RATIO * self._acceleration)
        spare = self._least_rad + _MOTION_TOLERANCE * np.ptp(totals, axis=0) + coast
        self.last = commanded[-1], moved
        off = np.maximum(least - moved, moved - greatest) - spare
        # the range of the motion, at most the delay later than that of C
        range_s = begin_s - _RANGE_WINDOW_FRACTION * self._length_s
        tested = totals[(times >= range_s) & (times <= begin_s)]
        if len(tested):
            wanted = np.ptp(tested, axis=0)
            still = _MIN_RANGE_RATIO * wanted - np.ptp(turned[times >= range_s], axis=0)
            off = np.where(wanted > _MIN_TESTED_RANGE_RAD, np.maximum(off, still), off)
        return np.asarray(off)


def _at(times: FloatArray, values: FloatArray, when: FloatArray) -> FloatArray:
    """Interpolate (n, 7) values linearly at (k,) times: (k, 7)."""
    right = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    left = right - 1
    share = np.clip((when - times[left]) / (times[right] - times[left]), 0.0, 1.0)[:, None]
    return np.asarray(values[left] + share * (values[right] - values[left]))
