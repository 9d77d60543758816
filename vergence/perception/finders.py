"""What finds targets in live images: each one tracked from image to image, families as well."""

from collections.abc import Hashable, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import TagFamily, Target
from vergence.models.response import Response
from vergence.perception.spotting import identity
from vergence.vision import Detection, Detector, EyeCamera, Tracker, make_detector

_SEARCHED_EVERY: Final = 15
"""Images after which a family is searched for again, and for so many a lost tag is awaited."""


class Finder(Protocol):
    """Finds targets in one image after the other."""

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
        """What is in the next image."""


def finders_of(
    targets: Sequence[Target],
    camera: EyeCamera | None = None,
    response: Response | None = None,
) -> list[Finder]:
    """What finds each target in a live image.

    Args:
        targets: what to look for.
        camera: the eye; None if unknown.
        response: light by grey level; None for the camera's, see `make_detector`.
    """
    return [_finder(make_detector(target, camera, response)) for target in targets]


def _finder(detector: Detector[Any]) -> Finder:
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
    """(2,) since the image before."""


class FamilyTracker:
    """Follows all tags of a family, each where it is expected.

    Searching an image takes many times as long as following. It is done for tags that are lost, as
    long as they may come back soon; else in every 15th image for tags that have come, and by the
    quick ways alone where there is nothing to follow.

    Args:
        detector: of the family.
    """

    def __init__(self, detector: Detector[Any]) -> None:
        self._detector = detector
        self._tracks: list[_Track] = []
        self._awaited: dict[Hashable, int] = {}
        self._images = 0

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
        """The tags of the next image, of several with one number the first."""
        followed = [self._follow(image, track) for track in self._tracks]
        self._tracks = [track for track in followed if track is not None]
        if self._due(image):
            for new in self._detector.detect_all(image):
                if identity(new.target) not in self._known():
                    self._tracks.append(_Track(new, np.zeros(2)))
        self._images += 1
        self._awaited.update(dict.fromkeys(self._known(), self._images + _SEARCHED_EVERY))
        return [track.last for track in self._tracks]

    def _known(self) -> list[Hashable]:
        return [identity(track.last.target) for track in self._tracks]

    def _due(self, image: NDArray[np.uint8]) -> bool:
        """Whether to search the whole image."""
        known = self._known()
        self._awaited = {tag: until for tag, until in self._awaited.items() if until > self._images}
        if self._images % _SEARCHED_EVERY == 0 or any(tag not in known for tag in self._awaited):
            return True
        return not known and self._detector.search(image) is not None

    def _follow(self, image: NDArray[np.uint8], track: _Track) -> _Track | None:
        last, motion = track
        expected = last._replace(
            corners_px=last.corners_px + motion, point_px=last.point_px + motion
        )
        found = self._detector.track(image, expected)
        return None if found is None else _Track(found, found.point_px - last.point_px)
