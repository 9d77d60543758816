"""Errors of settled fixations: fix by the nominal model minus the point that a true head sees."""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from vergence.eval.article.common.loop_noise import LinearLoop, noise_gain
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_views

ARTICLE_GAIN: Final = 4.0
"""Gain of the article's control law, 1/s (physical: a setting of the article's system)."""


def joint_angles_imaging_at(
    nominal: HeadModel, heads: HeadModel, points: ArrayLike, pixels: ArrayLike
) -> FloatArray:
    """True joint angles at which true heads see points at given pixels.

    With the nominal principal points as pixels these are the angles at which the closed loop
    settles: the undistorted detection is at the nominal principal point only if the raw pixel is.

    Args:
        nominal: the nominal head; it gives the joint limits and the neck's rest angles.
        heads: the true heads, of batch shape (..., 1) or ().
        points: (..., 3) in N, m.
        pixels: (..., 2, 2) raw pixels.

    Returns:
        (..., 7) joint angles, rad; nan if a pixel lies outside the image or a joint outside its
        limits.
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
    """Mean encoder readings of the joint angles in a settled loop.

    Detection noise makes the eyes jitter by far less than an encoder step. But near the boundary
    between two steps the encoder reads both in turn, and its mean lies between them.

    Args:
        nominal: the head; its encoders and its loop are used.
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
    """Jitter of the optical axis under the article's law, as a ratio to the detection noise."""
    return noise_gain(LinearLoop.of(nominal, ARTICLE_GAIN))


def mean_fix_errors_m(
    nominal: HeadModel,
    heads: HeadModel,
    points: FloatArray,
    pixels: ArrayLike | None = None,
    encoders: bool = True,
    noise_px: ArrayLike | None = None,
) -> FloatArray:
    """Mean errors of the nominal head's fixes on resting targets.

    At the principal points gaze and ITPC are the same computation; elsewhere the fixes are ITPC's.

    Args:
        nominal: the head that triangulates.
        heads: the true heads, of batch shape (..., 1) or ().
        points: (..., 3) in N, m.
        pixels: (..., 2, 2) raw pixels at which the target is seen; None for the principal points.
        encoders: true to read the joints through their encoders, with quantisation.
        noise_px: (...) standard deviation of the detections, px; None for the preset's.

    Returns:
        (..., 3) fix minus truth, m; nan where `joint_angles_imaging_at` gives nan.
    """
    seen = nominal.cameras.principal if pixels is None else np.asarray(pixels)
    q = joint_angles_imaging_at(nominal, heads, points, seen)
    fix = triangulate_views(
        nominal, mean_encoder_readings(nominal, q, noise_px) if encoders else q, seen
    )
    return fix.point - points


def settled_fix_errors_m(
    nominal: HeadModel,
    heads: HeadModel,
    points: FloatArray,
    encoders: bool = True,
    noise_px: ArrayLike | None = None,
) -> FloatArray:
    """(heads, points, 3) errors of settled fixations on all points, m; see `mean_fix_errors_m`."""
    return mean_fix_errors_m(nominal, heads[:, None], points, encoders=encoders, noise_px=noise_px)
