"""Find all targets that are asked for in photographs, and follow them in live images."""

from array import array
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import CameraResponse
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.stereo_files import read_intrinsics
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.perception.notes import LinearResponseCheck, PhotographNotes, target_key
from vergence.perception.photographs import list_photographs
from vergence.vision import BoardDetector, Camera, Tracker, as_grey, make_detector, parse_target
from vergence.vision.detection import BoardDetection
from vergence.vision.image import read_pixels
from vergence.vision.objects.detectors import make_object_detector
from vergence.vision.objects.targets import GazeTarget, ObjectTarget, PlaceTarget, PointTarget
from vergence.vision.pose import Pose
from vergence.vision.targets import AprilTag, PlanarTarget, TagFamily, Target


class Photograph(NamedTuple):
    """An image and the targets found in it."""

    path: Path
    image: NDArray[np.uint8]
    """(height, width) grey levels."""
    detections: list[BoardDetection]


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """Parse targets from texts, see `vergence.vision.parse_target`."""
    if not texts:
        raise ConfigurationError(
            "target: expected at least one, such as --target tag:36h11:5:120 or "
            "--target checkerboard:9x6:24.23, got none"
        )
    return [parse_target(text) for text in dict.fromkeys(texts)]


def tag_number(target: PlanarTarget | ObjectTarget) -> int | None:
    """The number of a tag; None for a board."""
    return target.id if isinstance(target, AprilTag) else None


class TargetFinder:
    """Finds all targets in images of one eye, each tag for the first that it matches."""

    def __init__(
        self,
        targets: Sequence[Target],
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        self.response_check = LinearResponseCheck()
        self._detectors = [make_detector(target, camera, response) for target in targets]

    def find(self, image: NDArray[Any]) -> list[BoardDetection]:
        """Find all targets, in the order of the targets given, tags sorted by their numbers."""
        found: list[BoardDetection] = []
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


class PhotographSearch:
    """Search of photographs, each view of one or of several cameras, for targets."""

    def __init__(
        self,
        targets: Sequence[Target],
        views: Sequence[Sequence[tuple[TargetFinder, Path]]],
        *,
        check_white: bool = True,
    ) -> None:
        self._views = views
        self._notes = PhotographNotes(targets, check_white=check_white)
        self.failures: list[str] = []
        """Images that could not be read, one line each."""

    def search(
        self, progress: Callable[[float], None] | None, *, is_single: bool = False, kind: str = ""
    ) -> Iterator[list[Photograph]]:
        """The photographs of each view, none if one cannot be read: of a single view, an error."""
        for number, view in enumerate(self._views, 1):
            try:
                found = [finder.find_in_file(path) for finder, path in view]
            except VergenceError as error:
                if is_single:
                    raise
                self.failures.append(str(error))
                found = []
            for photograph in found:
                self._notes.add(photograph.image, photograph.detections)
            yield found
            if progress is not None:
                progress(number / len(self._views))
        if len(self.failures) == len(self._views):
            raise ConfigurationError(
                f"expected images that can be read, got none in {len(self._views)}{kind}"
                + "".join(f"; the first: {why}" for why in self.failures[:1])
            )

    def remarks(self, paths: Iterable[Path]) -> tuple[str, ...]:
        """Notes on the images searched, and on the orientation of some files."""
        finders = (finder for view in self._views for finder, _ in view)
        return self._notes.lines(paths, dict.fromkeys(each.response_check for each in finders))


class Sighting(NamedTuple):
    """A target in an image."""

    image: str
    """The image's path as it was given."""
    detection: BoardDetection
    centre_px: FloatArray
    """(2,) its centre; nan where too few corners of a board were found."""
    sigma_px: FloatArray
    """(2,) standard deviation of the centre."""

    def document(self) -> dict[str, Any]:
        """Plain values, pixels; None for values that are nan."""
        target, found = self.detection.target, self.detection
        return {
            "image": self.image,
            "target": str(target),
            "id": tag_number(target),
            "centre_px": null_nonfinite_rows(self.centre_px),
            "corners_px": null_nonfinite_rows(found.corners_px),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "corners_sigma_px": null_nonfinite_rows(found.corners_sigma_px),
            "pose": None if found.camera is None else pose_document(found.pose, target.size_known),
        }


def pose_document(pose: Pose | None, size_known: bool = True) -> dict[str, Any] | None:
    """Plain values, millimetres and radians; lengths are None if they hold only up to a factor."""
    if pose is None:
        return None
    unit = np.array([1e3 if size_known else np.nan] * 3 + [1.0] * 3)
    sigma = null_nonfinite_elements(unit * pose.sigma)
    return {
        "translation_mm": null_nonfinite_rows(unit[:3] * pose.matrix[:3, 3]),
        "rotation_vector_rad": pose.rotation_vector.tolist(),
        "rotation_matrix": pose.matrix[:3, :3].tolist(),
        "sigma_mm": sigma[:3] if size_known else None,
        "sigma_rad": sigma[3:],
        "covariance_mm_rad": null_nonfinite_elements(unit * pose.covariance * unit[:, None]),
        "chi_square": pose.chi_square,
        "degrees_of_freedom": pose.degrees,
        "contradicted": pose.contradicted,
        "size_ratio": pose.size_ratio,
        "other": pose_document(pose.other, size_known),
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectResult:
    """Targets found in all images."""

    images: tuple[Path, ...]
    """Images that could be read."""
    sightings: tuple[Sighting, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each, see `PhotographNotes`."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""


def detect_in_photographs(
    paths: Sequence[Path],
    targets: Sequence[Target],
    camera: Camera | None = None,
    response: CameraResponse | None = None,
    progress: Callable[[float], None] | None = None,
    on_photograph: Callable[[Photograph], None] | None = None,
) -> DetectResult:
    """Find targets in photographs."""
    if not paths:
        raise ConfigurationError("expected images or folders of images, got none")
    finder = TargetFinder(targets, camera, response)
    views = [[(finder, path)] for path in list_photographs(paths)]
    search = PhotographSearch(targets, views)
    read: list[Path] = []
    sightings: list[Sighting] = []
    for view in search.search(progress, is_single=len(views) == 1):
        for photograph in view:
            path, _, found = photograph
            read.append(path)
            sightings += [Sighting(str(path), d, *target_centre_px(d, camera)) for d in found]
            if on_photograph is not None:
                on_photograph(photograph)
    return DetectResult(
        images=tuple(read),
        sightings=tuple(sightings),
        remarks=search.remarks(read),
        failures=tuple(search.failures),
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


def target_centre_px(
    detection: BoardDetection, camera: Camera | None
) -> tuple[FloatArray, FloatArray]:
    """(2,) pixel of a target's centre, for a board by a homography, and (2,) its sigma; or nan."""
    target = detection.target
    if isinstance(target, AprilTag):
        return detection.point_px, detection.sigma_px
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(detection.corners_px).all(axis=-1))
    weights = centre_weights(target.corners_m, seen)
    homography: Any = None
    if seen.sum() >= 4 and np.isfinite(weights).all():
        corners = detection.corners_px[seen]
        plane = corners if camera is None else camera.rays(corners)
        homography = cv2.findHomography(target.corners_m[seen], plane)[0]
    if homography is None:
        return np.full(2, np.nan), np.full(2, np.nan)
    ray = homography @ [*target.corners_m.mean(axis=0), 1.0]
    middle = ray[:2] / ray[2]
    if camera is not None:
        middle = camera.project([[*middle, 1.0]])[0]
    return middle, np.sqrt(weighted_sum(detection.corners_sigma_px**2, weights**2))


WINDOW_S: Final = 3.0
"""Time window of rates and noise, s (chosen: steady values against fast changes)."""
_UPDATE_INTERVAL_S: Final = 1.0
"""Interval between reports, s (chosen: up to date against readable)."""
_SEARCH_INTERVAL_IMAGES: Final = 15
"""Images between searches for new tags of a family, and for which a lost tag is searched for
(chosen: new tags found early against time)."""


class SeenObject(NamedTuple):
    """An object in an image, in the form of a `BoardDetection`."""

    target: ObjectTarget
    point_px: FloatArray
    sigma_px: FloatArray


LiveFinder = Callable[[NDArray[np.uint8]], Sequence[BoardDetection | SeenObject]]
"""Finds targets in the next image of a sequence."""


def make_live_finder(
    target: GazeTarget, camera: Camera | None = None, response: CameraResponse | None = None
) -> LiveFinder:
    """Make a finder for a target in live images."""
    if not isinstance(target, PlanarTarget | TagFamily):
        return ObjectFinder(target, camera)
    detector = make_detector(target, camera, response)
    if isinstance(target, TagFamily):
        return FamilyTracker(detector)
    tracker = Tracker(detector)
    return lambda image: [found] if (found := tracker.find(image)) is not None else []


class ObjectFinder:
    """Finds the best candidate for an object in each image."""

    def __init__(self, target: ObjectTarget, camera: Camera | None) -> None:
        if isinstance(target, PointTarget | PlaceTarget):
            raise ConfigurationError(
                f"target: expected one that a single image shows, got {target}"
            )
        self._target, self._camera = target, camera
        self._detector: Any = None

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[SeenObject]:
        """Find it; the camera of unknown intrinsics has a field of view of 53 degrees."""
        height, width = image.shape[:2]
        if self._detector is None:
            matrix = [[width, 0, 0.5 * width], [0, width, 0.5 * height], [0, 0, 1]]
            camera = self._camera or Camera(size=(width, height), matrix=np.array(matrix, float))
            self._detector = make_object_detector(self._target, camera)
        colours = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        found = max(self._detector.detect(colours, None), key=lambda one: one.score, default=None)
        return [] if found is None else [SeenObject(self._target, found.pixel, found.sigma_px)]


class FamilyTracker:
    """Tracks a family's tags; searches in full every 15th image and for 15 after a loss."""

    def __init__(self, detector: BoardDetector[Any]) -> None:
        self._detector = detector
        self._tracks: list[tuple[BoardDetection, FloatArray]] = []
        """Last detection of each tag, and its (2,) motion since the previous image, px."""
        self._awaited: dict[Hashable, int] = {}
        self._images = 0

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[BoardDetection]:
        """Find the tags in the next image; of several with one number, only the first."""
        tracks, self._tracks = self._tracks, []
        for last, motion in tracks:
            corners, point = last.corners_px + motion, last.point_px + motion
            found = self._detector.track(image, last._replace(corners_px=corners, point_px=point))
            if found is not None:
                self._tracks.append((found, found.point_px - last.point_px))
        if self._is_search_due(image):
            for new in self._detector.detect_all(image):
                if target_key(new.target) not in self._known():
                    self._tracks.append((new, np.zeros(2)))
        self._images += 1
        self._awaited.update(dict.fromkeys(self._known(), self._images + _SEARCH_INTERVAL_IMAGES))
        return [last for last, _ in self._tracks]

    def _known(self) -> list[Hashable]:
        return [target_key(last.target) for last, _ in self._tracks]

    def _is_search_due(self, image: NDArray[np.uint8]) -> bool:
        awaited = {tag for tag, until in self._awaited.items() if until > self._images}
        if self._images % _SEARCH_INTERVAL_IMAGES == 0 or not awaited <= {*self._known()}:
            return True
        return not self._tracks and self._detector.search(image) is not None


@dataclass
class TargetStatistics:
    """Running statistics of a target's pixels over the window or the whole run, by Welford."""

    target: PlanarTarget | ObjectTarget
    images: int = 0
    """Number of all images."""
    images_with_target: int = 0
    """Number of images with the target."""
    _mean: FloatArray = field(default_factory=lambda: np.zeros(2))
    _squares: FloatArray = field(default_factory=lambda: np.zeros(2))
    _variance: FloatArray = field(default_factory=lambda: np.zeros(2))

    def add(self, found: BoardDetection | SeenObject) -> None:
        """Add an image with the target."""
        self.images_with_target = seen = self.images_with_target + 1
        before = found.point_px - self._mean
        self._mean = self._mean + before / seen
        self._squares = self._squares + before * (found.point_px - self._mean)
        self._variance = self._variance + (found.sigma_px**2 - self._variance) / seen

    @property
    def point_px(self) -> FloatArray:
        """(2,) mean pixel of its measured point; nan if it was never detected."""
        return self._mean if self.images_with_target else np.full(2, np.nan)

    @property
    def noise_px(self) -> FloatArray:
        """(2,) standard deviation of that pixel; nan for fewer than three detections."""
        seen = self.images_with_target
        return np.sqrt(self._squares / (seen - 1)) if seen > 2 else np.full(2, np.nan)

    @property
    def sigma_px(self) -> FloatArray:
        """(2,) standard deviation that the detector states, rms; nan if it was never detected."""
        return np.sqrt(self._variance) if self.images_with_target else np.full(2, np.nan)

    @property
    def rate(self) -> float:
        """Fraction of the images with the target."""
        return self.images_with_target / self.images if self.images else 0.0

    def document(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "target": str(self.target),
            "id": tag_number(self.target),
            "detection_rate": self.rate,
            "images_without": self.images - self.images_with_target,
            "point_px": null_nonfinite_rows(self.point_px),
            "noise_px": null_nonfinite_rows(self.noise_px),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
        }


class LiveSummary(NamedTuple):
    """Statistics over the window or the whole run."""

    images: int
    """Images since the start."""
    seconds: float
    """Time since the start, s."""
    frame_rate_hz: float
    """Frame rate; nan for fewer than two images."""
    detection_ms: float
    """Median time of detection per image."""
    targets: tuple[TargetStatistics, ...]

    def document(self) -> dict[str, Any]:
        """Plain values."""
        return self._asdict() | {
            "frame_rate_hz": null_nonfinite_rows(self.frame_rate_hz),
            "detection_ms": null_nonfinite_rows(self.detection_ms),
            "targets": [target.document() for target in self.targets],
        }


_Seen = Mapping[PlanarTarget | ObjectTarget, BoardDetection | SeenObject]


class LiveStatistics:
    """Statistics over a sliding window, s, and over the whole run."""

    def __init__(self, targets: Iterable[GazeTarget] = (), window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        self._frames: deque[tuple[float, float, _Seen]] = deque()
        """Time, s, duration, s, and detections of each image of the window."""
        self._begun_s = self._first_s = self._now_s = 0.0
        self._took_s = array("d")
        self._of_run = {
            target: TargetStatistics(target)
            for target in targets
            if not isinstance(target, TagFamily)
        }

    def add(
        self, time_s: float, detection_s: float, detections: Sequence[BoardDetection | SeenObject]
    ) -> None:
        """Add the detections of an image, with the time at which they ended and their duration."""
        if not self._took_s:
            self._begun_s, self._first_s = time_s - detection_s, time_s
        self._now_s = time_s
        self._took_s.append(detection_s)
        by_target: dict[PlanarTarget | ObjectTarget, BoardDetection | SeenObject] = {}
        for one in detections:  # of several tags with one number, only the first counts
            by_target.setdefault(one.target, one)
        for target, one in by_target.items():
            self._of_run.setdefault(target, TargetStatistics(target)).add(one)
        self._frames.append((time_s, detection_s, by_target))
        while self._frames[0][0] < time_s - self._window_s:
            self._frames.popleft()

    def window_summary(self) -> LiveSummary:
        """Current statistics: images and seconds since the start, the rest over the window."""
        of_window = {target: TargetStatistics(target) for target in self._of_run}
        for _, _, by_target in self._frames:
            for target, one in by_target.items():
                of_window[target].add(one)
        apart_s = self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0
        return self._summary(of_window, [took_s for _, took_s, _ in self._frames], apart_s)

    def run_summary(self) -> LiveSummary:
        """Statistics since the start."""
        return self._summary(self._of_run, self._took_s, self._now_s - self._first_s)

    def _summary(
        self,
        by_target: Mapping[PlanarTarget | ObjectTarget, TargetStatistics],
        took_s: Sequence[float],
        apart_s: float,
    ) -> LiveSummary:
        count = len(took_s)
        return LiveSummary(
            images=len(self._took_s),
            seconds=self._now_s - self._begun_s,
            frame_rate_hz=(count - 1) / apart_s if apart_s > 0.0 else np.nan,
            detection_ms=1e3 * float(np.median(took_s)) if count else np.nan,
            targets=tuple(replace(each, images=count) for each in by_target.values()),
        )


def watch_targets(
    images: Iterable[NDArray[np.uint8]],
    finders: Sequence[LiveFinder],
    statistics: LiveStatistics,
    clock: Callable[[], float],
    *,
    time_limit_s: float | None = None,
    on_update: Callable[[LiveSummary], None] | None = None,
) -> bool:
    """Find targets until no image or time is left; True if it is the time. Updates each second."""
    begun = shown = clock()
    for image in images:
        before = clock()
        found = [one for finder in finders for one in finder(image)]
        now = clock()
        statistics.add(now, now - before, found)
        if on_update is not None and now - shown >= _UPDATE_INTERVAL_S:
            on_update(statistics.window_summary())
            shown = now
        if time_limit_s is not None and now - begun >= time_limit_s:
            return True
    return False
