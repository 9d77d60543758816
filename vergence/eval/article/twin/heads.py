"""A population of true heads that stands for the article's one head, of which little is known.

What the article's own figures say about its head. At time zero of section 5.3.2 the target stood
1.6 and 1.2 degrees of tilt (left, right) and 0.8 and -1.1 degrees of pan beside where the nominal
geometry has it. Head-eye calibration takes up most of that: an offset of pan is a rotation of the
camera in its eye, whatever the posture, so the 1.9 degrees between the two pans do not reach the
point (0.10 degrees of vergence are 124 mm at 2.5 m). It cannot take up what the two tilts have in
common, 1.4 degrees: both eyes tilt about one line, so turning both together leaves every relation
between the two cameras as it was. Hence two kinds of error: residuals of calibration, independent
and small, and a common tilt. Bending under load, which the article names too, counts as offsets.
"""

import dataclasses
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from vergence.errors import ConfigurationError
from vergence.eval.article.common.loop_noise import Loop, noise_gain
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.models.head import HeadModel
from vergence.models.joints import LINKS
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors
from vergence.triangulation import triangulate_views

COMMON_TILT = "common_tilt"
"""The source of error that is drawn apart from the independent ones."""
SOURCES = (
    *(name for name in ModelErrors.__dataclass_fields__ if name != "common_tilt_rad"),
    COMMON_TILT,
)
"""The sources of model error by name."""
SOURCE_LABELS = {
    "link_m": "link lengths",
    "coaxiality_rad": "coaxiality",
    "joint_offset_rad": "joint offsets",
    "head_eye_rad": "head-eye rotation",
    "head_eye_m": "head-eye translation",
    "focal_relative": "focal lengths",
    "principal_px": "principal points",
    "distortion": "distortion",
    COMMON_TILT: "common tilt",
}
"""The same in words."""
ARTICLE_GAIN = 4.0
"""The law's gain, 1/s."""
_TILT_SIGNS = {"left_tilt": 1.0, "right_tilt": -1.0}
"""A positive left tilt looks down, a positive right tilt up."""
_GREATEST_SCALE = 64.0
_SCALES = 81


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The physical twin: how the true heads differ from the nominal one, before scaling."""

    head: str = "physical"
    """A preset's name or the path of a TOML file: the nominal head, which controls."""
    heads: int = 100
    """How many true heads are drawn."""
    link_mm: float = 0.2
    """Link lengths: what milled or printed brackets keep, mm."""
    coaxiality_deg: float = 0.1
    """Link twists: 0.1 mm across the 60 mm of an eye's bracket, degrees."""
    joint_offset_deg: float = 0.05
    """What head-eye calibration leaves of the joint offsets, each on its own: about the
    encoders' precision, degrees."""
    common_tilt_deg: float = 1.4
    """What both tilts are off by together, which no calibration between the two cameras sees:
    the mean of the two that the initial pixels of section 5.3.2 show, degrees."""
    head_eye_deg: float = 0.1
    """Head-eye rotations, about each axis: the common precision of hand-eye calibration."""
    head_eye_mm: float = 0.5
    """Head-eye translations, along each axis: the same, mm."""
    focal_percent: float = 0.2
    """Focal lengths: 1 px, the uncertainty that calibration toolboxes report, percent."""
    principal_px: float = 0.5
    """Principal points; an error that calibration shared with the head-eye rotation is gone, px."""
    distortion: float = 0.01
    """k1 and k2."""
    largest_error_percent: float = 4.97
    """Largest depth error by gaze of the article's head over the static points, percent of
    depth: the population's median, by the one scalar that multiplies all of the above."""
    scale: float = 0.0
    """That scalar; 0 to find it."""
    noise_poses: int = 4
    """Fixations of each static point on which the detector's noise is measured on images."""
    noise_frames: int = 40
    """Images of each."""

    def errors(self, scale: float, only: str | None = None) -> tuple[ModelErrors, float]:
        """The spreads of all sources, or of one.

        Args:
            scale: what multiplies them.
            only: one of `SOURCES`; None for all.

        Returns:
            The independent errors, and the common tilt's standard deviation, rad.
        """
        spreads = {
            "link_m": self.link_mm / 1000.0,
            "coaxiality_rad": np.deg2rad(self.coaxiality_deg),
            "joint_offset_rad": np.deg2rad(self.joint_offset_deg),
            "head_eye_rad": np.deg2rad(self.head_eye_deg),
            "head_eye_m": self.head_eye_mm / 1000.0,
            "focal_relative": self.focal_percent / 100.0,
            "principal_px": self.principal_px,
            "distortion": self.distortion,
            COMMON_TILT: np.deg2rad(self.common_tilt_deg),
        }
        chosen = {
            name: scale * float(value) if only in (None, name) else 0.0
            for name, value in spreads.items()
        }
        common = chosen.pop(COMMON_TILT)
        return ModelErrors(**chosen), common


def draw_heads(
    nominal: HeadModel, config: TwinConfig, seed: int, scale: float, only: str | None = None
) -> HeadModel:
    """The population of true heads; the same draws whatever the scale and the sources.

    Args:
        nominal: the head that they deviate from.
        config: by how much.
        seed: the run's seed.
        scale: what multiplies all spreads.
        only: the one source of error to leave, of `SOURCES`; None for all.

    Returns:
        A head of batch shape (heads,).
    """
    if config.heads < 1:
        raise ConfigurationError(f"heads: expected at least 1, got {config.heads}")
    errors, common = config.errors(scale, only)
    rng = job_rng(seed, "physical twin")
    tilt = common * rng.standard_normal(config.heads)
    heads = nominal.perturbed(rng, errors, config.heads)
    return with_common_tilt(heads, tilt)


def with_common_tilt(heads: HeadModel, tilt_rad: FloatArray) -> HeadModel:
    """Heads whose eyes both look lower than their encoders say.

    Args:
        heads: of batch shape (n,).
        tilt_rad: (n,) by how much, rad.

    Returns:
        The heads with other offsets of both tilts.
    """
    offset = np.broadcast_to(heads.links.offset, (len(tilt_rad), len(LINKS))).copy()
    for frame, (_frame, _parent, joint) in enumerate(LINKS):
        if joint in _TILT_SIGNS:
            offset[:, frame] += _TILT_SIGNS[joint] * tilt_rad
    return heads.replace(links={"offset": offset})


def looking(
    nominal: HeadModel, heads: HeadModel, points: ArrayLike, pixels: ArrayLike
) -> FloatArray:
    """The true joint angles at which true heads see points at given pixels.

    A loop that holds the target at the nominal principal points settles exactly there: the
    detected pixel, undistorted by the nominal lens, is the nominal principal point only if the
    raw pixel is.

    Args:
        nominal: the head that the pixels' limits and the neck's rest come from.
        heads: the true heads, of batch shape (..., 1) or ().
        points: (..., 3) in N, m.
        pixels: (..., 2, 2) raw pixels.

    Returns:
        (..., 7) joint angles, rad; nan where a target would leave the image or a joint its range.
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
    # a head whose optical axis is the wanted pixel's ray fixates with the angles in question
    axis = dataclasses.replace(heads, head_eye=heads.head_eye @ turned)
    q = axis.fixate(points, nominal.rest()[:3])
    size = np.array([cameras.width, cameras.height])
    inside = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=(-2, -1))
    return np.where((inside & nominal.limits.contains(q))[..., None], q, np.nan)


def encoded(nominal: HeadModel, q: FloatArray, noise_px: ArrayLike | None = None) -> FloatArray:
    """Joint angles as a settled loop's encoders read them in the mean.

    Detection noise makes a held eye tremble. That is little against a step of the encoder, but an
    eye near the edge between two steps is read as both in turn.

    Args:
        nominal: the head whose encoders and loop they are.
        q: (..., 7) true angles, rad.
        noise_px: (...) standard deviation of the detections, px; None for the preset's.

    Returns:
        (..., 7) rad.
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
    """Trembling of the axis under the article's law over the noise of a detection."""
    return noise_gain(Loop.of(nominal, ARTICLE_GAIN))


def fix_errors(
    nominal: HeadModel,
    heads: HeadModel,
    points: FloatArray,
    pixels: ArrayLike | None = None,
    encoders: bool = True,
    noise_px: ArrayLike | None = None,
) -> FloatArray:
    """Mean errors of the nominal head's fixes on resting targets.

    At the principal points gaze and ITPC are the same computation; elsewhere this is ITPC.

    Args:
        nominal: the head that triangulates.
        heads: the true heads, of batch shape (..., 1) or ().
        points: (..., 3) in N, m.
        pixels: (..., 2, 2) raw pixels at which the target is seen; None for the principal points.
        encoders: whether the joints are read through their encoders.
        noise_px: (...) standard deviation of the detections, px; None for the preset's.

    Returns:
        (..., 3) fix less truth, m; nan where the eyes cannot look so.
    """
    seen = nominal.cameras.principal if pixels is None else np.asarray(pixels)
    q = looking(nominal, heads, points, seen)
    fix = triangulate_views(nominal, encoded(nominal, q, noise_px) if encoders else q, seen)
    return fix.point - points


def static_errors(
    nominal: HeadModel,
    heads: HeadModel,
    points: FloatArray,
    encoders: bool = True,
    noise_px: ArrayLike | None = None,
) -> FloatArray:
    """(heads, points, 3) errors of settled fixations on all points, m; see `fix_errors`."""
    return fix_errors(nominal, heads[:, None], points, encoders=encoders, noise_px=noise_px)


def largest_relative(errors: FloatArray, points: FloatArray) -> FloatArray:
    """(heads,) largest |dz| / z over the points, percent, of (heads, points, 3) errors."""
    return np.asarray(100.0 * np.nanmax(np.abs(errors[..., 2]) / points[:, 2], axis=-1))


def find_scale(
    nominal: HeadModel, config: TwinConfig, seed: int, noise_px: ArrayLike | None = None
) -> float:
    """The scalar at which the median head's largest depth error is the article's.

    Args:
        nominal: the nominal head.
        config: the spreads and the article's figure.
        seed: the run's seed.
        noise_px: (21,) standard deviation of the detections at Table 5's points, px; None for
            the preset's.

    Returns:
        The scalar, or that of the config if it has one.

    Raises:
        ConfigurationError: the encoders alone give more, or no spread gives as much.
    """
    if config.scale > 0.0:
        return config.scale
    points = static_points("physical")

    def median(scale: float) -> float:
        heads = draw_heads(nominal, config, seed, scale)
        errors = static_errors(nominal, heads, points, noise_px=noise_px)
        return float(np.median(largest_relative(errors, points)))

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
    # the encoders' steps make the median jump: the scalar that comes nearest, of many
    scales = np.linspace(0.8 * low, 1.2 * high, _SCALES)
    misses = [abs(median(float(scale)) - config.largest_error_percent) for scale in scales]
    return float(scales[int(np.argmin(misses))])
