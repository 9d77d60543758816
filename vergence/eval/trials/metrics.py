"""Metrics of gaze trials, one value a trial: settling, overshoot, precision, effort, tracking.

All take trajectories with time along the first axis and any shape of trials after it. Errors are
pixels by eye and image axis. Of a target at rest they are taken beyond the least error that the
head can reach, which is zero for eyes that fixate exactly. Where an error is nan (a target behind
the camera, or not seen where only the images know) the trial goes on: it counts as outside every
band, and as `missing_px` in averages.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.parts import FloatArray

_ROUNDING_S: Final = 1e-9
STEADY_S: Final = 0.25
"""How much of a trial's end the steady-state error is taken over, s."""


def settle_time(time_s: ArrayLike, pixel_error: ArrayLike, band_px: float) -> FloatArray:
    """When both eyes' errors enter a band to stay until the trial's end.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) by eye and image axis, beyond the least one, px; nan
            counts as outside.
        band_px: the band, on the norm of each eye's error.

    Returns:
        (...) one of the times; nan for trials that never settle.
    """
    time = np.asarray(time_s, dtype=np.float64)
    norm = np.linalg.norm(np.asarray(pixel_error), axis=-1)
    outside = ~(norm < band_px).all(axis=-1)
    steps = len(time)
    # the step after the last one outside the band; `steps` if that is the last of the trial
    entered = steps - np.argmax(outside[::-1], axis=0)
    entered = np.where(outside.any(axis=0), entered, 0)
    return np.where(entered < steps, time[np.minimum(entered, steps - 1)], np.nan)


def overshoot(pixel_error: ArrayLike, onset: ArrayLike = 0) -> FloatArray:
    """How far the error passes beyond its goal, as a fraction of its size at the onset.

    The goal is zero, or the least error of a head that cannot reach zero. Per eye, the error is
    projected on the direction that it has at the onset; the larger of the two eyes' values counts.

    Args:
        pixel_error: (steps, ..., 2, 2) by eye and image axis, beyond the least one, px.
        onset: (...) or a scalar, the step at which the target appears or jumps.

    Returns:
        (...) 0 where nothing passes beyond it, or where neither eye had an error to reduce.
    """
    error = np.asarray(pixel_error, dtype=np.float64)
    begun = np.broadcast_to(np.asarray(onset, dtype=np.int64), error.shape[1:-2])
    first = np.take_along_axis(error, begun[None, ..., None, None], axis=0)
    square = np.sum(first**2, axis=-1)
    along = np.sum(error * first, axis=-1) / np.where(square > 0.0, square, np.nan)
    steps = np.arange(len(error)).reshape(-1, *(1,) * begun.ndim)
    along = np.where((steps >= begun)[..., None], along, np.nan)
    beyond = np.fmax.reduce(np.fmax.reduce(-along, axis=0), axis=-1)
    return np.asarray(np.fmax(0.0, beyond))


def error_norm(pixel_error: ArrayLike, missing_px: float) -> FloatArray:
    """The error of the head: the root of the mean square of both eyes' errors.

    Args:
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: what an error that is nan counts as, px.

    Returns:
        (steps, ...) px.
    """
    square = np.sum(np.asarray(pixel_error, dtype=np.float64) ** 2, axis=-1)
    square = np.where(np.isnan(square), missing_px**2, square)
    return np.asarray(np.sqrt(square.mean(axis=-1)))


def steady_state_error(
    time_s: ArrayLike, pixel_error: ArrayLike, missing_px: float, window_s: float = STEADY_S
) -> FloatArray:
    """The root mean square of the error over a trial's end.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: what an error that is nan counts as, px.
        window_s: how much of the end.

    Returns:
        (...) px.
    """
    time = np.asarray(time_s)
    norm = error_norm(np.asarray(pixel_error)[time > time[-1] - window_s], missing_px)
    return np.asarray(np.sqrt(np.mean(norm**2, axis=0)))


def tracking_rms(
    time_s: ArrayLike, pixel_error: ArrayLike, missing_px: float, after_s: ArrayLike
) -> FloatArray:
    """The root mean square of the error once a moving target should have been caught up with.

    Args:
        time_s: (steps,) s, see `steady_state_error`, as are the following two.
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: px.
        after_s: (...) or a scalar, from when on it counts.

    Returns:
        (...) px; nan for trials that are over by then.
    """
    square = error_norm(pixel_error, missing_px) ** 2
    counts = late(time_s, after_s, square.shape[1:])
    with np.errstate(invalid="ignore"):
        mean = np.sum(square, axis=0, where=counts) / counts.sum(axis=0)
    return np.asarray(np.sqrt(mean))


def tracking_lag(
    time_s: ArrayLike,
    pixel_error: ArrayLike,
    image_velocity: ArrayLike,
    after_s: ArrayLike,
) -> FloatArray:
    """How far the eyes trail a moving target, as a time.

    Eyes that repeat the target's path L seconds late see it L times its image velocity (that
    seen by an eye held still) off the centre. L is the least-squares fit of this, over both eyes
    and the time from `after_s` on.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) px.
        image_velocity: (steps, ..., 2, 2) px/s of the target, seen by eyes held still.
        after_s: (...) or a scalar, from when on it counts.

    Returns:
        (...) seconds, negative for eyes that lead; nan where nothing moves.
    """
    error, velocity = np.asarray(pixel_error), np.asarray(image_velocity)
    counts = late(time_s, after_s, error.shape[1:-2])[..., None, None]
    known = np.isfinite(error) & np.isfinite(velocity) & counts
    axes = (0, -2, -1)
    along = np.sum(error * velocity, axis=axes, where=known)
    square = np.sum(velocity**2, axis=axes, where=known)
    return np.asarray(along / np.where(square > 0.0, square, np.nan))


def late(time_s: ArrayLike, after_s: ArrayLike, trials: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tell which times of trials are not before one of their own.

    Args:
        time_s: (steps,) s.
        after_s: (...) or a scalar, s.
        trials: the shape `...`.

    Returns:
        (steps, ...) which.
    """
    time = np.reshape(np.asarray(time_s), (-1, *(1,) * len(trials)))
    return np.asarray(time >= np.broadcast_to(after_s, trials) - _ROUNDING_S)


def command_energy(command: ArrayLike, period_s: float) -> FloatArray:
    """The integral of the squared joint velocity commands, summed over joints.

    Args:
        command: (steps, ..., joints) rad/s, each held for a period.
        period_s: the control period.

    Returns:
        (...) rad^2/s.
    """
    return np.asarray(period_s * np.sum(np.asarray(command) ** 2, axis=(0, -1)))


def command_peak(command: ArrayLike) -> FloatArray:
    """The greatest command of any joint.

    Args:
        command: (steps, ..., joints) rad/s.

    Returns:
        (...) rad/s.
    """
    return np.asarray(np.abs(np.asarray(command)).max(axis=(0, -1)))


def at_time(time_s: ArrayLike, values: ArrayLike, when_s: ArrayLike) -> FloatArray:
    """What each trial's trajectory was at a time of its own.

    Args:
        time_s: (steps,) s, increasing.
        values: (steps, n) one value a trial.
        when_s: (n,) s, among `time_s`; nan for never.

    Returns:
        (n,) nan where the time is.
    """
    time, when = np.asarray(time_s), np.asarray(when_s)
    known: NDArray[np.bool_] = np.isfinite(when)
    step = np.argmin(np.abs(time[:, None] - np.where(known, when, time[0])), axis=0)
    return np.where(known, np.asarray(values)[step, np.arange(len(when))], np.nan)
