"""Bundle adjustment of a head: its parameters, the board, and every true joint angle.

The adjustment minimises the sum of squares of

    (projected - measured) / sigma                       each corner in each eye and frame,
    e / sigma_e                                          the reading error of each angle,
    (x - x_0) / sigma_0                                  the prior of each parameter of the head

over the head's parameters x, the parameters y of the reading-error terms, the board's poses in
frame 0 and its bend, and the reading errors e. Errors of a single frame are eliminated frame by
frame (Schur complement). About a hundred shared unknowns remain, and their normal matrix is
assembled from small blocks. The reading-error terms are systematic errors of joint readings:

    true angle = reading + error + sum_k term_k(readings; y_k)

Each term belongs to an actuator and has one parameter y, in rad. With backlash (play), the joint
lags behind the motor, whose angle is read, until the motor has crossed the gap: y is its whole
width. An eccentric encoder disc causes harmonics of the angle q: y cos(q), y sin(q), y cos(2q) and
y sin(2q). The eyes' harmonics have zero mean over the recording, as a mean is a joint's offset.
(The neck's joints have no offset among the parameters.)
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import (
    BoardPoses,
    bent_board,
    camera_parameter_names,
    camera_parameters,
    cross_matrices,
    heights_by_curvature,
    normalised_residuals,
    project_with_jacobians,
)
from vergence.calibration.head.recording import (
    SAME_POSE_RAD,
    HeadFrames,
    IntArray,
    ReadingErrorUnknowns,
)
from vergence.calibration.least_squares import GroupedEquations, ReducedNormalEquations
from vergence.models.geometry import inverse_pose, pose_parameter_twists, rot_z
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, NECK, FloatArray


class ProjectedBoard(NamedTuple):
    """Pixels of one eye in all frames, and their Jacobians."""

    pixels: FloatArray
    """(f, n, 2) px; nan behind the camera."""
    head_jacobian: FloatArray
    """(f, n, 2, p_eye) Jacobian by the head's `ParametricHead.eye_parameter_indices`."""
    joint_jacobian: FloatArray
    """(f, n, 2, 7) Jacobian by the joint angles, px/rad."""
    board_jacobian: FloatArray
    """(f, n, 2, 6) Jacobian by a small rotation, in frame 0, and a translation of the board."""


@dataclass(frozen=True, eq=False)
class ParametricHead:
    """Chains of a head with (p,) `HeadModel.parameters` relative to the nominal head."""

    nominal_head: HeadModel
    values: FloatArray

    @cached_property
    def head(self) -> HeadModel:
        """The head with these parameters."""
        return self.nominal_head.with_parameters(self.values)

    @cached_property
    def constant_poses(self) -> FloatArray:
        """(10, 4, 4) B_0 to B_3 of the neck, and M_0 to M_2 of each eye with its camera."""
        poses = np.array(self.head.links.constant_poses())
        for eye in range(2):
            poses[6 + 3 * eye] = poses[6 + 3 * eye] @ self.head.head_eye[eye]
        return poses

    @cached_property
    def twists(self) -> FloatArray:
        """(p, 6, 6) body twists by parameter and constant: M_0 to M_2 of the left, then right."""
        links, nominal_head, head = self.head.links, self.nominal_head, self.head
        names = head.parameters().names
        out = np.zeros((len(names), 6, 6))
        own = links.twists(nominal_head.links)
        out[: len(own)] = own
        for eye, name in enumerate(EYE_NAMES):
            last = 3 * eye + 2
            into = adjoint(inverse_pose(head.head_eye[eye]))
            out[:, last] = out[:, last] @ into.T
            first = names.index(f"{name}.head_eye.rx")
            rotation = self.values[first : first + 3]
            out[first : first + 6, last] = pose_parameter_twists(
                nominal_head.head_eye[eye], rotation
            )
        return out

    @cached_property
    def eye_parameter_indices(self) -> tuple[IntArray, IntArray]:
        """(p_eye,) by eye: indices of the parameters that it depends on, its camera's last."""
        names = self.nominal_head.parameters().names
        found = []
        for eye, name in enumerate(EYE_NAMES):
            moved = self.twists[:, 3 * eye : 3 * eye + 3].any(axis=(1, 2))
            camera = camera_parameter_names(self.nominal_head.cameras.lens[eye])
            own = [names.index(f"{name}.camera.{each}") for each in camera]
            found.append(np.concatenate([np.flatnonzero(moved), own]).astype(np.intp))
        return found[0], found[1]

    def project_board(
        self, eye: int, q: FloatArray, points: FloatArray, offsets: FloatArray
    ) -> ProjectedBoard:
        """Project (f, n, 3) points in frame 0, m, at (f, 7) q; offsets are from the board's."""
        B, M = self.constant_poses[:4], self.constant_poses[4 + 3 * eye : 7 + 3 * eye]
        joints = [0, 1, 2, 3 + 2 * eye, 4 + 2 * eye]
        turns = rot_z(q[:, joints]).transpose(1, 0, 2, 3)
        columns = self.eye_parameter_indices[eye]
        twists = self.twists[columns, 3 * eye : 3 * eye + 3]
        # twists of the frames in frame 0, by each parameter and joint
        by_head, by_joint = np.zeros((len(q), 6, len(columns))), np.zeros((len(q), 6, 7))
        pose = np.eye(4)
        for place, constant in enumerate((*B[:3], B[3] @ M[0], *M[1:])):
            pose = pose @ constant
            into = adjoint(pose)
            if place > 2:
                by_head += into @ twists[:, place - 3].T
            if place < 5:  # each joint is about z
                by_joint[..., joints[place]] = into[..., 2]
                pose = pose @ turns[place]
        to_board = np.eye(4) + np.zeros((len(q), 4, 4))
        to_board[:, :3, 3] = points[:, 0] - offsets[:, 0]
        by = np.concatenate([-by_head, -by_joint, adjoint(to_board)], axis=-1)

        R, p = pose[:, :3, :3], pose[:, None, :3, 3]
        image = project_with_jacobians(*camera_parameters(self.head, eye), (points - p) @ R)
        in_base = image.point_jacobian @ R.transpose(0, 2, 1)[:, None]
        # times a twist of a point in frame 0: the change of its pixel
        wrench = np.concatenate([np.cross(points[:, :, None], in_base), in_base], axis=-1)
        rows = (wrench.reshape(len(q), -1, 6) @ by).reshape(*image.pixels.shape, -1)
        by_head, by_joint, by_board = np.split(rows, [len(columns), len(columns) + 7], axis=-1)
        by_head[..., -image.camera_jacobian.shape[-1] :] = image.camera_jacobian
        return ProjectedBoard(image.pixels, by_head, by_joint, by_board)


def adjoint(pose: FloatArray) -> FloatArray:
    """(..., 6, 6) adjoint matrix of the pose T_A_B: transforms a twist from frame B to frame A."""
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = pose[..., :3, :3]
    out[..., 3:, :3] = cross_matrices(pose[..., :3, 3]) @ pose[..., :3, :3]
    return out


def board_points_and_offsets(
    corners: FloatArray, boards: BoardPoses, pose_index: IntArray
) -> tuple[FloatArray, ...]:
    """Corners (n, 3) of boards in frame 0, m, and offsets from each board's origin, by frame."""
    turned = corners @ boards.rotation[pose_index].transpose(0, 2, 1)
    return turned + boards.translation[pose_index][:, None], turned


_PRIOR_SIGMA: Final = {"play": np.deg2rad(0.5), "harmonics": np.deg2rad(0.3)}
"""Prior standard deviations of the parameters, rad (chosen: gears of hobby servos, and a disc of
20 mm that is 0.05 mm off its axis)."""
TERM_KINDS: Final = tuple(_PRIOR_SIGMA)
_HARMONICS: Final = {"cos1": (1, np.cos), "sin1": (1, np.sin), "cos2": (2, np.cos),
                     "sin2": (2, np.sin)}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingErrorTerms:
    """Terms that model systematic reading errors: backlash, and harmonics of the encoders."""

    names: tuple[str, ...] = ()
    """(t,) names such as `left_pan.play` and `left_pan.cos1`."""
    actuator_index: IntArray
    """(t,) actuator of each term, of the neck's three joints and the eyes' four actuators."""
    prior_mean: FloatArray
    """(t,) prior means of the parameters, rad."""
    prior_sigma: FloatArray
    """(t,) prior standard deviations of the parameters, rad; 0 for fixed ones."""
    actuator_readings: FloatArray
    """(F, 7) the actuators' angles, rad, in all frames in the order of time."""
    frame_index: IntArray
    """(f,) indices of the selected frames."""
    harmonic_mean: FloatArray
    """(t,) mean of each harmonic of the eyes over all frames; 0 for other terms."""

    @classmethod
    def of_frames(
        cls, head: HeadModel, frames: HeadFrames, kinds: Collection[str]
    ) -> "ReadingErrorTerms":
        """Make terms of some `TERM_KINDS` for all actuators that move, frames in time."""
        readings = head.actuation.actuators_of(frames.joint_positions)
        every = np.arange(len(readings))
        return replace(NO_TERMS, actuator_readings=readings, frame_index=every).with_terms(
            head, kinds
        )

    def with_terms(self, head: HeadModel, kinds: Collection[str]) -> "ReadingErrorTerms":
        """Make other terms for the same readings, see `of_frames`."""
        own, readings = head.actuation, self.actuator_readings
        moves = (own.upper > own.lower) & (np.ptp(readings, axis=0) > SAME_POSE_RAD)
        names, joint, sigma = [], [], []
        for kind in TERM_KINDS:
            for each in np.flatnonzero(moves).tolist() if kind in kinds else ():
                parts = ["play"] if kind == "play" else list(_HARMONICS)
                names += [f"{[*head.joints[:3], *own.names][each]}.{part}" for part in parts]
                joint += [each] * len(parts)
                sigma += [_PRIOR_SIGMA[kind]] * len(parts)
        waves = [_harmonic(name, readings[:, k]) for name, k in zip(names, joint, strict=True)]
        return replace(
            self,
            names=tuple(names),
            actuator_index=np.array(joint, dtype=np.intp),
            prior_mean=np.zeros(len(names)),
            prior_sigma=np.array(sigma, dtype=np.float64),
            harmonic_mean=np.array([wave.mean() for wave in waves])
            * (np.array(joint) >= NECK.stop),
        )

    @property
    def kinds(self) -> tuple[str, ...]:
        """(t,) kind of each term, one of `TERM_KINDS`."""
        return tuple("play" if name.endswith(".play") else "harmonics" for name in self.names)

    @property
    def is_backlash(self) -> NDArray[np.bool_]:
        """(t,) True for backlash."""
        return np.array([kind == "play" for kind in self.kinds], dtype=np.bool_)

    def select(self, frames: NDArray[np.bool_]) -> "ReadingErrorTerms":
        """Select some of the frames."""
        return self if self is NO_TERMS else replace(self, frame_index=self.frame_index[frames])

    def fixed_at(self, values: FloatArray) -> "ReadingErrorTerms":
        """Fix the parameters at values (t,)."""
        return replace(self, prior_mean=values, prior_sigma=np.zeros(len(values)))

    def evaluate(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(f, 7) sum of the terms by actuator, rad, and (f, t) derivative by each parameter."""
        angles = self.actuator_readings[:, self.actuator_index]
        by = np.zeros_like(angles)
        for column, name in enumerate(self.names):
            by[:, column] = _harmonic(name, angles[:, column]) - self.harmonic_mean[column]
        added, play = by * values, self.is_backlash
        added[:, play], by[:, play] = _backlash_offset(angles[:, play], values[play])
        return added[self.frame_index] @ np.eye(7)[self.actuator_index], by[self.frame_index]

    def linearised_sum(self, values: FloatArray, other_values: FloatArray) -> FloatArray:
        """(f, 7) sum of the terms with other parameters, linearised at given ones."""
        added, by = self.evaluate(values)
        return added + (by * (other_values - values)) @ np.eye(7)[self.actuator_index]


NO_TERMS: Final = ReadingErrorTerms(
    actuator_index=np.zeros(0, dtype=np.intp), prior_mean=np.zeros(0), prior_sigma=np.zeros(0),
    actuator_readings=np.zeros((1, 7)), frame_index=np.zeros(1, dtype=np.intp),
    harmonic_mean=np.zeros(0),
)  # fmt: skip


def _harmonic(name: str, angles: FloatArray) -> FloatArray:
    """(F,) harmonic of angles (F,) that a parameter multiplies; 0 for backlash."""
    order, function = _HARMONICS.get(name.rpartition(".")[2], (0, np.sin))
    return np.asarray(function(order * angles))


def _backlash_offset(angles: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(F, k) offsets of joints from motors, and by width (k,); the first frame is in the middle."""
    half = 0.5 * np.abs(width)
    away, by = np.zeros_like(angles), np.zeros_like(angles)
    for frame in range(1, len(angles)):
        free = away[frame - 1] - (angles[frame] - angles[frame - 1])
        away[frame] = np.clip(free, -half, half)
        by[frame] = np.where(np.abs(free) > half, 0.5 * np.sign(free), by[frame - 1])
    return np.where(width < 0.0, -away, away), by


CURVATURE_COUNT: Final = 3
"""Number of curvatures of the board, see `vergence.calibration.adjustment` (numerical)."""
_CURVATURE_SIGMA: Final = 0.5
"""Prior standard deviation of a curvature, 1/m (chosen: 0.6 mm at the edge of a 100 mm board)."""
_WEAK_PRIOR_INFORMATION: Final = 1e-6
"""Prior information of unknowns without a prior, 1/rad^2 and 1/m^2 (numerical)."""
_CAUCHY_SIGMAS: Final = 3.0
"""Scale of Cauchy's loss, in standard deviations: a larger corner or reading error counts for less
(chosen)."""


class HeadUnknowns(NamedTuple):
    """Values of all unknowns of a head adjustment."""

    head_parameters: FloatArray
    """(p,) parameters of the head, see `HeadModel.parameters`."""
    board_curvatures: FloatArray
    """(3,) curvatures of the board, 1/m."""
    boards: BoardPoses
    """(b) poses of the board in frame 0, one per placement."""
    shared_errors: FloatArray
    """(r,) reading errors that frames share while joints rest, rad."""
    frame_errors: FloatArray
    """(f, 7) reading errors of single frames, rad."""
    term_parameters: FloatArray
    """(t,) parameters of the reading-error terms, rad."""


class MeasurementWeights(NamedTuple):
    """Weights of the measurements, 0 to 1."""

    corners: FloatArray
    """(2, f, n) weight of each corner by eye."""
    angles: FloatArray
    """(f, 7) weight of each reading error of a single frame."""
    cauchy_scale: float = np.inf
    """Typical mean square of a corner's residuals, in units of sigma^2, which scales Cauchy's loss;
    inf for least squares."""

    @classmethod
    def of(cls, kept_corners: NDArray[np.bool_]) -> "MeasurementWeights":
        """Make weights 1 for kept corners (2, f, n) and 0 for others."""
        return cls(kept_corners.astype(np.float64), np.ones((kept_corners.shape[1], 7)))


@dataclass(frozen=True, eq=False)
class HeadAdjustment:
    """The adjustment problem: a nominal head, its (p,) prior sigmas (0: fixed), its frames."""

    nominal_head: HeadModel
    prior_sigma: FloatArray
    frames: HeadFrames
    scatter_ratio: FloatArray = field(default_factory=lambda: np.ones(7))
    """(7,) ratio of each actuator's reading scatter to its expectation by quantisation and
    backlash."""
    terms: ReadingErrorTerms = NO_TERMS
    """Reading-error terms."""

    @cached_property
    def reading_error_unknowns(self) -> ReadingErrorUnknowns:
        """Unknown reading errors of the joints."""
        found = ReadingErrorUnknowns.of(self.nominal_head, self.frames)
        return replace(found, reading_sigma=found.reading_sigma * self.scatter_ratio)

    @cached_property
    def prior_mean(self) -> FloatArray:
        """(p,) nominal parameters, the mean of the prior."""
        return self.nominal_head.parameters().values

    @cached_property
    def joints_from_actuators(self) -> FloatArray:
        """(7, 7) matrix from actuator angles to joint angles."""
        out = np.eye(7)
        if not self.nominal_head.actuation.direct:
            out[EYES, EYES] = self.nominal_head.actuation.to_joints
        return out

    @cached_property
    def placement_count(self) -> int:
        """Number of placements of the board."""
        return int(self.frames.placement.max()) + 1

    @property
    def shared_count(self) -> int:
        """Number s of shared unknowns."""
        return len(self.prior_information)

    @property
    def common_count(self) -> int:
        """Number of leading shared unknowns common to all frames: head, bend, reading terms."""
        return len(self.prior_mean) + CURVATURE_COUNT + len(self.terms.names)

    @cached_property
    def prior_information(self) -> FloatArray:
        """(s,) prior information of each shared unknown, 1 / sigma^2."""
        own = self.reading_error_unknowns
        # four corners tell no bend
        bend = 1e-6 if len(self.frames.corners) <= 4 else _CURVATURE_SIGMA
        common = [self.prior_sigma, np.full(CURVATURE_COUNT, bend), self.terms.prior_sigma]
        return np.concatenate(
            [
                1.0 / np.maximum(np.concatenate(common), 1e-9) ** 2,
                # placements of the board that no frame shows need a solvable pose too
                np.full(6 * self.placement_count, _WEAK_PRIOR_INFORMATION),
                1.0 / own.reading_sigma[own.shared_error_actuator] ** 2,
            ]
        )

    @cached_property
    def frame_columns(self) -> NDArray[np.intp]:
        """(f, s_f) indices of each frame's unknowns among the shared ones; -1 for none."""
        common, f = self.common_count, len(self.frames.time_s)
        head = np.broadcast_to(np.arange(common), (f, common))
        board = common + 6 * self.frames.placement[:, None] + np.arange(6)
        run = self.reading_error_unknowns.shared_error_index
        run = np.where(run >= 0, common + 6 * self.placement_count + run, -1)
        return np.concatenate([head, board, run], axis=1)

    def joint_angles(self, state: HeadUnknowns) -> FloatArray:
        """(f, 7) true joint angles, rad."""
        own = self.reading_error_unknowns
        # frames without a shared error, of index -1, take the zero at the end
        shared = np.append(state.shared_errors, 0.0)[own.shared_error_index]
        errors = np.where(own.has_frame_error, state.frame_errors, 0.0) + shared
        return self.nominal_head.actuation.joints_of(
            own.actuator_readings + errors + self.terms.evaluate(state.term_parameters)[0]
        )

    def linearised(
        self, state: HeadUnknowns, weights: MeasurementWeights, *, keep_parts: bool = False
    ) -> ReducedNormalEquations:
        """Assemble the normal equations at a state, maybe with each frame's parts.

        The shared unknowns are head parameters, bend, reading-error terms, boards, shared errors.
        """
        chain = ParametricHead(self.nominal_head, state.head_parameters)
        q, own = self.joint_angles(state), self.reading_error_unknowns
        points, turned = board_points_and_offsets(
            bent_board(self.frames.corners, state.board_curvatures), state.boards,
            self.frames.placement,
        )  # fmt: skip
        normals = state.boards.rotation[self.frames.placement][:, :, 2]
        heights = heights_by_curvature(self.frames.corners)
        sigma = np.where(own.reading_sigma > 0.0, own.reading_sigma, 1.0)
        kept = np.where(own.has_frame_error, state.frame_errors / sigma, 0.0)
        p, width = len(self.prior_mean), self.frame_columns.shape[1]
        by_term = self.terms.evaluate(state.term_parameters)[1][:, None, None]
        far, cut = _CAUCHY_SIGMAS**2 * np.array([1.0, 2.0 * weights.cauchy_scale])
        far = far if np.isfinite(cut) else np.inf
        trust = weights.angles / (1.0 + kept**2 / far)
        cost = float((weights.angles * _loss(kept**2, far)).sum())
        equations = GroupedEquations(
            self.frame_columns, self.common_count, (trust / sigma**2)[..., None] * np.eye(7),
            trust * kept / sigma, keep_parts=keep_parts,
        )  # fmt: skip
        residuals = np.zeros(self.frames.pixels.shape)
        for eye in range(2):
            seen = chain.project_board(eye, q, points, turned)
            residuals[eye], scale = normalised_residuals(
                seen.pixels, self.frames.pixels[eye], self.frames.sigma[eye]
            )
            square = (residuals[eye] ** 2).sum(axis=-1)
            cost += float((weights.corners[eye] * _loss(square, cut)).sum())
            root = np.sqrt(weights.corners[eye] / (1.0 + square / cut))[..., None]
            lift = np.einsum("fncj,fj->fnc", seen.board_jacobian[..., 3:], normals)
            by_angle = seen.joint_jacobian @ self.joints_from_actuators
            rows = np.concatenate(
                [
                    seen.head_jacobian,
                    lift[..., None] * heights[None, :, None],
                    by_angle[..., self.terms.actuator_index] * by_term,
                    seen.board_jacobian,
                    np.where((own.shared_error_index >= 0)[:, None, None], by_angle, 0.0),
                    np.where(own.has_frame_error[:, None, None], by_angle, 0.0),
                ],
                axis=-1,
            )
            rows *= (root * scale)[..., None]
            if np.isnan(seen.pixels).any():  # corners behind the camera that were not measured
                np.nan_to_num(rows, copy=False)
            equations.add(
                rows.reshape(len(q), -1, rows.shape[-1]),
                (root * residuals[eye]).reshape(len(q), -1),
                np.concatenate([chain.eye_parameter_indices[eye], np.arange(p, width)]),
            )
        deviation = np.concatenate(
            [
                state.head_parameters - self.prior_mean,
                state.board_curvatures,
                state.term_parameters - self.terms.prior_mean,
                np.zeros(6 * self.placement_count),
                state.shared_errors,
            ]
        )
        return equations.reduced(cost, residuals, self.prior_information, deviation)

    def moved(
        self, state: HeadUnknowns, normal: ReducedNormalEquations, step: FloatArray
    ) -> HeadUnknowns:
        """Apply a step of the shared unknowns; the frames' own errors follow."""
        p, c, b = len(self.prior_mean), self.common_count, 6 * self.placement_count
        padded = np.append(step, 0.0)
        follow = normal.own_step + np.einsum(
            "fjs,fs->fj", normal.own_by_shared, padded[self.frame_columns]
        )
        terms = state.term_parameters + step[p + CURVATURE_COUNT : c]
        # the true angles take the linearised step although backlash is not linear
        follow += self.terms.evaluate(terms)[0] - self.terms.linearised_sum(
            state.term_parameters, terms
        )
        return HeadUnknowns(
            state.head_parameters + step[:p],
            state.board_curvatures + step[p : p + CURVATURE_COUNT],
            state.boards.moved(step[c : c + b].reshape(-1, 6)),
            state.shared_errors + step[c + b :],
            np.where(self.reading_error_unknowns.has_frame_error, state.frame_errors - follow, 0.0),
            terms,
        )

    def select(self, frames: NDArray[np.bool_]) -> "HeadAdjustment":
        """Restrict the problem to some of the frames."""
        return replace(self, frames=self.frames.select(frames), terms=self.terms.select(frames))

    def start(self, boards: BoardPoses) -> HeadUnknowns:
        """Make the initial state: the nominal head in front of given boards (frame 0)."""
        return HeadUnknowns(
            self.prior_mean.copy(),
            np.zeros(CURVATURE_COUNT),
            boards.select(np.arange(self.placement_count)),
            np.zeros(len(self.reading_error_unknowns.shared_error_actuator)),
            np.zeros(self.reading_error_unknowns.actuator_readings.shape),
            self.terms.prior_mean.copy(),
        )


def _loss(squares: FloatArray, cut: float) -> FloatArray:
    """Cauchy's loss: squares that grow as logarithms far above a cut."""
    return cut * np.log1p(squares / cut) if np.isfinite(cut) else squares
