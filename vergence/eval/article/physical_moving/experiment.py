"""The physical twin on a moving target (Figs. 12 and 13): many heads, one of them with images."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.envs.streams import IntArray
from vergence.envs.targets.prescribed import LineTarget
from vergence.eval.article.common.closed_loop import ClosedLoop, GazeRecord, hold_gaze
from vergence.eval.article.experiment import Experiment
from vergence.eval.article.physical_moving.figures import draw
from vergence.eval.article.physical_moving.findings import conclude, summarise
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.eval.article.twin.population import draw_population
from vergence.eval.article.twin.statistics import AXES, METHODS
from vergence.eval.jobs import Job, Mapper
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

MM: Final = 1000.0
_IMAGED_TRIAL: Final = 1_000_000
_CHUNK: Final = 25
"""Heads of a job: the same whoever runs it."""


@dataclass(frozen=True, kw_only=True)
class PhysicalMovingConfig(TwinConfig):
    """What the moving experiment on the physical twin is."""

    origin_mm: tuple[float, float, float] = (-278.60, -23.13, 957.84)
    """Where the recorded part of the line begins, in N, mm."""
    end_mm: tuple[float, float, float] = (-390.02, -30.39, 1111.91)
    """Where it ends, mm."""
    speed_m_s: float = 0.01
    """How fast the target moves, m/s."""
    settle_s: float = 2.0
    """For how long it moves along the same line before the record begins, s."""
    every: int = 1
    """Control periods from fix to fix of the record."""
    table_every: int = 20
    """Fixes from row to row of the trajectories in the table."""


def run(config: PhysicalMovingConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Follow the line with the population and with the head that sees images.

    Args:
        config: what to run.
        seed: seed of the heads and of all noise.
        mapper: runs the jobs.

    Returns:
        `case` is `twin` (one row), `head` (a row a head and method: mean absolute errors over the
        line), `time` (a row an instant and method: the head with images), `band` (a row an
        instant, method and axis: percentiles of the population).
    """
    drawn = draw_population(config, seed, mapper)
    heads, imaged = drawn.heads, drawn.imaged
    noise = drawn.noise_at(0.5 * (config.origin_mm[2] + config.end_mm[2]) / MM)
    loop = _loop(drawn.nominal, config, seed)
    jobs: list[Job] = [
        partial(
            _follow, loop, heads[first : first + _CHUNK], first,
            {"detection_noise_px": noise}, "kinematic",
        )
        for first in range(0, config.heads, _CHUNK)
    ]  # fmt: skip
    halved = dataclasses.replace(config, common_tilt_deg=0.5 * config.common_tilt_deg)
    upright = draw_heads(drawn.nominal, halved, seed, drawn.scale)
    jobs += [
        partial(
            _follow, loop, upright[first : first + _CHUNK], first,
            {"detection_noise_px": noise}, "kinematic",
        )
        for first in range(0, config.heads, _CHUNK)
    ]  # fmt: skip
    jobs.append(partial(_follow, loop, heads[imaged : imaged + 1], _IMAGED_TRIAL, {}, "rendered"))
    *parts, seen = mapper(jobs)
    half = len(parts) // 2
    population = _Errors.joined(parts[:half])
    kept = slice(None, None, config.table_every)
    frames: list[pd.DataFrame] = [
        drawn.frame(),
        _head_rows("population", population, np.arange(config.heads)),
        _head_rows("half tilt", _Errors.joined(parts[half:]), np.arange(config.heads)),
        _head_rows("imaged", seen, np.array([imaged])),
        _time_rows(seen, kept),
        _band_rows(population, kept),
    ]
    return pd.concat(frames, ignore_index=True)


@dataclass(frozen=True)
class _Errors:
    """What a record of a moving target is kept for."""

    time_s: FloatArray
    """(samples,)."""
    target: FloatArray
    """(samples, 3) the target at present, mm."""
    errors: dict[str, FloatArray]
    """(samples, heads, 3) by method, mm."""

    @classmethod
    def of(cls, record: GazeRecord, settle_s: float) -> "_Errors":
        return cls(
            record.time_s[:, 0] - settle_s,
            MM * record.target[:, 0],
            {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm},
        )

    @classmethod
    def joined(cls, parts: "list[_Errors]") -> "_Errors":
        errors = {m: np.concatenate([p.errors[m] for p in parts], axis=1) for m in METHODS}
        return cls(parts[0].time_s, parts[0].target, errors)


def _loop(nominal: HeadModel, config: PhysicalMovingConfig, seed: int) -> ClosedLoop:
    """The line, begun early enough for the eyes to follow it when the record begins."""
    origin, end = np.array(config.origin_mm) / MM, np.array(config.end_mm) / MM
    length = float(np.linalg.norm(end - origin))
    early = origin - (end - origin) / length * config.speed_m_s * config.settle_s
    target = LineTarget(
        origin=tuple(early.tolist()), end=tuple(end.tolist()), speed=config.speed_m_s
    )
    periods = int(length / config.speed_m_s * nominal.timing.control_rate_hz)
    return ClosedLoop(
        head=nominal,
        target=target,
        samples=1 + periods // config.every,
        every=config.every,
        settle_s=config.settle_s,
        seed=seed,
    )


def _follow(
    loop: ClosedLoop, heads: HeadModel, trial: int, options: dict[str, Any], plant: str
) -> _Errors:
    """Some heads along the line."""
    record = hold_gaze(
        dataclasses.replace(
            loop, true_head=heads, num=heads.batch_shape[0], trial=trial, plant=plant,
            plant_options=options,
        )
    )  # fmt: skip
    return _Errors.of(record, loop.settle_s)


def _head_rows(group: str, errors: _Errors, heads: IntArray) -> pd.DataFrame:
    frames = []
    for method in METHODS:
        error = errors.errors[method]
        columns: dict[str, Any] = {
            "case": "head", "group": group, "head": heads, "method": method
        }  # fmt: skip
        for k, axis in enumerate(AXES):
            columns[f"mean_abs_{axis}_mm"] = np.nanmean(np.abs(error[..., k]), axis=0)
            columns[f"mean_{axis}_mm"] = np.nanmean(error[..., k], axis=0)
            columns[f"std_{axis}_mm"] = np.nanstd(error[..., k], axis=0, ddof=1)
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames)


def _time_rows(seen: _Errors, kept: slice) -> pd.DataFrame:
    frames = []
    for method in METHODS:
        columns: dict[str, Any] = {
            "case": "time", "group": "imaged", "method": method, "time_s": seen.time_s[kept]
        }  # fmt: skip
        for k, axis in enumerate(AXES):
            columns[f"truth_{axis}_mm"] = seen.target[kept, k]
            columns[f"error_{axis}_mm"] = seen.errors[method][kept, 0, k]
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames)


def _band_rows(population: _Errors, kept: slice) -> pd.DataFrame:
    frames = []
    for method in METHODS:
        for k, axis in enumerate(AXES):
            error = np.abs(population.errors[method][kept, :, k])
            low, median, high = np.percentile(error, [10.0, 50.0, 90.0], axis=1)
            frames.append(
                pd.DataFrame(
                    {
                        "case": "band",
                        "group": "population",
                        "method": method,
                        "axis": axis,
                        "time_s": population.time_s[kept],
                        "low_mm": low,
                        "median_mm": median,
                        "high_mm": high,
                    }
                )
            )
    return pd.concat(frames)


EXPERIMENT = Experiment(
    name="physical-moving",
    title="Physical twin, moving target",
    article="Section 5.1.2, Figures 12 and 13",
    what=(
        "An AprilTag moves along the article's line at 0.01 m/s and both eyes follow it. The "
        "population of heads is that of the static targets, with the same scalar; the head that "
        "is most like the article's there follows the tag on drawn images. The eyes are on the "
        "target when the record begins. Gaze is judged by where the target is at present, ITPC "
        "by where it was when its image was exposed."
    ),
    config=PhysicalMovingConfig,
    quick={
        "heads": 40,
        "every": 4,
        "table_every": 10,
        "speed_m_s": 0.03,
        "noise_poses": 2,
        "noise_frames": 10,
    },
    run=run,
    summarise=summarise,
    draw=draw,
    conclude=conclude,
)
