"""Preliminary calibration during a recording, and the depth uncertainty it would give."""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import HeadAdjustment
from vergence.calibration.head.fit import fit_robustly
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.prior import parameter_prior_sigma
from vergence.calibration.head.start import estimate_consensus_board_poses
from vergence.calibration.head.uncertainty import head_and_term_covariance
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.triangulation import triangulate_views

DEPTHS_M: Final = (1.0, 2.5)
"""Distances straight ahead at which depth is judged, m (chosen: the range of use)."""
_STEP_SIGMAS: Final = 1e-3
"""Step of finite differences, in standard deviations of each parameter (numerical)."""


class CalibrationPreview(NamedTuple):
    """Preliminary calibration from the recording so far."""

    head: HeadModel
    """The fitted head."""
    values: FloatArray
    """(p,) its parameters, see `HeadModel.parameters`."""
    boards: BoardPoses
    """(b) poses of the board in frame 0."""
    depth_percent: FloatArray
    """(2,) standard deviation of depth at `DEPTHS_M` ahead that comes from the head's parameters,
    in per cent of the depth."""


def preview_calibration(
    head: HeadModel, frames: HeadFrames, previous: CalibrationPreview | None = None
) -> CalibrationPreview | None:
    """Fit a head to frames so far, from `previous`; None if they do not determine a head yet."""
    try:
        begin = estimate_consensus_board_poses(head, frames)
        problem = HeadAdjustment(head, parameter_prior_sigma(head), begin.frames)
        near = problem.start(begin.boards)
        if previous is not None:
            near = near._replace(head_parameters=previous.values)
        found = fit_robustly(problem, begin.boards, begin.inlier_views, near).solution
        covariance = head_and_term_covariance(found)
    except np.linalg.LinAlgError:
        return None
    sigma = depth_sigma_m(head, found.state.head_parameters, covariance)
    values = found.state.head_parameters
    if not np.isfinite(sigma).all():
        return None
    return CalibrationPreview(
        found.head, values, found.state.boards, 100.0 * sigma / np.array(DEPTHS_M)
    )


def depth_sigma_m(
    nominal_head: HeadModel, values: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(2,) sigma, m, along N's z of points `DEPTHS_M` ahead, from (p, p) covariance alone."""
    head = nominal_head.with_parameters(values)
    ahead = np.array([[0.0, 0.0, depth_m] for depth_m in DEPTHS_M])
    points = ahead + head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    q = head.fixate(points, head.rest()[NECK])
    pixels = head.project(q, points)
    steps = np.diag(_STEP_SIGMAS * np.sqrt(np.diagonal(covariance)))
    changed = nominal_head.with_parameters((values + np.stack([steps, -steps]))[:, :, None])
    depth = triangulate_views(changed, q, pixels).point[..., 2]
    by_step = (depth[0] - depth[1]) / 2.0  # (p, 2)
    # in units of the steps
    scale = 1.0 / np.diagonal(steps)
    correlation = covariance * scale[:, None] * scale
    squares: FloatArray = np.einsum("id,ij,jd->d", by_step, correlation, by_step)
    return np.sqrt(squares)
