"""Excitation of an eye for the measurement: slow to and fro, a chirp, and quick reversals."""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from vergence.models.parts import FloatArray

SLOW_RAD_S: Final = 0.15
"""Speed of the slow part, rad/s, which shows the backlash and that the joint follows (chosen)."""
CHIRP_RAD_S: Final = 0.8
"""Greatest speed of the chirp, rad/s: 10 ms of exposure blur a webcam's image by 5 px (chosen)."""
QUICK_RAD_S: Final = 2.5
"""Greatest speed of the reversals, which images need not resolve, rad/s: at twice this a weak joint
would hardly move, and the supervisor would stop it as stuck (chosen)."""
_SLOW_AMPLITUDE_RAD: Final = 0.06
"""Amplitude of the slow part, rad (chosen)."""
_CHIRP_HZ: Final = (0.4, 4.0)
"""First and last frequency of the chirp, Hz (chosen)."""
# Durations of the slow part, the chirp and the reversals, s (chosen: precision against time).
_SLOW_DURATION_S: Final = 4.8
_CHIRP_DURATION_S: Final = 9.0
_REVERSALS_DURATION_S: Final = 3.0

_DRIFT_GAIN: Final = 1.0
"""Gain of the correction towards the planned angle, 1/s (chosen)."""
_DELAY_PERIODS: Final = 3
"""Rough delay of a joint behind its commands, control periods (chosen)."""


def excitation_speeds(reach_rad: float, max_speed_rad_s: float, period_s: float) -> FloatArray:
    """Speeds of the excitation, one per control period.

    Args:
        reach_rad: greatest distance from the start angle, rad.
        max_speed_rad_s: greatest speed, rad/s.
        period_s: the control period, s.

    Returns:
        (n,) speeds, rad/s.
    """
    slow = _to_and_fro(
        min(_SLOW_AMPLITUDE_RAD, reach_rad),
        min(SLOW_RAD_S, max_speed_rad_s),
        _SLOW_DURATION_S,
        period_s,
    )
    quick = min(QUICK_RAD_S, max_speed_rad_s)
    return np.concatenate(
        [
            slow,
            _chirp(reach_rad, min(CHIRP_RAD_S, max_speed_rad_s), period_s),
            _to_and_fro(reach_rad, quick, _REVERSALS_DURATION_S, period_s),
            slow,
        ]
    )


def _to_and_fro(way_rad: float, speed_rad_s: float, length_s: float, period_s: float) -> FloatArray:
    """Speeds of a triangular motion about the start angle."""
    quarter = max(2, round(way_rad / speed_rad_s / period_s))
    turn = np.repeat([1.0, -1.0, -1.0, 1.0], quarter)
    times = max(1, round(length_s / period_s / len(turn)))
    return np.asarray(speed_rad_s * np.tile(turn, times))


def _chirp(reach_rad: float, speed_rad_s: float, period_s: float) -> FloatArray:
    """Speeds of a sinusoidal motion with growing frequency."""
    first, last = _CHIRP_HZ
    t = period_s * np.arange(round(_CHIRP_DURATION_S / period_s))
    rate = (last / first) ** (1.0 / _CHIRP_DURATION_S)
    frequency = first * rate**t
    phase = 2.0 * np.pi * (frequency - first) / np.log(rate)
    most = np.minimum(speed_rad_s, 2.0 * np.pi * frequency * reach_rad)
    return np.asarray(most * np.cos(phase))


def drift_corrected_velocities(
    slot: int, speeds_rad_s: FloatArray, period_s: float, read_angle: Callable[[], float]
) -> Iterator[FloatArray]:
    """Requested velocities for one actuator, with a slow correction against drift.

    Args:
        slot: its index in the 7-element command.
        speeds_rad_s: (n,) its speeds, rad/s.
        period_s: the control period, s.
        read_angle: returns its present angle, rad.

    Yields:
        (7,) velocities, rad/s.
    """
    middle = read_angle()
    places = middle + period_s * np.concatenate(
        [np.zeros(_DELAY_PERIODS + 1), np.cumsum(speeds_rad_s)]
    )
    for speed, place in zip(speeds_rad_s, places, strict=False):
        requested = np.zeros(7)
        requested[slot] = speed + _DRIFT_GAIN * (place - read_angle())
        yield requested
