"""Depth uncertainty of a calibrated pair against distance."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.calibration.calibrate import Calibration
from vergence.calibration.projection import project_with_jacobians
from vergence.calibration.uncertainty import triangulation_covariances
from vergence.models.parts import FloatArray

BASELINES: Final = (3.0, 100.0)
"""Nearest and farthest distance of the figure, in baselines (chosen: the range of use)."""
NEAR_M: Final = 0.2
"""Distance from which on the figure reaches in any case, m (chosen: the range of use)."""
FAR_M: Final = 5.0
"""Distance up to which the figure reaches in any case, m (chosen: the range of use)."""


@dataclass(frozen=True, eq=False)
class DepthSigma:
    """Standard deviations of depth along the pair's middle axis; nan outside either image."""

    distance_m: FloatArray
    """(n) distance from the middle of the baseline."""
    calibration_m: FloatArray
    """(n) contribution of calibration errors, which are the same in every pair of images."""
    noise_m: FloatArray
    """(n) contribution of the noise of one pair of images."""

    @property
    def total_m(self) -> FloatArray:
        """(n) root sum square of both contributions."""
        return np.asarray(np.hypot(self.calibration_m, self.noise_m))


def pixel_noise_px(calibration: Calibration) -> float:
    """Estimate a detected corner's standard deviation per coordinate from each camera alone."""
    return float(np.sqrt(0.5 * np.mean(np.square(calibration.rms_alone_px))))


def depths_to_plot_m(calibration: Calibration) -> FloatArray:
    """(n) distances for a figure, m, evenly spaced on a logarithmic scale."""
    baseline = float(np.linalg.norm(calibration.rig.translation))
    near, far = min(NEAR_M, BASELINES[0] * baseline), max(FAR_M, BASELINES[1] * baseline)
    return np.geomspace(near, far, 80)


def depth_sigma_at(calibration: Calibration, distance_m: FloatArray) -> DepthSigma:
    """Uncertainty of depth along the bisector of the axes, (n) m from the baseline's middle."""
    rig = calibration.rig
    axis = np.array([0.0, 0.0, 1.0]) + rig.rotation[2]
    axis /= np.linalg.norm(axis)
    middle = -0.5 * rig.rotation.T @ rig.translation
    points = middle + distance_m[:, None] * axis
    covariances = triangulation_covariances(
        calibration.fit.solution, calibration.covariance, points, pixel_noise_px(calibration)
    )
    inside = _in_both(calibration, points)
    calibration_sigma, noise_sigma = (
        np.where(inside, np.sqrt(np.einsum("i,nij,j->n", axis, each, axis)), np.nan)
        for each in covariances
    )
    return DepthSigma(distance_m, calibration_sigma, noise_sigma)


def _in_both(calibration: Calibration, points: FloatArray) -> FloatArray:
    """(n) True for points (n, 3) in the left camera's frame that are inside both images."""
    rig = calibration.rig
    inside = np.ones(len(points), bool)
    for camera, size in enumerate(calibration.observations.image_sizes):
        mine = points @ rig.rotation.T + rig.translation if camera else points
        pixels = project_with_jacobians(
            rig.lenses[camera], rig.camera_parameters[camera], mine
        ).pixels
        inside &= ((pixels > -0.5) & (pixels < np.array(size) - 0.5)).all(axis=-1)
    return inside
