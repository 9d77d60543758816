"""Calibration of one camera from photographs of a board: pinhole, lens, and inlier photographs."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import (
    BoardPoses,
    BundleAdjustment,
    BundleSolution,
    CameraRig,
)
from vergence.calibration.least_squares import choose
from vergence.calibration.observations import BoardObservations
from vergence.errors import ConfigurationError
from vergence.models.lens import BROWN_CONRADY, LENSES
from vergence.models.parts import FloatArray
from vergence.models.stereo_files import GREATEST_BASELINE_M, LEAST_BASELINE_M
from vergence.perception.locate import equivalent_corner_orders

LEAST_VIEWS: Final = 5
"""Fewest views of a calibration (chosen: fewer cannot tell a bad photograph from a lens)."""
FOLDS: Final = 5
"""Folds of the cross-validation (chosen: more take longer)."""
_FOLD_TOLERANCE: Final = 1e-6
"""Relative tolerance of a fold's sum of squares, which may be coarser than the result's
(numerical)."""
_SAMPLE_COUNT: Final = 10
"""Random samples of views from which a start is tried (chosen: with a fifth of bad views, 95 % of
the cases have at least one good sample)."""
_VIEWS_PER_SAMPLE: Final = 6
"""Views per sample (chosen: fewer determine a camera badly, more are rarely all good)."""
_TRUSTED_FRACTION: Final = 0.6
"""Fraction of the views, the best-fitting ones, that the first fits use: least trimmed squares,
Rousseeuw 1984 (chosen: up to two fifths of the views may be bad)."""
_POOR_START_CHI: Final = 4.0
"""Ratio of residuals to sigma above which a start is poor (chosen: cameras that are about right
leave 1 to 2 before the poses are refined)."""
_MOST_FITS: Final = 10
"""Largest number of rounds of fitting and selecting views (numerical)."""
_OUTLIER_CHI_RATIO: Final = 3.0
"""Ratio of a view's noise, residuals over sigma, to the trusted views' median above which it is an
outlier, if `_OUTLIER_RMS_RATIO` is exceeded too (chosen)."""
_OUTLIER_RMS_RATIO: Final = 2.0
"""Ratio of a view's rms in pixels to the trusted views' median, see `_OUTLIER_CHI_RATIO`
(chosen)."""
_EQUAL_FIT_RATIO: Final = 1.2
"""Ratio to the least median noise up to which a fit counts as equally good, so that the one with
more views wins (chosen)."""
_NOISY_VIEW_RATIO: Final = 1.2
"""Ratio of a view's noise to the median above which its sigma is enlarged (chosen: a view's noise
scatters by about 6 % by chance)."""
_SIGMA_TOLERANCE: Final = 0.05
"""Relative change of a view's sigma that needs no further fit (numerical)."""
_MISTAKEN_RATIO: Final = 10.0
"""Ratio of a corner's residual to the larger of the medians of its view and of all views above
which the corner is mistaken, if `_MISTAKEN_SIGMAS` is exceeded too (chosen: noise reaches 4)."""
_MISTAKEN_SIGMAS: Final = 5.0
"""Residual of a mistaken corner in its standard deviations, see `_MISTAKEN_RATIO` (chosen)."""
_MOST_MISTAKEN_FRACTION: Final = 0.1
"""Largest fraction of mistaken corners in a view; of others the pose is wrong (chosen)."""
_LEAST_POSE_CORNERS: Final = 4
"""Fewest corners that determine a pose (physical: geometry of a planar target)."""
_PLACEHOLDER_TRANSLATION: Final = np.array([0.0, 0.0, 1.0])
"""Translation of a view without a pose, m: in front of the camera (numerical)."""


@dataclass(frozen=True, eq=False)
class CameraFit:
    """Cameras found from the views that agree."""

    solution: BundleSolution
    """Solution of the kept views."""
    kept_views: NDArray[np.bool_]
    """(v) True for kept views, the inliers."""
    views: BundleSolution
    """Residuals of all views with these cameras."""

    @property
    def median_noise(self) -> float:
        """Median of the kept views' noise."""
        return float(np.median(self.views.view_chi[self.kept_views]))


def estimate_board_poses(problem: BundleAdjustment, rig: CameraRig) -> BoardPoses:
    """Board's pose in each view of one camera (`cv2.solvePnP`); placeholders without corners."""
    rotations, translations = [], []
    for view in rig.rays(0, problem.pixels[0]):
        seen = np.isfinite(view).all(axis=-1)
        found: Any = (False,)
        if seen.sum() >= _LEAST_POSE_CORNERS:
            with suppress(cv2.error):  # collinear corners
                found = cv2.solvePnP(
                    problem.board_corners[seen], view[seen], np.eye(3), None,
                    flags=cv2.SOLVEPNP_IPPE,
                )  # fmt: skip
        turn, shift = found[1:] if found[0] else (np.zeros(3), _PLACEHOLDER_TRANSLATION)
        rotations.append(cv2.Rodrigues(turn)[0])
        translations.append(np.ravel(shift))
    return BoardPoses(np.array(rotations), np.array(translations))


def initial_camera_guesses(
    problem: BundleAdjustment, lens: str, size: tuple[int, int]
) -> list[FloatArray]:
    """Find initial parameters of a camera with OpenCV's own calibration; size in px."""
    if lens != "fisheye":
        found = _opencv_guess(problem, lens, size)
    else:
        found = [_by_angle(values) for values in _opencv_guess(problem, BROWN_CONRADY, size)]
        found += _opencv_guess(problem, lens, size)
    return [each for each in found if np.isfinite(each).all() and (each[:2] > 1.0).all()]


def _by_angle(values: FloatArray) -> FloatArray:
    """Fisheye near the axis: tan(t) (1 + k1 tan(t)^2) = t (1 + (1/3 + k1) t^2 + ...)."""
    return np.array([*values[:4], 1.0 / 3.0 + values[4], 0.0, 0.0, 0.0])


def _opencv_guess(problem: BundleAdjustment, lens: str, size: tuple[int, int]) -> list[FloatArray]:
    """Parameters by OpenCV; none if it finds no homography or no focal length."""
    views = [(there, view) for there, view in zip(problem.seen[0], problem.pixels[0], strict=True)
             if there.any()]  # fmt: skip
    boards: Any = [problem.board_corners[there].astype(np.float32) for there, _ in views]
    corners: Any = [view[there].astype(np.float32) for there, view in views]
    guess: Any = None
    calibrate: Any = cv2.calibrateCamera
    flags = [cv2.CALIB_RATIONAL_MODEL if lens == "rational" else 0]
    if lens == "fisheye":
        calibrate = cv2.fisheye.calibrate
        boards, corners = ([one[None].astype(float) for one in each] for each in (boards, corners))
        focal = max(size) / np.pi
        guess = np.array(
            [[focal, 0.0, 0.5 * size[0]], [0.0, focal, 0.5 * size[1]], [0.0, 0.0, 1.0]]
        )
        place: Any = cv2 if hasattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC") else cv2.fisheye  # 5 or 4
        own = int(place.CALIB_RECOMPUTE_EXTRINSIC | place.CALIB_FIX_SKEW)
        flags = [own, own | int(place.CALIB_USE_INTRINSIC_GUESS)]  # wide views need the guess
    for each in flags:
        with suppress(cv2.error):
            start = (None, None) if guess is None else (guess.copy(), np.zeros(4))
            _, matrix, bends, *_ = calibrate(boards, corners, size, *start, flags=each)
            return [np.array([*matrix[[0, 1, 0, 1], [0, 1, 2, 2]],
                              *np.ravel(bends)[: len(LENSES[lens])]])]  # fmt: skip
    return []


def fit_consistent_views(observations: BoardObservations) -> CameraFit:
    """Fit a camera to photographs that agree: the best of random starts, least trimmed squares."""
    problem, size = observations.problem, observations.image_sizes[0]
    views = np.flatnonzero(observations.usable[0])
    if len(views) < LEAST_VIEWS:
        alike = observations.alike_count
        raise ConfigurationError(
            f"expected the board in at least {LEAST_VIEWS} photographs of a camera, better 20, "
            f"found it in {len(views)} of {len(observations.usable[0])}"
            + (f" ({alike} are like others but for noise)" if alike else "")
        )
    rng = np.random.default_rng(0)
    count = _SAMPLE_COUNT if len(views) > _VIEWS_PER_SAMPLE else 0
    samples = [views, *(rng.choice(views, _VIEWS_PER_SAMPLE, replace=False) for _ in range(count))]
    tried: list[tuple[float, CameraRig, BoardPoses]] = []

    def try_start(lens: str, values: FloatArray) -> None:
        rig = CameraRig.single(lens, values)
        poses = estimate_board_poses(problem, rig)
        reduced_chi = np.nan_to_num(BundleSolution(problem, rig, poses).view_chi[views], nan=np.inf)
        tried.append((float(np.quantile(reduced_chi, _TRUSTED_FRACTION)), rig, poses))

    for sample in samples:
        for values in initial_camera_guesses(problem.select(sample), BROWN_CONRADY, size):
            try_start(BROWN_CONRADY, values)
            try_start("fisheye", _by_angle(values))
    if not tried or min(tried, key=itemgetter(0))[0] > _POOR_START_CHI:
        for values in _opencv_guess(problem.select(views), "fisheye", size):
            try_start("fisheye", values)
    if not tried:
        raise ConfigurationError(
            "expected photographs of a board that is tilted this way and that, got some from "
            "which no focal length follows"
        )
    _, rig, poses = min(tried, key=itemgetter(0))
    trusted = max(int(np.ceil(_TRUSTED_FRACTION * len(views))), LEAST_VIEWS)
    reduced_chi = BundleSolution(problem, rig, poses).view_chi
    kept = np.zeros(len(reduced_chi), bool)
    for _ in range(_MOST_FITS):
        chosen = np.zeros_like(kept)
        chosen[np.argsort(np.where(observations.usable[0], reduced_chi, np.inf))[:trusted]] = True
        if np.array_equal(chosen, kept):
            break
        kept = chosen
        solution = problem.select(kept).solve(rig, poses.select(kept))
        rig, poses = solution.rig, estimate_board_poses(problem, solution.rig)
        reduced_chi = problem.fit_poses(rig, poses).view_chi
    return drop_and_reweight_views(problem, solution, kept, poses)


def fit_camera(observations: BoardObservations, lens: str, consistent_fit: CameraFit) -> CameraFit:
    """Find a camera with a given lens from the views that agree, see `fit_consistent_views`."""
    problem, first = observations.problem, consistent_fit.solution.rig
    own, values = first.lenses[0], first.camera_parameters[0]
    related = [values] if own == lens else []
    if own == BROWN_CONRADY != lens:
        related = [_by_angle(values) if lens == "fisheye" else np.append(values, np.zeros(3))]

    def solutions(kept: NDArray[np.bool_], starts: Sequence[FloatArray]) -> list[BundleSolution]:
        found = []
        for values in starts:
            rig = CameraRig.single(lens, values)
            poses = estimate_board_poses(problem, rig)
            with suppress(np.linalg.LinAlgError):
                found.append(problem.select(kept).solve(rig, poses.select(kept)))
        return found

    fits = []
    # views that only the first fit's lens excluded are tried again
    for kept in (consistent_fit.kept_views, observations.usable[0]):
        found = solutions(kept, related)
        enough = _EQUAL_FIT_RATIO * consistent_fit.solution.reduced_chi
        if all(solution.reduced_chi > enough for solution in found):
            size = observations.image_sizes[0]
            found += solutions(kept, initial_camera_guesses(problem.select(kept), lens, size))
        if found:
            best = min(found, key=lambda each: each.reduced_chi)
            poses = estimate_board_poses(problem, best.rig)
            fits.append(drop_and_reweight_views(problem, best, kept, poses))
        if consistent_fit.kept_views.sum() == observations.usable[0].sum():
            break
    if not fits:
        raise ConfigurationError(f"lens: expected one that fits these images, got {lens}")
    least = min(fit.median_noise for fit in fits)
    return max(
        (fit for fit in fits if fit.median_noise <= _EQUAL_FIT_RATIO * least),
        key=lambda fit: int(fit.kept_views.sum()),
    )


def drop_and_reweight_views(
    problem: BundleAdjustment,
    solution: BundleSolution,
    kept_views: NDArray[np.bool_],
    poses: BoardPoses,
) -> CameraFit:
    """Leave out outlier views, and weight the others by their residuals.

    A view whose residuals, in units of sigma, are r > 1.2 times the median has too small a sigma,
    as its board was not quite still. Its sigma is multiplied by (r / 1.2)^2.
    """
    weighted = problem
    for _ in range(_MOST_FITS):
        views = problem.fit_poses(solution.rig, poses)
        poses, noise, rms_px = views.poses, views.view_chi, views.view_rms_px
        outliers = noise > _OUTLIER_CHI_RATIO * np.median(noise[kept_views])
        outliers &= rms_px > _OUTLIER_RMS_RATIO * np.median(rms_px[kept_views])
        chosen = ~outliers & np.isfinite(noise)
        if chosen.sum() < LEAST_VIEWS:
            chosen = kept_views
        share = np.maximum(noise / np.median(noise[chosen]) / _NOISY_VIEW_RATIO, 1.0) ** 2
        before = weighted.sigma[:, kept_views]
        weighted = replace(problem, sigma=problem.sigma * share[:, None, None])
        same = np.array_equal(chosen, kept_views)
        if same and np.allclose(
            weighted.sigma[:, kept_views], before, rtol=_SIGMA_TOLERANCE, equal_nan=True
        ):
            break
        kept_views = chosen
        solution = weighted.select(kept_views).solve(solution.rig, poses.select(kept_views))
    return CameraFit(solution, kept_views, views)


def mistaken_corners_px(problem: BundleAdjustment, rig: CameraRig) -> FloatArray:
    """(v, n) px from where others of a view put a mistaken corner; 0 for good ones."""
    shown = problem.seen[0].any(axis=-1)
    every = problem.select(shown)
    poses, mistaken = estimate_board_poses(every, rig), np.zeros(every.seen[0].shape, bool)
    sigma = np.sqrt((every.sigma[0] ** 2).mean(axis=-1))
    for _ in range(_MOST_FITS):
        rest = replace(every, pixels=np.where(mistaken[..., None], np.nan, every.pixels))
        fitted = rest.fit_poses(rig, poses)
        poses, away = fitted.poses, np.linalg.norm(fitted.residuals_px[0], axis=-1)
        usual = np.maximum(np.nanmedian(away, axis=1, keepdims=True), np.nanmedian(away))
        over = np.nan_to_num(away / np.maximum(_MISTAKEN_RATIO * usual, _MISTAKEN_SIGMAS * sigma))
        # a mistaken corner also pulls the pose, so that only the worst are taken per round
        worst = (over > 1.0) & (over > 0.5 * over.max(axis=1, keepdims=True))
        if not worst.any():
            break
        mistaken |= worst
    few = mistaken.sum(axis=1) <= _MOST_MISTAKEN_FRACTION * every.seen[0].sum(axis=1)
    away = np.linalg.norm(BundleSolution(every, rig, poses).residuals_px[0], axis=-1)
    away_px = np.zeros(problem.pixels.shape[1:3])
    away_px[shown] = np.where(mistaken & few[:, None], away, 0.0)
    return away_px


def cross_validation_residuals(
    solution: BundleSolution, progress: Callable[[], None] | None = None
) -> FloatArray:
    """(c, v, n, 2) px, each view by cameras found without it, its pose fitted; nan if not found."""
    problem = solution.problem
    residuals = np.full(problem.pixels.shape, np.nan)
    views = problem.pixels.shape[1]
    folds = min(FOLDS, views)  # of a few views, one each; neighbours, which may be alike, together
    for fold in range(folds):
        out = np.arange(views) * folds // views == fold
        trained = problem.select(~out).solve(
            solution.rig, solution.poses.select(~out), _FOLD_TOLERANCE
        )
        tested = problem.select(out)
        residuals[:, out] = tested.fit_poses(trained.rig, solution.poses.select(out)).residuals_px
        if progress is not None:
            progress()
    return residuals


def cross_validation_mean_squares(fit: CameraFit, problem: BundleAdjustment) -> FloatArray:
    """(v,) mean squares, sigma^2; of the fit, or `_UNSEEN_MEAN_SQUARE`, for views not kept."""
    errors = fit.views.view_chi**2
    sigma = problem.sigma[:, fit.kept_views]
    errors[fit.kept_views] = np.nanmean(
        (cross_validation_residuals(fit.solution) / sigma) ** 2, axis=(0, 2, 3)
    )
    return np.where(np.isfinite(errors), errors, _UNSEEN_MEAN_SQUARE)


def choose_lens(mean_squares_by_lens: Mapping[str, FloatArray]) -> str:
    """Choose the simplest lens model that predicts unseen views as well as the best one.

    It is the first model in `_LENS_PREFERENCE` that meets two conditions. The logarithm of the
    ratio of its errors to the best model's, averaged over the views, is at most 2 % or two of its
    standard errors, whichever is larger. And no single view has a ratio that refutes the model.
    """
    logs = {lens: np.log(each) for lens, each in mean_squares_by_lens.items()}
    best = min(logs, key=lambda lens: float(np.mean(logs[lens])))
    for lens in _LENS_PREFERENCE:
        if lens in logs:
            more = logs[lens] - logs[best]
            chance = max(2.0 * np.std(more) / np.sqrt(len(more)), _LEAST_LOG_GAIN)
            if np.mean(more) <= chance and np.max(more) < _REFUTING_LOG_RATIO:
                return lens
    return best


_REFUTING_LOG_RATIO: Final = 2.0 * np.log(3.0)
"""Log ratio of mean squares at which a single view refutes a lens model (chosen: three times the
error is no chance)."""
_UNSEEN_MEAN_SQUARE: Final = 1e12
"""Mean square, in units of sigma^2, of a view that a camera cannot have seen (numerical)."""
_LEAST_LOG_GAIN: Final = 0.02
"""Least gain in the logarithm of a mean square (chosen: less is not worth more coefficients, which
the views hardly determine)."""
_LENS_PREFERENCE: Final = (BROWN_CONRADY, "fisheye", "rational")
"""Lens models in order of preference: fewer coefficients first, then the more common one."""


_MOST_PAIR_ERROR_WIDTHS: Final = 0.03
"""Largest median reprojection error over the pairs, in image widths, with the relative pose of the
best single pair (chosen: public photograph sets have 0.004)."""
_AGREEING_FRACTION: Final = 0.5
"""Fraction of the pairs that have to agree (chosen)."""
_TRUSTED_ERROR_RATIO: Final = 3.0
"""Ratio of a pair's reprojection error to the median up to which the first fit uses it (chosen)."""


def fit_camera_pair(
    observations: BoardObservations, left: CameraFit, right: CameraFit
) -> tuple[BoardObservations, CameraFit]:
    """Both cameras and their pose from agreeing views; symmetric boards' corners in one order."""
    both = left.kept_views & right.kept_views
    if both.sum() < LEAST_VIEWS:
        raise ConfigurationError(
            f"expected the board in both images of at least {LEAST_VIEWS} pairs, better 20, got "
            f"{both.sum()} of {len(both)}"
        )
    alone = [fit.solution.rig for fit in (left, right)]
    curvatures = 0.5 * (alone[0].board_curvatures + alone[1].board_curvatures)
    by_left = estimate_board_poses(observations.problem.select_camera(0), alone[0])
    orders = equivalent_corner_orders(observations.target)
    turned = [_turned(observations, order, both) for order in orders]
    best: tuple[float, CameraRig, FloatArray] | None = None
    for one in turned:
        by_right = estimate_board_poses(one.problem.select_camera(1), alone[1])
        turns = by_right.rotation @ by_left.rotation.transpose(0, 2, 1)
        shifts = by_right.translation - np.einsum("vij,vj->vi", turns, by_left.translation)
        for view in np.flatnonzero(both):
            rig = CameraRig(
                alone[0].lenses + alone[1].lenses,
                alone[0].camera_parameters + alone[1].camera_parameters,
                turns[view], shifts[view], curvatures,
            )  # fmt: skip
            missed = np.stack([_missed_px(each.problem, rig, by_left) for each in turned])
            score = float(np.quantile(missed.min(axis=0)[both], _AGREEING_FRACTION))
            if best is None or score < best[0]:
                best = score, rig, missed
    assert best is not None
    score, rig, missed = best
    if not score < _MOST_PAIR_ERROR_WIDTHS * observations.image_sizes[1][0]:
        raise ConfigurationError(
            "expected pairs of photographs taken at the same moment by two cameras that are fixed "
            f"to each other, got {both.sum()} pairs of which fewer than half agree on where the "
            "second camera is: does each left image go with its right one?"
        )
    for which, order in enumerate(orders):
        observations = _turned(observations, order, both & (missed.argmin(axis=0) == which))
    trusted = both & (missed.min(axis=0) <= _TRUSTED_ERROR_RATIO * score)
    kept = np.stack([left.kept_views, right.kept_views])
    problem = replace(
        observations.problem,
        pixels=np.where(kept[..., None, None], observations.problem.pixels, np.nan),
    )
    by_right = estimate_board_poses(problem.select_camera(1), alone[1])
    back = by_right.transformed(rig.rotation.T, -rig.rotation.T @ rig.translation)
    poses = choose(left.kept_views, by_left, back)
    solution = problem.select(trusted).solve(rig, poses.select(trusted))
    fit = drop_and_reweight_views(problem, solution, trusted, poses)
    _check_place(fit.solution.rig)
    return observations, fit


def _check_place(rig: CameraRig) -> None:
    """Refuse an implausible position of the right camera."""
    place = -rig.rotation.T @ rig.translation
    length = float(np.linalg.norm(place))
    if place[0] < 0.0 and abs(place[0]) > 0.5 * length:
        raise ConfigurationError(
            "expected the right camera on the right of the left one, got it "
            f"{1000.0 * abs(place[0]):.1f} mm on its left: exchange --left and --right "
            "(or is the left camera upside down?)"
        )
    if not LEAST_BASELINE_M <= length <= GREATEST_BASELINE_M:
        raise ConfigurationError(
            f"expected cameras {1000.0 * LEAST_BASELINE_M:g} to {1000.0 * GREATEST_BASELINE_M:g} "
            f"mm apart, got {1000.0 * length:.4g} mm: is the square's size in millimetres?"
        )


def _turned(
    observations: BoardObservations, order: NDArray[np.intp], views: NDArray[np.bool_]
) -> BoardObservations:
    """Reorder the right images' corners in some views."""
    pixels, sigma = observations.pixels.copy(), observations.sigma.copy()
    for values in (pixels, sigma):
        values[1, views] = values[1, views][:, order]
    return replace(observations, pixels=pixels, sigma=sigma)


def _missed_px(problem: BundleAdjustment, rig: CameraRig, poses: BoardPoses) -> FloatArray:
    """(v) rms reprojection error in the right camera, px; nan without corners."""
    moved = poses.transformed(rig.rotation, rig.translation)
    one = problem.select_camera(1)
    squares = BundleSolution(one, rig.alone(1), moved).residuals_px[0] ** 2
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nansum(squares, axis=(1, 2)) / one.seen[0].sum(axis=1)))
