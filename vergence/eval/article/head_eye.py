"""The article's future work as an experiment: its head calibrated from its own movements."""

from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.recording import HeadFrames
from vergence.calibration.head.simulated import quantised, simulate_recording
from vergence.eval.article.experiment import Experiment, SummaryRow, job_rng, rows_where
from vergence.eval.article.hand_eye import refine_by_reprojection, solve_both_eyes
from vergence.eval.article.reported import ARTICLE_LARGEST_PERCENT, static_points
from vergence.eval.article.twin import draw_heads
from vergence.eval.trials.twin_errors import TWIN_ERRORS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.reporting import style
from vergence.reporting.jobs import Mapper
from vergence.reporting.text import Numbers, read_template
from vergence.triangulation import triangulate_views

STAGES = ("before", "closed form", "reprojection", "whole head")
"""Stages of calibration: none, head-eye transforms by ITPC-style closed form, the same refined by
reprojection, and all parameters of the head."""
READINGS = ("exact", "encoders")


@dataclass(frozen=True, kw_only=True)
class HeadEyeConfig:
    """Settings of the physical twin's calibration."""

    head: str = "physical"
    """Nominal head, one of the article's: simulated or physical."""
    heads: int = 16
    """Number of true heads drawn."""
    errors: ModelErrors = TWIN_ERRORS
    """Standard deviations of the true heads from the nominal one."""
    poses: int = 60
    """Number of poses in which each head looks at the board."""
    frames: int = 4
    """Frames per pose, with the joints moved a little."""
    noise_px: float = 0.05
    """Standard deviation of each coordinate of a corner of the board, px."""
    boards_m: tuple[float, ...] = (0.5, 1.0)
    """Distances of the board straight ahead, m, one placement after the other; two determine depth
    at 2.5 m twice as well as one."""


def run(config: HeadEyeConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Calibrate every head of a population; a row per head, stage, reading and point of Table 5."""
    nominal = load_head(config.head)
    heads = draw_heads(nominal, config.errors, config.heads, seed)
    jobs = [partial(_calibrated, nominal, heads[i], config, seed, i) for i in range(config.heads)]
    return pd.concat(mapper(jobs), ignore_index=True)


def _calibrated(
    nominal: HeadModel, true: HeadModel, config: HeadEyeConfig, seed: int, number: int
) -> pd.DataFrame:
    frames = simulate_recording(
        nominal, true, job_rng(seed, "head-eye", number), poses=config.poses,
        frames_per_pose=config.frames, noise_px=config.noise_px, distances_m=config.boards_m,
    ).frames  # fmt: skip
    stages = zip(STAGES, _stages(nominal, frames), strict=True)
    return pd.concat([_at_points(found, true, number, stage) for stage, found in stages])


def _stages(nominal: HeadModel, frames: HeadFrames) -> tuple[HeadModel, ...]:
    """Calibrate the head in each of `STAGES`."""
    closed = solve_both_eyes(nominal, frames)
    refined = refine_by_reprojection(nominal, frames, closed)
    head_eye = (nominal.replace(head_eye=fit.head_eye) for fit in (closed, refined))
    return nominal, *head_eye, calibrate_head(nominal, frames).head


def _at_points(found: HeadModel, true: HeadModel, number: int, stage: str) -> pd.DataFrame:
    """Compute depth errors while the true head fixates Table 5's points exactly."""
    points = static_points("physical")
    q = true.fixate(points)
    pixels = true.project(q, points)
    tables = []
    for reading in READINGS:
        read = quantised(found, q) if reading == "encoders" else q
        fix = triangulate_views(found, read, pixels)
        rows = {
            "head": number, "stage": stage, "reading": reading,
            "point": np.arange(1, len(points) + 1), "truth_z_mm": 1000.0 * points[:, 2],
            "error_z_mm": 1000.0 * (fix.point - points)[:, 2],
        }  # fmt: skip
        tables.append(pd.DataFrame(rows))
    return pd.concat(tables)


NAME: Final = "head-eye"
ARTICLE_PERCENT: Final = ARTICLE_LARGEST_PERCENT["itpc"]


def depth_errors_percent(table: pd.DataFrame, stage: str, reading: str = "exact") -> FloatArray:
    """(heads, points) absolute depth errors, percent of depth; infinite where there is no fix."""
    rows = rows_where(table, stage=stage, reading=reading)
    share = 100.0 * rows["error_z_mm"].abs() / rows["truth_z_mm"]
    wide = rows.assign(percent=share).pivot(index="head", columns="point", values="percent")
    return np.asarray(wide.fillna(np.inf).to_numpy(), dtype=np.float64)


def worst_depth_error_percent(table: pd.DataFrame, stage: str, reading: str = "exact") -> float:
    """The largest depth error of all heads, percent of depth."""
    return float(depth_errors_percent(table, stage, reading).max())


def summarise(table: pd.DataFrame, config: HeadEyeConfig) -> list[SummaryRow]:
    """Summarise the largest depth error of each stage; the article has no such values."""
    del config
    return [
        SummaryRow.of(NAME, f"largest depth error, {stage}, joints read {how}", "itpc", "z",
                      None, worst_depth_error_percent(table, stage, reading), unit="%")
        for stage in STAGES
        for reading, how in (("exact", "exactly"), ("encoders", "by the encoders"))
    ]  # fmt: skip


def numbers(table: pd.DataFrame, config: HeadEyeConfig) -> Numbers:
    """Collect the numbers for the text."""
    values = {"heads": float(config.heads), "article_percent": ARTICLE_PERCENT}
    for stage in STAGES:
        name = stage.replace(" ", "_")
        values[f"{name}_percent"] = worst_depth_error_percent(table, stage)
        values[f"{name}_encoders_percent"] = worst_depth_error_percent(table, stage, "encoders")
        values[f"{name}_median_percent"] = float(
            np.median(depth_errors_percent(table, stage).max(axis=1))
        )
    return values


_STYLES: Final[dict[str, dict[str, Any]]] = {
    "before": {"color": style.GREY, "marker": "o"},
    "closed form": {"color": style.ORANGE, "marker": "s", "label": "head-eye, closed form"},
    "reprojection": {"color": style.BLUE, "marker": "^", "label": "head-eye, reprojection"},
    "whole head": {"color": style.GREEN, "marker": "D"},
}
_PANELS: Final = {"exact": "joints read exactly", "encoders": "joints read by the encoders"}


def draw(table: pd.DataFrame, config: HeadEyeConfig) -> dict[str, Figure]:
    """Draw all figures, by name."""
    del config
    depth = np.unique(table["truth_z_mm"].to_numpy()) / 1000.0
    figure = style.new_figure(9.0, 4.6)
    for panel, (reading, title) in zip(
        figure.subplots(1, 2, sharey=True), _PANELS.items(), strict=True
    ):
        for stage, look in _STYLES.items():
            errors = depth_errors_percent(table, stage, reading).max(axis=0)
            panel.plot(depth, errors, **({"label": stage} | look), markersize=4)
        panel.axhline(ARTICLE_PERCENT, **style.ARTICLE_STYLE, label="article's largest, ITPC")
        panel.set(xlabel="depth [m]", title=title)
        style.log_axis(panel)
    figure.axes[0].set_ylabel("largest |depth error| of the heads [% of depth]")
    style.legend_below(figure, 3)
    return {"head-eye-depth": figure}


EXPERIMENT: Final = Experiment(
    name="head-eye", title="Physical twin, calibrated",
    article="Sections 5.1.2 and 6, Table 5, Figure 10",
    text=read_template(__package__, "sections/head_eye.jinja"), config=HeadEyeConfig,
    quick={"heads": 4, "poses": 20},
    run=run, summarise=summarise, numbers=numbers, draw=draw,
)  # fmt: skip
