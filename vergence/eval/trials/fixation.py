"""Metrics of fixation, one value a trial: how still the eyes hold a target that rests.

Trajectories have time along the first axis and any shape of trials after it. A joint's speed is the
mean over a control period, so that swings from one period to the next count too.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.eval.trials.metrics import late
from vergence.models.parts import FloatArray

FIXATION_S: Final = 5.0
"""End of a trial over which the joints' speeds while fixating are taken, s; see
`fixation_start`."""
_APPROACH_S: Final = 2.0
"""Time from the onset that fixation leaves to the approach, s: most laws settle within it."""
SWING_RAD_S: Final = float(np.deg2rad(20.0))
"""Peak to peak of a joint speed above which an eye swings, rad/s."""
SWING_WINDOW_S: Final = 0.25
"""Time within which a swing has to show, s. Laws swing at 3 to 15 Hz where delays, play or noise
are beyond what they hold (measured); what chases single outliers is in fewer such windows."""
SWING_S: Final = 1.0
"""Time through which every such window has to show it, s: a turn of up to half of it is none."""
GO_S: Final = 0.7
"""Time from the onset in which the eyes may turn to the target as they like, s."""
HELD_S: Final = 0.1
"""Time within the band from which a trial counts as having been there, s."""


def fixation_start(onset_s: ArrayLike, duration_s: float) -> FloatArray:
    """The time from which on eyes are taken to fixate a target that rests since its onset.

    `FIXATION_S` before the end, but not before 2 s after the onset, nor, in trials too short for
    that, before half of the time after the onset.

    Args:
        onset_s: (...) since the trial's start, s.
        duration_s: how long the trial lasts.

    Returns:
        (...) s.
    """
    onset = np.asarray(onset_s, dtype=np.float64)
    approach = np.minimum(_APPROACH_S, 0.5 * (duration_s - onset))
    return np.asarray(np.maximum(onset + approach, duration_s - FIXATION_S))


def speed_rms(time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike) -> FloatArray:
    """The root mean square of the speed of the worst joint, from a time on.

    Args:
        time_s: (steps + 1,) s.
        speed: (steps, ..., joints) rad/s, the mean from one time to the next.
        after_s: (...) or a scalar, from when on it counts.

    Returns:
        (...) rad/s; nan for trials that are over by then.
    """
    square, counts = _counted(time_s, np.asarray(speed) ** 2, after_s)
    with np.errstate(invalid="ignore"):
        mean = np.sum(square, axis=0, where=counts) / counts.sum(axis=0)
    return np.asarray(np.sqrt(mean.max(axis=-1)))


def speed_peak_to_peak(time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike) -> FloatArray:
    """The range of the speed of the worst joint, from a time on: the greatest less the least.

    Args:
        time_s: (steps + 1,) s, see `speed_rms`, as are the following two.
        speed: (steps, ..., joints) rad/s.
        after_s: (...) or a scalar.

    Returns:
        (...) rad/s; nan for trials that are over by then.
    """
    found, counts = _counted(time_s, speed, after_s)
    greatest = np.max(found, axis=0, where=counts, initial=-np.inf)
    least = np.min(found, axis=0, where=counts, initial=np.inf)
    return np.asarray(np.where(counts.any(axis=0), greatest - least, np.nan).max(axis=-1))


def _counted(
    time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Speeds, and which of them, of the same shape, begin no earlier than a time."""
    found = np.asarray(speed, dtype=np.float64)
    counts = late(np.asarray(time_s)[:-1], after_s, found.shape[1:-1])
    return found, np.broadcast_to(counts[..., None], found.shape)


def swings(time_s: ArrayLike, speed: ArrayLike, onset_s: ArrayLike) -> NDArray[np.bool_]:
    """Tell trials whose eyes swing although their target rests.

    The peak to peak of a joint's speed exceeds `SWING_RAD_S` in every `SWING_WINDOW_S` of a whole
    `SWING_S`, at any time from `GO_S` after the onset on. A single turn of up to half a second is
    in too few of the windows, whatever its speed. A sinusoid is told from 20 degrees/s peak to
    peak on at 4 Hz, from 23 at 3 Hz, from 40 at 2 Hz.

    Args:
        time_s: (steps + 1,) s, evenly spaced, see `speed_rms`.
        speed: (steps, ..., joints) rad/s.
        onset_s: (...) or a scalar, since when the target rests, s.

    Returns:
        (...) False for trials that are too short to tell.
    """
    time, found = np.asarray(time_s), np.asarray(speed, dtype=np.float64)
    if len(time) < 2:  # stopped before its first period was over
        return np.zeros(found.shape[1:-1], dtype=np.bool_)
    period_s = time[1] - time[0]
    window = max(2, round(SWING_WINDOW_S / period_s))
    whole = max(window, round(SWING_S / period_s))
    if len(found) < whole:
        return np.zeros(found.shape[1:-1], dtype=np.bool_)
    range_ = _greatest(found, window) + _greatest(-found, window)
    swung = (range_ > SWING_RAD_S).any(axis=-1)
    swung &= late(time[: len(swung)], np.asarray(onset_s) + GO_S, swung.shape[1:])
    return np.asarray(_throughout(swung, whole - window + 1).any(axis=0))


def left_again(
    time_s: ArrayLike, pixel_error: ArrayLike, band_px: float, onset_s: ArrayLike
) -> NDArray[np.bool_]:
    """Tell trials that have been in a band for `HELD_S` since the onset, and left it again.

    Args:
        time_s: (steps,) s, evenly spaced.
        pixel_error: (steps, ..., 2, 2) by eye and image axis, beyond the least one, px; nan
            counts as outside.
        band_px: the band, on the norm of each eye's error.
        onset_s: (...) or a scalar, since when the target rests, s.

    Returns:
        (...) whether they did.
    """
    time = np.asarray(time_s)
    inside = (np.linalg.norm(np.asarray(pixel_error), axis=-1) < band_px).all(axis=-1)
    if len(time) < 2:
        return np.zeros(inside.shape[1:], dtype=np.bool_)
    held = round(HELD_S / (time[1] - time[0])) + 1
    if len(inside) <= held:
        return np.zeros(inside.shape[1:], dtype=np.bool_)
    settled = _throughout(inside & late(time, onset_s, inside.shape[1:]), held)
    before = np.logical_or.accumulate(settled[:-1], axis=0)
    return np.asarray((before & ~inside[held:]).any(axis=0))


def _greatest(values: NDArray[Any], length: int) -> NDArray[Any]:
    """(steps - length + 1, ...) the greatest of so many values from each step on."""
    found, covered = values, 1
    while 2 * covered <= length:
        found = np.maximum(found[:-covered], found[covered:])
        covered *= 2
    rest = length - covered
    return np.maximum(found[: len(found) - rest], found[rest:]) if rest else found


def _throughout(holds: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """(steps - length + 1, ...) whether it holds for so many steps from each one on."""
    return np.asarray(~_greatest(~holds, length))
