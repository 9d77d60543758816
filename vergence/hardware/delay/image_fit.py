"""Fit of the latency of an eye's images, and of the backlash between encoder and camera.

An image received at r shows the target from the joint angles at r - d, as reported by the encoders.
The camera follows the encoder within the backlash, pushed by the flanks of the gear.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from vergence.envs.streams import IntArray
from vergence.hardware.delay.joint_fit import CLUSTER_S, jackknife_covariance
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_TIME_STEP_S: Final = 0.002
"""Time step of the motion with which images are compared, s (numerical)."""
_MAX_LATENCY_S: Final = 0.4
"""Longest latency of the search, s (chosen)."""
_POSITION_PRIOR_FRACTION: Final = 0.2
"""Prior standard deviation of the target's position, as a fraction of its distance (chosen)."""
_SCALE_PRIOR_SIGMA: Final = 0.2
"""Prior standard deviation of the image scale, for uncalibrated cameras (chosen)."""
_LOSS_SCALE: Final = 2.0
"""Scale of the robust loss, in standard deviations: larger residuals count linearly (chosen)."""
_MIN_SIGMA_PX: Final = 0.05
"""Least standard deviation of a detection that is assumed, px (chosen)."""
_MIN_SPEED_PX_S: Final = 20.0
"""Image speed of the target below which its direction is uncertain, px/s (chosen)."""
_OUTLIER_SIGMAS: Final = 6.0
"""Residual above which an image says nothing of the jitter, in standard deviations (chosen)."""
_VARIANCE_ROUNDS: Final = 3
"""Rounds in which images are weighted by the variances found before (numerical)."""
_MIN_DELAY_SPEED_PX_S: Final = 150.0
"""Image speed of the target above which an image's residual shows its delay, px/s (chosen)."""


@dataclass(frozen=True, kw_only=True)
class ImageFit:
    """Latency, jitter and backlash of an eye's images."""

    latency_s: float
    """Mean latency, s."""
    latency_sigma_s: float
    jitter_s: float | None
    """Width of the distribution of latencies, taken as uniform, s; None if the eye turned too
    slowly to measure it."""
    jitter_sigma_s: float
    backlash_rad: float
    backlash_sigma_rad: float
    residual_px: float
    """Rms of the reprojection errors, px."""
    scale: float
    """Measured motion of the image per motion predicted with the model's focal length."""
    scale_sigma: float
    images: int
    """Number of images."""

    @property
    def least_latency_s(self) -> float:
        """Least latency, s; images arrive up to the jitter later."""
        return max(self.latency_s - 0.5 * (self.jitter_s or 0.0), 0.0)

    @property
    def least_latency_sigma_s(self) -> float:
        """Its standard deviation, s."""
        jitter_sigma_s = 0.0 if self.jitter_s is None else self.jitter_sigma_s
        return float(np.hypot(self.latency_sigma_s, 0.5 * jitter_sigma_s))


def fit_latency_and_backlash(
    head: HeadModel,
    eye: int,
    slot: int,
    fixed_actuator_angles: FloatArray,
    angle_at: Callable[[FloatArray], FloatArray],
    path_span_s: tuple[float, float],
    received_s: FloatArray,
    pixels: FloatArray,
    target_guess: FloatArray,
    blur_speed_rad_s: float,
) -> ImageFit | None:
    """Fit latency, jitter and backlash to one eye's pixels while the actuator of a slot turned.

    The target's position and the image scale are estimated too. The other actuators stood at fixed
    angles, (7,) rad; `angle_at` is this one's by time, within a span, s. The images were received
    at (k,) times, s, with (k, 2) raw pixels of the target, nan if it was not found, about a point
    in N, m; above the blur speed they are left out. None if too few of them show the target.
    """
    grid = np.arange(*path_span_s, _TIME_STEP_S)
    angles = angle_at(grid)
    speeds = np.gradient(angles, _TIME_STEP_S)
    centre = head.cameras.principal[eye]

    def predicted(
        latency_s: float, backlash_rad: float, at: FloatArray, scale: float = 1.0
    ) -> FloatArray:
        joint = angles if backlash_rad == 0.0 else _through_backlash(angles, backlash_rad)
        motors = np.tile(fixed_actuator_angles, (len(seen), 1))
        motors[:, slot] = np.interp(received_s[seen] - latency_s, grid, joint)
        found = head.project(head.actuation.joints_of(motors), at)[:, eye]
        return np.asarray(centre + scale * (found - centre))

    whole = (received_s - _MAX_LATENCY_S > path_span_s[0]) & (received_s < path_span_s[1])
    seen = np.flatnonzero(whole & np.isfinite(pixels).all(axis=-1))
    if len(seen) < 30:
        return None

    def spread(latency_s: float) -> float:
        residual = pixels[seen] - predicted(latency_s, 0.0, target_guess)
        residual -= np.median(residual, axis=0)
        return float(np.abs(residual).sum())

    coarse = min(np.arange(0.0, _MAX_LATENCY_S, 0.01), key=spread)
    seen = seen[np.abs(np.interp(received_s[seen] - coarse, grid, speeds)) < blur_speed_rad_s]
    if len(seen) < 30:
        return None
    away = float(np.linalg.norm(target_guess))

    def weighted_residual(values: FloatArray) -> FloatArray:
        at = target_guess + away * values[2:5]
        residual = pixels[seen] - predicted(values[0], abs(values[1]), at, 1.0 + values[5])
        return np.concatenate([residual.ravel() / noise, values[2:] / before])

    noise = 0.3
    before = np.array([*[_POSITION_PRIOR_FRACTION] * 3, _SCALE_PRIOR_SIGMA])
    start = np.array([coarse, 1e-3, 0.0, 0.0, 0.0, 0.0])
    for _ in range(2):  # again with the estimated noise
        found = least_squares(
            weighted_residual, start, x_scale=[0.01, 1e-3, *[0.01] * 4], loss="soft_l1",
            f_scale=_LOSS_SCALE, jac="3-point", diff_step=[1e-3] * 6,
        )  # fmt: skip
        start = found.x
        residual = noise * weighted_residual(found.x)[: -len(before)].reshape(-1, 2)
        noise = max(1.4826 * float(np.median(np.abs(residual))), _MIN_SIGMA_PX)
    clusters = ((received_s[seen] - received_s[seen][0]) / CLUSTER_S).astype(np.int64)
    evidence = np.asarray(found.jac), found.fun, np.repeat(clusters, 2)
    sigma = np.sqrt(np.diagonal(jackknife_covariance(*evidence, _LOSS_SCALE, len(before))))
    at, scale = target_guess + away * found.x[2:5], 1.0 + float(found.x[5])
    ahead, behind = (
        predicted(found.x[0] + late_s, abs(found.x[1]), at, scale) for late_s in (-0.001, 0.001)
    )
    jitter_s, jitter_sigma_s = _jitter(residual, (ahead - behind) / 0.002, clusters)
    return ImageFit(
        latency_s=float(found.x[0]),
        latency_sigma_s=float(sigma[0]),
        jitter_s=jitter_s,
        jitter_sigma_s=jitter_sigma_s,
        backlash_rad=abs(float(found.x[1])),
        backlash_sigma_rad=float(sigma[1]),
        residual_px=float(np.sqrt(np.mean(residual**2))),
        scale=scale,
        scale_sigma=float(sigma[5]),
        images=len(seen),
    )


def _through_backlash(angles: FloatArray, backlash_rad: float) -> FloatArray:
    """(n,) camera angles behind a backlash, pushed by the encoder's angles."""
    half, out = 0.5 * backlash_rad, []
    joint = float(angles[0])
    for angle in angles.tolist():
        joint = min(max(joint, angle - half), angle + half)
        out.append(joint)
    return np.array(out)


def _jitter(
    residual: FloatArray, velocity: FloatArray, clusters: IntArray
) -> tuple[float | None, float]:
    """Width of the distribution of latencies, None if unobservable, and its standard deviation, s.

    From (n, 2) residuals, px, image velocities of the target, px/s, and (n,) dependent clusters.
    """
    speed = np.linalg.norm(velocity, axis=-1)
    if (speed > _MIN_DELAY_SPEED_PX_S).sum() < 10:
        return None, np.inf
    moving = speed > _MIN_SPEED_PX_S
    residual, velocity, clusters = residual[moving], velocity[moving], clusters[moving]
    speed = speed[moving]
    along = np.sum(residual * velocity, axis=-1) / speed
    # errors of pixels and of the path beside those of time, which grow with speed
    columns = np.stack([np.ones_like(speed), speed**2], axis=-1)
    expected = np.full(len(speed), 1.4826 * float(np.median(np.abs(along)))) ** 2

    def variances(rows: IntArray) -> FloatArray:
        weighted = columns[rows] / expected[rows, None]
        return np.asarray(np.linalg.lstsq(weighted, along[rows] ** 2 / expected[rows])[0])

    for _ in range(_VARIANCE_ROUNDS):
        kept = np.flatnonzero(along**2 < _OUTLIER_SIGMAS**2 * expected)
        found = np.maximum(variances(kept), [_MIN_SIGMA_PX**2, 0.0])
        expected = columns @ found
    parts = np.unique(clusters)
    without = np.array([variances(kept[clusters[kept] != part])[1] for part in parts])
    sigma = float(np.sqrt((len(parts) - 1) * np.mean((without - without.mean()) ** 2)))
    width = float(np.sqrt(12.0 * found[1]))
    return width, float(6.0 * sigma / max(width, np.sqrt(12.0 * sigma)))
