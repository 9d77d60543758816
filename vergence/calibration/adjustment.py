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

from collections.abc import Callable, Iterator, Sequence
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
    """Pixels of points in a camera's frame, and their Jacobians."""

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

    def project(
        self, camera: int, points: FloatArray, *, by_rig: bool = True
    ) -> tuple[ProjectedPoints, NDArray[np.intp]]:
        """Project (..., 3) points of the left camera's frame, m.

        Also the (k,) places of the parameters, those of the camera Jacobian, in `packed`. Without
        `by_rig`, the camera Jacobian lacks the relative pose of the cameras.
        """
        seen = project_with_jacobians(
            self.lenses[camera], self.camera_parameters[camera], self.in_camera(camera, points)
        )
        every = np.arange(self.blocks[-1].start)
        own = every[self.blocks[camera]]
        if camera == 0:
            return seen, own
        by_point = seen.point_jacobian @ self.rotation
        if not by_rig:
            return seen._replace(point_jacobian=by_point), own
        by_vector = cv2.Rodrigues(Rotation.from_matrix(self.rotation).as_rotvec())[1]
        turning = np.einsum("kij,...j->...ik", by_vector.reshape(3, 3, 3), points)
        by_all = [seen.camera_jacobian, seen.point_jacobian @ turning, seen.point_jacobian]
        return (
            ProjectedPoints(seen.pixels, by_point, np.concatenate(by_all, axis=-1)),
            np.append(own, every[self.blocks[-2]]),
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


class ReducedNormalEquations(NamedTuple):
    """Normal equations of shared unknowns; each group's own ones eliminated (Schur complement).

    A group has unknowns of its own: a view the board's pose, a frame of a head its reading errors.
    """

    cost: float
    """Sum of squares."""
    matrix: FloatArray
    """(s, s) normal matrix of the shared unknowns."""
    gradient: FloatArray
    """(s,) gradient, half of the cost's."""
    own_by_shared: FloatArray
    """(g, o, s_g) negative derivative of each group's own unknowns by those in its columns."""
    own_step: FloatArray
    """(g, o) negative step of the groups' own unknowns while the shared ones stay."""
    own_matrix: FloatArray
    """(g, o, o) normal matrix of each group's own unknowns."""
    residuals: FloatArray
    """(c, g, n, 2) residuals divided by sigma; 0 for corners that were not found."""
    group_parts: tuple[FloatArray, FloatArray] | None
    """(g, s_g, s_g) and (g, s_g) each group's parts of matrix and gradient, if they were kept."""


class GroupedEquations:
    """Sums of the equations of groups, from which `ReducedNormalEquations` follow.

    Args:
        columns: (g, s_g) places of each group's unknowns among the shared ones; -1 for none.
        common_count: how many leading ones all groups have in common.
        own_matrix: (g, o, o) the prior's normal matrix of the groups' own unknowns.
        own_gradient: (g, o) the prior's gradient.
        keep_parts: keep the parts of each group.
    """

    def __init__(
        self, columns: NDArray[np.intp], common_count: int, own_matrix: FloatArray,
        own_gradient: FloatArray, *, keep_parts: bool = False,
    ) -> None:  # fmt: skip
        groups, width = columns.shape
        self._columns, self._common = columns, common_count
        self._own_matrix, self._own_gradient = own_matrix.copy(), own_gradient.copy()
        self._across = np.zeros((groups, own_matrix.shape[-1], width))
        self._matrix = np.zeros((common_count, common_count))
        self._blocks = np.zeros((groups, width, width - common_count))
        self._gradients = np.zeros((groups, width))
        self._parts = np.zeros((groups, width, width)) if keep_parts else None

    def add(self, jacobian: FloatArray, residuals: FloatArray, columns: NDArray[np.intp]) -> None:
        """Add (g, m) residuals with (g, m, k + o) Jacobian, own unknowns last, at (k,) columns."""
        known = len(columns)
        common = columns[columns < self._common]
        count = len(common)
        turned = jacobian.transpose(0, 2, 1)
        # group by group: one large product would wait for threads, where others use the CPU too
        product, pulls = turned @ jacobian, (turned @ residuals[..., None])[..., 0]
        # all groups share the common block: sum it at once
        self._matrix[np.ix_(common, common)] += product[:, :count, :count].sum(axis=0)
        self._blocks[:, columns] += product[:, :known, count:known]
        if self._parts is not None:
            self._parts[:, columns[:, None], columns] += product[:, :known, :known]
        self._gradients[:, columns] += pulls[:, :known]
        self._own_matrix += product[:, known:, known:]
        self._own_gradient += pulls[:, known:]
        self._across[:, :, columns] += product[:, known:, :known]

    def reduced(
        self, cost: float, residuals: FloatArray, prior_information: FloatArray,
        deviation: FloatArray,
    ) -> ReducedNormalEquations:  # fmt: skip
        """Eliminate the own unknowns; (s,) prior of the shared ones and deviation from its mean."""
        common, across, gone = self._common, self._across, self._across.transpose(0, 2, 1)
        diagonal = np.einsum("gii->gi", self._own_matrix)
        solved = _solve_damped(
            self._own_matrix, _LEAST_DAMPING * diagonal,
            np.concatenate([across, self._own_gradient[..., None]], axis=-1),
        )  # fmt: skip
        by_shared, step = solved[..., :-1], solved[..., -1]
        gradients = self._gradients - (gone @ step[..., None])[..., 0]
        parts = None if self._parts is None else (self._parts - gone @ by_shared, gradients)
        # -1, the last, takes what belongs to no unknown
        size = len(prior_information) + 1
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        matrix[:common, :common] = self._matrix
        matrix[:common, :common] -= (gone[:, :common] @ by_shared[..., :common]).sum(axis=0)
        others = self._blocks - gone @ by_shared[..., common:]
        rest = self._columns[:, common:]
        np.add.at(matrix, (np.arange(common)[None, :, None], rest[:, None, :]), others[:, :common])
        np.add.at(matrix, (rest[:, :, None], rest[:, None, :]), others[:, common:])
        np.add.at(gradient, self._columns, gradients)
        matrix[common:, :common] = matrix[:common, common:].T
        return ReducedNormalEquations(
            cost + float((prior_information * deviation**2).sum()),
            matrix[:-1, :-1] + np.diag(prior_information),
            gradient[:-1] + prior_information * deviation,
            by_shared, step, self._own_matrix, residuals, parts,
        )  # fmt: skip


def normalised_residuals(
    pixels: FloatArray, measured: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals of (..., 2) px over sigma, and 1 / sigma; 0 for what was not measured."""
    found = np.isfinite(measured).all(axis=-1, keepdims=True)
    scale = np.where(found, 1.0 / np.where(found, sigma, 1.0), 0.0)
    return np.where(found, scale * (pixels - np.where(found, measured, 0.0)), 0.0), scale


def heights_by_curvature(corners: FloatArray) -> FloatArray:
    """(n, 3) derivative of a board's height at corners (n, 2 or 3), m, by its curvatures, m^2."""
    x, y = (corners - corners.mean(axis=0))[:, :2].T
    return np.column_stack([0.5 * x * x, 0.5 * y * y, x * y])


def bent_board(corners: FloatArray, curvatures: FloatArray) -> FloatArray:
    """(n, 3) corners of a flat board, m, bent by curvatures (3,), 1/m."""
    bent = corners.copy()
    bent[:, 2] += heights_by_curvature(corners) @ curvatures
    return bent


class _PoseEquations(NamedTuple):
    """Normal equations of each view's pose, for given cameras."""

    cost: FloatArray
    matrix: FloatArray
    gradient: FloatArray


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

    def points(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        """(v, n, 3) the board's corners in the left camera's frame, metres."""
        return self._turned(rig, poses) + poses.translation[:, None]

    def _turned(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        bent = bent_board(self.board_corners, rig.board_curvatures)
        return np.asarray(bent @ poses.rotation.transpose(0, 2, 1))

    def rows(
        self, rig: CameraRig, poses: BoardPoses, *, by_rig: bool = True
    ) -> Iterator[tuple[FloatArray, FloatArray, NDArray[np.intp]]]:
        """Each camera's residuals over sigma (v, m), their Jacobian (v, m, k + 6), and columns.

        The last six are by a small rotation of the board in the left camera's frame, and a
        translation; the others, if `by_rig`, by the parameters of `CameraRig.packed` at (k,).
        """
        turned = self._turned(rig, poses)
        points, views = turned + poses.translation[:, None], len(turned)
        by_bend = (
            poses.rotation[:, None, :, 2, None] * heights_by_curvature(self.board_corners)[:, None]
        )
        bend = np.arange(len(rig.packed()))[rig.blocks[-1]]
        for camera in range(len(rig.lenses)):
            seen, columns = rig.project(camera, points, by_rig=by_rig)
            # a small rotation d of the board moves a corner by d x turned
            by = [np.cross(turned[..., None, :], seen.point_jacobian), seen.point_jacobian]
            if by_rig:
                by = [seen.camera_jacobian, seen.point_jacobian @ by_bend, *by]
            residuals, scale = normalised_residuals(
                seen.pixels, self.pixels[camera], self.sigma[camera]
            )
            jacobian = np.concatenate(by, axis=-1)
            jacobian *= scale[..., None]
            jacobian[scale == 0.0] = 0.0  # also of corners behind the camera
            yield (
                residuals.reshape(views, -1),
                jacobian.reshape(views, residuals[0].size, -1),
                np.append(columns, bend) if by_rig else bend[:0],
            )

    def residuals(self, rig: CameraRig, poses: BoardPoses) -> FloatArray:
        """(c, v, n, 2) residuals divided by sigma; 0 for corners that were not found."""
        rows = [residuals for residuals, *_ in self.rows(rig, poses, by_rig=False)]
        return np.stack(rows).reshape(self.pixels.shape)

    def linearised(
        self, rig: CameraRig, poses: BoardPoses, *, keep_parts: bool = False
    ) -> ReducedNormalEquations:
        """Normal equations of the rig's parameters, the views' poses eliminated."""
        views, row, prior = len(poses.rotation), rig.packed(), rig.prior_information
        equations = GroupedEquations(
            np.broadcast_to(np.arange(len(row)), (views, len(row))), len(row),
            np.zeros((views, 6, 6)), np.zeros((views, 6)), keep_parts=keep_parts,
        )  # fmt: skip
        found = []
        for residuals, jacobian, columns in self.rows(rig, poses):
            equations.add(jacobian, residuals, columns)
            found.append(residuals)
        residuals = np.stack(found).reshape(self.pixels.shape)
        return equations.reduced(float((residuals**2).sum()), residuals, prior, row)

    def fit_poses(self, rig: CameraRig, start: BoardPoses) -> "BundleSolution":
        """Fit the poses to given cameras."""

        def linearised(poses: BoardPoses) -> _PoseEquations:
            total = _PoseEquations(
                *(np.zeros((len(poses.rotation), *shape)) for shape in ((), (6, 6), (6,)))
            )
            for residuals, jacobian, _ in self.rows(rig, poses, by_rig=False):
                turned = jacobian.transpose(0, 2, 1)
                total.cost[:] += (residuals**2).sum(axis=1)
                total.matrix[:] += turned @ jacobian
                total.gradient[:] += (turned @ residuals[..., None])[..., 0]
            return total

        poses, _ = damped_least_squares(
            linearised,
            lambda poses, _, steps, __: poses.moved(steps),
            start,
            tolerance=_POSE_TOLERANCE,
            relative_tolerance=_POSE_TOLERANCE,
        )
        return BundleSolution(self, rig, poses)

    def solve(
        self, start: CameraRig, poses: BoardPoses, tolerance: float = _TOLERANCE
    ) -> "BundleSolution":
        """Cameras and poses with the least squares; `LinAlgError` if they are not determined."""

        def moved(
            state: tuple[CameraRig, BoardPoses], now: ReducedNormalEquations, step: FloatArray,
            damping: FloatArray,
        ) -> tuple[CameraRig, BoardPoses]:  # fmt: skip
            rig, poses = state
            own_step = now.own_step / (1.0 + damping)
            return rig.unpacked(rig.packed() + step), poses.moved(
                -own_step - now.own_by_shared @ step
            )

        (rig, found), _ = damped_least_squares(
            lambda state: self.linearised(*state),
            moved,
            (start, self.fit_poses(start, poses).poses),
            tolerance=0.0,
            relative_tolerance=tolerance,
        )
        return BundleSolution(self, rig, found)


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    return np.asarray(np.cross(np.eye(3), vectors[..., None, :]))


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """Cameras and poses, mostly those that fit best, and the residuals there."""

    problem: BundleAdjustment
    rig: CameraRig
    poses: BoardPoses

    @cached_property
    def residuals(self) -> FloatArray:
        """(c, v, n, 2) residuals divided by sigma; 0 for corners that were not found."""
        return self.problem.residuals(self.rig, self.poses)

    @property
    def residuals_px(self) -> FloatArray:
        """(c, v, n, 2) projected minus measured pixels; nan for corners that were not found."""
        scaled = self.residuals * self.problem.sigma
        return np.where(self.problem.seen[..., None], scaled, np.nan)

    @cached_property
    def view_chi(self) -> FloatArray:
        """(v) noise of each view, residuals over sigma; nan for a view without corners."""
        count = self.problem.seen.sum(axis=(0, 2))
        freedom = np.where(count > 3, 2 * count - 6, np.nan)
        return np.asarray(np.sqrt((self.residuals**2).sum(axis=(0, 2, 3)) / freedom))

    @cached_property
    def view_rms_px(self) -> FloatArray:
        """(v) root mean square length of each view's residuals, px."""
        count = np.maximum(self.problem.seen.sum(axis=(0, 2)), 1)
        return np.asarray(np.sqrt(np.nansum(self.residuals_px**2, axis=(0, 2, 3)) / count))

    @property
    def reduced_chi(self) -> float:
        """Ratio of the residuals to sigma, root of the reduced chi-square: 1 if sigma is right."""
        estimated = 6 * len(self.poses.translation) + len(self.rig.packed())
        freedom = max(2 * int(self.problem.seen.sum()) - estimated, 1)
        return float(np.sqrt((self.residuals**2).sum() / freedom))

    @cached_property
    def view_parts(self) -> tuple[FloatArray, FloatArray]:
        """(v, p, p) and (v, p) each view's information on the rig's parameters, and gradient."""
        parts = self.problem.linearised(self.rig, self.poses, keep_parts=True).group_parts
        assert parts is not None
        return parts


def rms_length(residuals_px: FloatArray) -> float:
    """Root mean square length of residuals (..., 2), as OpenCV defines it; nan are left out."""
    return float(np.sqrt(np.nanmean((residuals_px**2).sum(axis=-1))))
