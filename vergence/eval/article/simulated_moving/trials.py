"""Trials of the moving target on the simulated rig, and their table."""

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from vergence.envs.targets.prescribed import CircleTarget
from vergence.eval.article.common.closed_loop import MM, ClosedLoop, hold_gaze
from vergence.eval.article.common.simulated_cases import (
    CASES,
    DRAWN_ERRORS,
    make_nominal_and_true_head,
)
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.simulated_static.trials import BOARD
from vergence.reporting.jobs import Job, Mapper

NAME: Final = "simulated-moving"
IMAGES: Final = "images"
WHITE: Final = "white"
NONE: Final = "none"
"""Kinds of detector: the real one on rendered images, one with white noise, one without noise."""


@dataclass(frozen=True, kw_only=True)
class SimulatedMovingConfig:
    """Configuration of the moving target on the simulated rig."""

    samples: int = 3780
    """Samples along the circle; the article's n."""
    every: int = 2
    """Control periods between samples; with 2 of 1/120 s the 3780 samples last 63 s."""
    period_s: float = 62.83185307179586
    """Period of the circle, s: "t / 10000" in the article, with t in milliseconds."""
    radius_mm: float = 100.0
    """Radius of the circle, mm."""
    settle_s: float = 2.0
    """Settling time from the target's start to the first sample, s."""
    gain: float = 4.0
    """The law's gain, 1/s."""


def run(config: SimulatedMovingConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    jobs: list[Job] = [partial(_follow, config, seed, case, IMAGES, 0.0) for case in CASES]
    jobs += [partial(_follow, config, seed, case, NONE, 0.0) for case in CASES]
    tables: list[pd.DataFrame] = mapper(jobs)
    exact = tables[list(CASES).index("exact")]
    # noise of the same standard deviation, but white and without the detector's bias
    sigma = float(exact.loc[exact["method"] == "itpc", "detection_sigma_px"].iloc[0])
    tables += mapper([partial(_follow, config, seed, "exact", WHITE, sigma)])
    return pd.concat(tables, ignore_index=True)


def _follow(
    config: SimulatedMovingConfig, seed: int, case: str, noise: str, sigma_px: float
) -> pd.DataFrame:
    """Follow the target; returns a row for each sample and method."""
    rig = make_nominal_and_true_head(case, DRAWN_ERRORS, seed)
    images = noise == IMAGES
    record = hold_gaze(
        ClosedLoop(
            head=rig.nominal,
            true_head=rig.true,
            target=CircleTarget(radius=config.radius_mm / MM, period=config.period_s),
            plant="rendered" if images else "kinematic",
            plant_options=BOARD if images else {"detection_noise_px": sigma_px},
            samples=config.samples,
            every=config.every,
            settle_s=config.settle_s,
            gain=config.gain,
            seed=int(job_rng(seed, NAME, list(CASES).index(case)).integers(2**63)),
        )
    )
    detected = record.pixels - record.true_pixels_at_exposure
    frames = []
    for method, error, time_s in (
        ("gaze", record.gaze_error_mm, record.time_s),
        ("itpc", record.itpc_error_mm, record.exposure_s),
        # the fix if the newest image is mistaken for the present
        ("itpc, undated", MM * (record.itpc.point - record.target), record.time_s),
    ):
        target = record.target_at_exposure if method == "itpc" else record.target
        rows = pd.DataFrame({"case": case, "noise": noise, "method": method,
                             "sample": np.arange(config.samples), "time_s": time_s})  # fmt: skip
        for axis, letter in enumerate("xy"):
            rows[f"target_{letter}_mm"] = MM * target[:, axis]
        for axis, letter in enumerate("xyz"):
            rows[f"error_{letter}_mm"] = error[:, axis]
        rows["detection_sigma_px"] = float(np.sqrt(np.nanvar(detected, axis=0, ddof=1).mean()))
        frames.append(rows)
    return pd.concat(frames, ignore_index=True)
