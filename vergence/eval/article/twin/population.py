"""The population that all experiments on the physical twin share: scalar, heads, noise."""

from functools import partial
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import MM, ClosedLoop
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.detector_noise import DetectorNoise, noise_of_head
from vergence.eval.article.twin.fixation_errors import static_errors
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.eval.article.twin.scale import find_scale, largest_relative
from vergence.eval.jobs import Mapper
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

ARTICLE_LARGEST_Y_MM: Final = 12.28
"""The article's largest y error by gaze of static targets."""
_TRIALS: Final = 100_000
"""Trials reserved for each point, so that each head at each point has its own noise."""


class Population(NamedTuple):
    """A drawn population and what it sees with."""

    nominal: HeadModel
    """What controls and triangulates."""
    heads: HeadModel
    """What really moves, of batch shape (heads,)."""
    scale: float
    """What multiplies all spreads."""
    imaged: int
    """The head most like the article's, which runs on images."""
    points: FloatArray
    """(21, 3) Table 5's points, m."""
    detector: DetectorNoise
    """(21, 2, 2) what its detector gets wrong there."""

    def noise_at(self, depth_m: float) -> float:
        """The standard deviation of detections at a depth, px."""
        return float(np.interp(depth_m, self.points[:, 2], self.detector.over_cameras()[0]))

    def resting(
        self, number: int, point: FloatArray, *, samples: int, settle_s: float, seed: int
    ) -> ClosedLoop:
        """All heads side by side before a target at rest, without images.

        Args:
            number: of the point among its table's, from 1 on; each has its own noise.
            point: (3,) in N, m.
            samples: fixes to record.
            settle_s: time before the first of them, s.
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

    def frame(self) -> pd.DataFrame:
        """The scalar and the head that sees images: a row for the experiments' tables."""
        return pd.DataFrame({"case": ["twin"], "scale": [self.scale], "head": [self.imaged]})


def draw_population(config: TwinConfig, seed: int, mapper: Mapper) -> Population:
    """Measure the detector on images, find the scalar and draw the heads.

    Args:
        config: what to draw.
        seed: the run's seed; the same gives the same population in every experiment.
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
    scale = find_scale(nominal, config, seed, noise)
    heads = draw_heads(nominal, config.errors.scaled(scale), config.heads, seed)
    errors = static_errors(nominal, heads, points, noise_px=noise)
    imaged = _most_like_the_article(errors, points, config.largest_error_percent)
    return Population(nominal, heads, scale, imaged, points, measured)


def _measure(
    nominal: HeadModel, point: FloatArray, config: TwinConfig, seed: int, number: int
) -> DetectorNoise:
    rng = job_rng(seed, "physical detector", number)
    return noise_of_head(nominal, point, config.noise_poses, config.noise_frames, rng)


def _most_like_the_article(errors: FloatArray, points: FloatArray, percent: float) -> int:
    """The head whose largest errors in depth and in y come nearest to the article's, as ratios."""
    depth = np.log(largest_relative(errors, points) / percent)
    height = np.log(MM * np.abs(errors[..., 1]).max(axis=1) / ARTICLE_LARGEST_Y_MM)
    return int(np.argmin(np.hypot(depth, height)))
