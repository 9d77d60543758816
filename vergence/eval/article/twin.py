"""The physical twin: a population of simulated true heads in place of the article's single head."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import ndtr

from vergence.errors import ConfigurationError
from vergence.eval.article.closed_loop import (
    MM,
    ClosedLoop,
    LinearLoop,
    noise_gain,
    with_joint_offsets,
)
from vergence.eval.article.experiment import job_rng, rows_where
from vergence.eval.article.reported import ARTICLE_GAIN, ARTICLE_LARGEST_PERCENT, static_points
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import LINKS, FloatArray, Rendering
from vergence.models.perturbation import ModelErrors
from vergence.reporting.jobs import Mapper
from vergence.reporting.style import METHOD_STYLE
from vergence.triangulation import triangulate_views
from vergence.vision import AprilTag, Camera, TargetRenderer, Tracker, make_detector
from vergence.vision.targets import board_pose

METHODS: Final = ("gaze", "itpc")
METHOD_LABELS: Final = {"gaze": "gaze", "itpc": "ITPC"}
AXES: Final = ("x", "y", "z")
# Percentiles between which the article's head counts as one of the population (chosen: the middle
# 80 %).
LOW: Final = 10.0
HIGH: Final = 90.0


def method_look(method: str, size: float, **more: Any) -> dict[str, Any]:
    """Style of a method's line; the markers of ITPC are hollow, of a size around those of gaze."""
    hollow = {"markerfacecolor": "none", "markersize": size} if method == "itpc" else {}
    return {**METHOD_STYLE[method], **more, **hollow}


class RankInPopulation(NamedTuple):
    """A figure of the article compared with a population's figures."""

    article: float
    low: float
    """The population's 10th percentile."""
    median: float
    high: float
    """The population's 90th percentile."""
    percentile: float
    """Percentage of the population below the article's figure."""

    @property
    def inside(self) -> bool:
        """True if the article's figure lies between the 10th and 90th percentile."""
        return self.low <= self.article <= self.high

    @property
    def verdict(self) -> str:
        """`inside` or `outside`."""
        return "inside" if self.inside else "outside"


def rank_in_population(article: float, population: ArrayLike) -> RankInPopulation:
    """Compare a figure of the article with a population's, (heads,)."""
    values = np.asarray(population, dtype=np.float64)
    low, median, high = np.percentile(values, [LOW, 50.0, HIGH])
    below = 100.0 * float(np.mean(values < article))
    return RankInPopulation(article, float(low), float(median), float(high), below)


def rank_ends(span: tuple[float, float], values: FloatArray) -> tuple[RankInPopulation, ...]:
    """Ranks of the article's least and greatest figure among those of heads, (heads, points)."""
    ends = (values.min(axis=1), values.max(axis=1))
    return tuple(rank_in_population(*pair) for pair in zip(span, ends, strict=True))


def count_inside(ranks: Sequence[RankInPopulation]) -> int:
    """Count the article's figures that lie between the 10th and 90th percentile of ours."""
    return sum(rank.inside for rank in ranks)


def axis_columns(**values: Sequence[FloatArray] | FloatArray) -> dict[str, FloatArray]:
    """Columns of a table such as `error_x_mm`, from three arrays per name, one for each axis."""
    return {f"{name}_{a}_mm": v[k] for k, a in enumerate(AXES) for name, v in values.items()}


def fixation_rows(table: pd.DataFrame, group: str = "population") -> pd.DataFrame:
    """The rows of one group's fixations."""
    chosen = rows_where(table, case="fixation", group=group)
    return chosen.astype({"head": int, "point": int})


def absolute_errors_mm(rows: pd.DataFrame, method: str, axis: str) -> FloatArray:
    """(heads, points) absolute errors of the mean fix, mm."""
    of_method = rows_where(rows, method=method)
    wide = of_method.pivot(index="head", columns="point", values=f"error_{axis}_mm")
    return np.asarray(wide.abs().to_numpy(), dtype=np.float64)


def depth_errors_percent(rows: pd.DataFrame, method: str) -> FloatArray:
    """(heads, points) |dz| / z, percent."""
    depth = rows.groupby("point")["truth_z_mm"].first().sort_index().to_numpy()
    return np.asarray(100.0 * absolute_errors_mm(rows, method, "z") / depth)


_LOWERS: Final = {"left_tilt": 1.0, "right_tilt": -1.0}
"""Sign of the tilt that lowers an eye: positive left tilt looks down, positive right tilt up."""


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The physical twin: errors of the true heads against the nominal one, and their detector."""

    head: str = "physical"
    """The nominal head, used for control: one of the article's, simulated or physical."""
    heads: int = 100
    """Number of true heads drawn."""
    errors: ModelErrors = TWIN_SPREADS
    """Standard deviations of the true heads' model errors, before scaling."""
    largest_error_percent: float = ARTICLE_LARGEST_PERCENT["gaze"]
    """Largest depth error by gaze of the article's head over the static points, percent of depth.
    The scale is set so that the population's median is equal to it."""
    scale: float = 0.0
    """Factor on all standard deviations; 0 to find it from `largest_error_percent`."""
    noise_poses: int = 4
    """Fixations of each static point at which the detector's errors are measured on images."""
    noise_frames: int = 40
    """Images per fixation."""


def draw_heads(nominal: HeadModel, errors: ModelErrors, count: int, seed: int) -> HeadModel:
    """Draw the population of true heads; the random numbers do not depend on the errors' size."""
    if count < 1:
        raise ConfigurationError(f"heads: expected at least 1, got {count}")
    rng = job_rng(seed, "physical twin")
    # common tilts are drawn first, so that all other errors are the same with and without them
    tilt = errors.common_tilt_rad * rng.standard_normal(count)
    heads = nominal.perturbed(rng, dataclasses.replace(errors, common_tilt_rad=0.0), count)
    return with_common_tilt(heads, tilt)


def with_common_tilt(heads: HeadModel, tilt_rad: FloatArray) -> HeadModel:
    """Lower both eyes of each head by an angle, (n,) rad, that the encoders do not measure."""
    lowers = np.array([_LOWERS.get(joint, 0.0) for _frame, _parent, joint in LINKS])
    return with_joint_offsets(heads, lowers * np.asarray(tilt_rad)[:, None])


class DetectorNoise(NamedTuple):
    """Detection errors at one place or several, over poses of the tag within a pixel."""

    sigma_px: FloatArray
    """(..., 2, 2) by camera and coordinate: sample standard deviation at a pose, rms over poses."""
    bias_px: FloatArray
    """(..., 2, 2) by camera and coordinate: mean error at a fixed pose, rms over poses."""

    @classmethod
    def stacked(cls, noises: "Sequence[DetectorNoise]") -> "DetectorNoise":
        """Stack the errors at several places, one `DetectorNoise` each."""
        return cls(*(np.stack(part) for part in zip(*noises, strict=True)))

    def over_cameras(self) -> tuple[FloatArray, FloatArray]:
        """(...,) standard deviation and bias, rms over cameras and coordinates, px."""
        sigma, bias = (np.sqrt(np.mean(part**2, axis=(-2, -1))) for part in self)
        return sigma, bias

    def table(self, points: FloatArray) -> pd.DataFrame:
        """Rows of an experiment's table, one per place."""
        sigma, bias = self.over_cameras()
        return pd.DataFrame({
            "case": "detector", "point": np.arange(1, len(points) + 1),
            "truth_z_mm": MM * points[:, 2], "sigma_px": sigma, "bias_px": bias,
        })  # fmt: skip


def _detections(
    camera: Camera, rendering: Rendering, T_C_T: FloatArray, frames: int, rng: np.random.Generator
) -> FloatArray:
    """(frames, 2) detected centres of a tag at a fixed pose, px; nan where not found."""
    tag = AprilTag()
    drawing, tracker = TargetRenderer(camera, tag, rendering), Tracker(make_detector(tag, camera))
    out = np.full((frames, 2), np.nan)
    for frame in range(frames):
        drawing.draw(T_C_T, rng)
        found = tracker.find(drawing.frame)
        if found is not None:
            out[frame] = found.point_px
    return out


def measure_pair_noise(
    cameras: tuple[Camera, Camera], rendering: Rendering, T_C_T: FloatArray, frames: int,
    rng: np.random.Generator,
) -> DetectorNoise:  # fmt: skip
    """Measure two cameras' detections of a tag at poses T_C_T, (poses, 2, 4, 4), m."""
    sigma, bias = np.empty((2, len(T_C_T), 2, 2))
    for pose, both in enumerate(T_C_T):
        for eye, camera in enumerate(cameras):
            seen = _detections(camera, rendering, both[eye], frames, rng)
            sigma[pose, eye] = np.nanstd(seen, axis=0, ddof=1)
            bias[pose, eye] = np.nanmean(seen, axis=0) - camera.project(both[eye, None, :3, 3])[0]
    return DetectorNoise(*(np.sqrt(np.mean(part**2, axis=0)) for part in (sigma, bias)))


def measure_head_noise(
    head: HeadModel, point: FloatArray, poses: int, frames: int, rng: np.random.Generator
) -> DetectorNoise:
    """Measure detections of a tag that an exact head fixates to within half a pixel."""
    pixels = head.cameras.principal + rng.uniform(-0.5, 0.5, (poses, 2, 2))
    T_N_C = head.camera_poses(joint_angles_imaging_at(head, head, point, pixels))
    cameras = (Camera.of(head, 0), Camera.of(head, 1))
    T_C_T = np.linalg.inv(T_N_C) @ board_pose(point)
    return measure_pair_noise(cameras, head.rendering, T_C_T, frames, rng)


def joint_angles_imaging_at(
    nominal: HeadModel, heads: HeadModel, points: ArrayLike, pixels: ArrayLike
) -> FloatArray:
    """(..., 7) true joint angles, rad, at which heads see points at raw pixels (..., 2, 2).

    With the nominal principal points as pixels these are the angles at which the closed loop
    settles: the undistorted detection is at the nominal principal point only if the raw pixel is.
    They are nan if a pixel lies outside the image or a joint outside its limits.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    cameras = heads.cameras
    slope = (heads.undistort(pixels) - cameras.principal) / cameras.focal
    ray = np.concatenate([slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
    z = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    x = np.stack([z[..., 2], np.zeros(z.shape[:-1]), -z[..., 0]], axis=-1)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    turned = np.zeros((*z.shape[:-1], 4, 4))
    turned[..., :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    turned[..., 3, 3] = 1.0
    # turn the camera so that its optical axis is the wanted pixel's ray: it then fixates with
    # the wanted joint angles
    axis = heads.replace(head_eye=heads.head_eye @ turned)
    q = axis.fixate(points, nominal.rest()[:3], warn=False)
    inside = ((pixels >= -0.5) & (pixels <= cameras.size - 0.5)).all(axis=(-2, -1))
    return np.where((inside & nominal.limits.contains(q))[..., None], q, np.nan)


def mean_encoder_readings(
    nominal: HeadModel, q: FloatArray, noise_px: ArrayLike | None = None
) -> FloatArray:
    """(..., 7) mean encoder readings of true joint angles in a settled loop, rad.

    Detection noise makes the eyes jitter by far less than an encoder step. But near the boundary
    between two steps the encoder reads both in turn, and its mean lies between them.
    """
    step = nominal.sensor.encoder_resolution_rad
    if step <= 0.0:
        return q
    noise = np.asarray(nominal.sensor.detection_noise_px if noise_px is None else noise_px)
    focal = float(nominal.cameras.focal.mean())
    tremble = np.maximum(_noise_gain(nominal) * noise / focal, 1e-12)[..., None]
    nearest = np.round(q / step)
    up = ndtr((q - (nearest + 0.5) * step) / tremble)
    down = ndtr(((nearest - 0.5) * step - q) / tremble)
    return np.asarray(step * (nearest + up - down))


@cache
def _noise_gain(nominal: HeadModel) -> float:
    """Jitter of the optical axis under the article's law, as a ratio to the detection noise."""
    return noise_gain(LinearLoop.of(nominal, ARTICLE_GAIN))


def mean_fix_errors_m(
    nominal: HeadModel, heads: HeadModel, points: FloatArray, pixels: ArrayLike | None = None,
    encoders: bool = True, noise_px: ArrayLike | None = None,
) -> FloatArray:  # fmt: skip
    """(..., 3) mean errors of the nominal head's fixes on resting targets, m; nan out of sight.

    At the principal points gaze and ITPC are the same computation; elsewhere the fixes are ITPC's.
    True heads have the batch shape (..., 1) or (); pixels are raw, (..., 2, 2), and None for the
    principal points; the noise of the detections, px, is None for the preset's.
    """
    seen = nominal.cameras.principal if pixels is None else np.asarray(pixels)
    q = joint_angles_imaging_at(nominal, heads, points, seen)
    read = mean_encoder_readings(nominal, q, noise_px) if encoders else q
    return triangulate_views(nominal, read, seen).point - points


def settled_fix_errors_m(
    nominal: HeadModel, heads: HeadModel, points: FloatArray, encoders: bool = True,
    noise_px: ArrayLike | None = None,
) -> FloatArray:  # fmt: skip
    """(heads, points, 3) errors of settled fixations on all points, m; see `mean_fix_errors_m`."""
    return mean_fix_errors_m(nominal, heads[:, None], points, encoders=encoders, noise_px=noise_px)


_GREATEST_SCALE: Final = 64.0
"""Upper end of the bracket beyond which the search gives up (numerical)."""
_SCALES: Final = 81
"""Grid points of the final search around the bisection's result (numerical)."""


def largest_depth_error_percent(errors: FloatArray, points: FloatArray) -> FloatArray:
    """(heads,) largest |dz| / z over the points, percent, from (heads, points, 3) errors."""
    return np.asarray(100.0 * np.nanmax(np.abs(errors[..., 2]) / points[:, 2], axis=-1))


def find_error_scale(
    nominal: HeadModel, config: TwinConfig, seed: int, noise_px: ArrayLike | None = None
) -> float:
    """Find the error scale at which the median head's largest depth error is the article's."""
    if config.scale > 0.0:
        return config.scale
    points = static_points("physical")

    def median(scale: float) -> float:
        heads = draw_heads(nominal, config.errors.scaled(scale), config.heads, seed)
        errors = settled_fix_errors_m(nominal, heads, points, noise_px=noise_px)
        return float(np.median(largest_depth_error_percent(errors, points)))

    low, high = 0.0, 1.0
    if median(low) >= config.largest_error_percent:
        raise ConfigurationError(
            f"largest_error_percent: expected more than the encoders alone give, "
            f"got {config.largest_error_percent}"
        )
    while median(high) < config.largest_error_percent:
        low, high = high, 2.0 * high
        if high > _GREATEST_SCALE:
            raise ConfigurationError(
                f"largest_error_percent: expected what the spreads can give, "
                f"got {config.largest_error_percent}"
            )
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        if median(middle) < config.largest_error_percent:
            low = middle
        else:
            high = middle
    # encoder quantisation makes the median jump: take the best scale of a fine grid
    scales = np.linspace(0.8 * low, 1.2 * high, _SCALES)
    misses = [abs(median(float(scale)) - config.largest_error_percent) for scale in scales]
    return float(scales[int(np.argmin(misses))])


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
        """Closed loop of all heads before a numbered target at rest, without images."""
        return ClosedLoop(
            head=self.nominal, true_head=self.heads, num=self.heads.batch_shape[0],
            target={"kind": "static", "point": point.tolist(), "start": "fixation"},
            samples=samples, settle_s=settle_s, plant="kinematic",
            plant_options={"detection_noise_px": self.noise_at(float(point[2]))}, seed=seed,
            trial=number * _TRIALS,
        )  # fmt: skip

    def table_row(self) -> pd.DataFrame:
        """Error scale and index of the head with images: a row of the experiments' tables."""
        return pd.DataFrame({"case": ["twin"], "scale": [self.scale], "head": [self.imaged_head]})


def draw_population(config: TwinConfig, seed: int, mapper: Mapper) -> TwinPopulation:
    """Measure the detector on images, find the error scale and draw the heads."""
    nominal = load_head(config.head)
    points = static_points("physical")
    jobs = [partial(_measure, nominal, point, config, seed, i) for i, point in enumerate(points)]
    measured = DetectorNoise.stacked(mapper(jobs))
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
