"""The physical twin on static targets (Figs. 10 and 11): a population of heads, one with images."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from vergence.envs.streams import IntArray
from vergence.eval.article.common.closed_loop import (
    ClosedLoop,
    GazeRecord,
    detection_sigma,
    gaze_uncertainty,
    hold_gaze,
    itpc_uncertainty,
)
from vergence.eval.article.experiment import Experiment
from vergence.eval.article.physical_static.error_budget import (
    ALL,
    BUDGET_SOURCES,
    budget_rows,
    detector_rows,
    off_axis_rows,
)
from vergence.eval.article.physical_static.figures import draw
from vergence.eval.article.physical_static.findings import (
    ARTICLE_LARGEST_PERCENT,
    conclude,
    summarise,
)
from vergence.eval.article.twin.heads import TwinConfig
from vergence.eval.article.twin.population import Population, draw_population
from vergence.eval.article.twin.statistics import AXES, METHODS
from vergence.eval.jobs import Job, Mapper
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.triangulation import triangulate_gaze

MM = 1000.0
_TRIALS = 100_000
"""Trials reserved for each point, so that each head at each point has its own noise."""


@dataclass(frozen=True, kw_only=True)
class PhysicalStaticConfig(TwinConfig):
    """What the static experiment on the physical twin is."""

    imaged_every: int = 1
    """The head with images looks at every so many of Table 5's points, the population at all."""
    samples: int = 1200
    """Fixes recorded at each point: the article's n."""
    settle_s: float = 2.0
    """Time before the first of them, s."""
    offsets_px: tuple[float, ...] = (0.0, 25.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0)
    """How far off the axis ITPC is evaluated, from the axis outwards, px."""
    worse_margin: float = 0.05
    """From which excess over the error of gaze on ITPC's counts as worse, as a fraction."""


def run(config: PhysicalStaticConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """Run the population, the head with images, the budget and ITPC off the axis.

    Args:
        config: what to run.
        seed: seed of the heads and of all noise.
        mapper: runs the jobs.

    Returns:
        `case` is `twin` (one row: the scalar, the head that sees images, one encoder step),
        `detector` (a row a point), `fixation` (a row a head, point and method), `budget` (a row a
        source and point), `off axis` (a row a source and offset).
    """
    drawn = draw_population(config, seed, mapper)
    nominal, points, scale = drawn.nominal, drawn.points, drawn.scale
    jobs: list[Job] = []
    excess = ARTICLE_LARGEST_PERCENT["itpc"] - ARTICLE_LARGEST_PERCENT["gaze"]
    for source in (ALL, *BUDGET_SOURCES):
        jobs.append(partial(budget_rows, nominal, config, points, seed, scale, source))
        jobs.append(
            partial(
                off_axis_rows, nominal, config, points, seed, scale, source,
                config.offsets_px, excess,
            )
        )  # fmt: skip
    frames: list[pd.DataFrame] = [
        *mapper(jobs),
        detector_rows(nominal, points, drawn.bias_px, "detector bias"),
        detector_rows(nominal, points, drawn.sigma_px, "one image's noise"),
        _detector_frame(drawn),
        _twin_frame(drawn),
    ]
    jobs = []
    for i, point in enumerate(points):
        loop = ClosedLoop(
            head=nominal,
            target={"kind": "static", "point": point.tolist(), "start": "fixation"},
            samples=config.samples,
            settle_s=config.settle_s,
            seed=seed,
            trial=(i + 1) * _TRIALS,
        )
        noise = float(drawn.noise_px[i])
        jobs.append(partial(_population, loop, drawn.heads, noise, i + 1))
        if i % config.imaged_every == 0:
            jobs.append(partial(_imaged, loop, drawn.heads[drawn.imaged], drawn.imaged, i + 1))
    frames += mapper(jobs)
    return pd.concat(frames, ignore_index=True)


def _detector_frame(drawn: Population) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "case": "detector",
            "point": np.arange(1, len(drawn.points) + 1),
            "truth_z_mm": MM * drawn.points[:, 2],
            "sigma_px": drawn.noise_px,
            "bias_px": np.sqrt(np.mean(drawn.bias_px**2, axis=(1, 2))),
        }
    )


def _twin_frame(drawn: Population) -> pd.DataFrame:
    """The scalar, and what one step of one encoder does to the farthest point."""
    nominal, far = drawn.nominal, drawn.points[np.argmax(drawn.points[:, 2])]
    q = nominal.fixate(far, nominal.rest()[:3])
    step = np.zeros(7)
    step[EYES.start + 1] = nominal.sensor.encoder_resolution_rad
    moved = abs(float((triangulate_gaze(nominal, q + step).point - far)[2]))
    return drawn.frame().assign(
        encoder_step_mm=MM * moved, encoder_step_percent=100.0 * moved / float(far[2])
    )


def _population(loop: ClosedLoop, heads: HeadModel, noise_px: float, number: int) -> pd.DataFrame:
    """All heads at one point, without images."""
    num = heads.batch_shape[0]
    record = hold_gaze(
        ClosedLoop(**{
            **vars(loop), "true_head": heads, "num": num, "plant": "kinematic",
            "plant_options": {"detection_noise_px": noise_px},
        })
    )  # fmt: skip
    which = np.arange(num)
    parts: list[pd.DataFrame] = [
        _rows("population", method, record, which, number) for method in METHODS
    ]
    return pd.concat(parts)


def _imaged(loop: ClosedLoop, head: HeadModel, which: int, number: int) -> pd.DataFrame:
    """One head at one point, on drawn images, with the article's uncertainties."""
    nominal = loop.head
    record = hold_gaze(
        ClosedLoop(**{**vars(loop), "true_head": head[None], "num": 1, "plant": "rendered"})
    )
    sigma_px = detection_sigma(record.pixels)[0]
    q = record.positions.mean(axis=0)[0]
    pixels = np.nanmean(record.pixels, axis=0)[0]
    frames = []
    for method, uncertainty in (
        ("gaze", gaze_uncertainty(nominal, q, sigma_px)),
        ("itpc", itpc_uncertainty(nominal, q, pixels, sigma_px)),
    ):
        rows = _rows("imaged", method, record, np.array([which]), number)
        for k, axis in enumerate(AXES):
            rows[f"uncertainty_{axis}_mm"] = float(uncertainty[k])
        rows["sigma_rms_px"] = float(np.sqrt(np.mean(sigma_px**2)))
        rows["sigma_least_px"] = float(sigma_px.min())
        rows["sigma_greatest_px"] = float(sigma_px.max())
        frames.append(rows)
    return pd.concat(frames)


def _rows(
    group: str, method: str, record: GazeRecord, heads: IntArray, number: int
) -> pd.DataFrame:
    """A row a head: the mean fix's error and the fixes' scatter."""
    error = record.gaze_error_mm if method == "gaze" else record.itpc_error_mm
    columns: dict[str, object] = {
        "case": "fixation",
        "group": group,
        "head": heads,
        "point": number,
        "method": method,
        "truth_z_mm": MM * record.target[0, :, 2],
        "pixel_error_px": np.linalg.norm(np.nanmean(record.pixel_error, axis=0), axis=-1).max(-1),
        "seen_share": np.isfinite(record.pixels).all(axis=(-2, -1)).mean(axis=0),
    }
    for k, axis in enumerate(AXES):
        columns[f"error_{axis}_mm"] = np.nanmean(error[..., k], axis=0)
        columns[f"scatter_{axis}_mm"] = np.nanstd(error[..., k], axis=0, ddof=1)
    return pd.DataFrame(columns)


EXPERIMENT = Experiment(
    name="physical-static",
    title="Physical twin, static targets",
    article="Section 5.1.2, Table 5, Figures 10 and 11",
    what=(
        "The article's head looks at an AprilTag at 21 places, 0.5 to 2.5 m away, and its errors "
        "are those of one head whose deviations from its model nobody knows. We run a population "
        "of heads whose links, joint offsets, coaxiality, head-eye transforms and intrinsics "
        "differ from the nominal ones that control and triangulate: 640x480 px, lens distortion, "
        "120 frames a second, 12-bit encoders, n = 1200. The relative sizes of the errors are "
        "what careful calibration leaves, and a common tilt that it cannot see; one scalar on "
        "all of them makes the median head's largest depth error the article's. The head "
        "most like the article's runs on drawn images with a real detector, the population "
        "without images, with the detection noise measured on drawn ones.\n\n"
        "ITPC is evaluated at the settled fixation, as in the article, and with the target beside "
        "the axis of both eyes, with each source of error alone and with all of them."
    ),
    config=PhysicalStaticConfig,
    quick={
        "heads": 40,
        "imaged_every": 5,
        "samples": 60,
        "noise_poses": 2,
        "noise_frames": 10,
        "offsets_px": (0.0, 100.0, 200.0, 300.0),
    },
    run=run,
    summarise=summarise,
    draw=draw,
    conclude=conclude,
)
