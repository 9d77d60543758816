"""Find targets in pairs of photographs, triangulate them, and judge the result."""

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import parse_response
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES, FloatArray
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.perception.finding import (
    Photograph,
    PhotographNotes,
    TargetFinder,
    centre_weights,
    parse_targets,
    tag_number,
    target_key,
    weighted_sum,
)
from vergence.perception.locate_config import LocateConfig
from vergence.perception.photographs import (
    eyes_move,
    join_first_names,
    pair_up,
    read_joint_angles,
    remark_on_orientation_tags,
)
from vergence.triangulation import Fix, Noise, triangulate_views
from vergence.vision import Camera
from vergence.vision.detection import Detection
from vergence.vision.targets import (
    AprilTag,
    Checkerboard,
    PlanarTarget,
    neighbour_pairs,
    stated_edge_m,
)

MM: Final = 1000.0
"""Millimetres per metre (physical)."""


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

    def document(self) -> dict[str, Any]:
        """Plain values, millimetres."""
        return {
            "mean": None if np.isnan(self.mean_m) else MM * self.mean_m,
            "spread": None if np.isnan(self.spread_m) else MM * self.spread_m,
            "count": self.edge_count,
            "stated": None if np.isnan(self.stated_m) else MM * self.stated_m,
        }


def neighbour_distances_m(target: PlanarTarget, points: FloatArray) -> FloatArray:
    """(k,) distances between neighbouring corners, m, of (n, 3) points, nan where unsolved."""
    first, second = neighbour_pairs(target).T
    apart = np.linalg.norm(points[first] - points[second], axis=-1)
    return np.asarray(apart[np.isfinite(apart)])


def measure_spacing(target: PlanarTarget, points: Iterable[FloatArray]) -> EdgeSpacing:
    """Mean and standard deviation of the distances over views, (n, 3) points each, m."""
    apart = np.concatenate([np.empty(0), *(neighbour_distances_m(target, each) for each in points)])
    stated = stated_edge_m(target) if target.size_known else np.nan
    if not len(apart):
        return EdgeSpacing(np.nan, np.nan, 0, stated)
    return EdgeSpacing(float(apart.mean()), float(apart.std()), len(apart), stated)


_SIGNIFICANT_SIGMAS: Final = 3.0
"""Standard deviations above which a difference is significant (chosen: false against missed
remarks)."""
_MIN_RELATIVE_DIFFERENCE: Final = 0.01
"""Smallest difference that is remarked on, as a fraction of the stated edge; good calibrations and
printers err by less (chosen: as above)."""
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


class MeanEdge(NamedTuple):
    """The mean edge of a target in one pair of images."""

    pair: str
    """Name of the left image."""
    target: PlanarTarget
    mean_m: float
    """Mean edge; nan if none was measured."""
    sigma_m: float
    """Standard deviation of that mean from the noise of pixels and joints."""

    @property
    def differs_from_stated(self) -> bool:
        """True if it differs from the stated edge beyond noise and small calibration errors."""
        if not self.target.size_known:
            return False
        stated = stated_edge_m(self.target)
        return abs(self.mean_m - stated) > max(
            _SIGNIFICANT_SIGMAS * self.sigma_m, _MIN_RELATIVE_DIFFERENCE * stated
        )


def mean_edge_sigma(
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


def describe_wrong_edges(name: str, mean_edges: Sequence[MeanEdge]) -> str:
    """Message about targets whose edges differ from the stated size; empty if none do."""
    mean_edges = [each for each in mean_edges if np.isfinite(each.mean_m)]
    off = [each for each in mean_edges if each.differs_from_stated]
    if not off:
        return ""
    lengths, stated = [MM * each.mean_m for each in off], MM * stated_edge_m(off[0].target)
    low, high = f"{min(lengths):.2f}", f"{max(lengths):.2f}"
    found = low if low == high else f"{low} to {high}"
    sigma = MM * float(np.median([each.sigma_m for each in off]))
    ratio = float(np.median(lengths)) / stated
    hint = next(
        (
            f"; {why}"
            for k, why in _UNIT_MISTAKE_HINTS.items()
            if abs(ratio / k - 1.0) < _UNIT_RATIO_TOLERANCE
        ),
        "",
    )
    where = join_first_names(dict.fromkeys(each.pair for each in off))
    if len(mean_edges) > 1:
        where = f"{len(off)} of {len(mean_edges)} places ({where})"
    return (
        f"{name}: edges are {found} mm in {where}, expected {stated:g} ± {sigma:.2g} mm: joint "
        f"angles, the head's calibration or the size do not fit{hint}"
    )


class TargetCentre(NamedTuple):
    """The centre of a target in frame N."""

    point: FloatArray
    """(3,) metres; nan without a solution."""
    covariance: FloatArray
    """(3, 3) m^2."""

    @property
    def sigma(self) -> FloatArray:
        """(3,) standard deviations, metres."""
        return np.sqrt(np.diagonal(self.covariance))


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
    centre: TargetCentre
    edge_sigma_m: float
    """Standard deviation of the mean distance between neighbouring corners, see `mean_edge`."""
    focal_px: float
    """Mean focal length of the head's cameras, which converts a point's gap to pixels."""

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(n,) True for corners with a solution."""
        return np.asarray(self.fix.valid, bool)

    @property
    def spacing(self) -> EdgeSpacing:
        """Distances between its neighbouring corners."""
        return measure_spacing(self.target, [self.fix.point])

    @property
    def mean_edge(self) -> MeanEdge:
        """Mean distance between its neighbouring corners, with its standard deviation."""
        return MeanEdge(self.pair, self.target, self.spacing.mean_m, self.edge_sigma_m)

    @property
    def gap_m(self) -> float:
        """Root mean square of the corners' gaps, metres; nan without a solution."""
        gaps = self.fix.gap[self.valid]
        return float(np.sqrt(np.mean(gaps**2))) if len(gaps) else np.nan

    @property
    def gap_px(self) -> float:
        """Root mean square distance between the lines of sight, as a distance in the image, px."""
        depth = np.linalg.norm(self.fix.point[self.valid], axis=-1)
        gaps = self.focal_px * self.fix.gap[self.valid] / depth
        return float(np.sqrt(np.mean(gaps**2))) if len(gaps) else np.nan

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
                "sigma": null_nonfinite_elements([MM * self.edge_sigma_m])[0],
            },
        }


def locate_target(
    head: HeadModel, q: FloatArray, pair: str, left: Detection, right: Detection
) -> LocatedTarget:
    """Triangulate a target that both eyes see, at (7,) angles, rad."""
    target = left.target
    own = Noise.of(head)
    turned = [_turned(right, order) for order in equivalent_corner_orders(target)]
    fixes = [_corner_fix(head, q, left, each, own) for each in turned]
    best = int(np.argmin([_mismatch(fix) for fix in fixes])) if len(fixes) > 1 else 0
    right, fix = turned[best], fixes[best]
    sure = [d._replace(corners_sigma_px=np.zeros_like(d.corners_px)) for d in (left, right)]
    of_joints = _corner_fix(head, q, sure[0], sure[1], own).covariance
    centre = (
        _measured_point(head, q, left, right, own)
        if isinstance(target, AprilTag)
        else _board_centre(target, fix, of_joints)
    )
    corners = np.stack([left.corners_px, right.corners_px], axis=1)
    return LocatedTarget(
        pair=pair,
        target=target,
        pixels=np.stack([left.corners_px, right.corners_px]),
        sigma_px=np.stack([left.corners_sigma_px, right.corners_sigma_px]),
        fix=fix,
        centre=centre,
        edge_sigma_m=mean_edge_sigma(
            head, q, target, corners, fix.point, fix.covariance - of_joints
        ),
        focal_px=float(head.cameras.focal.mean()),
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


def _turned(found: Detection, order: NDArray[np.intp]) -> Detection:
    return found._replace(
        corners_px=found.corners_px[order], corners_sigma_px=found.corners_sigma_px[order]
    )


def _mismatch(fix: Fix) -> float:
    """Cost of matching two views of a board: rms gap, plus a penalty for corners not solved."""
    valid = np.asarray(fix.valid, bool)
    if not valid.any():
        return np.inf
    return float(np.sqrt(np.mean(fix.gap[valid] ** 2)) + 1e3 * (~valid).mean())


def _corner_fix(
    head: HeadModel, q: FloatArray, left: Detection, right: Detection, own: Noise
) -> Fix:
    pixels = np.stack([left.corners_px, right.corners_px], axis=1)
    sigma = np.stack([left.corners_sigma_px, right.corners_sigma_px], axis=1)
    return _fix(head, q, pixels, sigma, own)


def _fix(head: HeadModel, q: FloatArray, pixels: FloatArray, sigma: FloatArray, own: Noise) -> Fix:
    """Triangulate with the detector's pixel noise, or the head file's if the detector has none."""
    known = np.where(np.isfinite(sigma), sigma, head.sensor.detection_noise_px)
    return triangulate_views(head, q, pixels, Noise(pixel_px=known, joint_rad=own.joint_rad))


def _measured_point(
    head: HeadModel, q: FloatArray, left: Detection, right: Detection, own: Noise
) -> TargetCentre:
    pixels = np.stack([left.point_px, right.point_px])
    fix = _fix(head, q, pixels, np.stack([left.sigma_px, right.sigma_px]), own)
    return TargetCentre(fix.point, fix.covariance)


_NAN_CENTRE: Final = TargetCentre(np.full(3, np.nan), np.full((3, 3), np.nan))
"""Centre of a board that cannot be located (numerical)."""


def _board_centre(target: PlanarTarget, fix: Fix, of_joints: FloatArray) -> TargetCentre:
    """Centre of a board: pixel errors average out over its corners, joint errors do not."""
    weights = centre_weights(target.corners_m, np.asarray(fix.valid, bool))
    if not np.isfinite(weights).all():
        return _NAN_CENTRE
    of_pixels = fix.covariance - of_joints
    used = weights != 0.0
    return TargetCentre(
        weighted_sum(fix.point, weights),
        weighted_sum(of_pixels, weights**2) + of_joints[used].mean(axis=0),
    )


MAX_GAP_PX: Final = 2.0
"""Largest distance between the lines of sight of a calibrated pair, px (chosen: false against
missed remarks)."""


class MissedTarget(NamedTuple):
    """A target that could not be triangulated: one image lacks it, or shows it twice."""

    pair: str
    target: PlanarTarget
    seen_in: str
    """`left` or `right` if only that image has the target; `twice` if one has it more than once."""


class ShownPair(NamedTuple):
    """The pair that is drawn in the picture."""

    left: Photograph
    right: Photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class LocateResult:
    """Targets located in all pairs."""

    config: LocateConfig
    head: HeadModel
    angles: dict[str, FloatArray]
    """(7,) joint angles by pair, rad."""
    pairs: tuple[str, ...]
    """Names of the pairs that could be read."""
    located: tuple[LocatedTarget, ...]
    missed: tuple[MissedTarget, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each: targets that are in no image although others are, clipped
    white, a response that seems wrong."""
    unpaired: tuple[Path, ...]
    """Images without a partner."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""
    shown: ShownPair
    """First pair in which a target was located, else the first with a detection in either image,
    else the first."""

    @property
    def any_triangulated(self) -> bool:
        """True if any point was triangulated."""
        return any(one.valid.any() for one in self.located)

    def located_by_target(self) -> list[list[LocatedTarget]]:
        """Located targets, grouped: each board by itself, tags of one family and size together."""
        kinds: dict[PlanarTarget, list[LocatedTarget]] = {}
        for one in self.located:
            target = one.target
            kind = replace(target, id=0) if isinstance(target, AprilTag) else target
            kinds.setdefault(kind, []).append(one)
        return list(kinds.values())

    def spacings(self) -> dict[str, EdgeSpacing]:
        """Distances between neighbouring corners over all pairs, by target."""
        return {
            str(target): measure_spacing(
                target, [one.fix.point for one in self.located if one.target == target]
            )
            for target in dict.fromkeys(one.target for one in self.located)
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row per located target and pair, plain values."""
        return [one.document() for one in self.located]

    def summary(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "head": self.head.name,
            "head_digest": self.head.digest,
            "pairs": list(self.pairs),
            "joints_rad": {
                pair: dict(zip(self.head.joints, q.tolist(), strict=True))
                for pair, q in self.angles.items()
            }
            if eyes_move(self.head)
            else None,
            "located": self.rows(),
            "spacing_mm": {name: each.document() for name, each in self.spacings().items()},
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
        for key, group in groupby(
            sorted(self.missed, key=lambda one: (str(one.target), one.seen_in)),
            key=lambda one: (str(one.target), one.seen_in),
        ):
            name, why = key
            names = [one.pair for one in group]
            where = "more than once in an image" if why == "twice" else f"in the {why} image only"
            pairs = "pair" if len(names) == 1 else "pairs"
            said.append(f"{name} found {where} of {len(names)} {pairs}: {join_first_names(names)}")
        return said + self._doubts()

    def _doubts(self) -> list[str]:
        """Signs that the head file and the images do not belong together, one line each."""
        said = []
        crossed = [one for one in self.located if one.valid.any()]
        lost = [one.pair for one in self.located if not one.valid.any()]
        if lost:
            said.append(
                f"the lines of sight do not cross before the eyes in "
                f"{join_first_names(dict.fromkeys(lost))} (are left and right swapped?)"
            )
        # coarse encoders separate the lines of sight by as much as their error turns an eye
        blur_rad = float(np.max(np.asarray(Noise.of(self.head).joint_rad)[EYES]))
        most = max(MAX_GAP_PX, 4.0 * blur_rad * float(self.head.cameras.focal.max()))
        apart = [one for one in crossed if one.gap_px > most]
        if apart:
            worst = max(apart, key=lambda one: one.gap_px)
            said.append(
                f"lines of sight miss each other by more than {most:.2g} px in {len(apart)} of "
                f"{len(crossed)} places, by {worst.gap_px:.1f} px in {worst.pair}: expected a head "
                "file of these cameras as they stand, and joint angles of that moment"
            )
        for every in self.located_by_target():
            edges = [one.mean_edge for one in every if one.spacing.edge_count]
            names = list(dict.fromkeys(str(one.target) for one in edges))
            said.append(describe_wrong_edges(join_first_names(names), edges))
        return [text for text in said if text]


def locate(config: LocateConfig, progress: Callable[[float], None] | None = None) -> LocateResult:
    """Find targets in pairs of photographs and triangulate them."""
    targets = parse_targets(config.target)
    response = None if config.response is None else parse_response(config.response)
    head = load_head(config.head)
    pairs, unpaired, single = pair_up(config.left, config.right)
    angles = read_joint_angles(head, config.joints, [pair.name for pair in pairs])
    finders = [
        TargetFinder(targets, Camera.of(head, eye), response) for eye in range(len(EYE_NAMES))
    ]
    read: list[str] = []
    located: list[LocatedTarget] = []
    missed: list[MissedTarget] = []
    failures: list[str] = []
    unseen = PhotographNotes(targets)
    shown: ShownPair | None = None
    rank = -1
    for number, pair in enumerate(pairs, 1):
        try:
            left, right = (
                finder.find_in_file(path) for finder, path in zip(finders, pair, strict=True)
            )
        except VergenceError as error:
            if single:
                raise
            failures.append(str(error))
            continue
        read.append(pair.name)
        for photograph in (left, right):
            unseen.add(photograph)
        here, not_here = _match(
            head, angles[pair.name], pair.name, left.detections, right.detections
        )
        located += here
        missed += not_here
        worth = 2 * bool(here) + bool(left.detections or right.detections)
        if worth > rank:
            shown, rank = ShownPair(left, right), worth
        if progress is not None:
            progress(number / len(pairs))
    if shown is None:
        raise ConfigurationError(
            f"expected images that can be read, got none in {len(pairs)} pairs; the first: "
            f"{failures[0]}"
        )
    return LocateResult(
        config=config,
        head=head,
        angles={name: angles[name] for name in read},
        pairs=tuple(read),
        located=tuple(located),
        missed=tuple(missed),
        remarks=(
            *unseen.notes(),
            *dict.fromkeys(line for finder in finders for line in finder.response_check.notes()),
            *remark_on_orientation_tags(path for pair in pairs for path in pair),
        ),
        unpaired=tuple(unpaired),
        failures=tuple(failures),
        shown=shown,
    )


def _match(
    head: HeadModel,
    q: FloatArray,
    pair: str,
    left: Sequence[Detection],
    right: Sequence[Detection],
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


_AXES = ("x", "y", "z")


def write_corner_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per corner of each target; cells without a solution are empty."""
    head = ["pair", "target", "id", "point"]
    head += [f"{axis}_mm" for axis in _AXES] + [f"sigma_{axis}_mm" for axis in _AXES] + ["gap_mm"]
    for what in ("", "sigma_"):
        head += [f"{what}{eye}_{axis}_px" for eye in EYE_NAMES for axis in "uv"]
    _write(path, head, (row for one in located for row in _points(one)))


def _points(one: LocatedTarget) -> Iterable[list[object]]:
    numbers = np.column_stack(
        [
            MM * one.fix.point,
            MM * one.fix.sigma,
            MM * one.fix.gap,
            *one.pixels,
            *one.sigma_px,
        ]
    )
    for point, row in enumerate(numbers):
        yield [one.pair, one.target, tag_number(one.target), point, *map(_cell, row.tolist())]


def write_target_table(path: Path, located: Sequence[LocatedTarget]) -> None:
    """Write one row per target of each pair."""
    head = ["pair", "target", "id", "points"]
    head += [f"{axis}_mm" for axis in _AXES] + [f"sigma_{axis}_mm" for axis in _AXES]
    head += ["gap_rms_mm", "spacing_mean_mm", "spacing_spread_mm", "spacing_stated_mm"]
    rows: list[list[object]] = []
    for one in located:
        mean, spread, _, stated = one.spacing
        numbers = [*one.centre.point, *one.centre.sigma, one.gap_m, mean, spread, stated]
        cells = [_cell(MM * float(number)) for number in numbers]
        rows.append([one.pair, one.target, tag_number(one.target), int(one.valid.sum()), *cells])
    _write(path, head, rows)


def _cell(value: float) -> float | str:
    return value if np.isfinite(value) else ""


def _write(path: Path, head: list[str], rows: Iterable[list[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)
