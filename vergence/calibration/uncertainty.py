r"""Covariance of the cameras that a bundle adjustment has found, robust to correlated residuals.

If the residuals of all corners were independent, the covariance would be s^2 (J'^T J')^-1 with the
noise s (see `adjustment`). The residuals of one view are correlated if its board was bent or moved
between two exposures. Therefore each view's normalised gradient, its pull on the cameras,
u_v = S^-1/2 J'_v^T r_v with S the sum of S_v = J'_v^T J'_v, is compared with the covariance that
independent corners imply: with H_v = S^-1/2 S_v S^-1/2,

    cov(u_v) = s^2 (H_v - H_v^2),   so that   sum of (1 - H_v)^-1/2 u_v (...)^T   is s^2 on average

(the CR2 estimator of Bell and McCaffrey 2002). If the pulls are significantly larger, a mixture
replaces the covariance of independent corners: with v views and p parameters, the pulls' own
covariance with weight v / (v + p), and s^2 scaled up to the size of the pulls with the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import (
    BundleSolution,
    CameraRig,
    cross_matrices,
    project_with_jacobians,
)
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_views

_LEAST_EIGENVALUE: Final = 1e-15
"""Least eigenvalue of the scaled information matrix; a smaller one belongs to a combination of
parameters that is not observable (numerical)."""
_LEAST_LEVERAGE_COMPLEMENT: Final = 1e-3
"""Least eigenvalue of 1 - H_v: a view that alone determines a parameter leaves no residual from
which to estimate its error (numerical)."""
_STEP_SIGMAS: Final = 1e-3
"""Step of finite differences, in standard deviations of each parameter (numerical)."""
_SIGNIFICANT_SIGMAS: Final = 2.0
"""Standard deviations by which the pulls have to exceed their expectation before their covariance
is used (chosen)."""


def rig_covariance(solution: BundleSolution) -> FloatArray:
    """(p, p) covariance of the rig's parameters, see `CameraRig.packed`."""
    return clustered_covariance(
        *solution.view_parts, solution.reduced_chi, np.diag(solution.rig.prior_information)
    )


def clustered_covariance(
    information: FloatArray, gradients: FloatArray, reduced_chi: float, prior: FloatArray
) -> FloatArray:
    """(p, p) CR2, from (v, p, p) S_v and (v, p) J'_v^T r_v by group; `reduced_chi` is s."""
    total = information.sum(axis=0) + prior
    scale = 1.0 / np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(scale[:, None] * total * scale)
    root = (scale[:, None] * vectors) / np.sqrt(np.maximum(values, _LEAST_EIGENVALUE))
    shares, axes = np.linalg.eigh(root.T @ information @ root)
    left = np.maximum(1.0 - shares, _LEAST_LEVERAGE_COMPLEMENT)
    pulls = np.einsum("vij,vj,vkj,vk->vi", axes, left**-0.5, axes, gradients @ root) / reduced_chi
    # expected covariance of the pulls, and spread of their sum of squares, for independent corners
    expected = np.einsum("vij,vj,vkj->vik", axes, (1.0 - shares) * shares / left, axes)
    mean = np.trace(expected, axis1=1, axis2=2).sum()
    ratio = (pulls**2).sum() / mean
    spread = np.sqrt(2.0 * (expected**2).sum()) / mean
    inner = np.eye(len(root))
    if ratio > 1.0 + _SIGNIFICANT_SIGMAS * spread:
        weight = len(pulls) / (len(pulls) + len(root))
        inner = weight * pulls.T @ pulls + (1.0 - weight) * ratio * inner
    return np.asarray(reduced_chi**2 * root @ inner @ root.T)


def direction_sigma_px(
    solution: BundleSolution, covariance: FloatArray, camera: int, rays: FloatArray
) -> FloatArray:
    """(n,) sigma, px, rms along u and v, of directions (n, 2), X / Z and Y / Z, in a camera."""
    # A rotation of the camera's frame is no error of its directions. The one that moves the
    # measured corners least is removed (as "fit" in the projection uncertainty of mrcal, Kogan).
    lens, values = solution.rig.lenses[camera], solution.rig.camera_parameters[camera]
    block = solution.rig.blocks[camera]
    points = board_points_in_camera(solution, camera)[solution.problem.seen[camera]]
    seen_turn, seen_values = _by_turn_and_values(lens, values, points / points[:, 2:])
    turn = np.linalg.lstsq(
        seen_turn.reshape(-1, 3), -seen_values.reshape(-1, len(values)), rcond=None
    )[0]
    by_turn, by_values = _by_turn_and_values(lens, values, np.insert(rays, 2, 1.0, axis=1))
    moved = by_values + by_turn @ turn
    spread = np.einsum("nip,pq,niq->n", moved, covariance[block, block], moved)
    return np.asarray(np.sqrt(0.5 * spread))


def _by_turn_and_values(
    lens: str, values: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    seen = project_with_jacobians(lens, values, points)
    return -seen.point_jacobian @ cross_matrices(points), seen.camera_jacobian


def board_points_in_camera(solution: BundleSolution, camera: int) -> FloatArray:
    """(v, n, 3) the board's corners in a camera's frame, metres."""
    points = solution.problem.points(solution.rig, solution.poses)
    return solution.rig.in_camera(camera, points)


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


def depth_sigma_at(
    solution: BundleSolution, covariance: FloatArray, sizes: Sequence[tuple[int, int]],
    noise_px: float, distance_m: FloatArray,
) -> DepthSigma:  # fmt: skip
    """Uncertainty of depth along the bisector of a pair's axes.

    Args:
        solution: the pair's calibration.
        covariance: (p, p) covariance of the rig's parameters.
        sizes: size of both images, px.
        noise_px: standard deviation of one pair's pixels.
        distance_m: (n) distances from the baseline's middle.
    """
    rig = solution.rig
    axis = np.array([0.0, 0.0, 1.0]) + rig.rotation[2]
    axis /= np.linalg.norm(axis)
    points = -0.5 * rig.rotation.T @ rig.translation + distance_m[:, None] * axis
    by_point, by_rig = np.zeros((len(points), 4, 3)), np.zeros((len(points), 4, len(covariance)))
    inside = np.ones(len(points), bool)
    for camera, size in enumerate(sizes):
        (seen, columns), rows = rig.project(camera, points), slice(2 * camera, 2 * camera + 2)
        inside &= ((seen.pixels > -0.5) & (seen.pixels < np.array(size) - 0.5)).all(axis=-1)
        by_point[:, rows] = seen.point_jacobian
        by_rig[:, rows, columns] = seen.camera_jacobian
    sigma = np.full((2, len(points)), np.nan)
    by_point, by_rig = by_point[inside], by_rig[inside]
    turned = by_point.swapaxes(-1, -2)
    along = axis @ np.linalg.inv(turned @ by_point)
    by_rig = ((along[:, None] @ turned) @ by_rig)[:, 0]
    sigma[0, inside] = np.sqrt(np.einsum("np,pq,nq->n", by_rig, covariance, by_rig))
    sigma[1, inside] = noise_px * np.sqrt(along @ axis)
    return DepthSigma(distance_m, *sigma)


def depth_sigma_by_head(
    nominal_head: HeadModel, values: FloatArray, sigma: FloatArray, covariance: FloatArray,
    views: tuple[FloatArray, FloatArray], along: FloatArray,
) -> FloatArray:  # fmt: skip
    """Uncertainty of depth by that of a head's parameters, to first order.

    Args:
        nominal_head: the head before its calibration.
        values: (p,) its calibrated parameters, see `HeadModel.parameters`.
        sigma: (p,) size of their deviations, for finite differences; 0 for exact ones.
        covariance: (p, p) their covariance.
        views: (n, j) joint angles, and pixels, from which the points are triangulated.
        along: (n, 3) directions of depth.

    Returns:
        (n,) standard deviation of depth, m.
    """
    free = np.flatnonzero(sigma)
    steps = _STEP_SIGMAS * np.diag(sigma)[free]
    moved = nominal_head.with_parameters((values + np.stack([steps, -steps]))[:, :, None])
    depth = np.einsum("snpi,pi->snp", triangulate_views(moved, *views).point, along)
    by_value = (depth[0] - depth[1]) / (2.0 * steps.sum(axis=1))[:, None]
    inner = covariance[np.ix_(free, free)]
    return np.asarray(np.sqrt(np.einsum("np,nm,mp->p", by_value, inner, by_value)))


def right_camera_pose_covariance(rig: CameraRig, covariance: FloatArray) -> FloatArray:
    """(6, 6) of r, p in (R^T exp([r]), p = -R^T T), rad, m, from `x_right = R x_left + T`."""
    vector = Rotation.from_matrix(rig.rotation).as_rotvec()
    by_vector = np.asarray(cv2.Rodrigues(vector)[1]).reshape(3, 3, 3)
    # R(v + d) = exp([J d]) R(v)
    spins = by_vector @ rig.rotation.T
    turning = np.stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]])
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -turning
    jacobian[3:, :3] = -rig.rotation.T @ cross_matrices(rig.translation) @ turning
    jacobian[3:, 3:] = -rig.rotation.T
    return np.asarray(jacobian @ covariance @ jacobian.T)
