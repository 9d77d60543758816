"""The trials of the gain sweep: steps at many gains, and loops with other delays and lags."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from vergence.envs.targets.prescribed import StepTarget
from vergence.eval.article.common.servoing import servo_pixel_errors
from vergence.eval.trials.metrics import overshoot_fraction, settle_time
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import Job, Mapper

STEPS: Final = {"+y": (0.0, 1.0), "-y": (0.0, -1.0), "+x": (1.0, 0.0), "-x": (-1.0, 0.0)}
"""Directions of the step, in N; y is down."""
PLANE_STEPS: Final = {"+y": (0.0, 1.0), "+x+y": (1.0, 1.0)}
"""Steps on which k1 and k2 are varied independently."""
_TRIALS: Final = 10_000
"""Trial numbers reserved per job, so that jobs share no noise (numerical)."""


@dataclass(frozen=True, kw_only=True)
class GainSweepConfig:
    """Configuration of the gain sweep."""

    head: str = "simulated"
    """Head, one of the article's: simulated or physical."""
    point_mm: tuple[float, float, float] = (0.0, -100.0, 1000.0)
    """Position of the target before the step, in N, mm."""
    step_mm: float = 100.0
    """Length of the target's jump along an axis, mm."""
    least_gain: float = 0.5
    """Smallest gain of the sweep with k1 = k2, 1/s."""
    greatest_gain: float = 6.0
    """Largest gain of the sweep, 1/s."""
    gain_step: float = 0.05
    """Increment of the gain, 1/s."""
    plane_step: float = 0.25
    """Increment of the gains for the plane of k1 and k2, 1/s."""
    mujoco_gains: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    """Gains at which the sweep also runs on the mujoco plant, 1/s."""
    duration_s: float = 12.0
    """Duration of a trial, s; the smallest gain needs 10 s to settle to 0.5 px."""
    onset_fraction: float = 0.005
    """Overshoot, as a fraction of the step, from which it counts as begun."""
    onset_gains: tuple[float, float] = (4.0, 4.2)
    """Gains between which the article's overshoot is assumed to begin, 1/s."""
    delays_frames: tuple[int, ...] = tuple(range(14))
    """Image delays tried to identify the loop, control periods."""
    lag_step_s: float = 0.002
    """Increment of the lags tried to identify the loop, s."""
    greatest_lag_s: float = 0.1
    """Longest lag tried to identify the loop, s."""


def run(config: GainSweepConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run all trials.

    Args:
        config: the configuration.
        seed: seed of the detection noise.
        mapper: runs the jobs.

    Returns:
        A row per trial. `case` is `sweep` (k1 = k2), `plane` (k1 and k2 independent) or `loop`
        (without noise, at other delays and lags); `overshoot` is a fraction of the step.
    """
    gains = _grid(config.least_gain, config.greatest_gain, config.gain_step)
    plane = _grid(config.least_gain, config.greatest_gain, config.plane_step)
    pairs = [(k1, k2) for k1 in plane for k2 in plane]
    both = [(k, k) for k in gains]
    few = [(k, k) for k in config.mujoco_gains]
    cases = [("sweep", "kinematic", step, both) for step in STEPS]
    cases += [("plane", "kinematic", step, pairs) for step in PLANE_STEPS]
    cases += [("sweep", "mujoco", step, few) for step in STEPS]
    jobs: list[Job] = [
        partial(_steps, config, seed, index * _TRIALS, *case) for index, case in enumerate(cases)
    ]
    jobs += [partial(_loops, config, delay) for delay in config.delays_frames]
    table: pd.DataFrame = pd.concat(mapper(jobs), ignore_index=True)
    return table


def _grid(least: float, greatest: float, step: float) -> list[float]:
    return [round(least + i * step, 9) for i in range(round((greatest - least) / step) + 1)]


def _steps(
    config: GainSweepConfig,
    seed: int,
    first_trial: int,
    case: str,
    plant: str,
    step: str,
    gains: Sequence[tuple[float, float]],
) -> pd.DataFrame:
    """Run trials of one step with the preset's own delay and lag."""
    head = load_head(config.head)
    options = {"nthread": 1} if plant == "mujoco" else {}
    time, error = servo_pixel_errors(
        head,
        _target(config, step),
        gains,
        duration_s=config.duration_s,
        seed=seed,
        first_trial=first_trial,
        plant=plant,
        plant_options=options,
    )
    timing = head.timing
    return _rows(case, plant, step, gains, timing.latency_frames, timing.lag_s, time, error)


def _loops(config: GainSweepConfig, delay_frames: int) -> pd.DataFrame:
    """Run trials with one image delay and many lags, at the config's onset gains."""
    lags = _grid(0.0, config.greatest_lag_s, config.lag_step_s)
    cases = [(gain, lag) for gain in config.onset_gains for lag in lags]
    gains = [(gain, gain) for gain, _ in cases]
    lag_s = np.array([lag for _, lag in cases])
    preset = load_head(config.head)
    latency_s = delay_frames / preset.timing.control_rate_hz
    head: HeadModel = preset.replace(timing={"latency_s": latency_s})
    time, error = servo_pixel_errors(
        head,
        _target(config, "-y"),
        gains,
        duration_s=min(config.duration_s, 3.0),
        seed=0,
        plant_options={"lag_s": lag_s, "detection_noise_px": 0.0},
    )
    return _rows("loop", "kinematic", "-y", gains, delay_frames, lag_s, time, error)


def _target(config: GainSweepConfig, step: str) -> StepTarget:
    dx, dy = {**STEPS, **PLANE_STEPS}[step]
    x, y, z = config.point_mm
    after = (x + config.step_mm * dx, y + config.step_mm * dy, z)
    return StepTarget(before=_metres(x, y, z), after=_metres(*after))


def _metres(x: float, y: float, z: float) -> tuple[float, float, float]:
    return (x / 1000.0, y / 1000.0, z / 1000.0)


def _rows(
    case: str,
    plant: str,
    step: str,
    gains: Sequence[tuple[float, float]],
    delay_frames: int,
    lag_s: float | FloatArray,
    time: FloatArray,
    error: FloatArray,
) -> pd.DataFrame:
    k1, k2 = np.array(gains).T
    return pd.DataFrame(
        {
            "case": case,
            "plant": plant,
            "step": step,
            "k1_per_s": k1,
            "k2_per_s": k2,
            "delay_frames": delay_frames,
            "lag_s": lag_s,
            "step_px": np.linalg.norm(error[0], axis=-1).max(axis=-1),
            "settle_1px_s": settle_time(time, error, 1.0),
            "settle_05px_s": settle_time(time, error, 0.5),
            "overshoot": overshoot_fraction(error),
        }
    )
