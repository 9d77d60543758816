"""Trials over time: errors, triangulation errors, and the effective gain of a controller.

The effective gain of an eye is the k that fits its commanded joint velocities best, by least
squares, to k times those of the fixed-gain law with gain 1 (1/s) for the same observation. For the
fixed-gain law it is that law's gain. Heads with coupled joints have one gain for both eyes, from
the actuators' velocities.

Times count from each trial's onset, as settle times do.
"""

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vergence.controllers.controller import Controller
from vergence.controllers.ibvs import IBVS
from vergence.envs.observation import ObservationLayout
from vergence.eval.trials.run import Trials
from vergence.models.parts import FloatArray

ERROR_BINS_PX: Final = np.geomspace(1.0, 512.0, 19)
"""Edges of the bins of image error for effective gains, px (chosen: half an octave each)."""
LEAST_ERROR_PX: Final = 1.0
"""Least image error for an effective gain, px; below it the law's direction is mostly noise
(chosen)."""
_PERIOD_TOLERANCE: Final = 1e-6
"""Tolerance, in control periods, within which an onset falls on a step (numerical)."""
_LEAST_BIN_SAMPLES: Final = 30
"""Least number of samples in a bin; bins with fewer are left out (chosen)."""


def error_quantile_table(trials: Trials) -> pd.DataFrame:
    """Percentiles over the trials of the worse eye's error and of the gaze fix's error.

    For targets at rest, the residual (the least error that the head can reach) is subtracted.

    Args:
        trials: the trials.

    Returns:
        One row per control period, from each trial's first period at or after its onset to the
        last period that all trials have: `time_s`; `error_p05_px`, `error_p50_px`,
        `error_p95_px`; likewise for `fix_error`, in m. A missing error counts as the image's
        diagonal, a missing fix as infinite, or as nan if the true position is unknown.
    """
    norm = np.linalg.norm(trials.reducible_error, axis=-1).max(axis=-1)
    norm = np.where(np.isnan(norm), trials.missing_px, norm)
    steps = _steps_since_onset(trials)
    columns = {"time_s": trials.time_s[: len(steps)]}
    columns |= _quantiles("error", "px", np.take_along_axis(norm, steps, axis=0))
    fix = trials.fix_error_m
    fix = np.where(np.isnan(fix) & np.isfinite(trials.target[..., 0]), np.inf, fix)
    columns |= _quantiles("fix_error", "m", np.take_along_axis(fix, steps, axis=0))
    return pd.DataFrame(columns)


def _steps_since_onset(trials: Trials) -> NDArray[np.intp]:
    """(periods, n) indices of each trial's steps since its onset, cut to the shortest trial."""
    period_s = trials.head.timing.period_s
    first = np.ceil(trials.onset_s / period_s - _PERIOD_TOLERANCE).astype(np.intp)
    left = len(trials.time_s) - first.max()
    return np.asarray(first + np.arange(left)[:, None])


def _quantiles(name: str, unit: str, values: FloatArray) -> dict[str, FloatArray]:
    levels = (5, 50, 95)
    found = np.percentile(values, levels, axis=-1, method="higher")
    return {f"{name}_p{level:02d}_{unit}": row for level, row in zip(levels, found, strict=True)}


def effective_gain_table(trials: Trials, layout: ObservationLayout) -> pd.DataFrame:
    """Effective gains, binned by image error and by time, of trials with kept observations.

    Args:
        trials: the trials.
        layout: layout of the observations.

    Returns:
        One row per bin: `by` (`error` in px, or `time` since the onset in s), `at` (its middle),
        `gain_p25`, `gain_p50`, `gain_p75` (1/s), `samples`.
    """
    seen = layout.decode(trials.observation)
    law = IBVS(head=trials.head, layout=layout, gain=1.0)
    unit = law.command(seen.positions_at_exposure, seen.pixel_error)
    command = trials.command[:, : unit.shape[1]]
    error = np.linalg.norm(seen.pixel_error, axis=-1)
    if trials.head.actuation.direct:
        groups = (*unit.shape[:2], 2, 2)
    else:
        groups = (*unit.shape[:2], 1, 4)
        error = error.max(axis=-1, keepdims=True)
    unit, command = unit.reshape(groups), command.reshape(groups)
    square = np.sum(unit**2, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.sum(unit * command, axis=-1) / square
        known = (error >= LEAST_ERROR_PX) & (square > 0.0)
    since_s = trials.time_s[:-1, None] - trials.onset_s[: gain.shape[1]]
    when = np.broadcast_to(since_s[..., None], gain.shape)
    time_bins = np.arange(0.0, trials.duration_s + 1e-9, 4.0 * layout.period_s)
    rows = _binned("error", error[known], gain[known], ERROR_BINS_PX)
    rows += _binned("time", when[known], gain[known], time_bins)
    columns = ("by", "at", "gain_p25", "gain_p50", "gain_p75", "samples")
    return pd.DataFrame(rows, columns=list(columns))


def _binned(
    by: str, x: FloatArray, gain: FloatArray, edges: FloatArray
) -> list[tuple[str | float, ...]]:
    place = np.digitize(x, edges) - 1
    rows: list[tuple[str | float, ...]] = []
    for i, (low, high) in enumerate(pairwise(edges)):
        own = gain[place == i]
        if len(own) < _LEAST_BIN_SAMPLES:
            continue
        middle = np.sqrt(low * high) if by == "error" else 0.5 * (low + high)
        rows.append((by, float(middle), *np.percentile(own, (25, 50, 75)).tolist(), len(own)))
    return rows


def single_predict_us(
    controller: Controller,
    observation: NDArray[np.float32],
    calls: int = 300,
    clock_ns: Callable[[], int] = time.perf_counter_ns,
) -> float:
    """Median duration of `predict` for a single head.

    Args:
        controller: the controller.
        observation: (steps, m, size) observations of m trials, of which the first is used.
        calls: number of calls to time.
        clock_ns: a clock in nanoseconds.

    Returns:
        Microseconds, the median over calls.
    """
    spent = []
    state, start = None, np.ones(1, dtype=np.bool_)
    for call in range(calls):
        step = call % len(observation)
        start[:] = step == 0
        seen = observation[step, :1]
        begun = clock_ns()
        _, state = controller.predict(seen, state=state, episode_start=start, deterministic=True)
        spent.append(clock_ns() - begun)
    return float(np.median(spent)) / 1e3
