"""Notes for the user on photographs: what no image shows, what is there instead, doubtful light."""

from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from vergence.errors import ConfigurationError
from vergence.models.camera import LINEAR, SRGB, CameraResponse, camera_matrix, light_table
from vergence.models.parts import FloatArray
from vergence.perception.photographs import join_first_names
from vergence.vision import Camera, make_detector
from vergence.vision.april_grid import alternative_grids
from vergence.vision.charuco import alternative_charuco, find_markers, upper_left_is_dark
from vergence.vision.detection import BoardDetection
from vergence.vision.image import has_orientation_tag, measurement_channel
from vergence.vision.optics import fit_homography
from vergence.vision.tag_families import AprilGrid, families_in
from vergence.vision.targets import (
    AprilTag,
    CharucoBoard,
    Checkerboard,
    PlanarTarget,
    TagFamily,
    Target,
    neighbour_pairs,
)

_Board = AprilGrid | CharucoBoard
_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel counts as clipped (chosen: just below 255, the largest)."""
_MAX_CLIPPED_FRACTION: Final = 0.15
"""Fraction of clipped pixels around a target above which its white is clipped (chosen: missed
against false remarks)."""


class PhotographNotes:
    """Notes on all photographs of a run, one line each."""

    def __init__(self, targets: Sequence[Target], *, check_white: bool = True) -> None:
        self._check_white = check_white
        self._asked = self._unseen = list(targets)
        self._images = self._clipped = 0
        self._rows: dict[_Board, list[NDArray[np.bool_]]] = defaultdict(list)

    def add(self, image: NDArray[np.uint8], detections: Sequence[BoardDetection]) -> None:
        """Add an image and all its detections."""
        self._images += 1
        self._unseen = [t for t in self._unseen if not any(is_of_target(d, t) for d in detections)]
        if self._check_white:
            self._clipped += any(_is_white_clipped(image, each) for each in detections)
        for each in detections:
            if isinstance(each.target, _Board):
                self._rows[each.target].append(_rows_seen_and_in_view(each, image.shape))

    def lines(
        self, paths: Iterable[Path] = (), checks: Iterable["LinearResponseCheck"] = ()
    ) -> tuple[str, ...]:
        """Lines on the images added, on the edges in them, and on orientation tags of files."""
        said = []
        if len(self._unseen) < len(self._asked):  # callers report themselves that nothing was found
            images = f"{self._images} image{'' if self._images == 1 else 's'}"
            said += [f"{target}: found in 0 of {images}" for target in self._unseen]
            said += [
                f"{target}: its last row is in 0 of {len(views)} images, though its place is in "
                f"view: if nothing covers it, the board is {other}, whose middle is elsewhere"
                for target, views in self._rows.items()
                if (other := _fitting_board(target, views)) != target
            ]
            if self._clipped:
                said.append(
                    f"white is clipped in {self._clipped} of {images}: its pixels count for "
                    "nothing, and corners of tags are less sure; expose less"
                )
        said += dict.fromkeys(line for check in checks for line in check.lines())
        turned = [path.name for path in paths if has_orientation_tag(path)]
        if turned:
            said.append(
                "pixels are those of the sensor, not turned as the orientation tag asks, in "
                f"{len(turned)} images: {join_first_names(turned)}"
            )
        return tuple(said)


def target_key(target: PlanarTarget) -> Hashable:
    """Key that is equal for detections of one target: family and number of a tag, else itself."""
    return (target.family, target.id) if isinstance(target, AprilTag) else target


def is_of_target(detection: BoardDetection, target: Target) -> bool:
    """True if a detection is of the target; tags are compared by family and number alone."""
    found = detection.target
    if isinstance(target, TagFamily):
        return isinstance(found, AprilTag) and found.family == target.family
    if isinstance(target, CharucoBoard) and isinstance(found, CharucoBoard):
        return replace(found, legacy=target.legacy) == target  # both layouts are searched for
    return target_key(found) == target_key(target)


def _is_white_clipped(image: NDArray[np.uint8], detection: BoardDetection) -> bool:
    corners = detection.corners_px[np.isfinite(detection.corners_px).all(axis=1)]
    u0, v0 = np.maximum(corners.min(axis=0).astype(int), 0)
    u1, v1 = corners.max(axis=0).astype(int) + 1
    return bool((image[v0:v1, u0:u1] >= _CLIPPED_GREY).mean() > _MAX_CLIPPED_FRACTION)


_MARGIN_SQUARES: Final = 1.25
"""Room in the image around a corner of a ChArUco board that is expected, in squares: the markers
beside it with white around them (chosen)."""
_SIDES: Final = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
"""Directions to the four sides (numerical)."""


def _rows_seen_and_in_view(found: BoardDetection, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(2, rows) masks: rows of a grid or ChArUco board with corners, and rows well in the image."""
    target = found.target
    if isinstance(target, AprilGrid):
        rows, margin_m = target.rows, target.spacing * target.tag_m
    else:
        assert isinstance(target, CharucoBoard)
        rows, margin_m = target.rows - 1, _MARGIN_SQUARES * target.square_m
    in_view = known = np.isfinite(found.corners_px).all(axis=1)
    transform = fit_homography(target.corners_m[known], found.corners_px[known])
    if transform is not None:
        around_m = target.corners_m[:, None] + margin_m * _SIDES
        places = cv2.perspectiveTransform(around_m, transform)
        in_view = ((places > 0.0) & (places < (shape[1] - 1.0, shape[0] - 1.0))).all(axis=(1, 2))
    return np.stack([known.reshape(rows, -1).any(axis=1), in_view.reshape(rows, -1).all(axis=1)])


def _fitting_board(target: _Board, views: Sequence[NDArray[np.bool_]]) -> _Board:
    """The board, or that of fewer rows if no image shows the last and most show their place."""
    seen, in_view = np.stack(views, axis=1)
    count = int(np.flatnonzero(seen.any(axis=0))[-1]) + 1
    if count == seen.shape[1] or in_view[:, count].mean() <= 0.5:
        return target
    if isinstance(target, AprilGrid):
        return replace(target, rows=count)
    dark = upper_left_is_dark(target)
    if not dark and count % 2 == 0:  # no board of that layout ends there
        return target
    try:
        return replace(target, rows=count + 1, legacy=not dark)
    except ConfigurationError:  # too few rows
        return target


_SIZE_OFFSETS: Final = ((-1, -1), (-1, 0), (0, -1), (1, 0), (0, 1), (1, 1), (-2, -2))
"""Columns and rows to add to the size asked for; first the error of counting squares instead of
inner corners (chosen: likely mistakes against time)."""
_MARKER_COUNTS: Final = (50, 100, 250, 1000)
"""Sizes of OpenCV's dictionaries of one name; smaller ones begin larger ones (physical: OpenCV)."""
_MARKERS: Final = (
    *(f"DICT_{bits}X{bits}_1000" for bits in range(4, 8)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    "DICT_APRILTAG_36h11",
)
"""Dictionaries of markers that are tried (chosen: those in use)."""
_LEAST_MARKERS: Final = 4
"""Least markers that show a board, and least missing first ids that show that its ids begin later
(chosen: boards against clutter and hidden markers)."""
_MAX_IMAGE_SIDE_PX: Final = 1280
"""Longest side of the image that is searched, px; larger images are reduced (chosen: small targets
against the time of a dozen searches in 12 megapixels)."""


def describe_similar_targets(
    image: NDArray[np.uint8], requested: Sequence[Target], camera: Camera | None = None
) -> str:
    """Phrase such as ``tag:36h11:3 is there`` on targets like those that were missed; or empty."""
    image, camera = _reduced(image, camera)
    if changed := _changed(image, requested, camera):
        return changed
    there: list[str] = []
    if any(isinstance(target, AprilTag | TagFamily) for target in requested):
        asked = [target.family for target in requested if isinstance(target, AprilTag)]
        there += (
            _tags(image, asked, camera)
            or _grids(image, None, camera)
            or _tags(image, families_in(image), camera)
        )
    for target in requested:
        if isinstance(target, Checkerboard):
            there += _boards(image, target, camera)
        elif isinstance(target, CharucoBoard):
            there += _charuco(image, target, camera)
        elif isinstance(target, AprilGrid):
            there += _grids(image, target, camera) or [
                f"{tag} (a single tag, its border one bit wide)"
                for tag in _tags(image, families_in(image), camera)[:1]
            ]
    there = list(dict.fromkeys(there))
    if not there:
        return ""
    return f"{join_first_names(there)} {'is' if len(there) == 1 else 'are'} there"


def _reduced(
    image: NDArray[np.uint8], camera: Camera | None
) -> tuple[NDArray[np.uint8], Camera | None]:
    """Reduce a large image to a size that is searched quickly, and its camera accordingly."""
    height, width = image.shape
    if max(width, height) <= _MAX_IMAGE_SIDE_PX:
        return image, camera
    scale = _MAX_IMAGE_SIDE_PX / max(width, height)
    size = round(scale * width), round(scale * height)
    if camera is not None:
        u, v = size[0] / width, size[1] / height
        camera = replace(
            camera,
            size=size,
            matrix=camera_matrix(camera.focal * (u, v), (camera.principal + 0.5) * (u, v) - 0.5),
        )
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), camera


def _tags(image: NDArray[np.uint8], families: Sequence[str], camera: Camera | None) -> list[str]:
    """Tags of the first family that has any."""
    for family in dict.fromkeys(families):
        found = make_detector(TagFamily(family=family, size_known=False), camera).detect_all(image)
        if found:
            return [str(each.target) for each in found]
    return []


def _boards(image: NDArray[np.uint8], target: Checkerboard, camera: Camera | None) -> list[str]:
    """First board of similar size."""
    for columns, rows in _SIZE_OFFSETS:
        try:
            other = replace(target, columns=target.columns + columns, rows=target.rows + rows)
        except ConfigurationError:  # too few corners for a board
            continue
        if make_detector(other, camera).search(image) is not None:
            return [f"{other} (inner corners)"]
    return []


def _grids(image: NDArray[np.uint8], target: AprilGrid | None, camera: Camera | None) -> list[str]:
    """Grid with other counts or another spacing; any grid if no target is given."""
    for other in alternative_grids(image, target):
        found = make_detector(other, camera).detect(image)
        if found is not None:
            rows = _fitting_board(other, [_rows_seen_and_in_view(found, image.shape)]).rows
            size = f"{1000 * other.tag_m:g}" if target is not None else "TAG"
            name = f"aprilgrid:{other.columns}x{rows}:{size}:{other.spacing:g}"
            return [f"{name} (tags, and their gap by their edge)"]
    return []


def _charuco(image: NDArray[np.uint8], target: CharucoBoard, camera: Camera | None) -> list[str]:
    """Board with other counts or another dictionary; if it is none of these, its markers' ids."""
    for dictionary in dict.fromkeys([target.dictionary, *_MARKERS]):
        corners, seen = find_markers(
            image, cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        )
        if len(seen) >= _LEAST_MARKERS:
            break
    else:
        return []
    name, size = dictionary.rsplit("_", 1)
    if dictionary != target.dictionary and size == "1000":  # smaller ones begin with its markers
        dictionary = f"{name}_{min(n for n in _MARKER_COUNTS if n > max(seen))}"
    other = alternative_charuco(corners, seen, target, dictionary)
    found = None if other in (None, target) else make_detector(other, camera).search(image)
    if found is not None:
        assert isinstance(found.target, CharucoBoard)
        rows = _rows_seen_and_in_view(found, image.shape)
        if not rows[1, : np.flatnonzero(rows[0])[0]].any():  # else its ids begin later
            return [str(_fitting_board(found.target, [rows]))]
    own = dictionary.removeprefix("DICT_")
    if min(seen) >= _LEAST_MARKERS and max(seen) - min(seen) < 2 * len(seen):
        return [f"a board of {own} whose ids begin at {min(seen)} in place of 0"]
    return [] if dictionary == target.dictionary else [f"a board of {own}"]


def _changed(image: NDArray[np.uint8], requested: Sequence[Target], camera: Camera | None) -> str:
    """A requested target that the mirrored image or its negative shows; empty if there is none."""
    for name, other in (
        ("mirrored", np.ascontiguousarray(image[:, ::-1])),
        ("white on black", 255 - image),
    ):
        for target in requested:
            if isinstance(target, Checkerboard):  # looks alike mirrored or as a negative
                continue
            found = make_detector(target, camera).detect(other)
            if found is not None:
                return f"{found.target} is there, {name}"
    return ""


_STRIP_HALF_WIDTH_PX: Final = 4.0
"""Half width of the strip along an edge, px (chosen: the whole blur against other edges)."""
_LEAST_EDGE_PX: Final = 16.0
"""Shortest edge that is used, px: shorter ones have less than 8 px between their ends (chosen:
number of edges against noise)."""
_EDGE_END_FRACTION: Final = 0.22
"""Fraction of an edge at each end that is left out, as other edges blur into it (chosen: bias
against pixels lost)."""
_MAX_EDGES_PER_TARGET: Final = 12
"""Most edges of a detection; each takes some milliseconds (chosen: certainty against time)."""
_LEAST_CONTRAST_GREY: Final = 40.0
"""Smallest contrast of an edge, grey levels; below it the responses hardly differ (chosen: evidence
against noise)."""
_CLIPPED_LIGHT_GREY: Final = 250
"""Grey level from which on a pixel may be clipped; an edge with such a pixel is not used (chosen:
bias against edges lost)."""
_LEAST_EDGES: Final = 8
"""Fewest edges for a conclusion (chosen: early remarks against false ones)."""
_MAX_EDGES_IN_TOTAL: Final = 120
"""Number of edges after which no more are added (chosen: certainty of the mean against time)."""
_MIN_STANDARD_ERRORS: Final = 4.0
"""Standard errors by which the mean ratio must exceed 0 for a remark (chosen: missed against false
remarks)."""
_MIN_MEAN_LOG_RATIO: Final = 0.03
"""Mean ratio that must be exceeded as well; no public set of grey photographs reaches it, nor does
a lens out of focus (measured: benchmarks.responses)."""


class LinearResponseCheck:
    """Tells by edges if levels stated as linear look encoded as sRGB; not the reverse."""

    def __init__(self) -> None:
        self._ratios: list[float] = []

    def add(
        self,
        image: ArrayLike,
        detections: Iterable[BoardDetection],
        stated_response: CameraResponse,
    ) -> None:
        """Add the edges of an image, read with the stated response, until there are enough."""
        if stated_response == LINEAR and len(self._ratios) < _MAX_EDGES_IN_TOTAL:
            self._ratios += srgb_fit_log_ratios(measurement_channel(image), detections)

    def lines(self) -> list[str]:
        """One line if the edges contradict a linear response, else none."""
        count = len(self._ratios)
        if count < _LEAST_EDGES:
            return []
        mean, spread = float(np.mean(self._ratios)), float(np.std(self._ratios, ddof=1))
        if not mean > max(_MIN_MEAN_LOG_RATIO, _MIN_STANDARD_ERRORS * spread / np.sqrt(count)):
            return []
        return [
            f"{count} edges look as if the camera's response were srgb, not linear: state it by "
            "--response, or as `response` of the eye in the head's file"
        ]


def srgb_fit_log_ratios(
    image: NDArray[np.uint8], detections: Iterable[BoardDetection]
) -> list[float]:
    """By edge, log ratio of residual squares of "linear" to "srgb"; above 0 if sRGB fits better."""
    ratios = []
    for found in detections:
        corners = found.corners_px[neighbour_pairs(found.target)]
        long = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) >= _LEAST_EDGE_PX
        chosen = corners[long]  # without edges that have a corner of nan
        every = max(len(chosen) // _MAX_EDGES_PER_TARGET, 1)
        for start, end in chosen[::every][:_MAX_EDGES_PER_TARGET]:
            strip = _strip(image, start, end)
            if strip is not None:
                squares = [_residual_squares(*strip, one) for one in (LINEAR, SRGB)]
                if min(squares) > 0.0:
                    ratios.append(float(np.log(squares[0] / squares[1])))
    return ratios


def _strip(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Pixels along an edge: signed distances from it, px, positive towards white, and levels."""
    ends = np.stack([start, end])
    low = np.maximum(np.floor(ends.min(axis=0) - _STRIP_HALF_WIDTH_PX).astype(int), 0)
    high = np.ceil(ends.max(axis=0) + _STRIP_HALF_WIDTH_PX).astype(int) + 1
    levels = image[low[1] : high[1], low[0] : high[0]].astype(float)
    if min(levels.shape) < 2:
        return None
    v, u = np.mgrid[: levels.shape[0], : levels.shape[1]]
    du, dv = u + low[0] - start[0], v + low[1] - start[1]
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    share = (du * along[0] + dv * along[1]) / length
    across = dv * along[0] - du * along[1]
    near = (np.abs(share - 0.5) < 0.5 - _EDGE_END_FRACTION) & (
        np.abs(across) <= _STRIP_HALF_WIDTH_PX
    )
    away, level = across[near], levels[near]
    far = 0.6 * _STRIP_HALF_WIDTH_PX
    sides = [level[away < -far], level[away > far]]
    if min(map(len, sides)) < 4:
        return None
    before, after = map(np.median, sides)
    if abs(after - before) < _LEAST_CONTRAST_GREY or (level >= _CLIPPED_LIGHT_GREY).any():
        return None
    return (-away if before > after else away), level


def _residual_squares(away: FloatArray, level: FloatArray, response: CameraResponse) -> float:
    """Residual sum of squares of levels after the fit of a blurred step; 0 if it does not fit."""
    light = light_table(response)
    dark, bright = np.interp(np.percentile(level, (10, 90)), np.arange(256), light)

    def residuals(values: FloatArray) -> FloatArray:
        z = (away - values[2]) / np.exp(values[3])
        height = np.exp(-0.5 * z * z)
        # any symmetric blur: the even terms of a Gram-Charlier series, whose integrals are odd
        odd = values[4] * (z**3 - 3.0 * z) + values[5] * (z**5 - 10.0 * z**3 + 15.0 * z)
        light_here = values[0] + values[1] * (ndtr(z) + height * odd)
        return np.asarray(np.interp(light_here, light, np.arange(256.0)) - level)

    first = [dark, bright - dark, 0.0, 0.0, 0.0, 0.0]
    found = least_squares(residuals, first, method="lm", max_nfev=120)
    blur = float(np.exp(found.x[3]))
    if not (
        0.2 < blur < 0.6 * _STRIP_HALF_WIDTH_PX and abs(found.x[2]) < 0.5 * _STRIP_HALF_WIDTH_PX
    ):
        return 0.0
    return float(2.0 * found.cost)
