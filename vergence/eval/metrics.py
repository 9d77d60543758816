"""Metrics of a gaze: settle time and overshoot."""

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.parts import FloatArray


def settle_time(time_s: ArrayLike, pixel_error: ArrayLike, band_px: float) -> FloatArray:
    """When both eyes' errors enter a band to stay until the trial's end.

    Args:
        time_s: (steps,) seconds since the target jumped.
        pixel_error: (steps, ..., 2, 2) by eye and image axis, px; nan counts as outside.
        band_px: the band, on the norm of each eye's error.

    Returns:
        (...) seconds; nan for trials that never settle.
    """
    time = np.asarray(time_s, dtype=np.float64)
    norm = np.linalg.norm(np.asarray(pixel_error), axis=-1)
    outside = ~(norm < band_px).all(axis=-1)
    steps = len(time)
    # the step after the last one outside the band; `steps` if that is the last of the trial
    entered = steps - np.argmax(outside[::-1], axis=0)
    entered = np.where(outside.any(axis=0), entered, 0)
    return np.where(entered < steps, time[np.minimum(entered, steps - 1)], np.nan)


def overshoot(pixel_error: ArrayLike) -> FloatArray:
    """How far the error passes beyond zero, as a fraction of its initial size.

    Per eye, the error is projected on the direction of the initial error; the larger of the
    two eyes' values counts.

    Args:
        pixel_error: (steps, ..., 2, 2) by eye and image axis, px.

    Returns:
        (...) 0 where nothing passes beyond zero.
    """
    error = np.asarray(pixel_error, dtype=np.float64)
    first = error[0]
    square = np.sum(first**2, axis=-1)
    along = np.sum(error * first, axis=-1) / np.where(square > 0.0, square, np.nan)
    return np.asarray(np.maximum(0.0, np.nanmax(-along, axis=(0, -1))))
