"""Trials of Table 3's static targets on the simulated rig, and their table."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import (
    MM,
    ClosedLoop,
    GazeRecord,
    corrected_gaze_fix,
    detection_sigma,
    dither_references_px,
    gaze_uncertainty_mm,
    hold_gaze,
    itpc_uncertainty_mm,
)
from vergence.eval.article.common.simulated_cases import (
    CASES,
    DRAWN_ERRORS,
    draw_true_heads,
    make_nominal_and_true_head,
)
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Job, Mapper
from vergence.triangulation import Fix

NAME: Final = "simulated-static"
BOARD: Final = {"board": "checkerboard", "facing": "forward"}
"""The article's target: the upper right corner of a checkerboard perpendicular to z."""


@dataclass(frozen=True, kw_only=True)
class SimulatedStaticConfig:
    """Configuration of static targets on the simulated rig."""

    samples: int = 1150
    """Detections at each point after settling; the article's n."""
    point_step: int = 1
    """Step through the 21 points, from the first."""
    settle_s: float = 2.0
    """Settling time from the target's appearance, eyes at rest, to the first sample, s."""
    gain: float = 4.0
    """The law's gain, 1/s."""
    dither_side: int = 4
    """Number of references per side of a dithered fixation's grid; the grid is one pixel wide,
    around the principal point."""
    heads: int = 100
    """Number of heads drawn, to see how representative the single drawn model is."""
    errors: ModelErrors = DRAWN_ERRORS
    """Standard deviations of the drawn model errors."""


def run(config: SimulatedStaticConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    points = range(0, len(static_points("simulated")), config.point_step)
    runs = [(case, "still") for case in CASES]
    # dithering reduces the detector's bias, the only systematic error of the exact model
    runs.append(("exact", "dithered"))
    jobs: list[Job] = [
        partial(_look, config, seed, case, fixation, point)
        for case, fixation in runs
        for point in points
    ]
    jobs += [partial(_population, config, seed, point) for point in points]
    return pd.DataFrame([row for rows in mapper(jobs) for row in rows])


def _target(point: int) -> dict[str, Any]:
    return {"kind": "static", "point": static_points("simulated")[point].tolist()}


def _look(
    config: SimulatedStaticConfig, seed: int, case: str, fixation: str, point: int
) -> list[dict[str, Any]]:
    """Hold one point with rendered images; returns a row for each method and axis."""
    rig = make_nominal_and_true_head(case, config.errors, seed)
    dithered = fixation == "dithered"
    keys = (list(CASES).index(case), int(dithered), point)
    record = hold_gaze(
        ClosedLoop(
            head=rig.nominal,
            true_head=rig.true,
            target=_target(point),
            plant_options=BOARD,
            samples=config.samples,
            settle_s=config.settle_s,
            gain=config.gain,
            references_px=dither_references_px(config.dither_side) if dithered else ((0.0, 0.0),),
            seed=int(job_rng(seed, NAME, *keys).integers(2**63)),
        )
    )
    common = {"case": case, "images": "rendered", "fixation": fixation, "head": 0}
    common |= _detections(record, dithered)
    return list(_rows(common, rig.nominal, record, point, dithered))


def _detections(record: GazeRecord, dithered: bool) -> dict[str, float]:
    """Noise and bias of the detections, and the fraction of images with detections."""
    noise = record.pixels - record.true_pixels_at_exposure
    sigma = detection_sigma(record.pixels)
    columns = {"seen": float(np.isfinite(record.pixels).all(axis=(1, 2)).mean())}
    for eye, name in enumerate(EYE_NAMES):
        for axis, letter in enumerate("uv"):
            tail = f"{name}_{letter}_px"
            # dithering moves the target in the image on purpose: its sigma is not noise
            columns[f"detection_sigma_{tail}"] = np.nan if dithered else float(sigma[eye, axis])
            columns[f"detection_bias_{tail}"] = float(np.nanmean(noise[:, eye, axis]))
    return columns


def _rows(
    common: dict[str, Any], head: HeadModel, record: GazeRecord, point: int, dithered: bool
) -> Iterator[dict[str, Any]]:
    q, truth = record.positions_at_exposure, record.target_at_exposure
    mean_q, mean_pixels = q.mean(axis=0), np.nanmean(record.pixels, axis=0)
    sigma = detection_sigma(record.pixels)
    uncertainty = {
        "gaze": gaze_uncertainty_mm(head, record.positions.mean(axis=0), sigma),
        "itpc": itpc_uncertainty_mm(head, mean_q, mean_pixels, sigma),
    }
    errors = {"gaze": record.gaze_error_mm, "itpc": record.itpc_error_mm}
    if dithered:
        corrected = corrected_gaze_fix(head, q, record.pixel_error, _depths(head, q, record.itpc))
        errors["gaze"] = MM * (corrected.point - truth)
    for method, error in errors.items():
        for axis, letter in enumerate("xyz"):
            yield {
                **common,
                "point": point + 1,
                "depth_mm": MM * float(truth[0, 2]),
                "method": method,
                "axis": letter,
                "n": int(np.isfinite(error[:, axis]).sum()),
                "error_mm": float(np.nanmean(error[:, axis])),
                "standard_deviation_mm": float(np.nanstd(error[:, axis], ddof=1)),
                "uncertainty_mm": np.nan if dithered else float(uncertainty[method][axis]),
            }


def _depths(head: HeadModel, q: FloatArray, fix: Fix) -> FloatArray:
    """(n, 2) depths of fixes in each eye's camera frame, m."""
    poses = head.camera_poses(q)
    offset = fix.point[:, None, :] - poses[..., :3, 3]
    return np.asarray((poses[..., :3, 2] * offset).sum(axis=-1))


def _population(config: SimulatedStaticConfig, seed: int, point: int) -> list[dict[str, Any]]:
    """Gaze errors of many drawn heads at one point, without images and noise."""
    preset = load_head("simulated")
    record = hold_gaze(
        ClosedLoop(
            head=preset,
            true_head=draw_true_heads(preset, config.errors, seed, config.heads),
            num=config.heads,
            target=_target(point),
            plant="kinematic",
            plant_options={"detection_noise_px": 0.0},
            samples=1,
            settle_s=max(config.settle_s, 3.0),
            gain=config.gain,
        )
    )
    error, depth = record.gaze_error_mm[0], MM * float(record.target[0, 0, 2])
    return [
        {
            "case": "drawn",
            "images": "none",
            "fixation": "still",
            "head": number + 1,
            "seen": 1.0,
            "point": point + 1,
            "depth_mm": depth,
            "method": "gaze",
            "axis": letter,
            "n": 1,
            "error_mm": float(error[number, axis]),
        }
        for number in range(config.heads)
        for axis, letter in enumerate("xyz")
    ]
