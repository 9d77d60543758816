"""Metrics of gaze trials, one value per trial: settling, overshoot, precision, effort, tracking.

All take trajectories with time along the first axis, followed by any shape of trials. Errors are
pixels by eye and image axis. For a target at rest the residual is subtracted first: the least error
that the head can reach, zero for eyes that can fixate exactly. A trial goes on where its error is
nan (the target is behind the camera or, on a plant without ground truth, not detected). Such an
error counts as outside every band, and as `missing_px` in averages.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.parts import FloatArray

_TIME_TOLERANCE_S: Final = 1e-9
"""Tolerance within which two times count as equal, s (numerical)."""
STEADY_S: Final = 0.25
"""Window at a trial's end for the steady-state error, s (chosen)."""


def settle_time(time_s: ArrayLike, pixel_error: ArrayLike, band_px: float) -> FloatArray:
    """The time at which both eyes' errors enter a band and stay in it until the trial's end.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) by eye and image axis, less the residual, px; nan counts
            as outside.
        band_px: the band, on the norm of each eye's error.

    Returns:
        (...) one of `time_s`; nan for trials that never settle.
    """
    time = np.asarray(time_s, dtype=np.float64)
    norm = np.linalg.norm(np.asarray(pixel_error), axis=-1)
    outside = ~(norm < band_px).all(axis=-1)
    steps = len(time)
    # the step after the last one outside the band; `steps` if that is the last of the trial
    entered = steps - np.argmax(outside[::-1], axis=0)
    entered = np.where(outside.any(axis=0), entered, 0)
    return np.where(entered < steps, time[np.minimum(entered, steps - 1)], np.nan)


def overshoot_fraction(reducible_error: ArrayLike, onset_step: ArrayLike = 0) -> FloatArray:
    """Overshoot of the error beyond its goal, as a fraction of the error at the onset.

    The goal is zero, or the residual of a head that cannot reach zero. Each eye's error is
    projected on its direction at the onset; the larger value of the two eyes counts.

    Args:
        reducible_error: (steps, ..., 2, 2) by eye and image axis, less the residual, px.
        onset_step: (...) or a scalar, the step at which the target appears or jumps.

    Returns:
        (...) 0 for no overshoot, or if neither eye had an error at the onset.
    """
    error = np.asarray(reducible_error, dtype=np.float64)
    begun = np.broadcast_to(np.asarray(onset_step, dtype=np.int64), error.shape[1:-2])
    first = np.take_along_axis(error, begun[None, ..., None, None], axis=0)
    square = np.sum(first**2, axis=-1)
    along = np.sum(error * first, axis=-1) / np.where(square > 0.0, square, np.nan)
    steps = np.arange(len(error)).reshape(-1, *(1,) * begun.ndim)
    along = np.where((steps >= begun)[..., None], along, np.nan)
    beyond = np.fmax.reduce(np.fmax.reduce(-along, axis=0), axis=-1)
    return np.asarray(np.fmax(0.0, beyond))


def binocular_rms_error(pixel_error: ArrayLike, missing_px: float) -> FloatArray:
    """The error of the head: the root mean square of both eyes' errors.

    Args:
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: value in place of an error that is nan, px.

    Returns:
        (steps, ...) px.
    """
    square = np.sum(np.asarray(pixel_error, dtype=np.float64) ** 2, axis=-1)
    square = np.where(np.isnan(square), missing_px**2, square)
    return np.asarray(np.sqrt(square.mean(axis=-1)))


def steady_state_rms(
    time_s: ArrayLike, pixel_error: ArrayLike, missing_px: float, window_s: float = STEADY_S
) -> FloatArray:
    """The root mean square of the error over a trial's end.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: value in place of an error that is nan, px.
        window_s: length of the window at the end, s.

    Returns:
        (...) px.
    """
    time = np.asarray(time_s)
    norm = binocular_rms_error(np.asarray(pixel_error)[time > time[-1] - window_s], missing_px)
    return np.asarray(np.sqrt(np.mean(norm**2, axis=0)))


def tracking_rms(
    time_s: ArrayLike, pixel_error: ArrayLike, missing_px: float, after_s: ArrayLike
) -> FloatArray:
    """The root mean square of the error after the time allowed for catching up.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) px.
        missing_px: value in place of an error that is nan, px.
        after_s: (...) or a scalar, start of the evaluated part, s.

    Returns:
        (...) px; nan for trials that are over by then.
    """
    square = binocular_rms_error(pixel_error, missing_px) ** 2
    counts = mask_from_time(time_s, after_s, square.shape[1:])
    with np.errstate(invalid="ignore"):
        mean = np.sum(square, axis=0, where=counts) / counts.sum(axis=0)
    return np.asarray(np.sqrt(mean))


def tracking_lag(
    time_s: ArrayLike,
    pixel_error: ArrayLike,
    image_velocity: ArrayLike,
    after_s: ArrayLike,
) -> FloatArray:
    """The time by which the eyes trail a moving target.

    Eyes that follow the target's path L seconds late have the error L v, v being the target's image
    velocity in an eye that does not move. L is fitted by least squares over both eyes and the time
    from `after_s` on.

    Args:
        time_s: (steps,) s.
        pixel_error: (steps, ..., 2, 2) px.
        image_velocity: (steps, ..., 2, 2) the target's image velocity in eyes at rest, px/s.
        after_s: (...) or a scalar, start of the evaluated part, s.

    Returns:
        (...) seconds, negative for eyes that lead; nan if nothing moves.
    """
    error, velocity = np.asarray(pixel_error), np.asarray(image_velocity)
    counts = mask_from_time(time_s, after_s, error.shape[1:-2])[..., None, None]
    known = np.isfinite(error) & np.isfinite(velocity) & counts
    axes = (0, -2, -1)
    along = np.sum(error * velocity, axis=axes, where=known)
    square = np.sum(velocity**2, axis=axes, where=known)
    return np.asarray(along / np.where(square > 0.0, square, np.nan))


def mask_from_time(
    time_s: ArrayLike, after_s: ArrayLike, trials_shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Mask the steps at or after a given time of each trial.

    Args:
        time_s: (steps,) s.
        after_s: (...) or a scalar, s.
        trials_shape: the shape `...`.

    Returns:
        (steps, ...) True from that time on.
    """
    time = np.reshape(np.asarray(time_s), (-1, *(1,) * len(trials_shape)))
    return np.asarray(time >= np.broadcast_to(after_s, trials_shape) - _TIME_TOLERANCE_S)


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


def value_at_time(time_s: ArrayLike, values: ArrayLike, when_s: ArrayLike) -> FloatArray:
    """Sample each trial's trajectory at a time of its own.

    Args:
        time_s: (steps,) s, increasing.
        values: (steps, n) one column per trial.
        when_s: (n,) times among `time_s`, s; nan for never.

    Returns:
        (n,) the values; nan where the time is nan.
    """
    time, when = np.asarray(time_s), np.asarray(when_s)
    known: NDArray[np.bool_] = np.isfinite(when)
    step = np.argmin(np.abs(time[:, None] - np.where(known, when, time[0])), axis=0)
    return np.where(known, np.asarray(values)[step, np.arange(len(when))], np.nan)
