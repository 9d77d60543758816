"""Trials of a target on a line before the physical twin: a population, and one head with images."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.envs.streams import IntArray
from vergence.envs.targets.prescribed import LineTarget
from vergence.eval.article.common.closed_loop import MM, ClosedLoop, hold_gaze
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.eval.article.twin.population import TwinPopulation, draw_population
from vergence.eval.article.twin.statistics import AXES, METHODS, axis_columns
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import Job, Mapper

_IMAGED_TRIAL: Final = 1_000_000
"""Trial number of the head with images, beyond those of the population (numerical)."""
_CHUNK: Final = 25
"""Heads per job, fixed so that results do not depend on the number of workers (numerical)."""


@dataclass(frozen=True, kw_only=True)
class PhysicalMovingConfig(TwinConfig):
    """Configuration of the moving target on the physical twin."""

    origin_mm: tuple[float, float, float] = (-278.60, -23.13, 957.84)
    """Start of the recorded part of the line, in N, mm."""
    end_mm: tuple[float, float, float] = (-390.02, -30.39, 1111.91)
    """End of the line, in N, mm."""
    speed_m_s: float = 0.01
    """Speed of the target, m/s."""
    settle_s: float = 2.0
    """Time for which the target moves along the same line before the record begins, s."""
    every: int = 1
    """Control periods between fixes of the record."""
    table_every: int = 20
    """Fixes between rows of the trajectories in the table."""

    @property
    def velocity_mm_s(self) -> FloatArray:
        """(3,) velocity of the target, in N, mm/s."""
        way = np.array(self.end_mm) - np.array(self.origin_mm)
        return np.asarray(way * (MM * self.speed_m_s / np.linalg.norm(way)))

    @property
    def middle_mm(self) -> FloatArray:
        """(3,) midpoint of the recorded part of the line, in N, mm."""
        return np.asarray(0.5 * (np.array(self.origin_mm) + np.array(self.end_mm)))


class _Errors(NamedTuple):
    """Errors of the fixes on a moving target."""

    time_s: FloatArray
    """(samples,) time since the record began, s."""
    target: FloatArray
    """(samples, 3) target position at present, in N, mm."""
    errors: dict[str, FloatArray]
    """(samples, heads, 3) errors by method, mm."""


def run(config: PhysicalMovingConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Follow the line with the population, with half its common tilt, and with one head on images.

    Args:
        config: the configuration.
        seed: seed of the heads and of all noise.
        mapper: runs the jobs.

    Returns:
        A table with the column `case`: `twin` (one row), `head` (a row per head and method: mean
        absolute errors over the line), `time` (a row per instant and method: the head with images),
        `band` (a row per instant, method and axis: percentiles of the population).
    """
    drawn = draw_population(config, seed, mapper)
    loop = _loop(drawn, config, seed)
    errors = config.errors.scaled(drawn.scale)
    halved = dataclasses.replace(errors, common_tilt_rad=0.5 * errors.common_tilt_rad)
    heads = {
        "population": drawn.heads,
        "half tilt": draw_heads(drawn.nominal, halved, config.heads, seed),
    }
    firsts = range(0, config.heads, _CHUNK)
    jobs: list[Job] = [
        partial(_follow, loop, group[first : first + _CHUNK], first)
        for group in heads.values()
        for first in firsts
    ]
    seeing = dataclasses.replace(loop, plant="rendered", plant_options={})
    imaged = drawn.heads[drawn.imaged_head : drawn.imaged_head + 1]
    jobs.append(partial(_follow, seeing, imaged, _IMAGED_TRIAL))
    *parts, seen = mapper(jobs)
    population, half_tilt = _joined(parts[: len(firsts)]), _joined(parts[len(firsts) :])
    kept = slice(None, None, config.table_every)
    frames: list[pd.DataFrame] = [
        drawn.table_row(),
        _head_rows("population", population, np.arange(config.heads)),
        _head_rows("half tilt", half_tilt, np.arange(config.heads)),
        _head_rows("imaged", seen, np.array([drawn.imaged_head])),
        _time_rows(seen, kept),
        _band_rows(population, kept),
    ]
    return pd.concat(frames, ignore_index=True)


def _loop(drawn: TwinPopulation, config: PhysicalMovingConfig, seed: int) -> ClosedLoop:
    """Closed loop on the line, begun early so that the eyes follow when the record begins."""
    origin, end = np.array(config.origin_mm) / MM, np.array(config.end_mm) / MM
    length = float(np.linalg.norm(end - origin))
    early = origin - (end - origin) / length * config.speed_m_s * config.settle_s
    target = LineTarget(
        origin=tuple(early.tolist()), end=tuple(end.tolist()), speed=config.speed_m_s
    )
    periods = int(length / config.speed_m_s * drawn.nominal.timing.control_rate_hz)
    depth_m = 0.5 * (config.origin_mm[2] + config.end_mm[2]) / MM
    return ClosedLoop(
        head=drawn.nominal,
        target=target,
        samples=1 + periods // config.every,
        every=config.every,
        settle_s=config.settle_s,
        plant="kinematic",
        plant_options={"detection_noise_px": drawn.noise_at(depth_m)},
        seed=seed,
    )


def _follow(loop: ClosedLoop, heads: HeadModel, trial: int) -> _Errors:
    """Run some heads along the line."""
    record = hold_gaze(
        dataclasses.replace(loop, true_head=heads, num=heads.batch_shape[0], trial=trial)
    )
    return _Errors(
        record.time_s[:, 0] - loop.settle_s,
        MM * record.target[:, 0],
        {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm},
    )


def _joined(parts: list[_Errors]) -> _Errors:
    """Join the heads of several jobs."""
    errors = {m: np.concatenate([part.errors[m] for part in parts], axis=1) for m in METHODS}
    return parts[0]._replace(errors=errors)


def _head_rows(group: str, seen: _Errors, heads: IntArray) -> pd.DataFrame:
    frames = []
    for method, error in seen.errors.items():
        by_axis = np.moveaxis(error, -1, 0)
        columns = axis_columns(
            mean_abs=[np.nanmean(np.abs(own), axis=0) for own in by_axis],
            mean=[np.nanmean(own, axis=0) for own in by_axis],
            std=[np.nanstd(own, axis=0, ddof=1) for own in by_axis],
        )
        frames.append(
            pd.DataFrame(
                {"case": "head", "group": group, "head": heads, "method": method, **columns}
            )
        )
    return pd.concat(frames)


def _time_rows(seen: _Errors, kept: slice) -> pd.DataFrame:
    frames: list[pd.DataFrame] = [
        pd.DataFrame(
            {
                "case": "time",
                "group": "imaged",
                "method": method,
                "time_s": seen.time_s[kept],
                **axis_columns(truth=seen.target[kept].T, error=error[kept, 0].T),
            }
        )
        for method, error in seen.errors.items()
    ]
    return pd.concat(frames)


def _band_rows(population: _Errors, kept: slice) -> pd.DataFrame:
    frames = []
    for method, error in population.errors.items():
        for k, axis in enumerate(AXES):
            low, median, high = np.percentile(np.abs(error[kept, :, k]), [10.0, 50.0, 90.0], axis=1)
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
