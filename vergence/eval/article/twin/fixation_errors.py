"""Errors of settled fixations: where the nominal model puts what a true head looks at."""

import dataclasses
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from vergence.eval.article.common.loop_noise import Loop, noise_gain
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_views

ARTICLE_GAIN: Final = 4.0
"""The law's gain, 1/s."""


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
    q = axis.fixate(points, nominal.rest()[:3], warn=False)
    inside = ((pixels >= -0.5) & (pixels <= cameras.size - 0.5)).all(axis=(-2, -1))
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
