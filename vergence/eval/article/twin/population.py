"""The population shared by all experiments on the physical twin: error scale, heads, noise."""

from functools import partial
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import MM, ClosedLoop
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.detector_noise import DetectorNoise, measure_head_noise
from vergence.eval.article.twin.fixation_errors import settled_fix_errors_m
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.eval.article.twin.scale import find_error_scale, largest_depth_error_percent
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import Mapper

ARTICLE_LARGEST_Y_MM: Final = 12.28
"""Largest y error by gaze on static targets, mm (physical: reported by the article)."""
_TRIALS: Final = 100_000
"""Trial numbers reserved per point, so that heads share no noise between points (numerical)."""


class TwinPopulation(NamedTuple):
    """A drawn population and its detector."""

    nominal: HeadModel
    """The head used for control and triangulation."""
    heads: HeadModel
    """The true heads, of batch shape (heads,)."""
    scale: float
    """Factor on all standard deviations of the model errors."""
    imaged_head: int
    """Index of the head most like the article's; it runs on rendered images."""
    points: FloatArray
    """(21, 3) Table 5's points, in N, m."""
    detector: DetectorNoise
    """(21, 2, 2) scatter and bias of the detections at these points."""

    def noise_at(self, depth_m: float) -> float:
        """Standard deviation of detections at a depth, interpolated, px."""
        return float(np.interp(depth_m, self.points[:, 2], self.detector.over_cameras()[0]))

    def hold_static_target(
        self, number: int, point: FloatArray, *, samples: int, settle_s: float, seed: int
    ) -> ClosedLoop:
        """Closed loop of all heads side by side before a target at rest, without images.

        Args:
            number: number of the point in its table, from 1; each has its own noise.
            point: (3,) in N, m.
            samples: number of fixes to record.
            settle_s: settling time before the first fix, s.
            seed: seed of all noise.
        """
        return ClosedLoop(
            head=self.nominal,
            true_head=self.heads,
            num=self.heads.batch_shape[0],
            target={"kind": "static", "point": point.tolist(), "start": "fixation"},
            samples=samples,
            settle_s=settle_s,
            plant="kinematic",
            plant_options={"detection_noise_px": self.noise_at(float(point[2]))},
            seed=seed,
            trial=number * _TRIALS,
        )

    def table_row(self) -> pd.DataFrame:
        """Error scale and index of the head with images: a row of the experiments' tables."""
        return pd.DataFrame({"case": ["twin"], "scale": [self.scale], "head": [self.imaged_head]})


def draw_population(config: TwinConfig, seed: int, mapper: Mapper) -> TwinPopulation:
    """Measure the detector on images, find the error scale and draw the heads.

    Args:
        config: the population.
        seed: the run's seed; it gives the same population in every experiment.
        mapper: runs the measurements.

    Returns:
        The population.
    """
    nominal = load_head(config.head)
    points = static_points("physical")
    measured = DetectorNoise.stacked(
        mapper(
            [partial(_measure, nominal, point, config, seed, i) for i, point in enumerate(points)]
        )
    )
    noise, _ = measured.over_cameras()
    scale = find_error_scale(nominal, config, seed, noise)
    heads = draw_heads(nominal, config.errors.scaled(scale), config.heads, seed)
    errors = settled_fix_errors_m(nominal, heads, points, noise_px=noise)
    imaged = _most_like_the_article(errors, points, config.largest_error_percent)
    return TwinPopulation(nominal, heads, scale, imaged, points, measured)


def _measure(
    nominal: HeadModel, point: FloatArray, config: TwinConfig, seed: int, number: int
) -> DetectorNoise:
    rng = job_rng(seed, "physical detector", number)
    return measure_head_noise(nominal, point, config.noise_poses, config.noise_frames, rng)


def _most_like_the_article(errors: FloatArray, points: FloatArray, percent: float) -> int:
    """Index of the head with largest depth and y errors nearest to the article's, as ratios."""
    depth = np.log(largest_depth_error_percent(errors, points) / percent)
    height = np.log(MM * np.abs(errors[..., 1]).max(axis=1) / ARTICLE_LARGEST_Y_MM)
    return int(np.argmin(np.hypot(depth, height)))
