"""Trials of the physical time response, from the article's initial pixels."""

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd
from scipy.optimize import root

from vergence.envs.targets.prescribed import StaticTarget
from vergence.errors import ConfigurationError
from vergence.eval.article.common.joint_offsets import with_joint_offsets
from vergence.eval.article.common.servoing import servo_pixel_errors
from vergence.eval.trials.metrics import settle_time
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, LINKS, FloatArray
from vergence.reporting.jobs import Job, Mapper

ARTICLE_S: Final = 0.65
"""Settling time of a gaze shift, s (physical: reported by the article)."""
_EYE_FRAMES: Final = [3, 4, 6, 7]
"""Rows of `LINKS` with the eyes' joints, in joint order (numerical)."""


@dataclass(frozen=True, kw_only=True)
class TimeResponseConfig:
    """Configuration of the time response."""

    head: str = "physical"
    """Head, one of the article's: simulated or physical."""
    point_mm: tuple[float, float, float] = (0.0, -145.0, 1500.0)
    """Target position, in N, mm."""
    left_px: tuple[float, float] = (385.98, 196.60)
    """Initial pixel of the target in the left eye, px."""
    right_px: tuple[float, float] = (361.09, 191.82)
    """Initial pixel of the target in the right eye, px."""
    gain: float = 4.0
    """Gain k1 = k2, 1/s."""
    delays_frames: tuple[int, ...] = tuple(range(13))
    """Image delays of the map, control periods."""
    least_threshold_px: float = 0.25
    """Smallest settling threshold of the map, px."""
    greatest_threshold_px: float = 5.0
    """Largest settling threshold of the map, px."""
    threshold_step_px: float = 0.05
    """Increment of the threshold, px."""
    trials: int = 200
    """Number of trials with the preset's own delay, lag and noise."""
    duration_s: float = 3.0
    """Duration of a trial, s."""


def run(config: TimeResponseConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run all trials.

    Args:
        config: the configuration.
        seed: seed of the detection noise.
        mapper: runs the jobs.

    Returns:
        A table with the column `case`: `offset` (a joint offset that explains the initial pixels),
        `initial` (a pixel coordinate by the article and by the nominal head), `map` (settling time
        for a delay, lag and threshold, without noise), `by` (least threshold within which the error
        stays from the article's time on), `rig` (a noisy trial of the preset's own loop) and
        `trace` (error of one such trial over time).
    """
    head = load_head(config.head)
    offsets = joint_offsets(head, config)
    lags = tuple(dict.fromkeys((head.timing.lag_s, 0.0)))
    jobs: list[Job] = [
        partial(_map_delay, config, offsets, delay, lag)
        for lag in lags
        for delay in config.delays_frames
    ]
    jobs.append(partial(_rig, config, offsets, seed))
    parts = [_start(head, config, offsets), *mapper(jobs)]
    table: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return table


def joint_offsets(head: HeadModel, config: TimeResponseConfig) -> tuple[float, ...]:
    """Eye joint offsets with which the target appears at the article's initial pixels.

    Four pixel coordinates determine four offsets. Other model errors could explain the pixels too.

    Args:
        head: the nominal head, whose joints are assumed to be at rest.
        config: the target and the pixels.

    Returns:
        Left tilt and pan, right tilt and pan, rad.

    Raises:
        ConfigurationError: no offsets make the target appear there.
    """
    point = np.array(config.point_mm) / 1000.0
    wanted = np.array([config.left_px, config.right_px])

    def miss(offsets: FloatArray) -> FloatArray:
        q = head.rest()
        q[EYES] += offsets
        return np.ravel(head.project(q, point) - wanted)

    found = root(miss, np.zeros(4), tol=1e-12)
    if not np.abs(miss(found.x)).max() < 1e-6:
        raise ConfigurationError(
            f"time-response: expected pixels at which the eyes can see {config.point_mm} mm, "
            f"got {config.left_px} and {config.right_px}"
        )
    return tuple(float(offset) for offset in found.x)


def _with_offsets(head: HeadModel, offsets: tuple[float, ...]) -> HeadModel:
    more = np.zeros(len(LINKS))
    more[_EYE_FRAMES] = offsets
    return with_joint_offsets(head, more)


def _start(head: HeadModel, config: TimeResponseConfig, offsets: tuple[float, ...]) -> pd.DataFrame:
    """Table rows with the offsets, and with the initial pixels beside those of the nominal head."""
    joints = pd.DataFrame(
        {"case": "offset", "joint": JOINTS[EYES], "offset_deg": np.rad2deg(offsets)}
    )
    nominal = head.project(head.rest(), np.array(config.point_mm) / 1000.0)
    pixels = pd.DataFrame(
        {
            "case": "initial",
            "eye": np.repeat(EYE_NAMES, 2),
            "axis": ["u", "v"] * 2,
            "article_px": [*config.left_px, *config.right_px],
            "nominal_px": nominal.ravel(),
            "principal_px": head.cameras.principal.ravel(),
        }
    )
    return pd.concat([joints, pixels], ignore_index=True)


def _servo(
    config: TimeResponseConfig,
    head: HeadModel,
    offsets: tuple[float, ...],
    seed: int,
    num: int,
    noise_px: float,
) -> tuple[FloatArray, FloatArray]:
    x, y, z = (value / 1000.0 for value in config.point_mm)
    return servo_pixel_errors(
        head,
        StaticTarget(point=(x, y, z)),
        np.full((num, 2), config.gain),
        duration_s=config.duration_s,
        seed=seed,
        plant_options={
            "true_head": _with_offsets(head, offsets),
            "detection_noise_px": noise_px,
        },
    )


def _map_delay(
    config: TimeResponseConfig, offsets: tuple[float, ...], delay_frames: int, lag_s: float
) -> pd.DataFrame:
    """Settling times of one loop, and its least threshold that holds from the article's time on."""
    preset = load_head(config.head)
    latency_s = delay_frames / preset.timing.control_rate_hz
    head = preset.replace(timing={"latency_s": latency_s, "lag_s": lag_s})
    time, error = _servo(config, head, offsets, 0, 1, 0.0)
    low, step = config.least_threshold_px, config.threshold_step_px
    count = round((config.greatest_threshold_px - low) / step) + 1
    thresholds = np.round(low + step * np.arange(count), 9)
    settled = [float(settle_time(time, error, band)[0]) for band in thresholds]
    loop = {"delay_frames": delay_frames, "lag_s": lag_s}
    mapped = pd.DataFrame({"case": "map", **loop, "threshold_px": thresholds, "settle_s": settled})
    norm = np.linalg.norm(error[:, 0], axis=-1).max(axis=-1)
    # tolerance, as the article's time is a whole number of periods only up to rounding
    held = norm[time >= ARTICLE_S - 1e-9].max()
    by = pd.DataFrame([{"case": "by", **loop, "threshold_px": float(held), "settle_s": ARTICLE_S}])
    return pd.concat([mapped, by], ignore_index=True)


def _rig(config: TimeResponseConfig, offsets: tuple[float, ...], seed: int) -> pd.DataFrame:
    """Run noisy trials of the preset's own loop, and keep the error of the first over time."""
    head = load_head(config.head)
    timing = head.timing
    noise_px = head.sensor.detection_noise_px
    time, error = _servo(config, head, offsets, seed, config.trials, noise_px)
    loop = {"delay_frames": timing.latency_frames, "lag_s": timing.lag_s}
    parts = [
        pd.DataFrame(
            {
                "case": "rig",
                **loop,
                "threshold_px": band,
                "trial": np.arange(config.trials),
                "settle_s": settle_time(time, error, band),
            }
        )
        for band in (1.0, 0.5)
    ]
    for eye, name in enumerate(EYE_NAMES):
        norm = np.linalg.norm(error[:, 0, eye], axis=-1)
        course = {"case": "trace", **loop, "trial": 0, "eye": name, "time_s": time}
        parts.append(pd.DataFrame({**course, "error_px": norm}))
    return pd.concat(parts, ignore_index=True)
