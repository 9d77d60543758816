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
from itertools import accumulate
from math import cos, exp, inf, log, sin, sqrt
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import compiled, inlined, subroutine
from vergence.models.camera import Camera, rays_to_pixels
from vergence.models.fixation import cholesky_factorise, cholesky_solve
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    Vector,
    direction_to_outer,
    point_to_local,
    point_to_outer,
    pose_at,
)
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
_CONTRADICTING_CHI: Final = 10.0
"""Residuals, in their sigmas, from which corners contradict each other (chosen: public photographs
by a pair calibrated from others have up to 4)."""
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
_RAY_STEP: Final = 1e-5  # half step of the lens's derivative, as a slope (numerical)
_NORMALISED: Final = np.eye(3)  # camera matrix of rays (physical)
_AROUND: Final = _RAY_STEP * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


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
    with another tilt. None where the corners contradict any pose."""

    @property
    def contradicted(self) -> bool:
        """True if no pose explains the corners: residuals of ten sigmas, rms."""
        return self.chi_square > _CONTRADICTING_CHI**2 * self.degrees

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
    eyes = [eye for eye in (_look(corners, view) for view in views) if len(eye.corners)]
    starts = [(eye, *solution) for eye in eyes for solution in _ippe(eye)]
    if not starts:
        return None
    count = eyes[0].errors.shape[1]
    if any(eye.errors.shape[1] != count for eye in eyes):
        found = ", ".join(str(eye.errors.shape[1]) for eye in eyes)
        raise ConfigurationError(f"pose_errors: expected as many in each view, got {found}")
    (first, _, near), (last, _, far), ratio = starts[0], starts[-1], 1.0
    sized = not size_known and bool((eyes[0].pose[:, 3] != eyes[-1].pose[:, 3]).any())
    if sized and first is not last:  # the lines to the target from both ends meet at this size
        baseline = last.pose[:, 3] - first.pose[:, 3]
        apart = near - far + baseline
        ratio = max(float(apart @ baseline / (apart @ apart)), _LEAST_SIZE_RATIO)
    states = np.zeros((len(starts), 12 + count + sized))
    states[:, 12 + count :] = log(ratio)
    for state, (eye, turn, place) in zip(states, starts, strict=True):
        own, origin = state[:12].reshape(3, 4), eye.pose[:, 3]
        own[:, :3], own[:, 3] = turn, origin + ratio * (place - origin)
    widths = np.array([eye.whitener.shape[1] for eye in eyes])
    ends = np.array([*accumulate(len(eye.whitener) for eye in eyes)])
    whitener = np.zeros((ends[-1], widths.max()))
    for eye, end, width in zip(eyes, ends, widths, strict=True):
        whitener[end - len(eye.whitener) : end, :width] = eye.whitener
    poses = np.array([eye.pose for eye in eyes]).reshape(-1, 12)
    every, errors = (np.concatenate([eye.corners for eye in eyes]), [eye.errors for eye in eyes])
    problem = _Problem(every, whitener, ends, widths, poses, np.array(errors), sized)
    normals = _minimise(problem, states)
    return _best(states, normals, len(whitener) - 6 - sized, sized)


class _Eye(NamedTuple):
    """The detected corners of a view, undistorted."""

    corners: FloatArray  # (n, 4) in T, m, and rays
    whitener: FloatArray  # (2 n, 2) of independent corners, (2 n, 2 n) of correlated ones
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
    around = rays_to_pixels(rays[:, None] + _AROUND, camera.row)
    by_ray = (around[:, :2] - around[:, 2:]).swapaxes(1, 2) / (2.0 * _RAY_STEP)
    seen = np.isfinite(rays + own + by_ray.sum(axis=2)).all(axis=1)
    by_ray = by_ray[seen]
    if correlated:
        both = np.flatnonzero(np.repeat(seen, 2))
        try:
            inverse = np.linalg.inv(np.linalg.cholesky(noise[both[:, None], both]))
        except np.linalg.LinAlgError as error:
            raise ConfigurationError("noise: expected a positive definite covariance") from error
        whitener = (inverse.reshape(len(inverse), len(by_ray), 1, 2) @ by_ray).reshape(
            inverse.shape
        )
    else:
        whitener = (by_ray / own[seen, :, None]).reshape(-1, 2)
    return _Eye(
        np.concatenate([corners_m, rays], axis=1)[seen],
        whitener,
        as_operand("pose", view.pose, 4, 4)[:3],
        as_operand("pose_errors", view.pose_errors, 6, "k"),
    )


def _ippe(eye: _Eye) -> list[tuple[FloatArray, FloatArray]]:
    """The two rotations and places in X of IPPE; none for corners that do not determine them."""
    if not _determine_pose(eye.corners[:, :2].tobytes()):
        return []
    board, rays = eye.corners[:, :3] * (1.0, 1.0, 0.0), np.ascontiguousarray(eye.corners[:, 2:])
    found = cv2.solvePnPGeneric(board, rays, _NORMALISED, None, flags=cv2.SOLVEPNP_IPPE)
    back, origin = eye.pose[:, :3], eye.pose[:, 3]
    return [
        (back @ cv2.Rodrigues(turn)[0], back @ place[:, 0] + origin)
        for turn, place in zip(found[1], found[2], strict=True)
    ]


@lru_cache(maxsize=64)
def _determine_pose(corners_m: bytes) -> bool:
    """True for four corners or more that are not on a line, with or without any one of them."""
    plane = np.frombuffer(corners_m).reshape(-1, 2)
    if len(plane) < 4:
        return False
    plane = (plane - plane.mean(axis=0)) / max(float(np.abs(plane).max()), 1e-300)
    plane = np.column_stack([plane, np.ones(len(plane))])
    leverage = (plane @ np.linalg.inv(plane.T @ plane + _RIDGE) * plane).sum(axis=1)
    return bool(leverage.sum() > 2.5 and leverage.max() < 1.0 - _LEAST_WIDTH)


def _best(states: FloatArray, normals: FloatArray, degrees: int, sized: bool) -> Pose | None:
    """The lowest minimum, with the next distinct one if that is not ruled out."""
    best = None
    for k in np.argsort(normals[:, -1, -1]):
        chi_square, matrix = float(normals[k, -1, -1]), np.eye(4)
        if not chi_square < inf:
            break
        matrix[:3] = states[k, :12].reshape(3, 4)
        if best is not None:
            factor = (_PRIOR_SQUARES * _PRIOR_VARIANCE_FACTOR + best.chi_square) / (
                _PRIOR_SQUARES + degrees
            )
            if chi_square - best.chi_square > 2.0 * max(factor, 1.0) * log(_LEAST_ODDS):
                break
            turned = float(np.vdot(best.matrix[:3, :3], matrix[:3, :3]))
            if turned > 1.0 + 2.0 * np.cos(_LEAST_TURN_RAD):
                continue
        try:
            covariance = np.asarray(np.linalg.inv(normals[k, :-1, :-1])[:6, :6], np.float64)
        except np.linalg.LinAlgError:
            continue
        if not np.diagonal(covariance).min() > 0.0:  # views that contradict each other
            continue
        ratio = exp(states[k, -1]) if sized else 1.0
        pose = Pose(matrix, covariance, chi_square, degrees, ratio)
        if best is not None:
            return best._replace(other=pose)
        best = pose
        if best.contradicted:  # the odds of a second one mean nothing
            break
    return best


class _Problem(NamedTuple):
    """What does not change while the pose is sought; of all views, one after the other."""

    corners: FloatArray  # (n, 4) in T, m, and rays
    whitener: FloatArray  # (2 n, width) weights of successive residuals
    ends: NDArray[np.int64]  # (v,) end of each view's rows
    widths: NDArray[np.int64]  # (v,) used columns of these rows
    cameras: FloatArray  # (v, 12) T_X_C, row by row
    errors: FloatArray  # (v, 6, k), see `View`
    sized: bool


@compiled
def _minimise(problem: _Problem, states: FloatArray) -> FloatArray:
    """Move each state to a minimum, and return the normal matrices there, see `_normal_matrix`.

    A state is the pose T_X_T, row by row, the errors of the cameras, and the logarithm of the size.
    """
    size = states.shape[1] - 6
    normals = np.zeros((len(states), size + 1, size + 1))
    rows, step = np.empty((len(problem.whitener), size + 1)), np.empty(size)
    for s in range(len(states)):
        state, normal, damping = states[s], normals[s], _DAMPING
        trial = state.copy()
        _normal_matrix(problem, state, rows, normal)
        for _ in range(_MOST_STEPS):
            factor = normal.copy()
            for j in range(size):
                factor[j, j] *= 1.0 + damping
                step[j] = -normal[size, j]
            if not cholesky_factorise(factor, size, 0.0):
                break
            cholesky_solve(factor, step, size)
            decrease = 0.0
            for j in range(size):
                decrease -= step[j] * normal[size, j]
            if not decrease > _LEAST_DECREASE:
                break
            _move(state, step, trial)
            _normal_matrix(problem, trial, rows, factor)
            if factor[size, size] < normal[size, size]:
                damping /= _DAMPING_RATIO
                for j in range(len(state)):
                    state[j] = trial[j]
                for j in range(size + 1):
                    for k in range(size + 1):
                        normal[j, k] = factor[j, k]
            else:
                damping *= _DAMPING_RATIO
    return normals


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@subroutine
def _move(state: FloatArray, step: FloatArray, out: FloatArray) -> None:
    """Add a step to a state; its elements 3 to 5 are a rotation vector in X (Rodrigues)."""
    turn = (step[3], step[4], step[5])
    square = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    angle = sqrt(square)
    by_turn, by_square = 1.0, 0.5
    if angle > 1e-6:
        by_turn, by_square = sin(angle) / angle, (1.0 - cos(angle)) / square
    for j in range(3):
        axis = (state[j], state[4 + j], state[8 + j])
        once = _cross(turn, axis)
        twice = _cross(turn, once)
        for i in range(3):
            out[4 * i + j] = axis[i] + by_turn * once[i] + by_square * twice[i]
        out[4 * j + 3] = state[4 * j + 3] + step[j]
    for j in range(6, len(step)):
        out[6 + j] = state[6 + j] + step[j]


@subroutine
def _normal_matrix(
    problem: _Problem, state: FloatArray, rows: FloatArray, normal: FloatArray
) -> None:
    """[J r]^T [J r] of all residuals; its last element, chi^2, is inf for a corner behind."""
    corners, whitener, ends, widths, cameras, errors, sized = problem
    count, last = errors.shape[2], len(normal) - 1
    target, ratio = pose_at(state, 0), exp(state[12 + count]) if sized else 1.0
    white, begin = np.empty(last + 1), 0
    for k in range(last + 1):
        for j in range(last + 1):
            normal[k, j] = 0.0
    for view in range(len(ends)):
        camera, error, end = pose_at(cameras[view], 0), errors[view], ends[view]
        for i in range(begin, end):
            row, axis = rows[i], i % 2
            x, y = ratio * corners[i // 2, 0], ratio * corners[i // 2, 1]
            arm, point = direction_to_outer(target, x, y, 0.0), point_to_outer(target, x, y, 0.0)
            seen = point_to_local(camera, point[0], point[1], point[2])
            if not seen[2] > 0.0:
                normal[last, last] = inf
                return
            ray = seen[axis] / seen[2]
            by_point = direction_to_outer(
                camera, (1 - axis) / seen[2], axis / seen[2], -ray / seen[2]
            )
            by_turn, by_camera_turn = _cross(arm, by_point), _cross(point, by_point)
            row[last] = ray - corners[i // 2, 2 + axis]
            for j in range(6, last):
                row[j] = 0.0
            for k in range(3):
                row[k], row[3 + k] = by_point[k], by_turn[k]
                for j in range(count):
                    row[6 + j] -= by_point[k] * error[k, j] + by_camera_turn[k] * error[3 + k, j]
                if sized:
                    row[6 + count] += arm[k] * by_point[k]
            for j in range(count):  # small enough to be linear
                row[last] += row[6 + j] * state[12 + j]
        for i in range(begin, end):
            first = i - i % 2 if widths[view] == 2 else begin
            for k in range(last + 1):
                white[k] = 0.0
                for j in range(widths[view]):
                    white[k] += whitener[i, j] * rows[first + j, k]
                for j in range(k + 1):
                    normal[k, j] += white[k] * white[j]
        begin = end
    for j in range(count):  # the errors of the cameras have unit variance
        normal[6 + j, 6 + j] += 1.0
        normal[last, 6 + j] += state[12 + j]
        normal[last, last] += state[12 + j] ** 2
    for k in range(last + 1):
        for j in range(k):
            normal[j, k] = normal[k, j]
