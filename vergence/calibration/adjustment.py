"""Bundle adjustment of photographs of a board: cameras, their relative pose, and board poses.

Corner n of view v is, in the frames of the left and the right camera, at

    p_left = R_v (x_n, y_n, z_n) + t_v,    p_right = R p_left + t

The adjustment minimises the sum of squares of `(projected - measured) / sigma` over the parameters
of the cameras, R and t, every R_v and t_v, and the curvatures of the board, as no paper is flat:

    z = (b_xx x^2 + b_yy y^2) / 2 + b_xy x y    from the middle of the board.

The poses of the board are eliminated, as each belongs to one view; about thirty unknowns remain.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vergence.calibration.least_squares import (
    GroupedEquations,
    ReducedNormalEquations,
    damped_least_squares,
)
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


_POSE_TOLERANCE: Final = 1e-12
"""Change of a view's sum of squares, absolute and relative, below which its pose is found; an error
of one standard deviation changes the sum by 1 (numerical)."""
_RATIONAL_PRIOR_SIGMA: Final = 1.0
"""Prior standard deviation of the coefficients k1 to k6 of the rational lens (chosen: real lenses
have coefficients of this size or less)."""
_TOLERANCE: Final = 1e-12
"""Relative change of the sum of squares below which cameras are found (numerical)."""


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
