"""Depth errors of the twin's heads at Table 5's points, before and after calibration."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.recording import HeadFrames
from vergence.calibration.head.simulated import quantised, simulate_recording
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.head_eye.hand_eye import refine_by_reprojection, solve_both_eyes
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.heads import draw_heads
from vergence.eval.trials.twin_errors import TWIN_ERRORS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Job, Mapper
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
    jobs: list[Job] = [
        partial(_calibrated, nominal, heads[i], config, seed, i) for i in range(config.heads)
    ]
    frames: list[pd.DataFrame] = list(mapper(jobs))
    return pd.concat(frames, ignore_index=True)


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
    return (
        nominal,
        nominal.replace(head_eye=closed.head_eye),
        nominal.replace(head_eye=refined.head_eye),
        calibrate_head(nominal, frames).head,
    )


def _at_points(found: HeadModel, true: HeadModel, number: int, stage: str) -> pd.DataFrame:
    """Compute depth errors while the true head fixates Table 5's points exactly."""
    points = static_points("physical")
    q = true.fixate(points)
    pixels = true.project(q, points)
    tables = []
    for reading in READINGS:
        read = quantised(found, q) if reading == "encoders" else q
        fix = triangulate_views(found, read, pixels)
        tables.append(
            pd.DataFrame(
                {
                    "head": number,
                    "stage": stage,
                    "reading": reading,
                    "point": np.arange(1, len(points) + 1),
                    "truth_z_mm": 1000.0 * points[:, 2],
                    "error_z_mm": 1000.0 * (fix.point - points)[:, 2],
                }
            )
        )
    return pd.concat(tables)
