"""Find all targets that are asked for in photographs and in live images, and what else is there."""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import LINEAR, SRGB, CameraResponse, camera_matrix, light_table
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.stereo_files import read_intrinsics
from vergence.operands import null_nonfinite_rows
from vergence.perception.photographs import list_photographs, remark_on_orientation_tags
from vergence.vision import Camera, Detector, Tracker, as_grey, make_detector, parse_target
from vergence.vision.april_grid import alternative_grids
from vergence.vision.charuco import alternative_charuco, find_markers, upper_left_is_dark
from vergence.vision.detection import Detection
from vergence.vision.image import measurement_channel, read_pixels
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

_MARGIN_SQUARES: Final = 1.25
"""Room in the image around a corner of a ChArUco board that is expected, in squares: the markers
beside it with white around them (chosen)."""
_SIDES: Final = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
"""Directions to the four sides (numerical)."""


class UnseenRowCheck:
    """Tells if no image shows the last rows of a board, although most show their place."""

    def __init__(self) -> None:
        self._rows: dict[PlanarTarget, list[NDArray[np.bool_]]] = defaultdict(list)

    def add(self, found: Detection, shape: tuple[int, ...]) -> None:
        """Add a detection in an image of shape (height, width, ...)."""
        if isinstance(found.target, AprilGrid | CharucoBoard):
            self._rows[found.target].append(rows_seen_and_in_view(found, shape))

    def fitting_boards(self) -> dict[PlanarTarget, PlanarTarget]:
        """Get the board of fewer rows that fits the images, for each target that has too many."""
        out: dict[PlanarTarget, PlanarTarget] = {}
        for target, views in self._rows.items():
            seen, in_view = np.stack(views, axis=1)
            last = int(np.flatnonzero(seen.any(axis=0))[-1])
            if last + 1 < seen.shape[1] and in_view[:, last + 1].mean() > 0.5:
                other = _with_rows(target, last + 1)
                if other is not None:
                    out[target] = other
        return out

    def notes(self) -> list[str]:
        """One line for each board whose last rows are in no image."""
        return [
            f"{target}: its last row is in 0 of {len(self._rows[target])} images, though its place "
            f"is in view: if nothing covers it, the board is {other}, whose middle is elsewhere"
            for target, other in self.fitting_boards().items()
        ]


def rows_seen_and_in_view(found: Detection, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Find the rows of a board with corners, and those whose place is well inside the image.

    Args:
        found: an AprilGrid or a ChArUco board.
        shape: (height, width, ...) of the image.

    Returns:
        (2, rows) both masks, from the row of the first number; rows of inner corners for ChArUco.
    """
    target = found.target
    assert isinstance(target, AprilGrid | CharucoBoard)
    if isinstance(target, AprilGrid):
        rows, margin_m = target.rows, target.spacing * target.tag_m
    else:
        rows, margin_m = target.rows - 1, _MARGIN_SQUARES * target.square_m
    known = np.isfinite(found.corners_px).all(axis=1)
    transform = fit_homography(target.corners_m[known], found.corners_px[known])
    if transform is None:
        in_view = known
    else:
        around_m = target.corners_m[:, None] + margin_m * _SIDES
        places = cv2.perspectiveTransform(around_m, transform)
        in_view = ((places > 0.0) & (places < (shape[1] - 1.0, shape[0] - 1.0))).all(axis=(1, 2))
    return np.stack([known.reshape(rows, -1).any(axis=1), in_view.reshape(rows, -1).all(axis=1)])


def _with_rows(target: PlanarTarget, count: int) -> PlanarTarget | None:
    """The board whose corners are in the first rows; None if there is none of that layout."""
    if isinstance(target, AprilGrid):
        return replace(target, rows=count)
    assert isinstance(target, CharucoBoard)
    dark = upper_left_is_dark(target)
    if not dark and count % 2 == 0:
        return None
    try:
        return replace(target, rows=count + 1, legacy=not dark)
    except ConfigurationError:  # too few rows
        return None


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
_MAX_NAMED_TARGETS: Final = 5
"""Most targets that a hint names (chosen: completeness against length)."""
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
            there += _grids(image, target, camera) or _single_border(image, camera)
    there = list(dict.fromkeys(there))
    if not there:
        return ""
    more = f" and {len(there) - _MAX_NAMED_TARGETS} more" if len(there) > _MAX_NAMED_TARGETS else ""
    verb = "is" if len(there) == 1 else "are"
    return f"{', '.join(there[:_MAX_NAMED_TARGETS])}{more} {verb} there"


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
            other = _without_unseen_rows(found, image)
            size = "" if target is None else f"{1000 * target.tag_m:g}"
            name = f"aprilgrid:{other.columns}x{other.rows}:{size or 'TAG'}:{other.spacing:g}"
            return [f"{name} (tags, and their gap by their edge)"]
    return []


def _without_unseen_rows(found: Detection, image: NDArray[np.uint8]) -> Any:
    """The target found, or the board of fewer rows that fits the image better."""
    check = UnseenRowCheck()
    check.add(found, image.shape)
    return check.fitting_boards().get(found.target, found.target)


def _single_border(image: NDArray[np.uint8], camera: Camera | None) -> list[str]:
    """Tags as the AprilTag library prints them, or of another family."""
    found = _tags(image, families_in(image), camera)
    return [f"{each} (a single tag, its border one bit wide)" for each in found[:1]]


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
        there, in_view = rows_seen_and_in_view(found, image.shape)
        if not in_view[: np.flatnonzero(there)[0]].any():  # else its ids begin later
            return [str(_without_unseen_rows(found, image))]
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
        self, image: ArrayLike, detections: Iterable[Detection], stated_response: CameraResponse
    ) -> None:
        """Add the edges of an image, read with the stated response, until there are enough."""
        if stated_response == LINEAR and len(self._ratios) < _MAX_EDGES_IN_TOTAL:
            self._ratios += srgb_fit_log_ratios(measurement_channel(image), detections)

    def notes(self) -> list[str]:
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


def srgb_fit_log_ratios(image: NDArray[np.uint8], detections: Iterable[Detection]) -> list[float]:
    """By edge, log ratio of residual squares of "linear" to "srgb"; above 0 if sRGB fits better."""
    ratios = []
    for found in detections:
        corners = found.corners_px[neighbour_pairs(found.target)]
        long = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) >= _LEAST_EDGE_PX
        chosen = corners[long]  # without edges that have a corner of nan
        for start, end in chosen[:: max(len(chosen) // _MAX_EDGES_PER_TARGET, 1)][
            :_MAX_EDGES_PER_TARGET
        ]:
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
    height, width = image.shape
    low = np.maximum(np.floor(np.minimum(start, end) - _STRIP_HALF_WIDTH_PX).astype(int), 0)
    high = np.minimum(
        np.ceil(np.maximum(start, end) + _STRIP_HALF_WIDTH_PX).astype(int) + 1, (width, height)
    )
    if (high - low < 2).any():
        return None
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    along = end - start
    length = float(np.hypot(*along))
    along = along / length
    du, dv = u - start[0], v - start[1]
    share = (du * along[0] + dv * along[1]) / length
    across = dv * along[0] - du * along[1]
    near = (
        (share > _EDGE_END_FRACTION)
        & (share < 1.0 - _EDGE_END_FRACTION)
        & (np.abs(across) <= _STRIP_HALF_WIDTH_PX)
    )
    away, level = across[near], image[v[near], u[near]].astype(float)
    far = np.abs(away) > 0.6 * _STRIP_HALF_WIDTH_PX
    one, two = level[far & (away < 0.0)], level[far & (away > 0.0)]
    if min(len(one), len(two)) < 4:
        return None
    if np.median(one) > np.median(two):
        away = -away
    contrast = abs(float(np.median(one)) - float(np.median(two)))
    if contrast < _LEAST_CONTRAST_GREY or (level >= _CLIPPED_LIGHT_GREY).any():
        return None
    return away, level


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


class Photograph(NamedTuple):
    """An image and the targets found in it."""

    path: Path
    image: NDArray[np.uint8]
    """(height, width) grey levels."""
    detections: list[Detection]


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """Parse targets from texts, see `vergence.vision.parse_target`."""
    if not texts:
        raise ConfigurationError(
            "target: expected at least one, such as --target tag:36h11:5:120 or "
            "--target checkerboard:9x6:24.23, got none"
        )
    return [parse_target(text) for text in dict.fromkeys(texts)]


def target_key(target: PlanarTarget) -> Hashable:
    """Key that is equal for detections of one target: family and number of a tag, else itself."""
    if isinstance(target, AprilTag):
        return target.family, target.id
    return target


def tag_number(target: PlanarTarget) -> int | None:
    """The number of a tag; None for a board."""
    return target.id if isinstance(target, AprilTag) else None


def is_of_target(detection: Detection, target: Target) -> bool:
    """True if a detection is of the target; tags are compared by family and number alone."""
    found = detection.target
    if isinstance(target, TagFamily):
        return isinstance(found, AprilTag) and found.family == target.family
    if isinstance(target, CharucoBoard) and isinstance(found, CharucoBoard):
        return replace(found, legacy=target.legacy) == target  # both layouts are searched for
    return target_key(found) == target_key(target)


_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel counts as clipped (chosen: just below 255, the largest)."""
_MAX_CLIPPED_FRACTION: Final = 0.15
"""Fraction of clipped pixels around a target above which its white is clipped (chosen: missed
against false remarks)."""


def is_white_clipped(image: NDArray[np.uint8], detection: Detection) -> bool:
    """True if the white of a target is clipped."""
    corners = detection.corners_px[np.isfinite(detection.corners_px).all(axis=1)]
    u0, v0 = np.maximum(corners.min(axis=0).astype(int), 0)
    u1, v1 = corners.max(axis=0).astype(int) + 1
    return bool((image[v0:v1, u0:u1] >= _CLIPPED_GREY).mean() > _MAX_CLIPPED_FRACTION)


class PhotographNotes:
    """Keeps track of targets and rows that no image has shown, and of images with clipped white."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._unseen = list(targets)
        self._asked = len(self._unseen)
        self._images = self._clipped = 0
        self._rows = UnseenRowCheck()

    def add(self, photograph: Photograph) -> None:
        """Add an image."""
        self._images += 1
        found = photograph.detections
        self._unseen = [t for t in self._unseen if not any(is_of_target(d, t) for d in found)]
        self._clipped += any(is_white_clipped(photograph.image, each) for each in found)
        for each in found:
            self._rows.add(each, photograph.image.shape)

    def notes(self) -> list[str]:
        """One line per target or last row in no image although others are, one on clipped white."""
        if len(self._unseen) == self._asked:
            return []  # callers report themselves that nothing was found
        images = f"{self._images} image{'' if self._images == 1 else 's'}"
        said = [f"{target}: found in 0 of {images}" for target in self._unseen]
        said += self._rows.notes()
        if self._clipped:
            said.append(
                f"white is clipped in {self._clipped} of {images}: its pixels count for nothing, "
                "and corners of tags are less sure; expose less"
            )
        return said


class TargetFinder:
    """Finds all targets in images of one eye, each tag for the first that it matches."""

    def __init__(
        self,
        targets: Sequence[Target],
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        self.targets = targets
        self.camera = camera
        self.response_check = LinearResponseCheck()
        self._detectors = [make_detector(target, camera, response) for target in targets]

    def find(self, image: ArrayLike) -> list[Detection]:
        """Find all targets, in the order of `targets`, tags sorted by their numbers."""
        found: list[Detection] = []
        for detector in self._detectors:
            known = {target_key(one.target) for one in found}
            new = [d for d in detector.detect_all(image) if target_key(d.target) not in known]
            self.response_check.add(image, new, detector.response_of(image))
            found += sorted(new, key=lambda one: tag_number(one.target) or 0)
        return found

    def find_in_file(self, path: Path) -> Photograph:
        """Read an image and find all targets in it."""
        pixels = read_pixels(path)
        try:
            return Photograph(path, as_grey(pixels), self.find(pixels))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error


_SEARCH_INTERVAL_IMAGES: Final = 15
"""Images between searches for new tags of a family, and for which a lost tag is searched for
(chosen: new tags found early against time)."""


class LiveFinder(Protocol):
    """Finds targets in a sequence of images."""

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
        """Find the targets in the next image."""


def make_live_finders(
    targets: Sequence[Target],
    camera: Camera | None = None,
    response: CameraResponse | None = None,
) -> list[LiveFinder]:
    """Make a finder for each target in live images."""
    return [_finder(make_detector(target, camera, response)) for target in targets]


def _finder(detector: Detector[Any]) -> LiveFinder:
    if isinstance(detector.target, TagFamily):
        return FamilyTracker(detector)
    tracker = Tracker(detector)

    def find(image: NDArray[np.uint8]) -> Sequence[Detection]:
        found = tracker.find(image)
        return [] if found is None else [found]

    return find


class _Track(NamedTuple):
    last: Detection
    motion_px: NDArray[np.float64]
    """(2,) motion of the measured point since the previous image."""


class FamilyTracker:
    """Tracks a family's tags; searches in full every 15th image and for 15 after a loss."""

    def __init__(self, detector: Detector[Any]) -> None:
        self._detector = detector
        self._tracks: list[_Track] = []
        self._awaited: dict[Hashable, int] = {}
        self._images = 0

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
        """Find the tags in the next image; of several with one number, only the first."""
        followed = [self._follow(image, track) for track in self._tracks]
        self._tracks = [track for track in followed if track is not None]
        if self._due(image):
            for new in self._detector.detect_all(image):
                if target_key(new.target) not in self._known():
                    self._tracks.append(_Track(new, np.zeros(2)))
        self._images += 1
        self._awaited.update(dict.fromkeys(self._known(), self._images + _SEARCH_INTERVAL_IMAGES))
        return [track.last for track in self._tracks]

    def _known(self) -> list[Hashable]:
        return [target_key(track.last.target) for track in self._tracks]

    def _due(self, image: NDArray[np.uint8]) -> bool:
        """True if the whole image is to be searched."""
        known = self._known()
        self._awaited = {tag: until for tag, until in self._awaited.items() if until > self._images}
        if self._images % _SEARCH_INTERVAL_IMAGES == 0 or any(
            tag not in known for tag in self._awaited
        ):
            return True
        return not known and self._detector.search(image) is not None

    def _follow(self, image: NDArray[np.uint8], track: _Track) -> _Track | None:
        last, motion = track
        expected = last._replace(
            corners_px=last.corners_px + motion, point_px=last.point_px + motion
        )
        found = self._detector.track(image, expected)
        return None if found is None else _Track(found, found.point_px - last.point_px)


class Sighting(NamedTuple):
    """A target in an image."""

    image: str
    """The image's path as it was given."""
    detection: Detection
    centre_px: FloatArray
    """(2,) its centre; nan where too few corners of a board were found."""
    sigma_px: FloatArray
    """(2,) standard deviation of the centre."""

    def document(self) -> dict[str, Any]:
        """Plain values, pixels; None for values that are nan."""
        return {
            "image": self.image,
            "target": str(self.detection.target),
            "id": tag_number(self.detection.target),
            "centre_px": null_nonfinite_rows(self.centre_px),
            "corners_px": null_nonfinite_rows(self.detection.corners_px),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "corners_sigma_px": null_nonfinite_rows(self.detection.corners_sigma_px),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectResult:
    """Targets found in all images."""

    images: tuple[Path, ...]
    """Images that could be read."""
    sightings: tuple[Sighting, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each: targets that are in no image although others are, clipped
    white, a response that seems wrong."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""

    def rows(self) -> list[dict[str, Any]]:
        """One row per sighting, plain values."""
        return [sighting.document() for sighting in self.sightings]


def detect_in_photographs(
    paths: Sequence[Path],
    finder: TargetFinder,
    progress: Callable[[float], None] | None = None,
    on_photograph: Callable[[Photograph], None] | None = None,
) -> DetectResult:
    """Find targets in photographs."""
    if not paths:
        raise ConfigurationError("expected images or folders of images, got none")
    every = list_photographs(paths)
    read: list[Path] = []
    sightings: list[Sighting] = []
    failures: list[str] = []
    unseen = PhotographNotes(finder.targets)
    for number, path in enumerate(every, 1):
        try:
            photograph = finder.find_in_file(path)
        except VergenceError as error:
            if len(every) == 1:
                raise
            failures.append(str(error))
            continue
        read.append(path)
        unseen.add(photograph)
        sightings += [
            Sighting(str(path), d, *target_centre_px(d, finder.camera))
            for d in photograph.detections
        ]
        if on_photograph is not None:
            on_photograph(photograph)
        if progress is not None:
            progress(number / len(every))
    if not read:
        raise ConfigurationError(
            f"expected images that can be read, got none in {len(every)}; the first: {failures[0]}"
        )
    return DetectResult(
        images=tuple(read),
        sightings=tuple(sightings),
        remarks=(
            *unseen.notes(),
            *finder.response_check.notes(),
            *remark_on_orientation_tags(read),
        ),
        failures=tuple(failures),
    )


def load_camera(
    head: str | None,
    calibration: Path | None,
    eye: str | None,
    *,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
) -> tuple[Camera | None, tuple[str, ...]]:
    """Load the camera that options name, None if none, and phrases on its doubtful values."""
    if head is not None and calibration is not None:
        raise ConfigurationError("camera: expected either --head or --camera, got both")
    for option, given in (("size", size), ("lens", lens)):
        if given is not None and calibration is None:
            raise ConfigurationError(f"{option}: expected --camera beside it, got none")
    if head is not None:
        if eye is None:
            raise ConfigurationError("eye: expected left or right beside --head, got none")
        return Camera.of(load_head(head), EYE_NAMES.index(eye)), ()
    if calibration is None:
        if eye is not None:
            raise ConfigurationError("eye: expected --head or --camera beside it, got neither")
        return None, ()
    if calibration.suffix.lower() == ".toml":
        raise ConfigurationError(
            f"camera: expected a calibration of OpenCV, ROS or kalibr, got {calibration} (a head "
            "file is given as --head, with --eye left or right)"
        )
    both = read_intrinsics([calibration], size=size, lens=lens)
    if eye is None and both.left is not both.right:
        raise ConfigurationError(
            f"eye: expected left or right, as {calibration} is of two cameras, got none"
        )
    return both.right if eye == "right" else both.left, both.guesses


def centre_weights(corners_m: FloatArray, found_mask: NDArray[np.bool_]) -> FloatArray:
    """(n,) weights whose mean is the centre by the affine fit; nan for corners on a line."""
    weights = np.zeros(len(corners_m))
    from_middle = (corners_m - corners_m.mean(axis=0))[found_mask]
    design = np.column_stack([np.ones(len(from_middle)), from_middle / np.ptp(corners_m)])
    if len(from_middle) < 3 or np.linalg.matrix_rank(design, tol=1e-6) < 3:
        return np.full(len(corners_m), np.nan)
    weights[found_mask] = np.linalg.pinv(design)[0]
    return weights


def weighted_sum(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sum of rows; rows with weight 0 are ignored, even if they are nan."""
    used = weights != 0.0
    return np.asarray(np.tensordot(weights[used], values[used], axes=1))


def target_centre_px(detection: Detection, camera: Camera | None) -> tuple[FloatArray, FloatArray]:
    """(2,) pixel of a target's centre, for a board by a homography, and (2,) its sigma; or nan."""
    target = detection.target
    if isinstance(target, AprilTag):
        return detection.point_px, detection.sigma_px
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(detection.corners_px).all(axis=-1))
    weights = centre_weights(target.corners_m, seen)
    nowhere = np.full(2, np.nan)
    if seen.sum() < 4 or not np.isfinite(weights).all():
        return nowhere, nowhere
    corners = detection.corners_px[seen]
    plane = corners if camera is None else camera.rays(corners)
    fitted: Any = cv2.findHomography(target.corners_m[seen], plane)
    homography = fitted[0]
    if homography is None:
        return nowhere, nowhere
    ray = homography @ [*target.corners_m.mean(axis=0), 1.0]
    middle = ray[:2] / ray[2]
    if camera is not None:
        middle = camera.project([[*middle, 1.0]])[0]
    return middle, np.sqrt(weighted_sum(detection.corners_sigma_px**2, weights**2))
