"""Search for an image point that was named in one eye, in both eyes' images."""

import threading
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import PointRefusedError
from vergence.models.camera import Camera
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.vision.detection import Detection, as_pixel
from vergence.vision.objects.patches import PointTracker, match_point
from vergence.vision.objects.targets import PointTarget

_PAIR_S: Final = 0.05
"""Greatest time between two images in which a point is matched, s (chosen: cameras that are not in
step)."""


class Found(NamedTuple):
    """What an eye's images say about the target."""

    detection: Any
    """The detection, see `Detection`; None if the target is not in the image."""
    time_s: float
    """Time of the exposure, s."""


class SeenImage(NamedTuple):
    """An image with its camera's pose and the time of its exposure."""

    image: NDArray[np.uint8]
    T_0_C: FloatArray
    time_s: float


class PointSeed:
    """The point that both eyes follow: where it was named, and where each eye saw it last."""

    def __init__(self, cameras: Sequence[Camera], target: PointTarget) -> None:
        self.cameras, self.lock = cameras, threading.RLock()
        self._target = target
        self.forget()

    def forget(self) -> None:
        """Start again from the pixel that the target names."""
        with self.lock:
            target = self._target
            self.named: tuple[int, FloatArray] | None = None
            if target.eye is not None and target.pixel is not None:
                self.named = target.eye, np.array(target.pixel)
            self.seen: list[tuple[SeenImage, FloatArray] | None] = [None, None]
            self.clicked = False
            self.refusal = ""

    def click(self, eye: int, pixel: ArrayLike) -> None:
        """Follow another point from the eye's next image on."""
        with self.lock:
            self.named, self.clicked = (eye, as_pixel("pixel", pixel)), True


class PointSearch:
    """Search for an image point that was named in one of the eyes."""

    def __init__(self, eye: int, seed: PointSeed) -> None:
        self._eye, self._seed = eye, seed
        self._tracker = PointTracker(seed.cameras[eye])
        self._found: Found | None = None
        self._following = False

    def forget(self) -> None:
        """See `EyeSearch.forget`."""
        self._tracker.forget()
        self._following, self._found = False, None
        self._seed.forget()

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        """See `EyeSearch.look`."""
        seed, seen = self._seed, SeenImage(np.asarray(image), T_0_C, time_s)
        with seed.lock:
            if seed.named is not None and seed.named[0] == self._eye:
                self._begin_at(seen, seed.named[1])
            elif seed.named is not None:
                self._following = False  # until the other eye has begun
            point: Any = self._tracker.find(seen.image, T_0_C) if self._following else None
            if point is None:
                point = self._match(seen)
            seed.seen[self._eye] = None if point is None else (seen, point[0])
            detection = None if point is None else Detection(point[0], point[1])
            self._found = Found(detection, time_s)

    def found(self) -> Found | None:
        """See `EyeSearch.found`."""
        found, self._found = self._found, None
        return found

    def _begin_at(self, seen: SeenImage, pixel: FloatArray) -> None:
        """Follow the point that was named in this eye; a refused click is told, not raised."""
        seed = self._seed
        seed.named = None
        try:
            self._tracker.begin(seen.image, pixel, seen.T_0_C)
        except PointRefusedError as error:
            seed.refusal = str(error)
            if not seed.clicked:
                raise
            return
        seed.refusal, seed.seen, self._following = "", [None, None], True

    def _match(self, seen: SeenImage) -> tuple[FloatArray, FloatArray] | None:
        """Find the point that the other eye follows in this eye's image, and follow it there."""
        seed, other = self._seed, self._seed.seen[1 - self._eye]
        if other is None or abs(other[0].time_s - seen.time_s) > _PAIR_S:
            return None
        pair = (seen, other[0]) if self._eye == 0 else (other[0], seen)
        images, poses = [one.image for one in pair], [one.T_0_C for one in pair]
        try:
            match = match_point(seed.cameras, images, poses, other[1], 1 - self._eye)
            self._tracker.begin(seen.image, match.pixel, seen.T_0_C)
        except PointRefusedError as error:
            seed.refusal = f"{EYE_NAMES[self._eye]} eye: {error}"
            return None
        seed.refusal, self._following = "", True
        return match.pixel, match.sigma_px
