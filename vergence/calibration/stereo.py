"""Calibration of two cameras and their relative pose from photographs of a board."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses, BundleAdjustment, CameraRig
from vergence.calibration.cameras import (
    LEAST_VIEWS,
    CameraFit,
    drop_and_reweight_views,
    estimate_board_poses,
)
from vergence.calibration.observations import BoardObservations
from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.models.stereo_files import GREATEST_BASELINE_M, LEAST_BASELINE_M
from vergence.perception.located import equivalent_corner_orders

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
    by_left = estimate_board_poses(
        observations.problem.select_camera(0), alone[0], observations.image_sizes[0]
    )
    orders = equivalent_corner_orders(observations.target)
    turned = [_turned(observations, order, both) for order in orders]
    best: tuple[float, CameraRig, FloatArray] | None = None
    for one in turned:
        by_right = estimate_board_poses(
            one.problem.select_camera(1), alone[1], observations.image_sizes[1]
        )
        turns = by_right.rotation @ by_left.rotation.transpose(0, 2, 1)
        shifts = by_right.translation - np.einsum("vij,vj->vi", turns, by_left.translation)
        for view in np.flatnonzero(both):
            rig = CameraRig(
                (alone[0].lenses[0], alone[1].lenses[0]),
                (alone[0].camera_parameters[0], alone[1].camera_parameters[0]),
                turns[view],
                shifts[view],
                0.5 * (alone[0].board_curvatures + alone[1].board_curvatures),
            )
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
    by_right = estimate_board_poses(problem.select_camera(1), alone[1], observations.image_sizes[1])
    back = rig.rotation.T
    poses = BoardPoses(
        np.where(left.kept_views[:, None, None], by_left.rotation, back @ by_right.rotation),
        np.where(
            left.kept_views[:, None],
            by_left.translation,
            (by_right.translation - rig.translation) @ back.T,
        ),
    )
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
    right = CameraRig.single(rig.lenses[1], rig.camera_parameters[1])._replace(
        board_curvatures=rig.board_curvatures
    )
    moved = BoardPoses(
        rig.rotation @ poses.rotation, poses.translation @ rig.rotation.T + rig.translation
    )
    one = problem.select_camera(1)
    linear = one.linearised(right, moved)
    shape = one.pixels.shape[1:]
    squares = ((linear.residuals.reshape(shape) * one.sigma[0]) ** 2).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nansum(squares, axis=1) / one.seen[0].sum(axis=1)))
