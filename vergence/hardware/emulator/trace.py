"""Recent true motion of an emulated joint.

Servos read it late, recordings hold it, and it tells since when a head has been at rest.
"""

from array import array
from bisect import bisect_right
from collections.abc import Iterable
from typing import Final, NamedTuple

from vergence.hardware.dynamixel.control_table import TICK_RAD_S

REST_RAD_S: Final = TICK_RAD_S
"""Greatest speed at rest: one unit of the servos' speed, 0.024 rad/s (physical: X series)."""
_MIN_KEPT_SAMPLES: Final = 16_384
"""Least number of samples kept: 20 s of a joint whose speed always changes (numerical)."""


class MotionSample(NamedTuple):
    """Time, angle and velocity of a joint."""

    time_s: float
    position_rad: float
    velocity_rad_s: float


class MotionTrace:
    """Samples of a joint's motion in the last 20 s or more.

    Callers add samples so often that the velocity changes monotonically between two.
    """

    def __init__(self) -> None:
        # plain numbers: so many objects would make garbage collection delay the servos' answers
        self._times, self._positions, self._velocities = array("d"), array("d"), array("d")

    def add(self, time_s: float, position_rad: float, velocity_rad_s: float) -> None:
        """Add a sample; of samples with equal velocity only the first and the last are kept."""
        times, positions, velocities = self._times, self._positions, self._velocities
        if len(times) >= 2 and velocities[-2] == velocities[-1] == velocity_rad_s:
            times[-1], positions[-1] = time_s, position_rad
            return
        if len(times) >= 2 * _MIN_KEPT_SAMPLES:
            del (
                times[:_MIN_KEPT_SAMPLES],
                positions[:_MIN_KEPT_SAMPLES],
                velocities[:_MIN_KEPT_SAMPLES],
            )
        times.append(time_s)
        positions.append(position_rad)
        velocities.append(velocity_rad_s)

    def samples_since(self, time_s: float) -> list[MotionSample]:
        """Samples from a time on, the first one interpolated at that time."""
        first = bisect_right(self._times, time_s)
        columns = (self._times[first:], self._positions[first:], self._velocities[first:])
        moments = [MotionSample(*row) for row in zip(*columns, strict=True)]
        if first == 0:
            return moments
        before = MotionSample(
            self._times[first - 1], self._positions[first - 1], self._velocities[first - 1]
        )
        return [_between(before, moments[0], time_s) if moments else before, *moments]


def rest_start_and_top_speed(
    traces: Iterable[MotionTrace], time_s: float
) -> tuple[float | None, float]:
    """Start of the present rest of all joints, and their greatest speed.

    Returns:
        The earliest time, from `time_s` on, after which no joint was faster than `REST_RAD_S`, or
        None if one still is; and the greatest speed of any joint since `time_s`, rad/s.
    """
    rested_s: float | None = time_s
    fastest = 0.0
    for trace in traces:
        moments = trace.samples_since(time_s)
        fastest = max([fastest, *(abs(moment.velocity_rad_s) for moment in moments)])
        own_s = _rested_s(moments, time_s)
        rested_s = None if rested_s is None or own_s is None else max(rested_s, own_s)
    return rested_s, fastest


def _rested_s(moments: list[MotionSample], time_s: float) -> float | None:
    speeds = [abs(moment.velocity_rad_s) for moment in moments]
    last = next((i for i in reversed(range(len(speeds))) if speeds[i] > REST_RAD_S), None)
    if last is None:
        return time_s
    if last == len(speeds) - 1:
        return None
    share = (speeds[last] - REST_RAD_S) / (speeds[last] - speeds[last + 1])
    begun_s = moments[last].time_s
    return begun_s + share * (moments[last + 1].time_s - begun_s)


def _between(before: MotionSample, after: MotionSample, time_s: float) -> MotionSample:
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    return MotionSample(
        time_s,
        before.position_rad + share * (after.position_rad - before.position_rad),
        before.velocity_rad_s + share * (after.velocity_rad_s - before.velocity_rad_s),
    )
