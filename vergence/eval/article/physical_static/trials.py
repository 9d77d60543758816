"""Trials of targets at rest before the physical twin: a population, and one head with images."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError
from vergence.eval.article.common.closed_loop import (
    MM,
    ClosedLoop,
    GazeRecord,
    detection_sigma,
    gaze_uncertainty_mm,
    hold_gaze,
    itpc_uncertainty_mm,
)
from vergence.eval.article.physical_static.error_budget import (
    ALL,
    BUDGET_SOURCES,
    BudgetCase,
    budget_rows,
    detector_rows,
    off_axis_rows,
)
from vergence.eval.article.twin.heads import TwinConfig
from vergence.eval.article.twin.population import TwinPopulation, draw_population
from vergence.eval.article.twin.statistics import METHODS, axis_columns
from vergence.models.head import HeadModel
from vergence.models.parts import EYES
from vergence.reporting.jobs import Job, Mapper
from vergence.triangulation import triangulate_gaze

ARTICLE_LARGEST_PERCENT: Final = {"gaze": 4.97, "itpc": 6.98}
"""The article's largest depth errors, percent of depth."""


@dataclass(frozen=True, kw_only=True)
class PhysicalStaticConfig(TwinConfig):
    """Configuration of static targets on the physical twin."""

    imaged_every: int = 1
    """Step through Table 5's points for the head with images; the population uses all points."""
    samples: int = 1200
    """Fixes recorded at each point; the article's n."""
    settle_s: float = 2.0
    """Settling time before the first fix, s."""
    offsets_px: tuple[float, ...] = (0.0, 25.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0)
    """Distances from the principal points at which ITPC is evaluated, rising, px."""
    worse_margin: float = 0.05
    """Excess of ITPC's error over that of gaze from which it counts as worse, as a fraction."""

    def __post_init__(self) -> None:
        if max(self.offsets_px) <= 0.0:
            raise ConfigurationError(
                f"offsets_px: expected one beyond the axis at least, got {self.offsets_px}"
            )


def run(config: PhysicalStaticConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run the population, the head with images, the error budget and ITPC off the axis.

    Args:
        config: the configuration.
        seed: seed of the heads and of all noise.
        mapper: runs the jobs.

    Returns:
        A table with the column `case`: `twin` (one row: error scale, index of the head with images,
        effect of one encoder step), `detector` (a row per point), `fixation` (a row per head, point
        and method), `budget` (a row per source and point), `off axis` (a row per source and
        offset).
    """
    drawn = draw_population(config, seed, mapper)
    nominal, points = drawn.nominal, drawn.points
    case = BudgetCase(nominal, config.errors.scaled(drawn.scale), config.heads, points, seed)
    excess = ARTICLE_LARGEST_PERCENT["itpc"] - ARTICLE_LARGEST_PERCENT["gaze"]
    jobs: list[Job] = []
    for source in (ALL, *BUDGET_SOURCES):
        jobs.append(partial(budget_rows, case, source))
        jobs.append(partial(off_axis_rows, case, source, config.offsets_px, excess))
    frames: list[pd.DataFrame] = [
        *mapper(jobs),
        detector_rows(nominal, points, drawn.detector.bias_px, "detector bias"),
        detector_rows(nominal, points, drawn.detector.sigma_px, "one image's noise"),
        drawn.detector.table(points),
        drawn.table_row().assign(**_encoder_step(drawn)),
    ]
    jobs = []
    for i, point in enumerate(points):
        loop = drawn.hold_static_target(
            i + 1, point, samples=config.samples, settle_s=config.settle_s, seed=seed
        )
        jobs.append(partial(_population, loop, i + 1))
        if i % config.imaged_every == 0:
            jobs.append(partial(_imaged, loop, drawn.imaged_head, i + 1))
    frames += mapper(jobs)
    return pd.concat(frames, ignore_index=True)


def _encoder_step(drawn: TwinPopulation) -> dict[str, float]:
    """Depth error of the farthest point from one step of the left pan encoder."""
    nominal, far = drawn.nominal, drawn.points[np.argmax(drawn.points[:, 2])]
    q = nominal.fixate(far, nominal.rest()[:3])
    step = np.zeros(7)
    step[EYES.start + 1] = nominal.sensor.encoder_resolution_rad
    moved = abs(float((triangulate_gaze(nominal, q + step).point - far)[2]))
    return {
        "encoder_step_mm": MM * moved,
        "encoder_step_percent": 100.0 * moved / float(far[2]),
    }


def _population(loop: ClosedLoop, number: int) -> pd.DataFrame:
    """Run all heads at one point, without images."""
    record = hold_gaze(loop)
    which = np.arange(loop.num or 1)
    frames: list[pd.DataFrame] = [
        _rows("population", method, record, which, number) for method in METHODS
    ]
    return pd.concat(frames)


def _imaged(loop: ClosedLoop, which: int, number: int) -> pd.DataFrame:
    """Run one head at one point on rendered images, with the article's propagated uncertainties."""
    nominal = loop.head
    assert loop.true_head is not None  # a population's loop
    head: HeadModel = loop.true_head[which]
    record = hold_gaze(
        dataclasses.replace(loop, true_head=head[None], num=1, plant="rendered", plant_options={})
    )
    sigma_px = detection_sigma(record.pixels)[0]
    q = record.positions.mean(axis=0)[0]
    pixels = np.nanmean(record.pixels, axis=0)[0]
    uncertainty = {
        "gaze": gaze_uncertainty_mm(nominal, q, sigma_px),
        "itpc": itpc_uncertainty_mm(nominal, q, pixels, sigma_px),
    }
    frames: list[pd.DataFrame] = [
        _rows("imaged", method, record, np.array([which]), number).assign(
            **axis_columns(uncertainty=uncertainty[method]),
            sigma_rms_px=float(np.sqrt(np.mean(sigma_px**2))),
            sigma_least_px=float(sigma_px.min()),
            sigma_greatest_px=float(sigma_px.max()),
        )
        for method in METHODS
    ]
    return pd.concat(frames)


def _rows(
    group: str, method: str, record: GazeRecord, heads: IntArray, number: int
) -> pd.DataFrame:
    """One row per head: error of the mean fix and scatter of the fixes."""
    error = record.gaze_error_mm if method == "gaze" else record.itpc_error_mm
    by_axis = np.moveaxis(error, -1, 0)
    pixel_error = np.linalg.norm(np.nanmean(record.pixel_error, axis=0), axis=-1)
    return pd.DataFrame(
        {
            "case": "fixation",
            "group": group,
            "head": heads,
            "point": number,
            "method": method,
            "truth_z_mm": MM * record.target[0, :, 2],
            "pixel_error_px": pixel_error.max(-1),
            "seen_share": np.isfinite(record.pixels).all(axis=(-2, -1)).mean(axis=0),
            **axis_columns(
                error=[np.nanmean(own, axis=0) for own in by_axis],
                scatter=[np.nanstd(own, axis=0, ddof=1) for own in by_axis],
            ),
        }
    )
