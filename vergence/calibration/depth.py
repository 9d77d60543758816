"""Uncertainty of depth by distance, of a calibrated pair."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.calibration.calibrate import Calibration
from vergence.calibration.projection import project
from vergence.calibration.uncertainty import point_covariances
from vergence.models.parts import FloatArray

BASELINES: Final = (3.0, 100.0)
"""Distances shown reach from and to so many baselines..."""
NEAR_M, FAR_M = 0.2, 5.0
"""...and at least over these, m."""


@dataclass(frozen=True, eq=False)
class DepthSigma:
    """Standard deviations of depth along the pair's middle axis."""

    distance_m: FloatArray
    """(n) from the middle of the baseline."""
    calibration_m: FloatArray
    """(n) from errors of the calibration, the same in every pair of images."""
    noise_m: FloatArray
    """(n) from the noise of one pair of images; nan for points that one camera does not see."""

    @property
    def total_m(self) -> FloatArray:
        """(n) from both."""
        return np.asarray(np.hypot(self.calibration_m, self.noise_m))


def pixel_noise_px(found: Calibration) -> float:
    """Standard deviation of a detected corner, each coordinate: what each camera leaves alone."""
    return float(np.sqrt(0.5 * np.mean(np.square(found.rms_alone_px))))


def depths_shown(found: Calibration) -> FloatArray:
    """(n) distances for a figure, m, evenly on a logarithmic scale."""
    baseline = float(np.linalg.norm(found.rig.translation))
    near, far = min(NEAR_M, BASELINES[0] * baseline), max(FAR_M, BASELINES[1] * baseline)
    return np.geomspace(near, far, 80)


def depth_sigma_at(found: Calibration, distance_m: FloatArray) -> DepthSigma:
    """Predict how surely depth is told along the axis in the middle between both cameras'.

    Args:
        found: a pair's calibration.
        distance_m: (n) from the middle of the baseline.

    Returns:
        Standard deviations; nan where a point is outside of an image.
    """
    rig = found.rig
    axis = np.array([0.0, 0.0, 1.0]) + rig.rotation[2]
    axis /= np.linalg.norm(axis)
    middle = -0.5 * rig.rotation.T @ rig.translation
    points = middle + distance_m[:, None] * axis
    covariances = point_covariances(
        found.fit.solution, found.covariance, points, pixel_noise_px(found)
    )
    inside = _in_both(found, points)
    calibration, noise = (
        np.where(inside, np.sqrt(np.einsum("i,nij,j->n", axis, each, axis)), np.nan)
        for each in covariances
    )
    return DepthSigma(distance_m, calibration, noise)


def _in_both(found: Calibration, points: FloatArray) -> FloatArray:
    """(n) whether both cameras see points (n, 3) of the left camera's frame."""
    rig = found.rig
    inside = np.ones(len(points), bool)
    for camera, size in enumerate(found.seen.sizes):
        mine = points @ rig.rotation.T + rig.translation if camera else points
        pixels = project(rig.lenses[camera], rig.values[camera], mine).pixels
        inside &= ((pixels > -0.5) & (pixels < np.array(size) - 0.5)).all(axis=-1)
    return inside
