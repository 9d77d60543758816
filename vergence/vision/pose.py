r"""Pose of a flat target from its corners in one or two images, with its covariance.

Minimised is the reprojection error of the corners in undistorted image coordinates, each weighted
by the covariance of its pixel (maximum likelihood for Gaussian noise), over the pose T_X_T and the
errors e of the cameras' own poses, which both eyes share:

    chi^2 = sum_v |W_v (pi(T_Cv_X(e) T_X_T P) - ray_v)|^2 + |e|^2,    W_v^T W_v = C_v^-1

by Levenberg-Marquardt from the two solutions of IPPE (Collins & Bartoli 2014, Infinitesimal
Plane-Based Pose Estimation) in each image. The corners are undistorted once; C_v is the pixels'
covariance, carried through the derivative of the undistortion. The covariance of the pose is its
block of the inverse normal matrix at the minimum, to first order in the noise.

A small or distant flat target has a second minimum, about a mirror image of its tilt. The odds of
both are exp(half the difference of their chi-squares), for equal prior odds. The detector's sigmas
may be too small, so the difference is first divided by a variance factor: the mean of squared
residuals, to which a few squares of twice the stated sigma are added. For the four corners of a tag
these dominate; for a board the residuals do.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import exp, inf, log
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.operands import as_operand

_LEAST_ODDS: Final = 99.0
"""Odds of the better solution from which the other one is not named: a probability of 0.99
(chosen: tilts that are wrong against solutions that nobody needs)."""
_PRIOR_VARIANCE_FACTOR: Final = 4.0
"""Variance factor assumed without residuals: sigmas half as large as the errors (measured:
docs/vision.md has up to 1.6 times)."""
_PRIOR_SQUARES: Final = 4.0
"""Number of squared residuals that this assumption counts for (chosen: twice a tag's own two)."""
_LEAST_TURN_RAD: Final = 1e-3  # least rotation between two distinct minima (numerical)
_LEAST_WIDTH: Final = 1e-6
"""Distance to 1 of a corner's leverage, which is 1 if all others are on a line (numerical)."""
_RIDGE: Final = 1e-9 * np.eye(3)  # makes the leverages of corners on a line sum up to 2 (numerical)
_LEAST_SIZE_RATIO: Final = 1e-3  # first guess where the lines to the target diverge (numerical)
_MOST_STEPS: Final = 50  # limit of steps, which damping alone can reach (numerical)
_DAMPING: Final = 1e-5  # first damping, as a share of the normal matrix's diagonal (numerical)
_DAMPING_RATIO: Final = 10.0  # change of the damping after each step (numerical)
_LEAST_DECREASE: Final = 1e-9
"""Expected decrease of chi^2 below which a minimum is reached: 3e-5 sigma (numerical)."""
_HOPELESS_RATIO: Final = 100.0
"""A start is given up if its chi^2 + 1 will remain above this ratio times the least one (chosen:
far above the odds of a second solution, against time)."""
_RAY_STEP: Final = 1e-5  # half step of the lens's derivative, as a slope (numerical)
_AROUND: Final = _RAY_STEP * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_CROSS: Final = np.cross(np.eye(3), np.eye(3)[:, None]).swapaxes(1, 2).reshape(3, 9)
"""v @ _CROSS is the matrix of w -> w x v, row by row."""


class Pose(NamedTuple):
    """Pose of a target."""

    matrix: FloatArray
    """(4, 4) T_X_T, metres."""
    covariance: FloatArray
    """(6, 6) of the translation, m, and the rotation vector w, rad, both in X: the true rotation is
    exp([w]) times that of `matrix`."""
    chi_square: float
    """Sum of squared residuals, divided by their variances; about `degrees` if the sigmas hold."""
    degrees: int
    """Degrees of freedom of the residuals."""
    size_ratio: float = 1.0
    """Size of the target over the assumed one; 1 where it is known or cannot be measured."""
    other: "Pose | None" = None
    """The second solution, where the data do not rule it out with a probability of 0.99; the better
    one comes first, and each has its own covariance. Both see the target at nearly the same place
    with another tilt."""

    @property
    def sigma(self) -> FloatArray:
        """(6,) standard deviations of translation, m, and rotation vector, rad."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def rotation_vector(self) -> FloatArray:
        """(3,) axis times angle of the rotation from X to T, rad, angle from 0 to pi."""
        return np.asarray(cv2.Rodrigues(self.matrix[:3, :3])[0].ravel())


class View(NamedTuple):
    """Corners of a target in one image."""

    camera: Camera
    corners_px: ArrayLike
    """(n, 2) in the order of the target's corners; nan for those not detected."""
    noise: ArrayLike
    """(n, 2) standard deviations of independent coordinates, px; or (2 n, 2 n) their covariance,
    px^2, in the order u_0, v_0, u_1, ... Corners without finite values count as not detected."""
    pose: ArrayLike = np.eye(4)
    """(4, 4) T_X_C; the identity gives the target's pose in the camera."""
    pose_errors: ArrayLike = np.zeros((6, 0))
    """(6, k) motions of the camera, translation of X's origin in m and rotation vector in rad, both
    in X, by one standard deviation of each of k independent errors, common to all views."""


def eye_views(
    head: HeadModel,
    q: ArrayLike,
    corners_px: Sequence[ArrayLike],
    noise: Sequence[ArrayLike],
    joint_rad: ArrayLike = 0.0,
) -> tuple[View, View]:
    """Views of both eyes of a head, for a pose in its frame N.

    Args:
        head: one head, not a population.
        q: (7,) joint angles at the exposure, rad.
        corners_px: (n, 2) by eye, see `View`.
        noise: by eye, see `View`.
        joint_rad: standard deviation of actuator angles, rad: a scalar, or (7,), see
            `vergence.Noise`. Those of the neck do not matter in N.

    Raises:
        ConfigurationError: an argument has another shape.
    """
    q = as_operand("q", q, 7)
    # Poses are a + b cos(angle) + c sin(angle) of each joint: a half turn apart, exact derivatives.
    quarter = 0.5 * np.pi * np.eye(7)[EYES]
    poses = head.camera_poses(q)
    rates = 0.5 * (head.camera_poses(q + quarter) - head.camera_poses(q - quarter))
    spin = rates[..., :3, :3] @ poses[..., :3, :3].swapaxes(-1, -2)
    turns = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    shifts = rates[..., :3, 3] - (spin @ poses[..., :3, 3:])[..., 0]
    twists = np.concatenate([shifts, turns], axis=-1)
    sigma = np.broadcast_to(as_operand("joint_rad", joint_rad), 7)[EYES]
    moved = np.moveaxis(twists, 0, -1) @ (head.actuation.to_joints * sigma)
    left, right = (
        View(head.cameras[eye], corners_px[eye], noise[eye], poses[eye], moved[eye])
        for eye in range(2)
    )
    return left, right


def estimate_pose(
    corners_m: ArrayLike, views: Sequence[View], *, size_known: bool = True
) -> Pose | None:
    """Estimate the pose of a flat target.

    Args:
        corners_m: (n, 2) corners in the target's frame T, metres, see `AprilTag.corners_m`.
        views: one image, or several at the same instant, see `View` and `eye_views`.
        size_known: False if the corners hold only up to a factor (`AprilTag.size_known`). Images
            from different places then give the size too (`Pose.size_ratio`), and the pose is in
            metres. A single one does not: rotation and direction hold, but the translation and its
            sigma are proportional to the assumed size.

    Returns:
        The pose in the frame X of the views; None if no view has four corners that determine it
        (without any one of them, the others must not be on a line), if none is in front, or if
        they contradict each other so much that no pose is a minimum.

    Raises:
        ConfigurationError: an array has another shape, or a noise is not positive.
    """
    corners = as_operand("corners_m", corners_m, "n", 2)
    eyes = [eye for eye in (_look(corners, view) for view in views) if len(eye.rays)]
    starts = [(eye, *solution) for eye in eyes for solution in _ippe(eye)]
    if not starts:
        return None
    (first, _, near), (last, _, far), ratio = starts[0], starts[-1], 1.0
    sized = not size_known and bool((eyes[0].pose[:, 3] != eyes[-1].pose[:, 3]).any())
    if sized and first is not last:  # the lines to the target from both ends meet at this size
        baseline = last.pose[:, 3] - first.pose[:, 3]
        apart = near - far + baseline
        ratio = max(float(apart @ baseline / (apart @ apart)), _LEAST_SIZE_RATIO)
    more = np.zeros((len(starts), eyes[0].errors.shape[1] + sized))
    more[:, len(more[0]) - sized :] = log(ratio)
    origins = np.array([eye.pose[:, 3] for eye, _, _ in starts])
    places = origins + ratio * (np.array([place for _, _, place in starts]) - origins)
    states = _States(np.array([turn for _, turn, _ in starts]), places, more)
    degrees = sum(2 * len(eye.rays) for eye in eyes) - 6 - sized
    try:
        return _best(*_minimise(eyes, sized, states), degrees, sized)
    except np.linalg.LinAlgError:  # views that contradict each other move it out of sight
        return None


class _Eye(NamedTuple):
    """The detected corners of a view, undistorted."""

    corners: FloatArray  # (n, 3) in T, m
    rays: FloatArray  # (n, 2)
    whitener: FloatArray  # (n, 2, 2) of independent corners, (1, 2 n, 2 n) of correlated ones
    pose: FloatArray  # (3, 4) T_X_C
    errors: FloatArray  # (6, k), see `View`


def _look(corners_m: FloatArray, view: View) -> _Eye:
    """Undistort the corners of a view, and find what makes their errors of unit variance."""
    count, camera = len(corners_m), view.camera
    pixels = as_operand("corners_px", view.corners_px, count, 2)
    noise = as_operand("noise", view.noise)
    correlated = noise.shape == (2 * count, 2 * count)
    if not correlated and noise.shape != (count, 2):
        raise ConfigurationError(
            f"noise: expected sigmas of shape {(count, 2)} or a covariance of shape "
            f"{(2 * count, 2 * count)}, got {noise.shape}"
        )
    own = np.diagonal(noise).reshape(count, 2) if correlated else noise
    if (own <= 0.0).any():
        raise ConfigurationError(f"noise: expected positive values, got {np.nanmin(own):g}")
    rays = camera.rays(pixels)
    around = np.pad(rays[:, None] + _AROUND, ((0, 0), (0, 0), (0, 1)), constant_values=1.0)
    around = camera.project(around.reshape(-1, 3)).reshape(count, 2, 2, 2)
    by_ray = ((around[:, 0] - around[:, 1]) / (2.0 * _RAY_STEP)).swapaxes(1, 2)
    seen = np.isfinite(rays + own + by_ray.sum(axis=2)).all(axis=1)
    blocks = np.square(own[seen, :, None]) * np.eye(2)
    if correlated:
        both = np.repeat(seen, 2)
        blocks = noise[None, both][:, :, both]
    try:
        whitener = np.linalg.inv(np.linalg.cholesky(blocks))
    except np.linalg.LinAlgError as error:
        raise ConfigurationError("noise: expected a positive definite covariance") from error
    count, size, _ = blocks.shape
    by_ray = by_ray[seen].reshape(count, 1, size // 2, 2, 2)
    whitener = whitener.reshape(count, size, size // 2, 1, 2) @ by_ray
    return _Eye(
        np.pad(corners_m[seen], ((0, 0), (0, 1))),
        rays[seen],
        whitener.reshape(blocks.shape),
        as_operand("pose", view.pose, 4, 4)[:3],
        as_operand("pose_errors", view.pose_errors, 6, "k"),
    )


def _ippe(eye: _Eye) -> list[tuple[FloatArray, FloatArray]]:
    """The two rotations and places in X of IPPE; none for corners that do not determine them."""
    if not _determine_pose(eye.corners.tobytes()):
        return []
    found = cv2.solvePnPGeneric(eye.corners, eye.rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    back, origin = eye.pose[:, :3], eye.pose[:, 3]
    return [
        (back @ cv2.Rodrigues(turn)[0], back @ place[:, 0] + origin)
        for turn, place in zip(found[1], found[2], strict=True)
    ]


@lru_cache(maxsize=64)
def _determine_pose(corners_m: bytes) -> bool:
    """True for four corners or more that are not on a line, with or without any one of them."""
    plane = np.frombuffer(corners_m).reshape(-1, 3)[:, :2]
    if len(plane) < 4:
        return False
    plane = (plane - plane.mean(axis=0)) / max(float(np.abs(plane).max()), 1e-300)
    plane = np.column_stack([plane, np.ones(len(plane))])
    leverage = (plane @ np.linalg.inv(plane.T @ plane + _RIDGE) * plane).sum(axis=1)
    return bool(leverage.sum() > 2.5 and leverage.max() < 1.0 - _LEAST_WIDTH)


class _States(NamedTuple):
    """Points of the search, one from each start."""

    turn: FloatArray  # (s, 3, 3) rotation of T_X_T
    place: FloatArray  # (s, 3) its translation
    more: FloatArray  # (s, k) errors of the cameras, then the logarithm of a size that is sought


def _minimise(eyes: Sequence[_Eye], sized: bool, states: _States) -> tuple[_States, FloatArray]:
    """Move each state to a minimum (Levenberg-Marquardt); also the normal matrices there."""
    normals = _normal_matrices(eyes, sized, states)
    damping = np.full(len(normals), _DAMPING)
    left = np.flatnonzero(np.isfinite(normals[:, -1, -1]))
    for _ in range(_MOST_STEPS):
        damped, slopes = normals[left, :-1, :-1], normals[left, :-1, -1]
        np.einsum("sii->si", damped)[:] *= 1.0 + damping[left, None]
        steps = -np.linalg.solve(damped, slopes[:, :, None])[:, :, 0]
        decreases, most = -(steps * slopes).sum(axis=1), normals[:, -1, -1].min() + 1.0
        useful = decreases > _LEAST_DECREASE
        useful &= normals[left, -1, -1] - decreases < _HOPELESS_RATIO * most
        left, steps = left[useful], steps[useful]
        if not len(left):
            break
        turned = np.array([cv2.Rodrigues(step)[0] for step in steps[:, 3:6]])
        trial = _States(
            turned @ states.turn[left],
            states.place[left] + steps[:, :3],
            states.more[left] + steps[:, 6:],
        )
        new = _normal_matrices(eyes, sized, trial)
        better = new[:, -1, -1] < normals[left, -1, -1]
        for old, moved in zip((*states, normals), (*trial, new), strict=True):
            old[left[better]] = moved[better]
        damping[left] *= np.where(better, 1.0 / _DAMPING_RATIO, _DAMPING_RATIO)
    return states, normals


def _normal_matrices(eyes: Sequence[_Eye], sized: bool, states: _States) -> FloatArray:
    """[J r]^T [J r] of all residuals; its last element, chi^2, is inf for a corner behind."""
    turn, place, more = states
    errors = more[:, : more.shape[1] - sized]
    count, common = len(turn), errors.shape[1]
    ratio = np.exp(more[:, -1, None, None]) if sized else 1.0
    # the errors of the cameras have unit variance
    rows = [np.zeros((count, common, 7 + more.shape[1]))]
    rows[0][:, :, 6 : 6 + common], rows[0][:, :, -1] = np.eye(common), errors
    ahead = np.ones(count, bool)
    for eye in eyes:
        arm = ratio * eye.corners @ turn.swapaxes(1, 2)
        point = arm + place[:, None]
        seen = (point - eye.pose[:, 3]) @ eye.pose[:, :3]
        depth, ray = seen[:, :, 2:], seen[:, :, :2] / seen[:, :, 2:]
        ahead &= (depth > 0.0).all(axis=(1, 2))
        by_point = (eye.pose[:, :2].T - ray[..., None] * eye.pose[:, 2]) / depth[..., None]
        motion = np.empty((*point.shape, 6 + more.shape[1]))  # of the point, before the camera
        motion[..., :3] = np.eye(3)
        motion[..., 3:6] = (arm @ _CROSS).reshape(*arm.shape, 3)
        moved = (point @ _CROSS).reshape(*arm.shape, 3) @ eye.errors[3:]
        motion[..., 6 : 6 + common] = -eye.errors[:3] - moved
        if sized:
            motion[..., -1] = arm
        part = np.empty((*ray.shape, 7 + more.shape[1]))
        part[..., :-1] = by_point @ motion
        # errors of the cameras are small enough to be linear
        shift = part[..., 6 : 6 + common] @ errors[:, None, :, None]
        part[..., -1] = ray - eye.rays + shift[..., 0]
        part = eye.whitener @ part.reshape(count, *eye.whitener.shape[:2], -1)
        rows.append(part.reshape(count, -1, 7 + more.shape[1]))
    every = np.concatenate(rows, axis=1)
    normals = np.asarray(every.swapaxes(1, 2) @ every)
    normals[~ahead, -1, -1] = inf
    return normals


def _best(states: _States, normals: FloatArray, degrees: int, sized: bool) -> Pose | None:
    """The lowest minimum, with the next distinct one if that is not ruled out."""
    best = None
    for k in np.argsort(normals[:, -1, -1]):
        chi_square, matrix = float(normals[k, -1, -1]), np.eye(4)
        if chi_square == inf:
            break
        matrix[:3, :3], matrix[:3, 3] = states.turn[k], states.place[k]
        if best is not None:
            factor = (_PRIOR_SQUARES * _PRIOR_VARIANCE_FACTOR + best.chi_square) / (
                _PRIOR_SQUARES + degrees
            )
            if chi_square - best.chi_square > 2.0 * max(factor, 1.0) * log(_LEAST_ODDS):
                break
            turned = float(np.sum(best.matrix[:3, :3] * matrix[:3, :3]))
            if turned > 1.0 + 2.0 * np.cos(_LEAST_TURN_RAD):
                continue
        covariance = np.asarray(np.linalg.inv(normals[k, :-1, :-1])[:6, :6], np.float64)
        if not (np.diagonal(covariance) > 0.0).all():  # out of sight
            continue
        ratio = exp(states.more[k, -1]) if sized else 1.0
        pose = Pose(matrix, covariance, chi_square, degrees, ratio)
        if best is not None:
            return best._replace(other=pose)
        best = pose
    return best
