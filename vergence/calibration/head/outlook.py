"""How surely a head that is being calibrated would tell depth by now."""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.adjustment import Poses
from vergence.calibration.head.adjust import HeadAdjustment
from vergence.calibration.head.fit import fitted
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.prior import spreads_of
from vergence.calibration.head.start import started
from vergence.calibration.head.uncertainty import head_covariance
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_views

DEPTHS_M: Final = (1.0, 2.5)
"""Distances of the points straight ahead whose depth is judged."""
_STEP: Final = 1e-3
"""Of finite differences, in standard deviations of each number."""


class Outlook(NamedTuple):
    """A head as a recording says that it is so far."""

    head: HeadModel
    """The head that fits best, near enough."""
    values: FloatArray
    """(p,) its numbers, see `HeadModel.parameters`."""
    boards: Poses
    """(b) in frame 0."""
    depth_percent: FloatArray
    """(2,) standard deviation of the depth of points `DEPTHS_M` ahead that comes from the head's
    numbers, in per cent of it."""


def outlook(head: HeadModel, frames: HeadFrames, before: Outlook | None = None) -> Outlook | None:
    """Fit a head to some frames, as a quick look before the calibration.

    Args:
        head: as its file has it.
        frames: what it saw so far, in the order of time, places numbered without gaps.
        before: what fewer of them told, to begin with.

    Returns:
        What it would tell; None where the frames give no head yet.
    """
    try:
        begin = started(head, frames)
        problem = HeadAdjustment(head, spreads_of(head), begin.frames)
        near = problem.start(begin.boards)
        if before is not None:
            near = near._replace(values=before.values)
        found = fitted(problem, begin.boards, begin.agree, near).solution
        covariance = head_covariance(found)
    except np.linalg.LinAlgError:
        return None
    sigma = depth_sigma(head, found.state.values, covariance)
    values = found.state.values
    if not np.isfinite(sigma).all():
        return None
    return Outlook(found.head, values, found.state.boards, 100.0 * sigma / np.array(DEPTHS_M))


def depth_sigma(about: HeadModel, values: FloatArray, covariance: FloatArray) -> FloatArray:
    """How surely a head at rest tells the depth of points that its eyes look at.

    Pixels and joint angles are taken as exact: what is left are the head's own numbers.

    Args:
        about: the head from which rotations are counted.
        values: (p,) see `HeadModel.parameters`.
        covariance: (p, p) of the values.

    Returns:
        (2,) standard deviations of the distances along N's z axis of points `DEPTHS_M` ahead, m.
    """
    head = about.with_parameters(values)
    ahead = np.array([[0.0, 0.0, depth_m] for depth_m in DEPTHS_M])
    points = ahead + head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    q = head.fixate(points, head.rest()[NECK])
    pixels = head.project(q, points)
    steps = np.diag(_STEP * np.sqrt(np.diagonal(covariance)))
    changed = about.with_parameters((values + np.stack([steps, -steps]))[:, :, None])
    depth = triangulate_views(changed, q, pixels).point[..., 2]
    by_step = (depth[0] - depth[1]) / 2.0  # (p, 2)
    # in units of the steps
    scale = 1.0 / np.diagonal(steps)
    correlation = covariance * scale[:, None] * scale
    squares: FloatArray = np.einsum("id,ij,jd->d", by_step, correlation, by_step)
    return np.sqrt(squares)
