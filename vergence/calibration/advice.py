"""Coverage of a calibration's views, and what to photograph next."""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import heights_by_curvature
from vergence.calibration.calibrate import Calibration
from vergence.calibration.uncertainty import board_points_in_camera, direction_sigma_px
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.perception.locate import MM

CELLS: Final = 3
"""Cells along each side of an image in which coverage is counted (chosen: parts with names)."""
MOST_SENTENCES: Final = 3
"""Most sentences of advice (chosen: as many as a person keeps in mind while photographing)."""
ENOUGH_VIEWS: Final = 20
"""Views that are enough (chosen: Kalibr, mrcal and OpenCV's tutorials ask for as many or more)."""
_FACING_DEG: Final = 15.0
"""Tilt below which a board faces the camera and hardly separates the focal length from the
distance, degrees (chosen: after Zhang 2000, figure 5)."""
_LEAST_TILTED_FRACTION: Final = 0.25
"""Fraction of the views that should be tilted by more than `_FACING_DEG` (chosen)."""
_LEAST_SIDE_TILT_DEG: Final = 10.0
"""Tilt from which on a board counts as tilted to a side, degrees (chosen)."""
_NEARER_SIDE_NAMES: Final = ("right side", "left side", "lower edge", "upper edge")
"""Side of the board that is nearest to the camera if its normal points to +x, -x, +y, -y."""
_LEAST_DISTANCE_RATIO: Final = 1.3
"""Ratio of the far views' distance to the near ones' below which all views count as equally far
(chosen)."""
_MOVED_RESIDUAL_RATIO: Final = 2.0
"""Ratio of a pair's joint residual to its images' own residuals above which the board or a camera
moved (chosen)."""
_MANY_VIEWS_FRACTION: Final = 0.25
"""Fraction of the views that were left out, or moved, from which on advice is given (chosen)."""
_UNCERTAIN_FOCAL_SIGMA: Final = 0.005
"""Relative standard deviation of a focal length that calls for advice (chosen: it causes 5 mm of
depth error at 1 m)."""
_UNCERTAIN_CORNER_RATIO: Final = 5.0
"""Ratio of the directions' standard deviation in an image corner to the image's median that calls
for advice, if it also exceeds `_UNCERTAIN_CORNER_PX` (chosen)."""
_UNCERTAIN_CORNER_PX: Final = 0.5
"""Standard deviation of directions in an image corner that matters, px (chosen)."""
_SIGMA_GRID_COUNT: Final = 9
"""Pixels along each side of an image at which the uncertainty of directions is evaluated
(numerical)."""
_NEAREST_M: Final = 0.1
"""Smallest plausible distance of a board's middle, m (chosen: webcams do not focus nearer)."""
_BENT_SAG_RATIO: Final = 0.005
"""Ratio of the board's sag to its diagonal that calls for a flat board (chosen: 1 mm for the
200 mm of a board on A4 paper)."""


class BoardSag(NamedTuple):
    """Sag of a bent board, mm: highest corner above the lowest by the fit, and its sigma."""

    mm: float
    sigma_mm: float


class BoardTilts(NamedTuple):
    """Tilts and distances of the board in the kept views of one camera."""

    tilt_deg: FloatArray
    """(v, 2) angle between the board's normal and the optical axis, split into x and y.

    Positive if the right side, or the lower edge, is nearer to the camera."""
    distance_m: FloatArray
    """(v) distance of the board's middle from the camera."""

    @property
    def angle_deg(self) -> FloatArray:
        """(v) angle between the board's normal and the optical axis."""
        return np.asarray(np.linalg.norm(self.tilt_deg, axis=-1))


def board_tilts(calibration: Calibration) -> list[BoardTilts]:
    """Compute the tilts and distances of the board in front of each camera."""
    solution, found = calibration.fit.solution, []
    for camera, corners in enumerate(solution.problem.seen):
        seen = corners.any(axis=-1)
        normal = solution.poses.rotation[seen, :, 2]
        if camera:
            normal = normal @ solution.rig.rotation.T
        across = np.linalg.norm(normal[:, :2], axis=-1)
        angle = np.degrees(np.arctan2(across, normal[:, 2]))
        tilt = normal[:, :2] * (angle / np.maximum(across, 1e-12))[:, None]
        middle = board_points_in_camera(solution, camera)[seen].mean(axis=1)
        found.append(BoardTilts(tilt, np.asarray(np.linalg.norm(middle, axis=-1))))
    return found


def views_per_cell(calibration: Calibration, camera: int) -> NDArray[np.intp]:
    """(CELLS, CELLS) number of kept views with a corner in each cell of the image, row by row."""
    return views_in_cells(
        calibration.fit.solution.problem.pixels[camera],
        calibration.observations.image_sizes[camera],
    )


def views_in_cells(views: FloatArray, size: tuple[int, int]) -> NDArray[np.intp]:
    """(CELLS, CELLS) views with a corner in each cell, of (v, n, 2) corners, px or nan."""
    cells = np.floor(np.clip(CELLS * (views + 0.5) / np.array(size), 0, CELLS - 1))
    counts = [
        (cells == (column, row)).all(axis=-1).any(axis=-1).sum()
        for row, column in np.ndindex(CELLS, CELLS)
    ]
    return np.reshape(counts, (CELLS, CELLS))


def direction_sigma_px_at(calibration: Calibration, camera: int, count: int) -> FloatArray:
    """(count, count) sigma of directions at `pixel_grid`, px; nan where the lens has no inverse."""
    rays = calibration.rig.rays(
        camera, pixel_grid(calibration.observations.image_sizes[camera], count)
    )
    there = np.isfinite(rays).all(axis=-1)
    sigma = np.full(there.shape, np.nan)
    if there.any():
        sigma[there] = direction_sigma_px(
            calibration.fit.solution, calibration.covariance, camera, rays[there]
        )
    return sigma


def board_sag(calibration: Calibration) -> BoardSag:
    """Compute the sag of the board, the spread of its corners' heights, and its uncertainty."""
    heights = heights_by_curvature(calibration.fit.solution.problem.board_corners)
    height = heights @ calibration.rig.board_curvatures
    between = heights[height.argmax()] - heights[height.argmin()]
    block = calibration.rig.blocks[-1]
    spread = between @ calibration.covariance[block, block] @ between
    return BoardSag(
        MM * float(between @ calibration.rig.board_curvatures), MM * float(np.sqrt(spread))
    )


def advise_next_photographs(calibration: Calibration) -> list[str]:
    """Advise on the next photographs: up to `MOST_SENTENCES`, then remarks on images and doubts."""
    sentences = [text for rule in _RULES if (text := rule(calibration))]
    doubts = calibration.pair.guesses if len(calibration.single_fits) > 1 else ()
    return [*sentences[:MOST_SENTENCES], *calibration.observations.remarks, *doubts]


def advise_on_pair_motion(calibration: Calibration) -> str:
    """Advise on pairs whose images fit alone but not together."""
    if len(calibration.single_fits) < 2:
        return ""
    alone = np.stack([fit.views.view_rms_px for fit in calibration.single_fits])
    judged = np.isfinite([fit.views.view_chi for fit in calibration.single_fits]).all(axis=0)
    usable = judged & np.all([fit.kept_views for fit in calibration.single_fits], axis=0)
    if not usable.any():
        return ""
    by_itself = np.sqrt((alone[:, usable] ** 2).mean(axis=0))
    together = calibration.fit.views.view_rms_px[usable]
    moved = together > _MOVED_RESIDUAL_RATIO * by_itself
    if moved.sum() < max(_MANY_VIEWS_FRACTION * len(moved), 1):
        return ""
    return (
        f"In {moved.sum()} of {len(moved)} pairs both images together leave more than "
        f"{_MOVED_RESIDUAL_RATIO:g} "
        f"times what each leaves by itself ({np.median(together[moved]):.2f} px against "
        f"{np.median(by_itself[moved]):.2f}): rest the board on something, fix the cameras to each "
        "other, and take both images at the same moment."
    )


def advise_on_view_count(calibration: Calibration) -> str:
    """Advise on too few views, or too many that were left out."""
    kept = calibration.fit.kept_views
    alike = calibration.observations.alike_count
    count, every = int(kept.sum()), len(kept) - alike
    lost = every - count
    if lost > _MANY_VIEWS_FRACTION * every:
        without = int((~calibration.observations.usable.any(axis=0)).sum()) - alike
        why = f"; in {without} the board was not found" if without else ""
        return (
            f"{lost} of {every} views were left out{why}: keep the whole board in the image, hold "
            "it still, and avoid blur and glare."
        )
    if count < ENOUGH_VIEWS:
        return f"The calibration has {count} views: take {ENOUGH_VIEWS} or more."
    return ""


def advise_on_empty_cells(calibration: Calibration) -> str:
    """Advise on parts of the images without a corner in any view."""
    parts = []
    for camera, name in enumerate(calibration.camera_names):
        empty = views_per_cell(calibration, camera) == 0
        if empty.any():
            of = f"the {name} camera" if len(calibration.single_fits) > 1 else "the image"
            parts.append(f"in the {_cells(empty)} of {of}")
    return f"No view has the board {' and none '.join(parts)}: hold it there too." if parts else ""


def _cells(empty: NDArray[np.bool_]) -> str:
    """Name the empty cells, whole sides at once."""
    rows, columns = ("upper", "middle", "lower"), ("left", "middle", "right")
    left, names = empty.copy(), []
    for index, name in ((0, "left"), (2, "right")):
        if left[:, index].all():
            names.append(f"{name} third")
            left[:, index] = False
    for index, name in ((0, "upper"), (2, "lower")):
        if empty[index].all():
            names.append(f"{name} third")
            left[index] = False
    for row, column in np.argwhere(left).tolist():
        both = f"{rows[row]} {columns[column]}"
        names.append("middle" if both == "middle middle" else both)
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def advise_on_tilts(calibration: Calibration) -> str:
    """Advise on boards that all face the camera, or are tilted to some sides only."""
    tilt = board_tilts(calibration)[0].tilt_deg
    angle = np.linalg.norm(tilt, axis=-1)
    tilted = int((angle > _FACING_DEG).sum())
    before = " before the left camera" if len(calibration.single_fits) > 1 else ""
    if tilted < _LEAST_TILTED_FRACTION * len(angle):
        count = {0: "None", 1: "Only one"}.get(tilted, f"Only {tilted}")
        verb = "is" if tilted < 2 else "are"
        return (
            f"{count} of {len(angle)} boards{before} {verb} tilted by more than {_FACING_DEG:g} "
            "degrees: tilt some by 30 degrees, to all four sides."
        )
    sides = np.column_stack([tilt[:, 0], -tilt[:, 0], tilt[:, 1], -tilt[:, 1]])
    missing = [
        name
        for name, side in zip(_NEARER_SIDE_NAMES, sides.T, strict=True)
        if side.max() < _LEAST_SIDE_TILT_DEG
    ]
    if missing:
        return (
            f"No board{before} is tilted by more than {_LEAST_SIDE_TILT_DEG:g} degrees with its "
            f"{' or its '.join(missing)} nearer: tilt some by 30 degrees that way."
        )
    return ""


def advise_on_distances(calibration: Calibration) -> str:
    """Advise on boards that are all at about the same distance."""
    near, far = np.quantile(board_tilts(calibration)[0].distance_m, [0.1, 0.9])
    if far > _LEAST_DISTANCE_RATIO * near:
        return ""
    known = calibration.observations.target.size_known
    away = f"{near:.2f} to {far:.2f} m away" if known else "equally far away"
    return f"Most boards are {away}: take some nearer and some farther away."


def median_and_corner_sigma_px(calibration: Calibration, camera: int) -> tuple[float, float]:
    """Sigma of directions, px: the image's median and worst corner; inf without an inverse."""
    sigma = direction_sigma_px_at(calibration, camera, _SIGMA_GRID_COUNT)
    sigma = np.where(np.isfinite(sigma), sigma, np.inf)
    return float(np.median(sigma)), float(sigma[[0, 0, -1, -1], [0, -1, 0, -1]].max())


def advise_on_uncertain_corners(calibration: Calibration) -> str:
    """Advise on image corners with uncertain directions."""
    sigma = [
        median_and_corner_sigma_px(calibration, camera)
        for camera in range(len(calibration.single_fits))
    ]
    camera = int(np.argmax([corner for _, corner in sigma]))
    usual, corner = sigma[camera]
    beyond = np.isinf(corner) and calibration.lens == "fisheye"  # at 90 degrees, beyond any board
    if corner <= max(_UNCERTAIN_CORNER_RATIO * usual, _UNCERTAIN_CORNER_PX) or beyond:
        return ""
    of = f"the {EYE_NAMES[camera]} camera's image" if len(sigma) > 1 else "the image"
    known = "unknown" if np.isinf(corner) else f"known to {corner:.1f} px only"
    half = "" if np.isinf(usual) else f", over half of it to {usual:.1f} px"
    return (
        f"In a corner of {of} directions are {known}{half}: let the board reach into the corners."
    )


def pixel_grid(size: tuple[int, int], count: int) -> FloatArray:
    """(count, count, 2) regular grid of pixels over an image, from border to border."""
    width, height = size
    u, v = np.linspace(-0.5, width - 0.5, count), np.linspace(-0.5, height - 0.5, count)
    return np.stack(np.meshgrid(u, v), axis=-1)


def advise_on_uncertain_focal_lengths(calibration: Calibration) -> str:
    """Advise on focal lengths that the views determine badly."""
    unsure = [
        float((calibration.sigma[block][:2] / values[:2]).max())
        for values, block in zip(
            calibration.rig.camera_parameters, calibration.rig.blocks, strict=False
        )
    ]
    camera = int(np.argmax(unsure))
    if unsure[camera] < _UNCERTAIN_FOCAL_SIGMA:
        return ""
    name = f"{calibration.camera_names[camera]} camera's" if len(unsure) > 1 else "camera's"
    return (
        f"The {name} focal length is known to {100.0 * unsure[camera]:.1f} %, and depth no better: "
        "take more views of tilted boards that fill the image."
    )


def advise_on_board_size_unit(calibration: Calibration) -> str:
    """Advise on boards that come out so near that their size was probably not given in mm."""
    far = float(np.median(board_tilts(calibration)[0].distance_m))
    if far > _NEAREST_M or not calibration.observations.target.size_known:
        return ""
    return (
        f"By the stated size, {calibration.observations.target}, the board was {MM * far:.0f} mm "
        "away: was the size given in mm?"
    )


def advise_on_bent_board(calibration: Calibration) -> str:
    """Advise on a board that is far from flat."""
    sag = board_sag(calibration)
    size = MM * float(np.linalg.norm(np.ptp(calibration.observations.target.corners_m, 0)))
    if sag.mm - 2.0 * sag.sigma_mm < _BENT_SAG_RATIO * size:
        return ""
    return f"The board is bent by {sag.mm:.1f} mm: mount it on something flat and stiff."


_RULES: Final[tuple[Callable[[Calibration], str], ...]] = (
    advise_on_board_size_unit,
    advise_on_pair_motion,
    advise_on_view_count,
    advise_on_empty_cells,
    advise_on_tilts,
    advise_on_distances,
    advise_on_uncertain_corners,
    advise_on_uncertain_focal_lengths,
    advise_on_bent_board,
)
"""Rules of advice, the most important first; each gives a sentence, empty if nothing is lacking."""
