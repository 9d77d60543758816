"""Bundle adjustment of photographs of a board: cameras, their relative pose, and board poses.

Corner n of view v is, in the frames of the left and the right camera, at

    p_left = R_v (x_n, y_n, z_n) + t_v,    p_right = R p_left + t

The adjustment minimises the sum of squares of `(projected - measured) / sigma` over the parameters
of the cameras, R and t, every R_v and t_v, and the curvatures of the board, as no paper is flat:

    z = (b_xx x^2 + b_yy y^2) / 2 + b_xy x y    from the middle of the board.

The poses of the board are eliminated, as each belongs to one view (Schur complement). About thirty
unknowns remain. With the Jacobians J by the camera parameters and P by a board's pose, this reduced
problem has

    J' = J - P (P^T P)^-1 P^T J,    covariance = (J'^T J')^-1,

and its covariance is the camera block of the full problem's covariance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vergence.models.camera import pixels_to_rays
from vergence.models.head import HeadModel
from vergence.models.lens import LENSES, pack_camera
from vergence.models.parts import FloatArray

PINHOLE_VALUES = ("f_u", "f_v", "u_0", "v_0")
"""First parameters of a camera, px; the lens's coefficients follow in OpenCV's order."""


def camera_parameter_names(lens: str) -> tuple[str, ...]:
    """Name a camera's parameters: the pinhole's, then the lens's coefficients."""
    return (*PINHOLE_VALUES, *LENSES[lens])


def camera_parameters(head: HeadModel, eye: int) -> tuple[str, FloatArray]:
    """Lens and parameters of an eye's camera, see `camera_parameter_names`."""
    cameras, lens = head.cameras, head.cameras.lens[eye]
    own = cameras.distortion[eye][: len(camera_parameter_names(lens)) - 4]
    return lens, np.concatenate([cameras.focal[eye], cameras.principal[eye], own])


class ProjectedPoints(NamedTuple):
    """Pixels and their Jacobians."""

    pixels: FloatArray
    """(..., 2) px."""
    point_jacobian: FloatArray
    """(..., 2, 3) Jacobian by the point, px/m."""
    camera_jacobian: FloatArray
    """(..., 2, k) Jacobian by the camera's parameters."""


def project_with_jacobians(
    lens: str, camera_parameters: FloatArray, points: FloatArray
) -> ProjectedPoints:
    """Project (..., 3) points, m, also beyond the lens's fold; nan behind the camera."""
    (f_u, f_v, u_0, v_0), coefficients = camera_parameters[:4], camera_parameters[4:]
    matrix, still = np.array([[f_u, 0.0, u_0], [0.0, f_v, v_0], [0.0, 0.0, 1.0]]), np.zeros(3)
    places = points.reshape(-1, 1, 3).copy()
    places[~(places[..., 2] > 0.0)] = np.nan
    pixels: Any
    by: Any
    # OpenCV's columns: at rest, those by the translation are those by the point
    if lens == "fisheye":
        pixels, by = cv2.fisheye.projectPoints(places, still, still, matrix, coefficients)
        by_point, by_camera = by[:, 11:14], by[:, :8]
    else:
        pixels, by = cv2.projectPoints(places, still, still, matrix, coefficients)
        by_point, by_camera = by[:, 3:6], by[:, 6 : 6 + len(camera_parameters)]
    batch = points.shape[:-1]
    return ProjectedPoints(
        pixels.reshape(*batch, 2),
        by_point.reshape(*batch, 2, 3),
        by_camera.reshape(*batch, 2, len(camera_parameters)),
    )


_MOST_STEPS: Final = 60
"""Largest number of steps; ten are usual, more only if a lens has more coefficients than the views
determine and these wander along a valley (numerical)."""
_LEAST_DAMPING: Final = 1e-13
"""Damping of the first step; it matters only if the matrix is singular (numerical)."""
_MOST_DAMPING: Final = 1e9
"""Damping above which the iteration ends (numerical)."""
_ROUNDING: Final = 1e-12
"""Relative change of a cost by rounding (numerical)."""
_ABSOLUTE_RIDGE: Final = 1e-200
"""Ridge that lets a view without corners have an inverse (numerical)."""
_POSE_TOLERANCE: Final = 1e-12
"""Change of a view's sum of squares, absolute and relative, below which its pose is found; an error
of one standard deviation changes the sum by 1 (numerical)."""
_RATIONAL_PRIOR_SIGMA: Final = 1.0
"""Prior standard deviation of the coefficients k1 to k6 of the rational lens (chosen: real lenses
have coefficients of this size or less)."""
_TOLERANCE: Final = 1e-12
"""Relative change of the sum of squares below which cameras are found (numerical)."""


_State = TypeVar("_State")
_Normal = TypeVar("_Normal")


def damped_least_squares(
    linearised: Callable[[_State], _Normal],
    moved: Callable[[_State, _Normal, FloatArray, FloatArray], _State],
    state: _State,
    *,
    tolerance: float,
    relative_tolerance: float,
    damping_unit: FloatArray | None = None,
    reweighted: Callable[[_State, _Normal], _Normal | None] | None = None,
) -> tuple[_State, _Normal]:
    """Levenberg and Marquardt's method for one problem or a batch of independent ones.

    Args:
        linearised: normal equations at a state; may raise `LinAlgError`. Attributes: `cost` (...),
            sum of squares; `matrix` (..., s, s); `gradient` (..., s), half of the cost's.
        moved: the state after a step (..., s) of a damping (...).
        state: the start; of a batch a NamedTuple of arrays (..., ...), as the equations are then.
        tolerance: change of the cost below which the iteration ends.
        relative_tolerance: the same, as a fraction of the cost.
        damping_unit: (s,) what damping multiplies; None for the normal matrix's diagonal.
        reweighted: after a step, the normal equations with other weights, or None for the same.

    Raises:
        numpy.linalg.LinAlgError: the start has no finite cost.
    """
    now: Any = linearised(state)
    then: Any
    if np.ndim(now.cost) == 0 and not np.isfinite(now.cost):
        raise np.linalg.LinAlgError("expected a start before the cameras")
    damping = np.full(np.shape(now.cost), _LEAST_DAMPING)
    for _ in range(_MOST_STEPS):
        unit = np.diagonal(now.matrix, axis1=-2, axis2=-1)
        unit = unit if damping_unit is None else damping_unit
        step = -_solve_damped(now.matrix, damping[..., None] * unit, now.gradient[..., None])[
            ..., 0
        ]
        there = moved(state, now, step, damping)
        try:
            then = linearised(there)
            change = now.cost - then.cost
        except np.linalg.LinAlgError:  # a step behind a camera
            then, change = now, np.full_like(damping, -np.inf)
        better = np.asarray(change >= 0.0)
        state, now = choose(better, there, state), choose(better, then, now)
        damping = np.where(
            better, np.maximum(0.1 * damping, _LEAST_DAMPING), np.maximum(10.0 * damping, 1.0)
        )
        other = reweighted(state, now) if reweighted is not None and better.all() else None
        if other is not None:
            now = other
            continue
        limit = np.maximum(tolerance, relative_tolerance * np.asarray(now.cost))
        # a rejected step ends it only where no step can be better but by rounding
        rounding = np.minimum(limit, _ROUNDING * np.maximum(now.cost, 1.0))
        done = np.abs(change) <= np.where(better, limit, rounding)
        if (done | (damping > _MOST_DAMPING)).all():
            break
    return state, now


def choose(better: NDArray[np.bool_], new: _State, old: _State) -> _State:
    """Select the new values of the problems that are better."""
    if better.ndim == 0:
        return new if better else old
    both: Any = (new, old)
    chosen: _State = type(both[0])(
        *(
            np.where(better.reshape(-1, *[1] * (one.ndim - 1)), one, other)
            for one, other in zip(*both, strict=True)
        )
    )
    return chosen


def _solve_damped(matrix: FloatArray, more: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (..., s, s) equations with a larger diagonal, by (..., s), scaled to ones."""
    size = range(matrix.shape[-1])
    larger = matrix.copy()
    larger[..., size, size] += more + _ABSOLUTE_RIDGE
    scale = 1.0 / np.sqrt(larger[..., size, size])[..., None]
    scaled = larger * scale * scale.swapaxes(-1, -2)
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


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

    def transformed(self, rotation: FloatArray, translation: FloatArray) -> "BoardPoses":
        """Poses in another frame, that of points `R x + t`, m."""
        return BoardPoses(rotation @ self.rotation, self.translation @ rotation.T + translation)


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

    def alone(self, camera: int) -> "CameraRig":
        """Make a rig of one of the cameras."""
        single = CameraRig.single(self.lenses[camera], self.camera_parameters[camera])
        return single._replace(board_curvatures=self.board_curvatures)

    def rays(self, camera: int, pixels: FloatArray) -> FloatArray:
        """Rays X / Z, Y / Z of (..., 2) pixels in a camera; nan where the lens has no inverse."""
        values = self.camera_parameters[camera]
        row = pack_camera((0, 0), values[:2], values[2:4], self.lenses[camera], values[4:])
        return np.asarray(pixels_to_rays(pixels, row))

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

    def in_camera(self, camera: int, points: FloatArray) -> FloatArray:
        """(..., 3) points of the left camera's frame in a camera's frame, m."""
        return points @ self.rotation.T + self.translation if camera else points

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

    @property
    def cost(self) -> FloatArray:
        """(v) sum of squares of each view."""
        return np.asarray((self.residuals**2).sum(axis=1))

    @property
    def matrix(self) -> FloatArray:
        """(v, 6, 6) normal matrix of each view's pose."""
        return np.asarray(self.pose_jacobian.transpose(0, 2, 1) @ self.pose_jacobian)

    @property
    def gradient(self) -> FloatArray:
        """(v, 6) gradient of each view's pose."""
        return np.asarray(np.einsum("vmk,vm->vk", self.pose_jacobian, self.residuals))

    def eliminated(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Reduced Jacobian J', (v, m, p), and minus the poses' derivative and their own step."""
        right = np.concatenate(
            [self.pose_jacobian.transpose(0, 2, 1) @ self.rig_jacobian, self.gradient[..., None]],
            axis=-1,
        )
        diagonal = np.einsum("vii->vi", self.matrix)
        solved = _solve_damped(self.matrix, _LEAST_DAMPING * diagonal, right)
        by_rig, step = solved[..., :-1], solved[..., -1]
        return self.rig_jacobian - self.pose_jacobian @ by_rig, by_rig, step


class _RigEquations(NamedTuple):
    """Normal equations of the rig's parameters, each view's pose eliminated."""

    cost: float
    matrix: FloatArray
    gradient: FloatArray
    linear: LinearisedResiduals
    by_rig: FloatArray
    """(v, 6, p) and `own_step` (v, 6): see `LinearisedResiduals.eliminated`."""
    own_step: FloatArray


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
    def heights(self) -> FloatArray:
        """(n, 3) derivative of each corner's height above the flat board by curvature, m^2."""
        return heights_by_curvature(
            self.board_corners[:, :2] - self.board_corners[:, :2].mean(axis=0)
        )

    def points(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        """(v, n, 3) the board's corners in the left camera's frame, metres."""
        return self._turned(rig, poses) + poses.translation[:, None]

    def _turned(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        bent = self.board_corners.copy()
        bent[:, 2] += self.heights @ rig.board_curvatures
        return np.asarray(bent @ poses.rotation.transpose(0, 2, 1))

    def linearised(
        self, rig: CameraRig, poses: BoardPoses, *, by_rig: bool = True
    ) -> LinearisedResiduals:
        """Residuals and Jacobians at cameras and poses; by the rig's parameters if `by_rig`."""
        turned = self._turned(rig, poses)
        points = turned + poses.translation[:, None]
        views, corners = points.shape[:2]
        by_bend = poses.rotation[:, None, :, 2, None] * self.heights[:, None]
        *cameras, between, bend = rig.blocks
        parts: list[list[FloatArray]] = [[], [], []]
        for camera, (lens, values) in enumerate(
            zip(rig.lenses, rig.camera_parameters, strict=True)
        ):
            jacobian = np.zeros((views, corners, 2, bend.stop if by_rig else 0))
            seen = project_with_jacobians(lens, values, rig.in_camera(camera, points))
            by_left = seen.point_jacobian @ rig.rotation if camera else seen.point_jacobian
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

    def at(self, rig: CameraRig, poses: BoardPoses) -> "BundleSolution":
        """Residuals at given cameras and poses, without derivatives by the cameras."""
        return BundleSolution(self, rig, poses, self.linearised(rig, poses, by_rig=False))

    def fit_poses(self, rig: CameraRig, start: BoardPoses) -> "BundleSolution":
        """Fit the poses to given cameras; without derivatives by these."""
        poses, linear = damped_least_squares(
            lambda poses: self.linearised(rig, poses, by_rig=False),
            lambda poses, _, steps, __: poses.moved(steps),
            start,
            tolerance=_POSE_TOLERANCE,
            relative_tolerance=_POSE_TOLERANCE,
        )
        return BundleSolution(self, rig, poses, linear)

    def solve(
        self, start: CameraRig, poses: BoardPoses, tolerance: float = _TOLERANCE
    ) -> "BundleSolution":
        """Cameras and poses with the least squares; `LinAlgError` if they are not determined."""
        prior = start.prior_information

        def linearised(state: tuple[CameraRig, BoardPoses]) -> _RigEquations:
            row, linear = state[0].packed(), self.linearised(*state)
            reduced, by_rig, own_step = linear.eliminated()
            # view by view: one large product would wait for threads, where others use the CPU too
            information = reduced.transpose(0, 2, 1) @ reduced
            return _RigEquations(
                float(linear.cost.sum() + prior @ row**2),
                information.sum(axis=0) + np.diag(prior),
                reduced.reshape(-1, len(row)).T @ linear.residuals.ravel() + prior * row,
                linear,
                by_rig,
                own_step,
            )

        def moved(
            state: tuple[CameraRig, BoardPoses], now: _RigEquations, step: FloatArray,
            damping: FloatArray,
        ) -> tuple[CameraRig, BoardPoses]:  # fmt: skip
            rig, poses = state
            own_step = now.own_step / (1.0 + damping)
            return rig.unpacked(rig.packed() + step), poses.moved(-own_step - now.by_rig @ step)

        (rig, found), now = damped_least_squares(
            linearised,
            moved,
            (start, self.fit_poses(start, poses).poses),
            tolerance=0.0,
            relative_tolerance=tolerance,
        )
        return BundleSolution(self, rig, found, now.linear)


def heights_by_curvature(corners: FloatArray) -> FloatArray:
    """(n, 3) derivative of a board's height at (n, 2) corners, m, by its curvatures, m^2."""
    x, y = corners.T
    return np.column_stack([0.5 * x * x, 0.5 * y * y, x * y])


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*vectors.shape, 3)


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """Cameras and poses, mostly those that fit best, and the residuals and Jacobians there."""

    problem: BundleAdjustment
    rig: CameraRig
    poses: BoardPoses
    linearisation: LinearisedResiduals
    """Residuals divided by sigma and Jacobians."""

    @property
    def residuals_px(self) -> FloatArray:
        """(c, v, n, 2) projected minus measured pixels; nan for corners that were not found."""
        cameras, views, corners, _ = self.problem.pixels.shape
        residuals = self.linearisation.residuals.reshape(views, cameras, corners, 2)
        scaled = residuals.transpose(1, 0, 2, 3) * self.problem.sigma
        return np.where(self.problem.seen[..., None], scaled, np.nan)

    @cached_property
    def view_chi(self) -> FloatArray:
        """(v) noise of each view, residuals over sigma; nan for a view without corners."""
        count = self.problem.seen.sum(axis=(0, 2))
        freedom = np.where(count > 3, 2 * count - 6, np.nan)
        return np.sqrt(self.linearisation.cost / freedom)

    @cached_property
    def view_rms_px(self) -> FloatArray:
        """(v) root mean square length of each view's residuals, px."""
        count = np.maximum(self.problem.seen.sum(axis=(0, 2)), 1)
        return np.asarray(np.sqrt(np.nansum(self.residuals_px**2, axis=(0, 2, 3)) / count))

    @cached_property
    def reduced_rig_jacobian(self) -> FloatArray:
        """(v, m, p) Jacobian of the residuals by the rig's parameters, poses eliminated."""
        return self.linearisation.eliminated()[0]

    @property
    def reduced_chi(self) -> float:
        """Ratio of the residuals to sigma, root of the reduced chi-square: 1 if sigma is right."""
        estimated = 6 * len(self.poses.translation) + len(self.rig.packed())
        freedom = max(2 * int(self.problem.seen.sum()) - estimated, 1)
        return float(np.sqrt((self.linearisation.residuals**2).sum() / freedom))

    @cached_property
    def information(self) -> FloatArray:
        """(v, p, p) each view's information on the rig's parameters, if sigma is right."""
        return np.asarray(self.reduced_rig_jacobian.transpose(0, 2, 1) @ self.reduced_rig_jacobian)


def rms_length(residuals_px: FloatArray) -> float:
    """Root mean square length of residuals (..., 2), as OpenCV defines it; nan are left out."""
    return float(np.sqrt(np.nanmean((residuals_px**2).sum(axis=-1))))
