"""Metrics of fixation, one value per trial: the stillness of the eyes on a target at rest.

Trajectories have time along the first axis, followed by any shape of trials. A joint's speed is its
mean over a control period, so that oscillations from one period to the next count too.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.eval.trials.metrics import mask_from_time
from vergence.models.parts import FloatArray

FIXATION_S: Final = 5.0
"""Length of the window at a trial's end for joint speeds while fixating, s (chosen); see
`fixation_window_start`."""
_APPROACH_S: Final = 2.0
"""Least time between the onset and the fixation window, s; most laws settle within it (chosen)."""
SWING_RAD_S: Final = float(np.deg2rad(20.0))
"""Peak-to-peak joint speed above which an eye swings (oscillates), rad/s (chosen)."""
SWING_WINDOW_S: Final = 0.25
"""Window within which the speed has to span `SWING_RAD_S`, s (chosen). Laws oscillate at 3 to 15 Hz
if delay, backlash or noise exceed their margins (docs/evaluate.md); reactions to single outliers
show in fewer such windows."""
SWING_S: Final = 1.0
"""Time throughout which every such window has to show the oscillation, s; a single turn of up to
half of it does not count (chosen)."""
TURN_S: Final = 0.7
"""Time after the onset left to the turn towards the target, in which nothing counts as
oscillation, s (chosen)."""
HELD_S: Final = 0.1
"""Time within the band after which a trial counts as having reached it, s (chosen)."""


def fixation_window_start(onset_s: ArrayLike, duration_s: float) -> FloatArray:
    """Time at which the fixation window starts.

    The part at a trial's end over which joint speeds are judged.

    The window is the last `FIXATION_S` of the trial. It starts 2 s after the onset at the earliest,
    or, in trials with less than 4 s after the onset, halfway between the onset and the end.

    Args:
        onset_s: (...) since the trial's start, s.
        duration_s: duration of the trial, s.

    Returns:
        (...) s.
    """
    onset = np.asarray(onset_s, dtype=np.float64)
    approach = np.minimum(_APPROACH_S, 0.5 * (duration_s - onset))
    return np.asarray(np.maximum(onset + approach, duration_s - FIXATION_S))


def worst_joint_speed_rms(time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike) -> FloatArray:
    """The root mean square of the worst joint's speed, from a time on.

    Args:
        time_s: (steps + 1,) s.
        speed: (steps, ..., joints) rad/s, the mean from one time to the next.
        after_s: (...) or a scalar, start of the evaluated part, s.

    Returns:
        (...) rad/s; nan for trials that are over by then.
    """
    square, counts = _speeds_and_mask(time_s, np.asarray(speed) ** 2, after_s)
    with np.errstate(invalid="ignore"):
        mean = np.sum(square, axis=0, where=counts) / counts.sum(axis=0)
    return np.asarray(np.sqrt(mean.max(axis=-1)))


def worst_joint_speed_range(time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike) -> FloatArray:
    """The peak-to-peak range of the worst joint's speed, from a time on.

    Args:
        time_s: (steps + 1,) s.
        speed: (steps, ..., joints) rad/s, the mean from one time to the next.
        after_s: (...) or a scalar, start of the evaluated part, s.

    Returns:
        (...) rad/s; nan for trials that are over by then.
    """
    found, counts = _speeds_and_mask(time_s, speed, after_s)
    greatest = np.max(found, axis=0, where=counts, initial=-np.inf)
    least = np.min(found, axis=0, where=counts, initial=np.inf)
    return np.asarray(np.where(counts.any(axis=0), greatest - least, np.nan).max(axis=-1))


def _speeds_and_mask(
    time_s: ArrayLike, speed: ArrayLike, after_s: ArrayLike
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Speeds, and a mask of their shape for those whose period begins at a time or later."""
    found = np.asarray(speed, dtype=np.float64)
    counts = mask_from_time(np.asarray(time_s)[:-1], after_s, found.shape[1:-1])
    return found, np.broadcast_to(counts[..., None], found.shape)


def detect_oscillation(
    time_s: ArrayLike, speed: ArrayLike, onset_s: ArrayLike
) -> NDArray[np.bool_]:
    """Detect trials whose eyes swing (oscillate) although their target rests.

    A trial swings if, at any time later than `TURN_S` after the onset, the peak-to-peak speed of a
    joint exceeds `SWING_RAD_S` in every window of `SWING_WINDOW_S` throughout a span of `SWING_S`.
    A single turn of up to half a second falls into too few of the windows, whatever its speed. The
    least peak-to-peak speed at which a sinusoid is detected is 20 degrees/s at 4 Hz, 23 at 3 Hz
    and 40 at 2 Hz.

    Args:
        time_s: (steps + 1,) s, evenly spaced, see `worst_joint_speed_rms`.
        speed: (steps, ..., joints) rad/s.
        onset_s: (...) or a scalar, time at which the target comes to rest, s.

    Returns:
        (...) True for trials that swing; False for trials that are too short to decide.
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
    swung &= mask_from_time(time[: len(swung)], np.asarray(onset_s) + TURN_S, swung.shape[1:])
    return np.asarray(_holds_for(swung, whole - window + 1).any(axis=0))


def detect_band_exits(
    time_s: ArrayLike, pixel_error: ArrayLike, band_px: float, onset_s: ArrayLike
) -> NDArray[np.bool_]:
    """Detect trials that stayed in a band for `HELD_S` after the onset, and left it again.

    Args:
        time_s: (steps,) s, evenly spaced.
        pixel_error: (steps, ..., 2, 2) by eye and image axis, beyond the least one, px; nan
            counts as outside.
        band_px: the band, on the norm of each eye's error.
        onset_s: (...) or a scalar, time at which the target comes to rest, s.

    Returns:
        (...) True for trials that did.
    """
    time = np.asarray(time_s)
    inside = (np.linalg.norm(np.asarray(pixel_error), axis=-1) < band_px).all(axis=-1)
    if len(time) < 2:
        return np.zeros(inside.shape[1:], dtype=np.bool_)
    held = round(HELD_S / (time[1] - time[0])) + 1
    if len(inside) <= held:
        return np.zeros(inside.shape[1:], dtype=np.bool_)
    settled = _holds_for(inside & mask_from_time(time, onset_s, inside.shape[1:]), held)
    before = np.logical_or.accumulate(settled[:-1], axis=0)
    return np.asarray((before & ~inside[held:]).any(axis=0))


def _greatest(values: NDArray[Any], length: int) -> NDArray[Any]:
    """(steps - length + 1, ...) the running maximum over `length` values from each step on."""
    found, covered = values, 1
    while 2 * covered <= length:
        found = np.maximum(found[:-covered], found[covered:])
        covered *= 2
    rest = length - covered
    return np.maximum(found[: len(found) - rest], found[rest:]) if rest else found


def _holds_for(holds: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """(steps - length + 1, ...) True where a condition holds for `length` steps from a step on."""
    return np.asarray(~_greatest(~holds, length))
