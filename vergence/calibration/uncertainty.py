r"""How surely cameras are known that a bundle adjustment has found.

If the residuals of all corners were independent, the covariance would be s^2 (J'^T J')^-1 with the
noise s (see `adjustment`). Those of one view are not where its board was bent or moved between two
exposures, so each view's pull on the cameras, u_v = S^-1/2 J'_v^T r_v with S the sum of
S_v = J'_v^T J'_v, is compared with what that covariance says: with H_v = S^-1/2 S_v S^-1/2,

    cov(u_v) = s^2 (H_v - H_v^2),   so that   sum of (1 - H_v)^-1/2 u_v (...)^T   is s^2 on average

(the CR2 estimate of Bell and McCaffrey 2002). If the pulls are surely greater, their own
covariance takes the place of independent corners', so far as there are views enough to tell it: of
v views and p numbers by the share v / (v + p), the rest being s^2 as many times as the pulls say.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from vergence.calibration.adjustment import Adjustment, Poses, Solution, cross_matrices
from vergence.calibration.projection import project
from vergence.models.parts import FloatArray

_LEAST_VALUE: Final = 1e-15
"""Of a correlation's eigenvalues: a combination of numbers that nothing tells."""
_LEAST_SHARE: Final = 1e-3
"""Of 1 - H_v: a view that alone tells a number has no residual to tell its error by."""
_SURELY: Final = 2.0
"""Standard deviations by which pulls exceed what is expected before they count."""


def covariance_of(solution: Solution) -> FloatArray:
    """(p, p) covariance of the rig's numbers, see `Rig.packed`.

    Args:
        solution: the cameras and how they were found.
    """
    gradients = np.einsum("vmp,vm->vp", solution.by_rig, solution.linear.residuals)
    return clustered_covariance(
        solution.information, gradients, solution.noise, np.diag(solution.rig.prior)
    )


def clustered_covariance(
    information: FloatArray, gradients: FloatArray, noise: float, prior: FloatArray
) -> FloatArray:
    """(p, p) covariance of numbers that several groups of measurements tell.

    Args:
        information: (v, p, p) S_v of each group, in which errors may go together.
        gradients: (v, p) J'_v^T r_v of each group.
        noise: s.
        prior: (p, p) what is known besides, as information.
    """
    total = information.sum(axis=0) + prior
    scale = 1.0 / np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(scale[:, None] * total * scale)
    root = (scale[:, None] * vectors) / np.sqrt(np.maximum(values, _LEAST_VALUE))
    shares, axes = np.linalg.eigh(root.T @ information @ root)
    left = np.maximum(1.0 - shares, _LEAST_SHARE)
    pulls = np.einsum("vij,vj,vkj,vk->vi", axes, left**-0.5, axes, gradients @ root) / noise
    # what it is on average, and the deviation of its sum of squares, if corners are independent
    expected = np.einsum("vij,vj,vkj->vik", axes, (1.0 - shares) * shares / left, axes)
    mean = np.trace(expected, axis1=1, axis2=2).sum()
    ratio = (pulls**2).sum() / mean
    spread = np.sqrt(2.0 * (expected**2).sum()) / mean
    inner = np.eye(len(root))
    if ratio > 1.0 + _SURELY * spread:
        weight = len(pulls) / (len(pulls) + len(root))
        inner = weight * pulls.T @ pulls + (1.0 - weight) * ratio * inner
    return np.asarray(noise**2 * root @ inner @ root.T)


def direction_sigma_px(
    solution: Solution, covariance: FloatArray, camera: int, rays: FloatArray
) -> FloatArray:
    """How surely a camera tells directions, in pixels where it sees them.

    A turn of the camera's frame is no error of its directions, so the camera is turned to where
    the corners that it saw move least (as "fit" in the projection uncertainty of mrcal, Kogan).

    Args:
        solution: the cameras and how they were found.
        covariance: (p, p) see `covariance_of`.
        camera: which one.
        rays: (n, 2) X / Z, Y / Z in that camera.

    Returns:
        (n) standard deviation, px: the root mean square of those along u and along v.
    """
    lens, values = solution.rig.lenses[camera], solution.rig.values[camera]
    block = solution.rig.blocks[camera]
    points = points_of(solution, camera)[solution.problem.seen[camera]]
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
    seen = project(lens, values, points)
    return -seen.by_point @ cross_matrices(points), seen.by_camera


def points_of(solution: Solution, camera: int) -> FloatArray:
    """(v, n, 3) the board's corners in a camera's frame, metres."""
    rig = solution.rig
    points = solution.problem.points(rig, solution.poses)
    return points @ rig.rotation.T + rig.translation if camera else points


def point_covariances(
    solution: Solution, covariance: FloatArray, points: FloatArray, noise_px: float
) -> tuple[FloatArray, FloatArray]:
    """How surely two cameras tell where points are.

    Args:
        solution: two cameras and how they were found.
        covariance: (p, p) see `covariance_of`.
        points: (n, 3) in the left camera's frame, metres.
        noise_px: standard deviation of a detected pixel, each coordinate.

    Returns:
        Two covariances (n, 3, 3), m^2: from errors of the calibration, which are the same in every
        image, and from the noise of one pair of images.
    """
    one = Adjustment(points[:1], np.zeros((2, 1, 1, 2)), np.ones((2, 1, 1, 2)))
    still = Poses(np.eye(3)[None], np.zeros((1, 3)))
    of_calibration, of_noise = [], []
    for point in points:
        linear = replace(one, board=point[None]).linearised(solution.rig, still)
        by_point, by_rig = linear.by_pose[0, :, 3:], linear.by_rig[0]
        spread = np.linalg.inv(by_point.T @ by_point)
        moved = spread @ by_point.T @ by_rig
        of_calibration.append(moved @ covariance @ moved.T)
        of_noise.append(noise_px**2 * spread)
    return np.array(of_calibration), np.array(of_noise)
