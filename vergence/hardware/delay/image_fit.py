"""How late an eye's images are, and how much play is before its camera, from what it sees.

An image that came at r shows the target from where the joints were at r - d, as the encoders tell
it. The camera follows the encoder within the play, pushed by its flanks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from vergence.envs.streams import IntArray
from vergence.hardware.delay.joint_fit import STRETCH_S, clustered
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_GRID_S: Final = 0.002
"""Time between two points of the way that images are compared with, s. Numerical."""
_MOST_S: Final = 0.4
"""Longest latency that is looked for, s."""
_DEPTH: Final = 0.2
"""Relative uncertainty of the target's distance before it is fitted."""
_SCALE: Final = 0.2
"""That of the focal length: cameras that nobody has calibrated."""
_SOFT: Final = 2.0
"""Residual from which on one counts by its size, not its square."""
_LEAST_PX: Final = 0.05
"""Least noise of a detection that is believed, px."""
_FAST_PX_S: Final = 150.0
"""Speed of the target in the image from which on it dates an image, px/s."""


@dataclass(frozen=True, kw_only=True)
class ImageFit:
    """How late an eye's images are."""

    latency_s: float
    """The mean, s."""
    latency_sigma_s: float
    jitter_s: float | None
    """Width of the latencies' spread if they are uniform, s; None where the eye turned too slowly
    to tell it."""
    jitter_sigma_s: float
    backlash_rad: float
    backlash_sigma_rad: float
    residual_px: float
    """Rms of what is seen beside the model, px."""
    scale: float
    """How far the image moves by how far it does with the model's focal length."""
    scale_sigma: float
    images: int
    """Number of images."""

    @property
    def least_s(self) -> float:
        """The latency beyond which an image comes up to the jitter later, s."""
        return max(self.latency_s - 0.5 * (self.jitter_s or 0.0), 0.0)

    @property
    def least_sigma_s(self) -> float:
        """Its standard deviation, s."""
        if self.jitter_s is None:
            return self.latency_sigma_s
        return float(np.hypot(self.latency_sigma_s, 0.5 * self.jitter_sigma_s))


def fit_images(
    head: HeadModel,
    eye: int,
    slot: int,
    base: FloatArray,
    path: Callable[[FloatArray], FloatArray],
    span_s: tuple[float, float],
    received_s: FloatArray,
    pixels: FloatArray,
    point: FloatArray,
    fastest_rad_s: float,
) -> ImageFit | None:
    """Find how late an eye's images are.

    Args:
        head: the model.
        eye: 0 for left.
        slot: place of the actuator that turned in a command of seven.
        base: (7,) where the others stood, of neck and actuators, rad.
        path: the actuator's angle by time.
        span_s: time that the path covers, s.
        received_s: (k,) when images came, s.
        pixels: (k, 2) raw pixels of the target; nan where it was not found.
        point: (3,) about where the target is, in N, m.
        fastest_rad_s: speed beyond which images are smeared, rad/s.

    Returns:
        The best by least squares; None where too few images show the target.
    """
    grid = np.arange(*span_s, _GRID_S)
    angles = path(grid)
    speeds = np.gradient(angles, _GRID_S)

    centre = head.cameras.principal[eye]

    def predicted(
        latency_s: float, backlash_rad: float, at: FloatArray, scale: float = 1.0
    ) -> FloatArray:
        joint = angles if backlash_rad == 0.0 else _within_play(angles, backlash_rad)
        motors = np.tile(base, (len(seen), 1))
        motors[:, slot] = np.interp(received_s[seen] - latency_s, grid, joint)
        found = head.project(head.actuation.joints_of(motors), at)[:, eye]
        return np.asarray(centre + scale * (found - centre))

    whole = (received_s - _MOST_S > span_s[0]) & (received_s < span_s[1])
    seen = np.flatnonzero(whole & np.isfinite(pixels).all(axis=-1))
    if len(seen) < 30:
        return None

    def spread(latency_s: float) -> float:
        gap = pixels[seen] - predicted(latency_s, 0.0, point)
        gap -= np.median(gap, axis=0)
        return float(np.abs(gap).sum())

    coarse = min(np.arange(0.0, _MOST_S, 0.01), key=spread)
    slow = np.abs(np.interp(received_s[seen] - coarse, grid, speeds)) < fastest_rad_s
    seen = seen[slow]
    if len(seen) < 30:
        return None
    away = float(np.linalg.norm(point))

    def residual(values: FloatArray) -> FloatArray:
        at = point + away * values[2:5]
        gap = pixels[seen] - predicted(values[0], abs(values[1]), at, 1.0 + values[5])
        return np.concatenate([gap.ravel() / noise, values[2:] / before])

    noise = 0.3
    before = np.array([_DEPTH, _DEPTH, _DEPTH, _SCALE])
    start = np.array([coarse, 1e-3, 0.0, 0.0, 0.0, 0.0])
    for _ in range(2):  # again, with the noise that was found
        found = least_squares(
            residual, start, x_scale=[0.01, 1e-3, *[0.01] * 4], loss="soft_l1", f_scale=_SOFT,
            jac="3-point", diff_step=[1e-3] * 6,
        )  # fmt: skip
        start = found.x
        gap = noise * residual(found.x)[: -len(before)].reshape(-1, 2)
        noise = max(1.4826 * float(np.median(np.abs(gap))), _LEAST_PX)
    stretches = ((received_s[seen] - received_s[seen][0]) / STRETCH_S).astype(np.int64)
    covariance = clustered(
        np.asarray(found.jac), found.fun, np.repeat(stretches, 2), _SOFT, known=len(before)
    )
    sigma = np.sqrt(np.diagonal(covariance))
    at, scale = point + away * found.x[2:5], 1.0 + float(found.x[5])
    ahead, behind = (
        predicted(found.x[0] + late_s, abs(found.x[1]), at, scale) for late_s in (-0.001, 0.001)
    )
    jitter_s, jitter_sigma_s = _jitter(gap, (ahead - behind) / 0.002, stretches)
    return ImageFit(
        latency_s=float(found.x[0]),
        latency_sigma_s=float(sigma[0]),
        jitter_s=jitter_s,
        jitter_sigma_s=jitter_sigma_s,
        backlash_rad=abs(float(found.x[1])),
        backlash_sigma_rad=float(sigma[1]),
        residual_px=float(np.sqrt(np.mean(gap**2))),
        scale=scale,
        scale_sigma=float(sigma[5]),
        images=len(seen),
    )


def _within_play(angles: FloatArray, backlash_rad: float) -> FloatArray:
    """(n,) the camera's angles behind a play, which the encoder's push."""
    half, out = 0.5 * backlash_rad, []
    joint = float(angles[0])
    for angle in angles.tolist():
        joint = min(max(joint, angle - half), angle + half)
        out.append(joint)
    return np.array(out)


def _jitter(
    gap: FloatArray, velocity: FloatArray, stretches: IntArray
) -> tuple[float | None, float]:
    """The width of the latencies' spread, and its standard deviation, s; None if it is not told.

    Args:
        gap: (n, 2) what is seen beside the model, px.
        velocity: (n, 2) of the target in the image, px/s.
        stretches: (n,) in which residuals depend on one another, whole numbers.
    """
    speed = np.linalg.norm(velocity, axis=-1)
    fast = speed > _FAST_PX_S
    if fast.sum() < 10:
        return None, np.inf
    along = np.sum(gap * velocity, axis=-1)[fast] / speed[fast]
    slow = np.abs(gap[speed < 0.5 * _FAST_PX_S])
    noise_px = 1.4826 * float(np.median(slow)) if len(slow) else 0.0
    late_s = along / speed[fast]
    late_s = late_s - np.median(late_s)
    kept = np.abs(late_s) < 6.0 * 1.4826 * max(float(np.median(np.abs(late_s))), 1e-4)
    square = late_s[kept] ** 2
    variance = float(np.mean(square - (noise_px / speed[fast][kept]) ** 2))
    together = np.bincount(stretches[fast][kept], square - square.mean())
    sigma = float(np.sqrt(np.sum(together**2))) / len(square)
    width = np.sqrt(12.0 * max(variance, 0.0))
    return float(width), float(6.0 * sigma / max(width, np.sqrt(12.0 * sigma)))
