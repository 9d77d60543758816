"""Find targets in live images: track each target, or each tag of a family, between images."""

from collections.abc import Hashable, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import CameraResponse
from vergence.perception.target_finder import target_key
from vergence.vision import Camera, Detection, Detector, Tracker, make_detector
from vergence.vision.targets import TagFamily, Target

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
