"""The population that all experiments on the physical twin share: scalar, heads, noise."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.detector_noise import DetectorNoise, noise_of_head
from vergence.eval.article.twin.heads import (
    TwinConfig,
    draw_heads,
    find_scale,
    largest_relative,
    static_errors,
)
from vergence.eval.jobs import Mapper
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

ARTICLE_LARGEST_Y_MM = 12.28
"""The article's largest y error by gaze of static targets."""


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
    sigma_px: FloatArray
    """(21, 2, 2) standard deviations of detections there, by eye and coordinate, px."""
    bias_px: FloatArray
    """(21, 2, 2) their biases at a pose, rms over poses, px."""

    @property
    def noise_px(self) -> FloatArray:
        """(21,) standard deviations of detections at Table 5's points, px."""
        return np.asarray(np.sqrt(np.mean(self.sigma_px**2, axis=(1, 2))))

    def noise_at(self, depth_m: float) -> float:
        """The standard deviation of detections at a depth, px."""
        return float(np.interp(depth_m, self.points[:, 2], self.noise_px))

    def frame(self) -> pd.DataFrame:
        """A row for the experiments' tables."""
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
    measured: Sequence[DetectorNoise] = mapper(
        [partial(_measure, nominal, point, config, seed, i) for i, point in enumerate(points)]
    )
    sigma, bias = (np.stack([getattr(m, part) for m in measured]) for part in DetectorNoise._fields)
    noise = np.sqrt(np.mean(sigma**2, axis=(1, 2)))
    scale = find_scale(nominal, config, seed, noise)
    heads = draw_heads(nominal, config, seed, scale)
    errors = static_errors(nominal, heads, points, noise_px=noise)
    imaged = _most_like_the_article(errors, points, config.largest_error_percent)
    return Population(nominal, heads, scale, imaged, points, sigma, bias)


def _measure(
    nominal: HeadModel, point: FloatArray, config: TwinConfig, seed: int, number: int
) -> DetectorNoise:
    rng = job_rng(seed, "physical detector", number)
    return noise_of_head(nominal, point, config.noise_poses, config.noise_frames, rng)


def _most_like_the_article(errors: FloatArray, points: FloatArray, percent: float) -> int:
    """The head whose largest errors in depth and in y come nearest to the article's, as ratios."""
    depth = np.log(largest_relative(errors, points) / percent)
    height = np.log(1000.0 * np.abs(errors[..., 1]).max(axis=1) / ARTICLE_LARGEST_Y_MM)
    return int(np.argmin(np.hypot(depth, height)))
