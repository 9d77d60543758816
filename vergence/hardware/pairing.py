"""Pairing of left and right images that were exposed at about the same time.

Two images are a pair if their exposures are at most a tolerance apart. Images arrive in the order
of their exposures, so an image is certainly alone once the other eye has a later one that is not
its partner either. Until then it waits, up to a time limit.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from vergence.envs.reading import Image
from vergence.models.parts import FloatArray
from vergence.vision.detection import BoardDetection, Detection


class SearchedImage(NamedTuple):
    """One eye's image after the detection."""

    exposed_s: float
    """Time of exposure, s of a monotonic clock."""
    ready_s: float
    """Time at which the detection ended, s."""
    pixel: FloatArray
    """(2,) raw pixel of the target; nan if it was not found."""
    detection: BoardDetection | Detection | None = None
    """Detection of the target; None if it was not found."""
    image: Image | None = None
    """The image itself, grey levels."""


class SearchedPair(NamedTuple):
    """A pair of images, or one eye's image alone."""

    left: SearchedImage | None
    right: SearchedImage | None

    @property
    def exposed_s(self) -> float:
        """The mean time of their exposures, s."""
        times = [one.exposed_s for one in self if one is not None]
        return sum(times) / len(times)

    @property
    def ready_s(self) -> float:
        """Time at which the later one was ready, s."""
        return max(one.ready_s for one in self if one is not None)


@dataclass
class PairCounts:
    """Numbers of pairs and of images without a partner."""

    pairs: int = 0
    unpaired_left: int = 0
    unpaired_right: int = 0


class Pairing:
    """Pairs the images of two eyes as they arrive.

    Args:
        tolerance_s: greatest time between the exposures of a pair, s.
        wait_s: longest wait of an image for its partner after it is ready, s.

    Attributes:
        counts: numbers of pairs and lone images so far.
    """

    def __init__(self, tolerance_s: float, wait_s: float) -> None:
        self._tolerance_s = tolerance_s
        self._wait_s = wait_s
        self._waiting: tuple[deque[SearchedImage], deque[SearchedImage]] = (deque(), deque())
        self.counts = PairCounts()

    def clear(self) -> None:
        """Discard the images that wait."""
        for queue in self._waiting:
            queue.clear()

    def add(self, eye: int, image: SearchedImage) -> None:
        """Add an image of an eye, 0 for left; each eye's images come in order of exposure."""
        self._waiting[eye].append(image)

    def next(self, now_s: float) -> SearchedPair | None:
        """The next pair or lone image, in the order of exposure; None while all wait.

        Args:
            now_s: present time, s.
        """
        left, right = self._waiting
        if left and right:
            apart_s = left[0].exposed_s - right[0].exposed_s
            if abs(apart_s) <= self._tolerance_s:
                self.counts.pairs += 1
                return SearchedPair(left.popleft(), right.popleft())
            return self._pop_unpaired(0 if apart_s < 0.0 else 1)
        for eye, queue in enumerate(self._waiting):
            if queue and now_s - queue[0].ready_s > self._wait_s:
                return self._pop_unpaired(eye)
        return None

    def _pop_unpaired(self, eye: int) -> SearchedPair:
        image = self._waiting[eye].popleft()
        if eye == 0:
            self.counts.unpaired_left += 1
            return SearchedPair(image, None)
        self.counts.unpaired_right += 1
        return SearchedPair(None, image)
