"""Find targets in pairs of photographs, triangulate them, and judge the result."""

import csv
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import parse_response
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES, FloatArray
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.perception.finding import (
    Photograph,
    PhotographSearch,
    TargetFinder,
    centre_weights,
    parse_targets,
    pose_document,
    tag_number,
    weighted_sum,
)
from vergence.perception.notes import target_key
from vergence.perception.photographs import (
    join_first_names,
    pair_up,
    read_joint_angles,
)
from vergence.triangulation import Fix, Noise, triangulate_views
from vergence.vision import Camera
from vergence.vision.detection import BoardDetection, corner_noise
from vergence.vision.pose import Pose, View, estimate_pose, eye_views
from vergence.vision.targets import (
    AprilTag,
    Checkerboard,
    PlanarTarget,
    neighbour_pairs,
    stated_edge_m,
)

MM: Final = 1000.0
"""Millimetres per metre (physical)."""


_SIGNIFICANT_SIGMAS: Final = 3.0
"""Standard deviations above which a difference is significant (chosen: false against missed
remarks)."""
_MIN_RELATIVE_DIFFERENCE: Final = 0.01
"""Smallest difference that is remarked on, as a fraction of the stated edge; good calibrations and
printers err by less (chosen: as above)."""


class EdgeSpacing(NamedTuple):
    """Distances between neighbouring corners: edges of squares, or of a tag."""

    mean_m: float
    """Mean distance; nan if there is none."""
    spread_m: float
    """Standard deviation of the distances."""
    edge_count: int
    """Number of distances."""
    stated_m: float
    """Stated distance; nan if no size was stated."""
    sigma_m: float = np.nan
    """Standard deviation of the mean from the noise of pixels and joints; nan if not known."""

    @property
    def differs_from_stated(self) -> bool:
        """True if the mean differs beyond noise and small calibration errors."""
        return abs(self.mean_m - self.stated_m) > max(
            _SIGNIFICANT_SIGMAS * self.sigma_m, _MIN_RELATIVE_DIFFERENCE * self.stated_m
        )

    def document(self) -> dict[str, Any]:
        """Plain values, millimetres."""
        lengths = MM * np.array([self.mean_m, self.spread_m, self.stated_m])
        mean, spread, stated = null_nonfinite_elements(lengths)
        return {"mean": mean, "spread": spread, "count": self.edge_count, "stated": stated}


def neighbour_distances_m(target: PlanarTarget, points: FloatArray) -> FloatArray:
    """(k,) distances between neighbouring corners, m, of (n, 3) points, nan where unsolved."""
    first, second = neighbour_pairs(target).T
    apart = np.linalg.norm(points[first] - points[second], axis=-1)
    return np.asarray(apart[np.isfinite(apart)])


def measure_spacing(
    target: PlanarTarget, points: Iterable[FloatArray], sigma_m: float = np.nan
) -> EdgeSpacing:
    """Mean and standard deviation of the distances over views, (n, 3) points each, m."""
    apart = np.concatenate([np.empty(0), *(neighbour_distances_m(target, each) for each in points)])
    mean, spread = (apart.mean(), apart.std()) if len(apart) else (np.nan, np.nan)
    stated = stated_edge_m(target) if target.size_known else np.nan
    return EdgeSpacing(float(mean), float(spread), len(apart), stated, sigma_m)


_UNIT_RATIO_TOLERANCE: Final = 0.05
"""Relative tolerance within which a ratio of lengths suggests a mistaken unit (chosen: mistakes
recognised against coincidence)."""
_UNIT_MISTAKE_HINTS: Final = {
    1000.0: "was the size given in m, or the head's lengths in mm?",
    100.0: "were the head's lengths given in cm?",
    39.37: "were the head's lengths given in inches?",
    25.4: "was the size given in inches?",
    10.0: "was the size given in cm?",
    0.001: "was the size given in micrometres?",
}
"""Likely mistake for each ratio of the measured to the stated length."""


def _mean_edge_sigma(
    head: HeadModel,
    q: FloatArray,
    target: PlanarTarget,
    pixels: FloatArray,
    points: FloatArray,
    pixel_noise_covariances: FloatArray,
) -> float:
    """Sigma of a board's mean edge, m; pixel errors are independent, joint errors common."""
    first, second = neighbour_pairs(target).T
    apart = points[first] - points[second]
    there = np.isfinite(apart).all(axis=1)
    if not there.any():
        return np.nan
    first, second, apart = first[there], second[there], apart[there]
    lengths = np.linalg.norm(apart, axis=1)
    along = apart / lengths[:, None] / len(lengths)
    slopes = np.zeros_like(points)  # derivatives of the mean with respect to each corner
    np.add.at(slopes, first, along)
    np.subtract.at(slopes, second, along)
    used = slopes.any(axis=1)
    variance = float(
        np.einsum("ni,nij,nj->", slopes[used], pixel_noise_covariances[used], slopes[used])
    )
    sure = Noise()
    for turn in np.diag(np.asarray(Noise.of(head).joint_rad))[EYES]:
        if turn.any():
            turned = triangulate_views(
                head, q + head.actuation.joint_velocities_of(turn), pixels, sure
            ).point
            moved = np.linalg.norm(turned[first] - turned[second], axis=1)
            variance += float(moved.mean() - lengths.mean()) ** 2
    return float(np.sqrt(max(variance, 0.0)))


def describe_wrong_edges(name: str, edges: Sequence[tuple[str, EdgeSpacing]]) -> str:
    """Message about a target's edges by pair that differ from the stated size; empty if none do."""
    off = [(pair, each) for pair, each in edges if each.differs_from_stated]
    if not off:
        return ""
    lengths, stated = [MM * each.mean_m for _, each in off], MM * off[0][1].stated_m
    low, high = f"{min(lengths):.2f}", f"{max(lengths):.2f}"
    found = low if low == high else f"{low} to {high}"
    sigma = MM * float(np.median([each.sigma_m for _, each in off]))
    ratio = float(np.median(lengths)) / stated
    mistakes = _UNIT_MISTAKE_HINTS.items()
    near = (f"; {why}" for k, why in mistakes if abs(ratio / k - 1.0) < _UNIT_RATIO_TOLERANCE)
    where = join_first_names(dict.fromkeys(pair for pair, _ in off))
    if len(edges) > 1:
        where = f"{len(off)} of {len(edges)} places ({where})"
    return (
        f"{name}: edges are {found} mm in {where}, expected {stated:g} ± {sigma:.2g} mm: joint "
        f"angles, the head's calibration or the size do not fit{next(near, '')}"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LocatedTarget:
    """A triangulated target."""

    pair: str
    """Name of the left image."""
    target: PlanarTarget
    pixels: FloatArray
    """(2, n, 2) its corners by eye, px; nan for corners that were not found."""
    sigma_px: FloatArray
    """(2, n, 2) their standard deviations."""
    fix: Fix
    """Triangulation of its n corners."""
    centre: Fix
    """Triangulation of its centre: of a board, by the weights of its corners."""
    spacing: EdgeSpacing
    """Distances between its neighbouring corners."""
    focal_px: float
    """Mean focal length of the head's cameras, which converts a point's gap to pixels."""
    pose: Pose | None
    """Pose of T in N by both eyes; of unknown size, that which they measure. None if no eye's
    corners determine it, or without a solution."""
    eye_poses: tuple[Pose | None, Pose | None]
    """Pose of T in each camera by its own image, of the same size."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n,) True for corners with a solution."""
        return self.fix.valid

    @property
    def gap_m(self) -> float:
        """Root mean square of the corners' gaps, metres; nan without a solution."""
        return _rms(self.fix.gap[self.valid])

    @property
    def gap_px(self) -> float:
        """Root mean square distance between the lines of sight, as a distance in the image, px."""
        depth = np.linalg.norm(self.fix.point[self.valid], axis=-1)
        return _rms(self.focal_px * self.fix.gap[self.valid] / depth)

    def document(self) -> dict[str, Any]:
        """Plain values, millimetres and pixels; None for values without a solution."""
        return {
            "pair": self.pair,
            "target": str(self.target),
            "id": tag_number(self.target),
            "pixels": null_nonfinite_rows(self.pixels),
            "points_mm": null_nonfinite_rows(MM * self.fix.point),
            "sigma_mm": null_nonfinite_rows(MM * self.fix.sigma),
            "centre_mm": null_nonfinite_rows(MM * self.centre.point),
            "centre_sigma_mm": null_nonfinite_rows(MM * self.centre.sigma),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "gap_mm": null_nonfinite_elements(MM * self.fix.gap),
            "spacing_mm": {
                **self.spacing.document(),
                "sigma": null_nonfinite_elements([MM * self.spacing.sigma_m])[0],
            },
            "pose": pose_document(self.pose),
            "eye_poses": {
                name: pose_document(pose, self.target.size_known)
                for name, pose in zip(EYE_NAMES, self.eye_poses, strict=True)
            },
        }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def locate_target(
    head: HeadModel, q: FloatArray, pair: str, left: BoardDetection, right: BoardDetection
) -> LocatedTarget:
    """Triangulate a target that both eyes see, at (7,) angles, rad."""
    target, joint_rad = left.target, Noise.of(head).joint_rad

    def fix_of(pixels: FloatArray, sigma: FloatArray) -> Fix:
        # the detector's noise, or the head file's if the detector has none
        known = np.where(np.isfinite(sigma), sigma, head.sensor.detection_noise_px)
        return triangulate_views(head, q, pixels, Noise(pixel_px=known, joint_rad=joint_rad))

    def candidate(order: NDArray[np.intp]) -> tuple[Fix, FloatArray, FloatArray]:
        pixels = np.stack([left.corners_px, right.corners_px[order]], axis=1)
        sigma = np.stack([left.corners_sigma_px, right.corners_sigma_px[order]], axis=1)
        return fix_of(pixels, sigma), pixels, sigma

    candidates = map(candidate, equivalent_corner_orders(target))
    fix, pixels, sigma = min(candidates, key=lambda each: _mismatch(each[0]))
    right = right._replace(corners_px=pixels[:, 1], corners_sigma_px=sigma[:, 1])
    of_joints = fix_of(pixels, np.zeros_like(pixels)).covariance
    of_pixels = fix.covariance - of_joints
    if isinstance(target, AprilTag):
        centre = fix_of(
            np.stack([left.point_px, right.point_px]), np.stack([left.sigma_px, right.sigma_px])
        )
    else:  # pixel errors average out over a board's corners, joint errors do not
        weights = centre_weights(target.corners_m, fix.valid)
        centre = Fix(
            point=weighted_sum(fix.point, weights),
            gap=weighted_sum(fix.gap, weights),
            covariance=weighted_sum(of_pixels, weights**2) + of_joints[weights != 0.0].mean(axis=0),
            valid=np.asarray(np.isfinite(weights).all()),
        )
    noise = [corner_noise(side, head.sensor.detection_noise_px) for side in (left, right)]
    views = eye_views(head, q, [left.corners_px, right.corners_px], noise, joint_rad)
    pose = None
    if fix.valid.any():
        pose = estimate_pose(target.corners_m, views, size_known=target.size_known)
    own_left, own_right = (
        estimate_pose(target.corners_m, [View(view.camera, view.corners_px, view.noise)])
        for view in views
    )
    edge_sigma_m = _mean_edge_sigma(head, q, target, pixels, fix.point, of_pixels)
    return LocatedTarget(
        pair=pair,
        target=target,
        pixels=pixels.swapaxes(0, 1),
        sigma_px=sigma.swapaxes(0, 1),
        fix=fix,
        centre=centre,
        spacing=measure_spacing(target, [fix.point], edge_sigma_m),
        focal_px=float(head.cameras.focal.mean()),
        pose=pose,
        eye_poses=(own_left, own_right),
    )


def equivalent_corner_orders(target: PlanarTarget) -> list[NDArray[np.intp]]:
    """Possible orders of a board's corners, if turning the board does not change its appearance."""
    places: NDArray[np.intp] = np.arange(len(target.corners_m))
    if not isinstance(target, Checkerboard) or not target.symmetric:
        return [places]
    grid = places.reshape(target.rows, target.columns)
    # a quarter turn keeps the colours only if each side has an odd number of squares
    quarters = target.rows == target.columns and target.rows % 2 == 0
    return [np.rot90(grid, turns).ravel() for turns in (range(4) if quarters else (0, 2))]


def _mismatch(fix: Fix) -> float:
    """Cost of matching two views of a board: rms gap, plus a penalty for corners not solved."""
    valid = fix.valid
    return _rms(fix.gap[valid]) + 1e3 * float((~valid).mean()) if valid.any() else np.inf


_MAX_GAP_PX: Final = 2.0
"""Largest distance between the lines of sight of a calibrated pair, px (chosen: false against
missed remarks)."""


class MissedTarget(NamedTuple):
    """A target that could not be triangulated: one image lacks it, or shows it twice."""

    pair: str
    target: PlanarTarget
    seen_in: str
    """`left` or `right` if only that image has the target; `twice` if one has it more than once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LocateResult:
    """Targets located in all pairs."""

    head: HeadModel
    angles: dict[str, FloatArray]
    """(7,) joint angles, rad, by the name of each pair that could be read."""
    located: tuple[LocatedTarget, ...]
    missed: tuple[MissedTarget, ...]
    remarks: tuple[str, ...]
    """Notes for the user on the images, one line each."""
    unpaired: tuple[Path, ...]
    """Images without a partner."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""
    shown: tuple[Photograph, Photograph]
    """The pair to draw: the first in which a target was located, else the first with a detection
    in either image, else the first."""

    @property
    def any_triangulated(self) -> bool:
        """True if any point was triangulated."""
        return any(one.valid.any() for one in self.located)

    def located_by_target(self) -> list[list[LocatedTarget]]:
        """Located targets, grouped: each board by itself, tags of one family and size together."""
        kinds: dict[PlanarTarget, list[LocatedTarget]] = defaultdict(list)
        for one in self.located:
            target = one.target
            kind = replace(target, id=0) if isinstance(target, AprilTag) else target
            kinds[kind].append(one)
        return list(kinds.values())

    def rows(self) -> list[dict[str, Any]]:
        """One row per located target and pair, plain values."""
        return [one.document() for one in self.located]

    def summary(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "head": self.head.name,
            "head_digest": self.head.digest,
            "pairs": list(self.angles),
            "joints_rad": {
                pair: dict(zip(self.head.joints, q.tolist(), strict=True))
                for pair, q in self.angles.items()
            }
            if self.head.actuation.count  # else frame N follows the neck, and points do not move
            else None,
            "located": self.rows(),
            "spacing_mm": {
                str(target): measure_spacing(
                    target, [one.fix.point for one in self.located if one.target == target]
                ).document()
                for target in dict.fromkeys(one.target for one in self.located)
            },
            "missed": [
                {"pair": pair, "target": str(target), "why": why}
                for pair, target, why in self.missed
            ],
            "without_partner": [str(path) for path in self.unpaired],
            "not_read": list(self.failures),
        }

    def notes(self) -> list[str]:
        """Remarks for the user in addition to the table, one line each."""
        said = list(self.remarks)
        if self.unpaired:
            said.append(
                f"{len(self.unpaired)} of the images have no partner: "
                f"{join_first_names(path.name for path in self.unpaired)}"
            )
        missed: dict[tuple[str, str], list[str]] = defaultdict(list)
        for pair, target, seen_in in self.missed:
            missed[str(target), seen_in].append(pair)
        for (name, seen_in), names in sorted(missed.items()):
            where = "more than once in an image"
            if seen_in != "twice":
                where = f"in the {seen_in} image only"
            pairs = "pair" if len(names) == 1 else "pairs"
            said.append(f"{name} found {where} of {len(names)} {pairs}: {join_first_names(names)}")
        return said + self._doubts()

    def _doubts(self) -> list[str]:
        """Signs that the head file and the images do not belong together, one line each."""
        fitting = "a head file of these cameras as they stand"
        if any(self.head.joints):
            fitting += ", and joint angles of that moment"

        def pairs_of(every: Iterable[LocatedTarget]) -> str:
            return join_first_names(dict.fromkeys(one.pair for one in every))

        said = []
        crossed = [one for one in self.located if one.valid.any()]
        if lost := [one for one in self.located if not one.valid.any()]:
            said.append(
                f"the lines of sight do not cross before the eyes in {pairs_of(lost)} (are left "
                "and right swapped?)"
            )
        # coarse encoders separate the lines of sight by as much as their error turns an eye
        blur_rad = float(np.max(np.asarray(Noise.of(self.head).joint_rad)[EYES]))
        most = max(_MAX_GAP_PX, 4.0 * blur_rad * float(self.head.cameras.focal.max()))
        if apart := [one for one in crossed if one.gap_px > most]:
            worst = max(apart, key=lambda one: one.gap_px)
            said.append(
                f"lines of sight miss each other by more than {most:.2g} px in {len(apart)} of "
                f"{len(crossed)} places, by {worst.gap_px:.1f} px in {worst.pair}: expected "
                + fitting
            )
        if refuted := [one for one in crossed if one.pose is not None and one.pose.contradicted]:
            said.append(
                f"no pose explains the corners of both images in {pairs_of(refuted)}: expected a "
                f"target of the stated size and {fitting}"
            )
        for every in self.located_by_target():
            measured = [one for one in every if one.spacing.edge_count]
            names = join_first_names(dict.fromkeys(str(one.target) for one in measured))
            said.append(describe_wrong_edges(names, [(one.pair, one.spacing) for one in measured]))
        return [text for text in said if text]


def locate(
    left: Path,
    right: Path,
    head: str,
    target: Sequence[str],
    response: str | None = None,
    joints: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> LocateResult:
    """Find targets in pairs of photographs and triangulate them, see `vergence locate --help`."""
    targets = parse_targets(target)
    curve = None if response is None else parse_response(response)
    model = load_head(head)
    pairs, unpaired = pair_up(left, right)
    angles = read_joint_angles(model, joints, [pair.name for pair in pairs])
    finders = [TargetFinder(targets, Camera.of(model, eye), curve) for eye in range(2)]
    search = PhotographSearch(targets, [list(zip(finders, pair, strict=True)) for pair in pairs])
    angles_read: dict[str, FloatArray] = {}
    located: list[LocatedTarget] = []
    missed: list[MissedTarget] = []
    shown, rank = None, -1
    for view in search.search(progress, is_single=not left.is_dir(), kind=" pairs"):
        if not view:
            continue
        left_one, right_one = view
        name, sides = left_one.path.name, (left_one.detections, right_one.detections)
        angles_read[name] = angles[name]
        here, not_here = _match(model, angles[name], name, *sides)
        located += here
        missed += not_here
        worth = 2 * bool(here) + any(sides)
        if worth > rank:
            shown, rank = (left_one, right_one), worth
    assert shown is not None  # else the search has raised an error
    return LocateResult(
        head=model,
        angles=angles_read,
        located=tuple(located),
        missed=tuple(missed),
        remarks=search.remarks([path for pair in pairs for path in pair]),
        unpaired=tuple(unpaired),
        failures=tuple(search.failures),
        shown=shown,
    )


def _match(
    head: HeadModel,
    q: FloatArray,
    pair: str,
    left: Sequence[BoardDetection],
    right: Sequence[BoardDetection],
) -> tuple[list[LocatedTarget], list[MissedTarget]]:
    """Triangulate the targets that both images have exactly once; list the others as missed."""
    located, missed = [], []
    for key, target in {target_key(d.target): d.target for d in (*left, *right)}.items():
        of_left, of_right = (
            [d for d in side if target_key(d.target) == key] for side in (left, right)
        )
        if len(of_left) == len(of_right) == 1:
            located.append(locate_target(head, q, pair, of_left[0], of_right[0]))
        elif of_left and of_right:
            missed.append(MissedTarget(pair, target, "twice"))
        else:
            missed.append(MissedTarget(pair, target, "left" if of_left else "right"))
    return located, missed


_POINT_COLUMNS: Final = [f"{what}{axis}_mm" for what in ("", "sigma_") for axis in "xyz"]
_PIXEL_COLUMNS: Final = [
    f"{what}{eye}_{axis}_px" for what in ("", "sigma_") for eye in EYE_NAMES for axis in "uv"
]
_POSE_COLUMNS: Final = [
    f"{what}pose_{part}"
    for what in ("", "sigma_", "other_")
    for part in ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad")
]


def write_corner_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per corner of each target; cells without a solution are empty."""
    rows = []
    for one in located:
        point, sigma, gap = MM * one.fix.point, MM * one.fix.sigma, MM * one.fix.gap
        numbers = np.column_stack([point, sigma, gap, *one.pixels, *one.sigma_px])
        rows += [(one, number, row) for number, row in enumerate(numbers)]
    _write(path, "point", [*_POINT_COLUMNS, "gap_mm", *_PIXEL_COLUMNS], rows)


def write_target_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per target of each pair."""
    columns = [*_POINT_COLUMNS, "gap_rms_mm", "spacing_mean_mm", "spacing_spread_mm"]
    rows = []
    for one in located:
        edges, centre = one.spacing, one.centre
        lengths = [one.gap_m, edges.mean_m, edges.spread_m, edges.stated_m]
        numbers = [MM * np.concatenate([centre.point, centre.sigma, lengths])]
        poses = np.full((3, 6), np.nan)  # translation and rotation vector
        for row, pose in ((0, one.pose), (2, one.pose and one.pose.other)):
            if pose is not None:
                poses[row] = [*pose.matrix[:3, 3], *pose.rotation_vector]
        if one.pose is not None:
            poses[1] = one.pose.sigma
        poses[:, :3] *= MM
        rows.append((one, int(one.valid.sum()), np.concatenate([*numbers, poses.ravel()])))
    _write(path, "points", [*columns, "spacing_stated_mm", *_POSE_COLUMNS], rows)


def _write(
    path: Path, count: str, columns: Sequence[str], rows: Iterable[tuple[LocatedTarget, int, Any]]
) -> None:
    """Write rows of a target, a number under the heading `count`, and (n) numbers or nan."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["pair", "target", "id", count, *columns])
        for one, number, values in rows:
            cells = null_nonfinite_elements(values)  # None is written as an empty cell
            writer.writerow([one.pair, one.target, tag_number(one.target), number, *cells])
