"""Trials of our heads and of fixed pairs like the ZED Mini on Table 7's points."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import MM, ClosedLoop, hold_gaze
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.detector_noise import DetectorNoise, measure_pair_noise
from vergence.eval.article.twin.heads import TwinConfig
from vergence.eval.article.twin.population import draw_population
from vergence.eval.article.twin.statistics import axis_columns
from vergence.models.camera import Camera, Cameras, camera_matrix
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Job, Mapper
from vergence.triangulation import triangulate_views
from vergence.vision.targets import board_pose

FACTORY_ERRORS: Final = ModelErrors(
    # 0.02 degrees of rotation between the two cameras, split between them
    head_eye_rad=float(np.deg2rad(0.02) / np.sqrt(2.0)),
    head_eye_m=0.00005,
    focal_relative=0.001,
    # about the reprojection error of a good calibration
    principal_px=0.2,
)
"""Residual errors of a fixed pair after factory calibration."""


@dataclass(frozen=True, kw_only=True)
class FixedPairConfig(TwinConfig):
    """Configuration of the comparison with a fixed pair."""

    samples: int = 120
    """Fixes recorded at each point."""
    settle_s: float = 2.0
    """Settling time before the first fix, s."""
    pair_rig: str = "simulated"
    """Rig that gives the pair's images grey levels, blur and noise: a preset or TOML file."""
    pair_size_px: tuple[int, int] = (1280, 720)
    """Width and height of the pair's images, px."""
    pair_focal_px: float = 676.21
    """Focal length of the pair's cameras, px (Table 6)."""
    pair_principal_px: tuple[float, float] = (645.09, 368.27)
    """Principal point of the pair's cameras, px (Table 6)."""
    pair_baseline_mm: float = 63.0
    """Baseline of the pair, mm."""
    pair_place_mm: tuple[float, float, float] = (0.0, -90.0, 14.0)
    """Centre of the pair, above the eyes, in N, mm."""
    calibration: ModelErrors = FACTORY_ERRORS
    """Errors left by factory calibration; head-eye errors apply to the pair's camera poses."""
    mount_rotation_deg: float = 2.0
    """Standard deviation of the pair's unknown orientation in N, about each axis, degrees."""
    mount_place_mm: float = 20.0
    """Standard deviation of the pair's unknown position in N, along each axis, mm."""


def run(config: FixedPairConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Measure Table 7's points with the population and with as many drawn pairs.

    Args:
        config: the configuration.
        seed: seed of heads, pairs and noise.
        mapper: runs the jobs.

    Returns:
        A table with the column `case`: `twin` (one row), `detector` (one row per point) or `fix`
        (one row per draw, point and method). The methods are `gaze` and `itpc` of the drawn head,
        `pair` of the drawn pair, and `misaligned` of that pair with an unknown pose in N.
    """
    drawn = draw_population(config, seed, mapper)
    points = static_points("zed_mini")
    pair = pair_head(config)
    measured = DetectorNoise.stacked(
        mapper([partial(_noise, pair, point, config, seed, i) for i, point in enumerate(points)])
    )
    jobs: list[Job] = [
        partial(
            _by_heads,
            drawn.hold_static_target(
                i + 1, point, samples=config.samples, settle_s=config.settle_s, seed=seed
            ),
            i + 1,
        )
        for i, point in enumerate(points)
    ]
    frames: list[pd.DataFrame] = [
        drawn.table_row(),
        measured.table(points),
        *mapper(jobs),
        _by_pairs(pair, points, measured, config, seed),
    ]
    return pd.concat(frames, ignore_index=True)


def pair_head(config: FixedPairConfig) -> HeadModel:
    """The fixed pair as a head whose joints never move: parallel cameras, axes along z_N."""
    rig = load_head(config.pair_rig)
    wanted = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    half = 0.5 * config.pair_baseline_mm
    wanted[:, :3, 3] = np.array(config.pair_place_mm) / MM
    wanted[:, 0, 3] += np.array([-half, half]) / MM
    # T_N_C = T_N_6 T_6_C, so this T_6_C gives the cameras the wanted poses at rest
    head_eye = rig.head_eye @ np.linalg.inv(rig.camera_poses(rig.rest())) @ wanted
    matrix = camera_matrix([config.pair_focal_px] * 2, config.pair_principal_px)
    cameras = (Camera(size=config.pair_size_px, matrix=matrix, pose=pose) for pose in head_eye)
    return dataclasses.replace(rig, name="pair", cameras=Cameras(*cameras))


def _noise(
    pair: HeadModel, point: FloatArray, config: FixedPairConfig, seed: int, number: int
) -> DetectorNoise:
    """Scatter and bias of the pair's detections at one point."""
    rng = job_rng(seed, "fixed pair detector", number)
    half_pixel = 0.5 * point[2] / config.pair_focal_px
    around = point + rng.uniform(-half_pixel, half_pixel, (config.noise_poses, 3))
    boards = np.stack([board_pose(p) for p in around])
    T_C_T = np.linalg.inv(pair.camera_poses(pair.rest())) @ boards[:, None]
    cameras = (Camera.of(pair, 0), Camera.of(pair, 1))
    return measure_pair_noise(cameras, pair.rendering, T_C_T, config.noise_frames, rng)


def _by_heads(loop: ClosedLoop, number: int) -> pd.DataFrame:
    record = hold_gaze(loop)
    truth = record.target[0]
    return pd.concat(
        [
            _rows("gaze", number, truth, np.nanmean(record.gaze_error_mm, axis=0)),
            _rows("itpc", number, truth, np.nanmean(record.itpc_error_mm, axis=0)),
        ]
    )


def _by_pairs(
    pair: HeadModel,
    points: FloatArray,
    noise: DetectorNoise,
    config: FixedPairConfig,
    seed: int,
) -> pd.DataFrame:
    """Draw as many pairs as heads; each fix is from the mean of as many images as the head's."""
    rng = job_rng(seed, "fixed pair")
    count = config.heads
    true = pair.perturbed(rng, config.calibration, count)
    turn = np.deg2rad(config.mount_rotation_deg) * rng.standard_normal((count, 3))
    shift = config.mount_place_mm / MM * rng.standard_normal((count, 3))
    place = np.array(config.pair_place_mm) / MM
    frames = []
    for i, point in enumerate(points):
        pixels = true.project(pair.rest(), point)
        pixels = pixels + noise.bias_px[i] * rng.standard_normal(pixels.shape)
        scatter = noise.sigma_px[i] / np.sqrt(config.samples)
        pixels = pixels + scatter * rng.standard_normal(pixels.shape)
        found = triangulate_views(pair, pair.rest(), pixels).point
        # small rotations: rotate the pair's fix about its centre
        moved = found + np.cross(turn, found - place) + shift
        truth = np.broadcast_to(point, found.shape)
        frames.append(_rows("pair", i + 1, truth, MM * (found - point)))
        frames.append(_rows("misaligned", i + 1, truth, MM * (moved - point)))
    return pd.concat(frames)


def _rows(method: str, number: int, truth: FloatArray, error_mm: FloatArray) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "case": "fix",
            "draw": np.arange(len(error_mm)),
            "point": number,
            "method": method,
            "truth_z_mm": MM * truth[:, 2],
            **axis_columns(error=error_mm.T),
        }
    )
