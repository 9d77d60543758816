"""Fit a head to its frames: start values, priors, the bundle adjustment and what it drops."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import (
    BoardPoses,
    BundleAdjustment,
    CameraRig,
    camera_parameters,
)
from vergence.calibration.cameras import estimate_board_poses
from vergence.calibration.head.adjust import (
    HeadAdjustment,
    HeadUnknowns,
    MeasurementWeights,
)
from vergence.calibration.head.recording import LEAST_CORNERS, HeadFrames
from vergence.calibration.least_squares import ReducedNormalEquations, damped_least_squares
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray
from vergence.models.perturbation import ModelErrors, standard_deviations
from vergence.perception.locate import equivalent_corner_orders

PRIOR: Final = ModelErrors(
    # errors of lengths from a ruler and a drawing
    link_m=0.003,
    head_eye_m=0.005,
    # bent or printed brackets
    coaxiality_rad=np.deg2rad(1.0).item(),
    # a servo horn fits its spline in steps of 15 degrees; the error after it was set by eye
    joint_offset_rad=np.deg2rad(3.0).item(),
    head_eye_rad=np.deg2rad(3.0).item(),
    focal_relative=0.05,
    principal_px=20.0,
    distortion=0.1,
)
"""Prior standard deviations (chosen: they matter only for directions that the recording does not
determine)."""
_COEFFICIENT_SIGMA: Final = {"p1": 0.005, "p2": 0.005}
"""Prior standard deviations of lens coefficients, by name (chosen)."""
_OTHER_COEFFICIENT_SIGMA: Final = 0.1
"""Prior standard deviation of other lens coefficients (chosen)."""


def parameter_prior_sigma(head: HeadModel, estimate_cameras: bool = True) -> FloatArray:
    """(p,) prior sigmas of parameters; cameras' from the head's record if any, or 0: fixed."""
    spreads = standard_deviations(head.geometry, PRIOR)
    known = {} if head.calibration is None else head.calibration.sigma
    for place, name in enumerate(head.parameters().names):
        if ".camera." in name:
            own = _COEFFICIENT_SIGMA.get(name.rpartition(".")[2], _OTHER_COEFFICIENT_SIGMA)
            spreads[place] = known.get(name, spreads[place] or own) if estimate_cameras else 0.0
    return spreads


_MOST_CANDIDATES: Final = 300
"""Most views of one placement that are compared pairwise (numerical)."""


def single_camera_rig(head: HeadModel, eye: int) -> CameraRig:
    """Make a rig of one eye's camera."""
    return CameraRig.single(*camera_parameters(head, eye))


def board_in_cameras(head: HeadModel, frames: HeadFrames) -> list[BoardPoses]:
    """Find the board's pose in each camera, frame by frame; a placeholder without the board."""
    every = BundleAdjustment(frames.corners, frames.pixels, frames.sigma)
    return [
        estimate_board_poses(every.select_camera(eye), single_camera_rig(head, eye))
        for eye in range(2)
    ]


class InitialBoardPoses(NamedTuple):
    """Initial poses of the board, on which most views agree."""

    frames: HeadFrames
    """Frames with the corners of rotationally symmetric boards in one order."""
    boards: BoardPoses
    """(b) poses of the board in frame 0."""
    inlier_views: NDArray[np.bool_]
    """(2, f) True for views that agree with these poses."""
    spread_m: float
    """Median rms distance of these views' corners from the poses' corners; median over
    placements."""
    remark: str = ""
    """What to tell of a placement that was found among other frames."""


def estimate_consensus_board_poses(head: HeadModel, frames: HeadFrames) -> InitialBoardPoses:
    """Find the poses of the board on which most views agree, through a given head."""
    places, turns, shifts = board_corners_and_poses_in_base(head, frames)
    orders = equivalent_corner_orders(frames.target)
    # pixels may be outside the lens's range
    enough = frames.shown & np.isfinite(places).all(axis=(-2, -1))
    rotations, translations, spreads = [], [], []
    pixels, sigma = frames.pixels.copy(), frames.sigma.copy()
    inlier_views = np.zeros(enough.shape, dtype=bool)
    for place in range(int(frames.placement.max()) + 1):
        here = np.argwhere(enough & (frames.placement == place))
        if not len(here):
            raise np.linalg.LinAlgError(
                "expected views that determine where the board is, got none"
            )
        best, away, order = _medoid(places, here, orders)
        rotations.append(turns[best])
        translations.append(shifts[best])
        near = away <= 4.0 * np.quantile(away, 0.25) + 0.25 * frames.size_m
        spreads.append(float(np.median(away[near])))
        for (eye, frame), its, close in zip(here.tolist(), order.tolist(), near, strict=True):
            inlier_views[eye, frame] = close
            pixels[eye, frame] = frames.pixels[eye, frame][orders[its]]
            sigma[eye, frame] = frames.sigma[eye, frame][orders[its]]
    return InitialBoardPoses(
        replace(frames, pixels=pixels, sigma=sigma),
        BoardPoses(np.array(rotations), np.array(translations)),
        inlier_views,
        float(np.median(spreads)),
    )


def board_corners_and_poses_in_base(
    head: HeadModel, frames: HeadFrames
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(2, f, n, 3) corners, m, and pose (2, f, 3, 3), (2, f, 3) in frame 0, or placeholders."""
    T_0_C = head.base_pose(frames.joint_positions)[:, None] @ head.camera_poses(
        frames.joint_positions
    )
    found = []
    for eye, seen in enumerate(board_in_cameras(head, frames)):
        T = T_0_C[:, eye]
        turn = T[:, :3, :3] @ seen.rotation
        shift = (T[:, :3, :3] @ seen.translation[..., None])[..., 0] + T[:, :3, 3]
        found.append((frames.corners @ turn.transpose(0, 2, 1) + shift[:, None], turn, shift))
    places, turns, shifts = map(np.stack, zip(*found, strict=True))
    return places, turns, shifts


def _medoid(
    places: FloatArray, here: NDArray[np.intp], orders: Sequence[NDArray[np.intp]]
) -> tuple[tuple[int, int], FloatArray, NDArray[np.intp]]:
    """Find the medoid view, the views' distances to it, and their corner orders."""
    some = here[:: -(-len(here) // _MOST_CANDIDATES)]
    sets = places[some[:, 0], some[:, 1]]
    most = np.ptp(sets[0], axis=0).max()
    away = np.min([_distance(sets[:, None], sets[None][:, :, order]) for order in orders], axis=0)
    eye, frame = some[int(np.minimum(away, most).mean(axis=1).argmin())].tolist()
    every = places[here[:, 0], here[:, 1]]
    by_order = np.array([_distance(every[:, order], places[eye, frame]) for order in orders])
    return (eye, frame), by_order.min(axis=0), by_order.argmin(axis=0)


def _distance(one: FloatArray, other: FloatArray) -> FloatArray:
    """(...) root mean square distance between corners (..., n, 3), m."""
    return np.asarray(np.sqrt(((one - other) ** 2).sum(axis=-1).mean(axis=-1)))


_COST_TOLERANCE: Final = 1e-3
"""Change of the cost below which the adjustment ends; an error of one standard deviation in one
parameter changes the cost by 1 (numerical)."""
_COST_ROUNDING: Final = 1e-9
"""Relative change of the cost that counts as rounding (numerical)."""
_ROBUST_TOLERANCE: Final = 1e-3
"""Relative change of the cost below which a robust fit ends, as a fit to the inliers follows
(numerical)."""
FIRST_CAUCHY_SCALE: Final = 1e4
"""Typical mean square of a corner's residuals with the nominal head, in units of sigma^2 (chosen:
it corresponds to errors of degrees)."""
_SCALE_UPDATE_RATIO: Final = 0.7
"""Ratio to its old value below which the typical mean square replaces it (chosen)."""


@dataclass(frozen=True, eq=False)
class HeadSolution:
    """Unknowns with the least cost, the normal equations there, and the weights used."""

    problem: HeadAdjustment
    state: HeadUnknowns
    normal: ReducedNormalEquations
    weights: MeasurementWeights

    @cached_property
    def head(self) -> HeadModel:
        """The fitted head."""
        return self.problem.nominal_head.with_parameters(self.state.head_parameters)

    @cached_property
    def kept_corners(self) -> NDArray[np.bool_]:
        """(2, f, n) True for the corners that were fitted."""
        return self.problem.frames.seen & (self.weights.corners > 0.0)

    @cached_property
    def squares(self) -> FloatArray:
        """(2, f, n) mean square of each corner's residuals, in sigma^2; nan if not found."""
        seen = self.problem.frames.seen
        return np.where(seen, 0.5 * (self.normal.residuals**2).sum(axis=-1), np.nan)

    @cached_property
    def normalised_reading_errors(self) -> FloatArray:
        """(f, 7) reading errors of single frames over their prior sigma; 0 for shared ones."""
        own = self.problem.reading_error_unknowns
        sigma = np.where(own.reading_sigma > 0.0, own.reading_sigma, 1.0)
        return np.where(own.has_frame_error, self.state.frame_errors / sigma, 0.0)

    @cached_property
    def squares_and_counts(self) -> tuple[float, float, float]:
        """Sum of squares, in sigma^2, number of residuals, and of the frames' own parameters."""
        counted = self.kept_corners
        own = (
            self.problem.reading_error_unknowns.has_frame_error
            & np.asarray(counted.any(axis=(0, 2)))[:, None]
        )
        # effective number of parameters: a reading error counts by its reduction of variance
        taken = float((own * (1.0 - self.reading_variance_ratio)).sum())
        return 2.0 * float(self.squares[counted].sum()), 2.0 * float(counted.sum()), taken

    @property
    def reduced_chi(self) -> float:
        """Ratio of the residuals to sigma, root of the reduced chi-square: 1 if sigma is right."""
        squares, measured, taken = self.squares_and_counts
        taken += self.problem.shared_count
        return float(np.sqrt(squares / max(measured - taken, 1.0)))

    def normal_and_frame_parts(self) -> tuple[ReducedNormalEquations, FloatArray, FloatArray]:
        """Normal equations, and the frames' parts of their matrix and gradient."""
        normal = self.problem.linearised(self.state, self.weights, keep_parts=True)
        assert normal.group_parts is not None
        return normal, *normal.group_parts

    @cached_property
    def reading_variance_ratio(self) -> FloatArray:
        """(f, 7) ratio of posterior to prior variance of the reading errors, shared ones fixed."""
        sigma = self.problem.reading_error_unknowns.reading_sigma
        inner = np.diagonal(np.linalg.inv(self.normal.own_matrix), axis1=1, axis2=2)
        return np.asarray(inner / np.where(sigma > 0.0, sigma, 1.0) ** 2)


def masked_mean(values: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Mean over the last axis of the values under a mask; nan where there are none."""
    count = mask.sum(axis=-1)
    total = np.where(mask, values, 0.0).sum(axis=-1)
    mean = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    return np.asarray(mean)


def restart(problem: HeadAdjustment, state: HeadUnknowns) -> HeadUnknowns:
    """Start of a problem at the shared unknowns of a like one, without reading errors."""
    return problem.start(state.boards)._replace(
        head_parameters=state.head_parameters,
        board_curvatures=state.board_curvatures,
        term_parameters=state.term_parameters,
    )


def solve(
    problem: HeadAdjustment,
    start: HeadUnknowns,
    weights: MeasurementWeights,
    *,
    cauchy_scale: float = np.inf,
    tolerance: float = _COST_TOLERANCE,
) -> HeadSolution:
    """Least squares by Levenberg and Marquardt; `cauchy_scale`, sigma^2, damps misfits."""
    robust = np.isfinite(cauchy_scale)
    weights = weights._replace(cauchy_scale=cauchy_scale)

    def reweighted(
        state: HeadUnknowns, now: ReducedNormalEquations
    ) -> ReducedNormalEquations | None:
        nonlocal weights
        counted = problem.frames.seen & (weights.corners > 0.0)
        typical_square = 0.5 * float(np.median((now.residuals[counted] ** 2).sum(axis=-1)))
        cauchy_scale = max(typical_square, 1.0)
        if not cauchy_scale < _SCALE_UPDATE_RATIO * weights.cauchy_scale:
            return None
        weights = weights._replace(cauchy_scale=cauchy_scale)
        return problem.linearised(state, weights)

    state, now = damped_least_squares(
        lambda state: problem.linearised(state, weights),
        lambda state, now, step, _: problem.moved(state, now, step),
        start,
        tolerance=tolerance,
        relative_tolerance=_ROBUST_TOLERANCE if robust else _COST_ROUNDING,
        # damping in units of the prior: it does not hold back steps along directions that the
        # frames hardly determine because they determine others well
        damping_unit=problem.prior_information,
        reweighted=reweighted if robust else lambda state, now: None,
    )
    return HeadSolution(problem, state, now, weights)


_INLIER_GATE: Final = 5.0
"""Gate on a corner's residual or a reading's error, in standard deviations (chosen)."""
_LEAST_INLIER_FRACTION: Final = 0.5
"""Fraction of a view's corners that have to be inliers for the view to be kept (chosen)."""
_MOST_ROUNDS: Final = 6
"""Largest number of rounds of selecting corners and fitting (numerical)."""
_LEAST_SCATTER_RATIO: Final = 1.3
"""Ratio of the readings' scatter to its expectation by quantisation and backlash above which their
standard deviation is enlarged (chosen)."""
_SCATTER_TOLERANCE: Final = 0.05
"""Relative change of a scatter that needs no further fit (numerical)."""


def fit_robustly(
    problem: HeadAdjustment,
    initial_boards: BoardPoses,
    inlier_views: NDArray[np.bool_],
    start: HeadUnknowns | None = None,
) -> HeadSolution:
    """Fit a head robustly, first to the (2, f) inlier views that agree on (b) boards in frame 0."""
    eligible = problem.frames.seen & problem.frames.shown[..., None]
    begin = problem.start(initial_boards)
    if start is not None:
        begin = begin._replace(
            head_parameters=start.head_parameters, board_curvatures=start.board_curvatures
        )
    first = MeasurementWeights.of(eligible & inlier_views[..., None])
    solution = solve(problem, begin, first, cauchy_scale=FIRST_CAUCHY_SCALE)
    if not inlier_views[eligible.any(axis=-1)].all():  # views that disagreed by the nominal head
        cauchy_scale = solution.weights.cauchy_scale
        solution = solve(
            problem, solution.state, MeasurementWeights.of(eligible), cauchy_scale=cauchy_scale
        )
    return refit_inliers_and_scatter(solution)


def refit_inliers_and_scatter(solution: HeadSolution) -> HeadSolution:
    """Refine a solution on its inliers, with readings weighted by their scatter."""
    problem = solution.problem
    eligible = problem.frames.seen & problem.frames.shown[..., None]
    kept, scatter_ratio = np.zeros_like(eligible), np.ones(7)
    for _ in range(_MOST_ROUNDS):
        previous = kept, scatter_ratio
        scatter_ratio = reading_scatter_ratio(solution)
        kept = inlier_corners(solution, eligible, scatter_ratio)
        if not kept.any():
            raise np.linalg.LinAlgError("expected views that agree with each other, got none")
        if np.array_equal(kept, previous[0]) and np.allclose(
            scatter_ratio, previous[1], rtol=_SCATTER_TOLERANCE
        ):
            break
        problem = replace(problem, scatter_ratio=scatter_ratio)
        solution = solve(problem, solution.state, MeasurementWeights.of(kept))
    return solution


def inlier_corners(
    solution: HeadSolution, eligible: NDArray[np.bool_], scatter_ratio: FloatArray
) -> NDArray[np.bool_]:
    """(2, f, n) True for inlier corners of views with mostly inliers and plausible readings."""
    typical_square = _typical_square(solution, eligible)
    fit = eligible & (
        np.nan_to_num(solution.squares, nan=np.inf) < _INLIER_GATE**2 * typical_square
    )
    errors = (
        np.abs(solution.normalised_reading_errors) * solution.problem.scatter_ratio / scatter_ratio
    )
    wrong = errors > _INLIER_GATE * np.sqrt(typical_square)
    moved = np.abs(solution.problem.joints_from_actuators) > 0.0
    for eye in range(2):
        joints = moved[[3 + 2 * eye, 4 + 2 * eye]].any(axis=0)
        fit[eye] &= ~np.asarray((wrong & joints).any(axis=1))[:, None]
    keep_view = fit.sum(axis=-1) >= np.maximum(
        _LEAST_INLIER_FRACTION * eligible.sum(axis=-1), LEAST_CORNERS
    )
    # a wrong neck reading drops both views, unless one of them is wrong already and may explain it
    keep_view &= ~(keep_view.all(axis=0) & np.asarray(wrong[:, NECK].any(axis=1)))
    return np.asarray(fit & np.asarray(keep_view)[..., None])


def _typical_square(solution: HeadSolution, eligible: NDArray[np.bool_]) -> float:
    """Mean square of a corner, sigma^2, at least 1; the robust fit's if below the views' median."""
    counted = eligible & (solution.weights.corners > 0.0)
    return min(max(float(np.median(solution.squares[counted])), 1.0), solution.weights.cauchy_scale)


def reading_scatter_ratio(solution: HeadSolution) -> FloatArray:
    """(7,) scatter of readings over that of quantisation and backlash, at least 1."""
    own, known = solution.problem.reading_error_unknowns, solution.problem.scatter_ratio
    found = np.ones(7)
    counted = np.asarray((solution.weights.corners > 0.0).any(axis=(0, 2)))
    typical_square = _typical_square(solution, solution.problem.frames.seen)
    for joint in range(7):
        used = own.has_frame_error[:, joint] & counted
        squares = solution.normalised_reading_errors[used, joint] ** 2
        if len(squares) < _LEAST_READINGS:
            continue
        # for a normal or a uniform distribution, without a few wrong readings
        trimmed_square = np.mean(
            squares[squares <= _INLIER_GATE**2 * max(float(np.median(squares)), 1e-12)]
        )
        expected = max(float(np.mean(1.0 - solution.reading_variance_ratio[used, joint])), 0.1)
        ratio = float(np.sqrt(trimmed_square / expected)) * known[joint]
        # noise of the corners enlarges the estimated reading errors as well
        found[joint] = ratio if ratio > _LEAST_SCATTER_RATIO * np.sqrt(typical_square) else 1.0
    return found


_LEAST_READINGS: Final = 20
"""Fewest readings of an actuator from which a scatter is estimated (chosen)."""
