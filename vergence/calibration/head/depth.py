"""Predicted depth errors of a calibrated head that fixates points, by direction and distance."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.models.parts import FloatArray
from vergence.models.posture import fixation_angles_and_visibility, midpoint_between_cameras
from vergence.triangulation import triangulate_views

_STEP_SIGMAS: Final = 1e-3
"""Step of a central difference, in prior standard deviations of a parameter: far above rounding,
with a square far below 1 (numerical)."""


@dataclass(frozen=True, eq=False)
class DepthErrors:
    """Errors along the line from midway between the eyes to fixated points; nan if out of reach."""

    distance_m: FloatArray
    """(n,) distance from midway between the eyes."""
    nominal_error_m: FloatArray
    """(n,) depth error of the nominal head, taking the calibrated head as the truth; positive if
    the triangulated point is too far."""
    nominal_error_norm_m: FloatArray
    """(n,) length of the nominal head's error in all three directions."""
    sigma_m: FloatArray
    """(n,) standard deviation of depth from the uncertainty of the calibration."""
    noise_floor_m: FloatArray
    """(n,) standard deviation of depth of a single settled fixation from the noise of pixels and
    encoders."""

    @property
    def nominal_error_percent(self) -> FloatArray:
        """(n,) depth error of the nominal head, percent of the distance."""
        return np.asarray(1e2 * self.nominal_error_m / self.distance_m)

    @property
    def sigma_percent(self) -> FloatArray:
        """(n,) standard deviation of depth from the calibration, percent of the distance."""
        return np.asarray(1e2 * self.sigma_m / self.distance_m)


def points_ahead(distance_m: FloatArray) -> FloatArray:
    """(n, 3) points straight ahead, m."""
    return np.asarray(distance_m[:, None] * np.array([0.0, 0.0, 1.0]))


def points_at_angles(distance_m: float, right_rad: FloatArray, down_rad: FloatArray) -> FloatArray:
    """(n, 3) points at one distance, turned to the right and then down by angles (n,), m."""
    return np.asarray(
        distance_m
        * np.column_stack(
            [
                np.sin(right_rad) * np.cos(down_rad),
                np.sin(down_rad),
                np.cos(right_rad) * np.cos(down_rad),
            ]
        )
    )


def predict_depth_errors(
    calibration: HeadCalibration, points_from_eyes_m: FloatArray
) -> DepthErrors:
    """Predict the errors of depth of the nominal head, and those that the calibration leaves.

    The calibrated head fixates each point; the nominal and the calibrated head triangulate it from
    the same joint angles and pixels. The uncertainty is to first order in the head's parameters,
    with derivatives by central differences.

    Args:
        calibration: the calibration.
        points_from_eyes_m: (n, 3) points relative to midway between the eyes, in N with the neck at
            rest, m.
    """
    head = calibration.head
    points = midpoint_between_cameras(head) + points_from_eyes_m
    distance = np.linalg.norm(points_from_eyes_m, axis=-1)
    along = points_from_eyes_m / distance[:, None]
    q, sees = fixation_angles_and_visibility(head, points)
    pixels = head.project(q, points)
    fix = triangulate_views(head, q, pixels)
    off = triangulate_views(calibration.nominal_head, q, pixels).point - points
    free = calibration.solution.problem.prior_sigma > 0.0
    steps = _STEP_SIGMAS * np.diag(calibration.solution.problem.prior_sigma)[free]
    values = calibration.solution.state.head_parameters + np.stack([steps, -steps])
    moved = triangulate_views(
        calibration.nominal_head.with_parameters(values[:, :, None]), q, pixels
    ).point
    depth = np.einsum("snpi,pi->snp", moved, along)
    depth_derivatives = (depth[0] - depth[1]) / (2.0 * steps.sum(axis=1))[:, None]
    spread = np.einsum(
        "np,nm,mp->p",
        depth_derivatives,
        calibration.covariance[np.ix_(free, free)],
        depth_derivatives,
    )
    floor = np.einsum("pi,pij,pj->p", along, fix.covariance, along)
    return DepthErrors(
        distance,
        *(
            np.where(sees, values, np.nan)
            for values in (
                (off * along).sum(axis=-1),
                np.linalg.norm(off, axis=-1),
                np.sqrt(spread),
                np.sqrt(floor),
            )
        ),
    )
