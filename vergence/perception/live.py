"""Targets in live images: found, followed, and their detection rate, position and noise."""

from array import array
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import CameraResponse
from vergence.models.parts import FloatArray
from vergence.operands import null_nonfinite_rows
from vergence.perception.finding import tag_number
from vergence.perception.notes import target_key
from vergence.vision import Camera, Detector, Tracker, make_detector
from vergence.vision.detection import Detection
from vergence.vision.targets import PlanarTarget, TagFamily, Target

WINDOW_S: Final = 3.0
"""Time window of rates and noise, s (chosen: steady values against fast changes)."""
UPDATE_INTERVAL_S: Final = 1.0
"""Interval between reports, s (chosen: up to date against readable)."""


_SEARCH_INTERVAL_IMAGES: Final = 15
"""Images between searches for new tags of a family, and for which a lost tag is searched for
(chosen: new tags found early against time)."""


LiveFinder = Callable[[NDArray[np.uint8]], Sequence[Detection]]
"""Finds targets in the next image of a sequence."""


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
    return lambda image: [found] if (found := tracker.find(image)) is not None else []


class FamilyTracker:
    """Tracks a family's tags; searches in full every 15th image and for 15 after a loss."""

    def __init__(self, detector: Detector[Any]) -> None:
        self._detector = detector
        self._tracks: list[tuple[Detection, FloatArray]] = []
        """Last detection of each tag, and its (2,) motion since the previous image, px."""
        self._awaited: dict[Hashable, int] = {}
        self._images = 0

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
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
        self._awaited = {tag: until for tag, until in self._awaited.items() if until > self._images}
        if self._images % _SEARCH_INTERVAL_IMAGES == 0 or not self._awaited.keys() <= {
            *self._known()
        }:
            return True
        return not self._tracks and self._detector.search(image) is not None


class TargetStatistics(NamedTuple):
    """Statistics of a target over the window or the whole run."""

    target: PlanarTarget
    images_with_target: int
    """Number of images with the target."""
    images: int
    """Number of all images."""
    point_px: FloatArray
    """(2,) mean pixel of its measured point; nan if it was never detected."""
    noise_px: FloatArray
    """(2,) standard deviation of that pixel; nan for fewer than three detections."""
    sigma_px: FloatArray
    """(2,) standard deviation that the detector states, rms."""

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


class _Frame(NamedTuple):
    time_s: float
    took_s: float
    found: Mapping[PlanarTarget, Detection]


class _Sums:
    """Running mean and variance of a target's pixels (Welford's recurrences)."""

    def __init__(self) -> None:
        self.seen = 0
        self._mean = np.zeros(2)
        self._squares = np.zeros(2)
        self._variance = np.zeros(2)

    def add(self, found: Detection) -> None:
        self.seen += 1
        before = found.point_px - self._mean
        self._mean = self._mean + before / self.seen
        self._squares = self._squares + before * (found.point_px - self._mean)
        self._variance = self._variance + (found.sigma_px**2 - self._variance) / self.seen

    def state(self, target: PlanarTarget, images: int) -> TargetStatistics:
        nothing, seen = np.full(2, np.nan), self.seen
        return TargetStatistics(
            target=target,
            images_with_target=seen,
            images=images,
            point_px=self._mean if seen else nothing,
            noise_px=np.sqrt(self._squares / (seen - 1)) if seen > 2 else nothing,
            sigma_px=np.sqrt(self._variance) if seen else nothing,
        )


class LiveStatistics:
    """Statistics over a sliding window, s, and over the whole run."""

    def __init__(self, targets: Iterable[Target] = (), window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        self._frames: deque[_Frame] = deque()
        self._begun_s = self._first_s = self._now_s = 0.0
        self._took_s = array("d")
        self._sums: dict[PlanarTarget, _Sums] = {
            target: _Sums() for target in targets if not isinstance(target, TagFamily)
        }

    def add(self, time_s: float, detection_s: float, detections: Sequence[Detection]) -> None:
        """Add the detections of an image, with the time at which they ended and their duration."""
        if not self._took_s:
            self._begun_s, self._first_s = time_s - detection_s, time_s
        self._now_s = time_s
        self._took_s.append(detection_s)
        by_target: dict[PlanarTarget, Detection] = {}
        for one in detections:  # of several tags with one number, only the first counts
            by_target.setdefault(one.target, one)
        for target, one in by_target.items():
            self._sums.setdefault(target, _Sums()).add(one)
        self._frames.append(_Frame(time_s, detection_s, by_target))
        while self._frames[0].time_s < time_s - self._window_s:
            self._frames.popleft()

    def window_summary(self) -> LiveSummary:
        """Current statistics: images and seconds since the start, the rest over the window."""
        frames = list(self._frames)
        apart = frames[-1].time_s - frames[0].time_s if frames else 0.0
        sums = {target: _Sums() for target in self._sums}
        for frame in frames:
            for target, one in frame.found.items():
                sums[target].add(one)
        return self._state(sums, [frame.took_s for frame in frames], apart)

    def run_summary(self) -> LiveSummary:
        """Statistics since the start."""
        return self._state(self._sums, self._took_s, self._now_s - self._first_s)

    def _state(
        self, sums: Mapping[PlanarTarget, _Sums], took_s: Sequence[float], apart_s: float
    ) -> LiveSummary:
        count = len(took_s)
        return LiveSummary(
            images=len(self._took_s),
            seconds=self._now_s - self._begun_s,
            frame_rate_hz=(count - 1) / apart_s if apart_s > 0.0 else np.nan,
            detection_ms=1e3 * float(np.median(took_s)) if count else np.nan,
            targets=tuple(each.state(target, count) for target, each in sums.items()),
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
        if on_update is not None and now - shown >= UPDATE_INTERVAL_S:
            on_update(statistics.window_summary())
            shown = now
        if time_limit_s is not None and now - begun >= time_limit_s:
            return True
    return False
