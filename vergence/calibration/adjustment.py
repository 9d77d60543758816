"""Bundle adjustment of photographs of a board: cameras, their relative pose, and board poses.

Corner n of view v is, in the frames of the left and the right camera, at

    p_left = R_v (x_n, y_n, z_n) + t_v,    p_right = R p_left + t

The adjustment minimises the sum of squares of `(projected - measured) / sigma` over the parameters
of the cameras, R and t, every R_v and t_v, and the curvatures of the board, as no paper is flat:

    z = (b_xx x^2 + b_yy y^2) / 2 + b_xy x y    from the middle of the board.

The poses of the board are eliminated (variable projection, Golub and Pereyra 1973): for given
cameras each pose is a separate problem of six unknowns. About thirty unknowns remain, which
`scipy.optimize.least_squares` solves. With the Jacobians J by the camera parameters and P by a
board's pose, this reduced problem has

    J' = J - P (P^T P)^-1 P^T J,    covariance = (J'^T J')^-1,

and its covariance is the camera block of the full problem's covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vergence.models.lens import LENSES
from vergence.models.parts import FloatArray

PINHOLE_VALUES = ("f_u", "f_v", "u_0", "v_0")
"""First parameters of a camera, px; the lens's coefficients follow in OpenCV's order."""
_SMALL_RADIUS: Final = 1e-9
"""Least normalised radius, which avoids a division by zero on the axis (numerical)."""


def camera_parameter_names(lens: str) -> tuple[str, ...]:
    """Name a camera's parameters: the pinhole's, then the lens's coefficients."""
    return (*PINHOLE_VALUES, *LENSES[lens])


class ProjectedPoints(NamedTuple):
    """Pixels and their Jacobians."""

    pixels: FloatArray
    """(..., 2) px."""
    point_jacobian: FloatArray
    """(..., 2, 3) Jacobian by the point, px/m."""
    camera_jacobian: FloatArray
    """(..., 2, k) Jacobian by the camera's parameters."""


class _Bent(NamedTuple):
    """Distorted normalised coordinates and their Jacobians."""

    xy: FloatArray
    """(..., 2) distorted normalised coordinates."""
    by_ideal: FloatArray
    """(..., 2, 2) Jacobian by the undistorted coordinates."""
    by_coefficients: FloatArray
    """(..., 2, n) Jacobian by the lens's coefficients."""


def project_with_jacobians(
    lens: str, camera_parameters: FloatArray, points: FloatArray
) -> ProjectedPoints:
    """Project (..., 3) points, m, also beyond the lens's fold; nan behind the camera."""
    z = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
    ideal = points[..., :2] / z
    bend = _bend_by_angle if lens == "fisheye" else _bend_by_radius
    bent = bend(camera_parameters[4:], ideal)
    focal = camera_parameters[:2]
    pixels = camera_parameters[2:4] + focal * bent.xy
    scaled = focal[:, None] * bent.by_ideal
    by_point = np.concatenate(
        [scaled / z[..., None], -(scaled @ ideal[..., None]) / z[..., None]], axis=-1
    )
    by_camera = np.zeros((*pixels.shape, len(camera_parameters)))
    by_camera[..., 0, 0], by_camera[..., 1, 1] = bent.xy[..., 0], bent.xy[..., 1]
    by_camera[..., 0, 2] = by_camera[..., 1, 3] = 1.0
    by_camera[..., 4:] = focal[:, None] * bent.by_coefficients
    return ProjectedPoints(pixels, by_point, by_camera)


def _bend_by_radius(coefficients: FloatArray, ideal: FloatArray) -> _Bent:
    """Distort by the Brown-Conrady lens, or the rational lens if there are 8 coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(coefficients, (0, 8 - len(coefficients))).tolist()
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    below = 1.0 / (1.0 + k4 * r2 + k5 * r4 + k6 * r6)
    radial = (1.0 + k1 * r2 + k2 * r4 + k3 * r6) * below
    slope = (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r4) * below
    slope -= radial * below * (k4 + 2.0 * k5 * r2 + 3.0 * k6 * r4)
    along_x, along_y = r2 + 2.0 * x * x, r2 + 2.0 * y * y
    xy = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * along_x,
            y * radial + p1 * along_y + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )
    by_ideal = np.empty((*ideal.shape, 2))
    by_ideal[..., 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_ideal[..., 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_ideal[..., 0, 1] = by_ideal[..., 1, 0] = 2.0 * (x * y * slope + p1 * x + p2 * y)
    radii = np.stack([r2, r4, r6], axis=-1) * below[..., None]
    by = np.empty((*ideal.shape, 8))
    for axis, ray in ((0, x), (1, y)):
        by[..., axis, [0, 1, 4]] = ray[..., None] * radii
        by[..., axis, 5:] = -(ray * radial)[..., None] * radii
    by[..., 0, 2] = by[..., 1, 3] = 2.0 * x * y
    by[..., 0, 3], by[..., 1, 2] = along_x, along_y
    return _Bent(xy, by_ideal, by[..., : len(coefficients)])


def _bend_by_angle(coefficients: FloatArray, ideal: FloatArray) -> _Bent:
    """Distort by the Kannala-Brandt fisheye lens."""
    r = np.maximum(np.linalg.norm(ideal, axis=-1), _SMALL_RADIUS)
    t = np.arctan(r)
    powers = np.stack([t ** (2 * n) for n in range(5)], axis=-1)
    bent = np.concatenate([[1.0], coefficients])
    scale = t / r * (powers @ bent)
    # along the radius: d(t (1 + k1 t^2 + ...)) / dr
    along = powers @ (bent * (2.0 * np.arange(5) + 1.0)) / (1.0 + r * r)
    unit = ideal / r[..., None]
    outer = unit[..., :, None] * unit[..., None, :]
    by_ideal = scale[..., None, None] * np.eye(2) + (along - scale)[..., None, None] * outer
    by_coefficients = (unit * t[..., None])[..., None] * powers[..., None, 1:]
    return _Bent(ideal * scale[..., None], by_ideal, by_coefficients)


_POSE_STEPS: Final = 50
"""Largest number of Levenberg-Marquardt steps for the board poses (numerical)."""
_POSE_TOLERANCE: Final = 1e-7
"""Convergence tolerance of a pose step, rad and in units of the board's size; the next step is
about 1e-4 of it (numerical)."""
_RELATIVE_RIDGE: Final = 1e-13
"""Relative ridge on the diagonal of a view's normal matrix; it matters only if the matrix is
singular (numerical)."""
_ABSOLUTE_RIDGE: Final = 1e-200
"""Absolute ridge, which lets a view without corners have an inverse (numerical)."""
_COST_ROUNDING: Final = 1e-13
"""Relative change of a sum of squares that counts as rounding (numerical)."""
_FIRST_DAMPING: Final = 1e-6
"""Initial damping of the pose steps, relative to the diagonal (numerical)."""
_MOST_DAMPING: Final = 1e6
"""Damping above which the iteration of a view's pose ends (numerical)."""
_MOST_EVALUATIONS: Final = 60
"""Largest number of evaluations of the sum of squares. Cameras take about 10, more only if a lens
has more coefficients than the views determine and these wander along a valley (numerical)."""
_RATIONAL_PRIOR_SIGMA: Final = 1.0
"""Prior standard deviation of the coefficients k1 to k6 of the rational lens (chosen: real lenses
have coefficients of this size or less)."""
_TOLERANCE: Final = 1e-8
"""Relative convergence tolerance of the sum of squares. With 10,000 residuals, a change of one
parameter by one standard deviation changes the sum by 1e-4 (numerical)."""


class BoardPoses(NamedTuple):
    """Poses of a board in the frame of the left camera, one per view."""

    rotation: FloatArray
    """(v, 3, 3) rotation matrices."""
    translation: FloatArray
    """(v, 3) metres."""

    def select(self, views: NDArray[Any]) -> "BoardPoses":
        """Select the poses of some views."""
        return BoardPoses(self.rotation[views], self.translation[views])

    def moved(self, steps: FloatArray) -> "BoardPoses":
        """Apply (v, 6) small steps: rotation vector in the left camera, rad; translation, m."""
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return BoardPoses(turns @ self.rotation, self.translation + steps[:, 3:])


class CameraRig(NamedTuple):
    """One camera, or two and their relative pose: `x_right = R x_left + T`."""

    lenses: tuple[str, ...]
    """(c) lens model of each camera."""
    camera_parameters: tuple[FloatArray, ...]
    """(c) parameters of each camera, see `camera_parameter_names`."""
    rotation: FloatArray
    """(3, 3) R; the identity for one camera."""
    translation: FloatArray
    """(3,) T, metres; zero for one camera."""
    board_curvatures: FloatArray
    """(3,) curvatures b_xx, b_yy, b_xy of the board, 1/m."""

    @classmethod
    def single(cls, lens: str, camera_parameters: FloatArray) -> "CameraRig":
        """Make a rig of one camera and a flat board."""
        return cls((lens,), (camera_parameters,), np.eye(3), np.zeros(3), np.zeros(3))

    @property
    def blocks(self) -> list[slice]:
        """Slices of `packed`: each camera's parameters, R and T, and the board's curvatures."""
        lengths = [len(values) for values in self.camera_parameters] + [
            6 * (len(self.camera_parameters) - 1),
            3,
        ]
        ends = np.cumsum(lengths).tolist()
        return [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]

    def packed(self) -> FloatArray:
        """Pack all parameters: the cameras', R as a rotation vector, T, and the curvatures."""
        between = [Rotation.from_matrix(self.rotation).as_rotvec(), self.translation]
        return np.concatenate(
            [
                *self.camera_parameters,
                *(between if len(self.camera_parameters) > 1 else ()),
                self.board_curvatures,
            ]
        )

    def unpacked(self, row: FloatArray) -> "CameraRig":
        """Make a rig from a packed array."""
        *cameras, between, bend = (row[block] for block in self.blocks)
        rig = self._replace(camera_parameters=tuple(cameras), board_curvatures=bend)
        if len(cameras) == 1:
            return rig
        turn = Rotation.from_rotvec(between[:3]).as_matrix()
        return rig._replace(rotation=turn, translation=between[3:])

    @property
    def prior_information(self) -> FloatArray:
        """(p) prior information of each parameter, 1 / sigma^2; 0 for no prior.

        Views hardly determine the coefficients of the rational lens one by one: numerator and
        denominator may share a factor, with poles in the image. The prior keeps them at about
        `_RATIONAL_PRIOR_SIGMA` or less, as in real lenses.
        """
        known = [
            np.where(
                [lens == "rational" and name[0] == "k" for name in camera_parameter_names(lens)],
                1.0,
                0.0,
            )
            for lens in self.lenses
        ]
        others = np.zeros(self.blocks[-1].stop - self.blocks[len(known) - 1].stop)
        return np.concatenate([*known, others]) / _RATIONAL_PRIOR_SIGMA**2

    def names(self, eyes: Sequence[str]) -> list[str]:
        """Name the parameters in the order of `packed`, by the names of the cameras."""
        names = [
            f"{eye}.{name}"
            for eye, lens in zip(eyes, self.lenses, strict=True)
            for name in camera_parameter_names(lens)
        ]
        if len(self.camera_parameters) > 1:
            names += [f"{what}_{axis}" for what in ("rotation", "translation") for axis in "xyz"]
        return [*names, "bend_xx", "bend_yy", "bend_xy"]


class LinearisedResiduals(NamedTuple):
    """Residuals divided by sigma, and their Jacobians, view by view."""

    residuals: FloatArray
    """(v, m): m = 2 n c, camera by camera; 0 for corners that were not found."""
    pose_jacobian: FloatArray
    """(v, m, 6) Jacobian by a small rotation of the board in the left camera's frame, and a
    translation."""
    rig_jacobian: FloatArray
    """(v, m, p) Jacobian by the parameters of `CameraRig.packed`."""


@dataclass(frozen=True, eq=False)
class BundleAdjustment:
    """Measurements of a bundle adjustment: corners of a board and their standard deviations."""

    board_corners: FloatArray
    """(n, 3) corners of the board in its frame, metres."""
    pixels: FloatArray
    """(c, v, n, 2) measured corners, px; nan for corners that were not found."""
    sigma: FloatArray
    """(c, v, n, 2) standard deviations, px."""

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(c, v, n) True for corners that were found."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    def select(self, views: NDArray[Any]) -> "BundleAdjustment":
        """Restrict the problem to some views."""
        return BundleAdjustment(self.board_corners, self.pixels[:, views], self.sigma[:, views])

    def select_camera(self, camera: int) -> "BundleAdjustment":
        """Restrict the problem to one camera."""
        only = slice(camera, camera + 1)
        return BundleAdjustment(self.board_corners, self.pixels[only], self.sigma[only])

    @cached_property
    def _bending(self) -> FloatArray:
        """(n, 3) derivative of each corner's height above the flat board by curvature, m^2."""
        x, y = (self.board_corners[:, :2] - self.board_corners[:, :2].mean(axis=0)).T
        return np.column_stack([0.5 * x * x, 0.5 * y * y, x * y])

    def points(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        """(v, n, 3) the board's corners in the left camera's frame, metres."""
        return self._turned(rig, poses) + poses.translation[:, None]

    def _turned(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        bent = self.board_corners + (self._bending @ rig.board_curvatures)[:, None] * np.array(
            [0.0, 0.0, 1.0]
        )
        return np.asarray(bent @ poses.rotation.transpose(0, 2, 1))

    def linearised(
        self, rig: CameraRig, poses: BoardPoses, *, by_rig: bool = True
    ) -> LinearisedResiduals:
        """Residuals and Jacobians at cameras and poses; by the rig's parameters if `by_rig`."""
        turned = self._turned(rig, poses)
        points = turned + poses.translation[:, None]
        views, corners = points.shape[:2]
        by_bend = poses.rotation[:, None, :, 2, None] * self._bending[:, None]
        *cameras, between, bend = rig.blocks
        parts: list[list[FloatArray]] = [[], [], []]
        for camera, (lens, values) in enumerate(
            zip(rig.lenses, rig.camera_parameters, strict=True)
        ):
            jacobian = np.zeros((views, corners, 2, bend.stop if by_rig else 0))
            if camera == 0:
                seen = project_with_jacobians(lens, values, points)
                by_left = seen.point_jacobian
            else:
                seen = project_with_jacobians(
                    lens, values, points @ rig.rotation.T + rig.translation
                )
                by_left = seen.point_jacobian @ rig.rotation
            if by_rig:
                jacobian[..., cameras[camera]] = seen.camera_jacobian
                jacobian[..., bend] = by_left @ by_bend
                if camera > 0:
                    vector = Rotation.from_matrix(rig.rotation).as_rotvec()
                    by_vector = np.asarray(cv2.Rodrigues(vector)[1]).reshape(3, 3, 3)
                    turning = np.einsum("kij,vnj->vnik", by_vector, points)
                    jacobian[..., between] = np.concatenate(
                        [seen.point_jacobian @ turning, seen.point_jacobian], axis=-1
                    )
            found = self.seen[camera][..., None]
            weight = np.where(found, 1.0 / np.where(found, self.sigma[camera], 1.0), 0.0)
            residual = np.where(found, seen.pixels - np.where(found, self.pixels[camera], 0.0), 0.0)
            parts[0].append((weight * residual).reshape(views, -1))
            # a small rotation d of the board moves a corner by d x turned
            by_pose = np.concatenate([np.cross(turned[..., None, :], by_left), by_left], axis=-1)
            parts[1].append((weight[..., None] * by_pose).reshape(views, -1, 6))
            parts[2].append((weight[..., None] * jacobian).reshape(views, weight[0].size, -1))
        return LinearisedResiduals(*(np.concatenate(part, axis=1) for part in parts))

    def fit_poses(
        self, rig: CameraRig, start: BoardPoses
    ) -> tuple[BoardPoses, LinearisedResiduals]:
        """Fit the poses to given cameras (Levenberg and Marquardt); with residuals there."""
        size = np.ptp(self.board_corners, axis=0).max()
        damping = np.full(len(start.translation), _FIRST_DAMPING)
        poses, now = start, self.linearised(rig, start, by_rig=False)
        cost = (now.residuals**2).sum(axis=1)
        for _ in range(_POSE_STEPS):
            normal = now.pose_jacobian.transpose(0, 2, 1) @ now.pose_jacobian
            slope = now.pose_jacobian.transpose(0, 2, 1) @ now.residuals[..., None]
            steps = -np.linalg.solve(_damped(normal, damping), slope)[..., 0]
            moved = poses.moved(np.asarray(steps))
            then = self.linearised(rig, moved, by_rig=False)
            costs = (then.residuals**2).sum(axis=1)
            better = costs <= cost
            pick = [np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b)
                    for a, b in zip((*moved, *then), (*poses, *now), strict=True)]  # fmt: skip
            poses, now = BoardPoses(*pick[:2]), LinearisedResiduals(*pick[2:])
            small = np.abs(steps / np.array([1, 1, 1, size, size, size])).max(axis=1)
            done = (
                (small < _POSE_TOLERANCE)
                | (np.abs(cost - costs) <= _COST_ROUNDING * cost)
                | (damping > _MOST_DAMPING)
            )
            cost = np.where(better, costs, cost)
            damping = np.where(better, np.maximum(0.1 * damping, 1e-12), 100.0 * damping)
            if done.all():
                break
        return poses, now

    def solve(
        self, start: CameraRig, poses: BoardPoses, tolerance: float = _TOLERANCE
    ) -> "BundleSolution":
        """Cameras and poses with the least squares; `LinAlgError` if they are not determined."""
        near = _Near(start.packed(), poses, None)
        last: dict[bytes, tuple[BoardPoses, LinearisedResiduals]] = {}

        def poses_for(row: FloatArray) -> tuple[BoardPoses, LinearisedResiduals]:
            key = row.tobytes()
            if key not in last:
                last.clear()
                last[key] = self.fit_poses(start.unpacked(row), near.poses_at(row))
            return last[key]

        prior_weights = np.sqrt(start.prior_information)

        def residuals(row: FloatArray) -> FloatArray:
            return np.concatenate([poses_for(row)[1].residuals.ravel(), prior_weights * row])

        def jacobian(row: FloatArray) -> FloatArray:
            nonlocal near
            fitted_poses = poses_for(row)[0]
            linear = self.linearised(start.unpacked(row), fitted_poses)
            pose_sensitivity = _pose_sensitivity(linear)
            near = _Near(row.copy(), fitted_poses, pose_sensitivity)
            eliminated = np.asarray(linear.rig_jacobian - linear.pose_jacobian @ pose_sensitivity)
            return np.vstack([eliminated.reshape(-1, len(row)), np.diag(prior_weights)])

        if not np.isfinite(residuals(start.packed())).all():
            raise np.linalg.LinAlgError("expected a start before the cameras")
        result: Any = least_squares(
            residuals, start.packed(), jacobian, method="lm", x_scale="jac", ftol=tolerance,
            xtol=tolerance, gtol=tolerance, max_nfev=_MOST_EVALUATIONS,
        )  # fmt: skip
        found, fitted_poses = start.unpacked(result.x), poses_for(result.x)[0]
        return BundleSolution(self, found, fitted_poses, self.linearised(found, fitted_poses))


class _Near(NamedTuple):
    """The last linearisation, from which the poses at other cameras are predicted."""

    row: FloatArray
    """(p) see `CameraRig.packed`."""
    poses: BoardPoses
    pose_sensitivity: FloatArray | None
    """(v, 6, p) see `_pose_sensitivity`; None before the first linearisation."""

    def poses_at(self, row: FloatArray) -> BoardPoses:
        """Predict the poses at other cameras, to first order."""
        if self.pose_sensitivity is None:
            return self.poses
        return self.poses.moved(-self.pose_sensitivity @ (row - self.row))


def _eliminated(linear: LinearisedResiduals) -> FloatArray:
    """(v, m, p) Jacobian J' by the rig's parameters with the poses eliminated."""
    return np.asarray(linear.rig_jacobian - linear.pose_jacobian @ _pose_sensitivity(linear))


def _pose_sensitivity(linear: LinearisedResiduals) -> FloatArray:
    """(v, 6, p) negative derivative of the best poses by the rig's parameters."""
    transposed = linear.pose_jacobian.transpose(0, 2, 1)
    normal = _damped(transposed @ linear.pose_jacobian, np.full(len(transposed), _RELATIVE_RIDGE))
    return np.asarray(np.linalg.solve(normal, transposed @ linear.rig_jacobian))


def _damped(normal: FloatArray, damping: FloatArray) -> FloatArray:
    """(v, 6, 6) normal matrices with larger diagonals, so that each has an inverse."""
    larger = damping[:, None] * np.einsum("vii->vi", normal) + _ABSOLUTE_RIDGE
    return np.asarray(normal + larger[..., None] * np.eye(6))


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*vectors.shape, 3)


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """The cameras that fit best, and the residuals and Jacobians there."""

    problem: BundleAdjustment
    rig: CameraRig
    poses: BoardPoses
    linearisation: LinearisedResiduals
    """Residuals divided by sigma and Jacobians, at the solution."""

    @property
    def residuals_px(self) -> FloatArray:
        """(c, v, n, 2) projected minus measured pixels; nan for corners that were not found."""
        return pixel_residuals(self.problem, self.linearisation)

    @cached_property
    def reduced_rig_jacobian(self) -> FloatArray:
        """(v, m, p) Jacobian of the residuals by the rig's parameters, poses eliminated."""
        return _eliminated(self.linearisation)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of measured values minus number of estimated ones."""
        measured = 2 * int(self.problem.seen.sum())
        return measured - 6 * len(self.poses.translation) - int(self.reduced_rig_jacobian.shape[-1])

    @property
    def reduced_chi(self) -> float:
        """Ratio of the residuals to sigma, root of the reduced chi-square: 1 if sigma is right."""
        return float(
            np.sqrt((self.linearisation.residuals**2).sum() / max(self.degrees_of_freedom, 1))
        )

    @cached_property
    def information(self) -> FloatArray:
        """(v, p, p) each view's information on the rig's parameters, if sigma is right."""
        return np.asarray(self.reduced_rig_jacobian.transpose(0, 2, 1) @ self.reduced_rig_jacobian)


def pixel_residuals(problem: BundleAdjustment, linear: LinearisedResiduals) -> FloatArray:
    """(c, v, n, 2) projected minus measured pixels; nan for corners that were not found."""
    cameras, views, corners, _ = problem.pixels.shape
    residuals = linear.residuals.reshape(views, cameras, corners, 2).transpose(1, 0, 2, 3)
    return np.where(problem.seen[..., None], residuals * problem.sigma, np.nan)


def rms_length(residuals_px: FloatArray) -> float:
    """Root mean square length of residuals (..., 2), as OpenCV defines it; nan are left out."""
    return float(np.sqrt(np.nanmean((residuals_px**2).sum(axis=-1))))
