"""The way that an eye turns to tell its loop: slowly to and fro, a chirp, and quick reversals."""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from vergence.models.parts import FloatArray

SLOW_RAD_S: Final = 0.15
"""Speed to and fro that tells the play, and by which a joint is proved to follow, rad/s."""
CHIRP_RAD_S: Final = 0.8
"""Greatest speed of the chirp, rad/s: an exposure of 10 ms smears a webcam's image by 5 px."""
QUICK_RAD_S: Final = 2.5
"""Greatest speed of the reversals, which no image has to follow, rad/s: a weak joint at twice as
much would go nowhere, and the supervisor would take it for stuck."""
_SLOW_RAD: Final = 0.06
"""Half the way of the slow part, rad."""
_CHIRP_HZ: Final = (0.4, 4.0)
_SLOW_S, _CHIRP_S, _QUICK_S = 4.8, 9.0, 3.0
_BACK: Final = 1.0
"""Rate at which the way is held about its middle, 1/s."""
_LATE: Final = 3
"""Control periods by which a joint is behind its commands, roughly."""


def speeds(reach_rad: float, most_rad_s: float, period_s: float) -> FloatArray:
    """Speeds, a control period each.

    Args:
        reach_rad: greatest distance from the middle, rad.
        most_rad_s: greatest speed, rad/s.
        period_s: the control period, s.

    Returns:
        (n,) rad/s.
    """
    slow = _to_and_fro(min(_SLOW_RAD, reach_rad), min(SLOW_RAD_S, most_rad_s), _SLOW_S, period_s)
    quick = min(QUICK_RAD_S, most_rad_s)
    return np.concatenate(
        [
            slow,
            _chirp(reach_rad, min(CHIRP_RAD_S, most_rad_s), period_s),
            _to_and_fro(reach_rad, quick, _QUICK_S, period_s),
            slow,
        ]
    )


def _to_and_fro(way_rad: float, speed_rad_s: float, length_s: float, period_s: float) -> FloatArray:
    """A constant speed that turns round, from the middle to either side."""
    quarter = max(2, round(way_rad / speed_rad_s / period_s))
    turn = np.repeat([1.0, -1.0, -1.0, 1.0], quarter)
    times = max(1, round(length_s / period_s / len(turn)))
    return np.asarray(speed_rad_s * np.tile(turn, times))


def _chirp(reach_rad: float, speed_rad_s: float, period_s: float) -> FloatArray:
    """A sinusoid of growing frequency, by its speed."""
    first, last = _CHIRP_HZ
    t = period_s * np.arange(round(_CHIRP_S / period_s))
    rate = (last / first) ** (1.0 / _CHIRP_S)
    frequency = first * rate**t
    phase = 2.0 * np.pi * (frequency - first) / np.log(rate)
    most = np.minimum(speed_rad_s, 2.0 * np.pi * frequency * reach_rad)
    return np.asarray(most * np.cos(phase))


def wishes(
    slot: int, way: FloatArray, period_s: float, angle: Callable[[], float]
) -> Iterator[FloatArray]:
    """Wishes for one actuator, held about where it stands.

    Args:
        slot: its place in a command of seven.
        way: (n,) its speeds, rad/s.
        period_s: the control period, s.
        angle: tells its present angle, rad.

    Yields:
        (7,) rad/s.
    """
    middle = angle()
    places = middle + period_s * np.concatenate([np.zeros(_LATE + 1), np.cumsum(way)])
    for speed, place in zip(way, places, strict=False):
        wish = np.zeros(7)
        wish[slot] = speed + _BACK * (place - angle())
        yield wish
