"""Which image of the left eye and which of the right one were exposed together.

Two images are a pair if their exposures are at most a tolerance apart. Images come in the order of
their exposures, so an image is alone for certain once the other eye has a later one that is no
partner either; until then it waits, at most for a time.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from vergence.envs.reading import Image
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection


class Sight(NamedTuple):
    """One eye's image after it has been looked at."""

    exposed_s: float
    """When it was exposed, s of a steady clock."""
    ready_s: float
    """When the target had been looked for in it, s."""
    pixel: FloatArray
    """(2,) raw pixel of the target; nan where it was not found."""
    detection: Detection | None = None
    """All that was found of it."""
    image: Image | None = None
    """The image itself, grey levels."""


class Sights(NamedTuple):
    """Images that count as one: a pair, or one eye's alone."""

    left: Sight | None
    right: Sight | None

    @property
    def exposed_s(self) -> float:
        """The mean time of their exposures, s."""
        times = [one.exposed_s for one in self if one is not None]
        return sum(times) / len(times)

    @property
    def ready_s(self) -> float:
        """When the later one was ready, s."""
        return max(one.ready_s for one in self if one is not None)


@dataclass
class Counts:
    """How many images came, by what became of them."""

    pairs: int = 0
    alone_left: int = 0
    alone_right: int = 0


class Pairing:
    """Makes pairs of two eyes' images as they come.

    Args:
        tolerance_s: greatest distance of the exposures of a pair, s.
        wait_s: how long an image waits for its partner after it is ready, s.

    Attributes:
        counts: what became of the images so far.
    """

    def __init__(self, tolerance_s: float, wait_s: float) -> None:
        self._tolerance_s = tolerance_s
        self._wait_s = wait_s
        self._waiting: tuple[deque[Sight], deque[Sight]] = (deque(), deque())
        self.counts = Counts()

    def clear(self) -> None:
        """Forget what waits."""
        for queue in self._waiting:
            queue.clear()

    def add(self, eye: int, sight: Sight) -> None:
        """Take an image of an eye, 0 for left; the images of an eye come in their order."""
        self._waiting[eye].append(sight)

    def next(self, now_s: float) -> Sights | None:
        """The next pair or lone image, in the order of exposure; None while all wait.

        Args:
            now_s: the present, s.
        """
        left, right = self._waiting
        if left and right:
            apart_s = left[0].exposed_s - right[0].exposed_s
            if abs(apart_s) <= self._tolerance_s:
                self.counts.pairs += 1
                return Sights(left.popleft(), right.popleft())
            return self._alone(0 if apart_s < 0.0 else 1)
        for eye, queue in enumerate(self._waiting):
            if queue and now_s - queue[0].ready_s > self._wait_s:
                return self._alone(eye)
        return None

    def _alone(self, eye: int) -> Sights:
        sight = self._waiting[eye].popleft()
        if eye == 0:
            self.counts.alone_left += 1
            return Sights(sight, None)
        self.counts.alone_right += 1
        return Sights(None, sight)
