"""What a camera sees of targets, image after image: how often, where, how steadily, how fast."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.eval.sight.plain import plain
from vergence.eval.sight.spotting import number_of
from vergence.models.boards import PlanarTarget, TagFamily, Target
from vergence.models.parts import FloatArray
from vergence.vision import Detection, EyeCamera, Tracker, make_detector

WINDOW_S = 3.0
"""Over how many seconds rates and noise are taken."""
SHOWN_EVERY_S = 1.0


class Finder(Protocol):
    """Finds targets in one image after the other."""

    def __call__(self, image: NDArray[np.uint8]) -> Sequence[Detection]:
        """What is in the next image."""


def finders_of(targets: Sequence[Target], camera: EyeCamera | None = None) -> list[Finder]:
    """What finds each target in a live image: tracked from image to image, families searched for.

    Args:
        targets: what to look for.
        camera: the eye; None if unknown.
    """
    return [_finder(target, camera) for target in targets]


def _finder(target: Target, camera: EyeCamera | None) -> Finder:
    detector = make_detector(target, camera)
    if isinstance(target, TagFamily):
        return detector.detect_all
    tracker = Tracker(detector)

    def find(image: NDArray[np.uint8]) -> Sequence[Detection]:
        found = tracker.find(image)
        return [] if found is None else [found]

    return find


class TargetState(NamedTuple):
    """How a target is seen."""

    target: PlanarTarget
    rate: float
    """Share of the images of the window that have it."""
    total_rate: float
    """Share of all images."""
    point_px: FloatArray
    """(2,) mean pixel of its measured point over the window; nan where it was not seen."""
    noise_px: FloatArray
    """(2,) standard deviation over the window; nan for fewer than three sightings."""
    sigma_px: FloatArray
    """(2,) the detector's own, rms over the window."""

    def document(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "target": str(self.target),
            "id": number_of(self.target),
            "detection_rate": self.total_rate,
            "point_px": plain(self.point_px),
            "noise_px": plain(self.noise_px),
            "sigma_px": plain(self.sigma_px),
        }


class LiveState(NamedTuple):
    """How it goes."""

    images: int
    """Since the beginning."""
    seconds: float
    """Since the beginning."""
    frame_rate_hz: float
    """Over the window; nan for fewer than two images."""
    detection_ms: float
    """Median time that detecting took for an image of the window."""
    targets: tuple[TargetState, ...]

    def document(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "images": self.images,
            "seconds": self.seconds,
            "frame_rate_hz": plain(self.frame_rate_hz),
            "detection_ms": plain(self.detection_ms),
            "targets": [target.document() for target in self.targets],
        }


@dataclass(frozen=True, eq=False)
class _Frame:
    time_s: float
    took_s: float
    found: Mapping[PlanarTarget, Detection]


class LiveStatistics:
    """Statistics over the last seconds, and counts since the beginning.

    Args:
        targets: those that are shown from the beginning, found or not.
        window_s: over how many seconds.
    """

    def __init__(self, targets: Iterable[Target] = (), window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        self._frames: deque[_Frame] = deque()
        self._images = 0
        self._begun_s = self._now_s = 0.0
        self._counts: dict[PlanarTarget, int] = {
            target: 0 for target in targets if not isinstance(target, TagFamily)
        }

    def add(self, time_s: float, took_s: float, found: Sequence[Detection]) -> None:
        """Take an image into account.

        Args:
            time_s: when it had been looked at.
            took_s: how long that took.
            found: what is in it.
        """
        if not self._images:
            self._begun_s = time_s - took_s
        self._images += 1
        self._now_s = time_s
        by_target: dict[PlanarTarget, Detection] = {}
        for one in found:  # of several tags of one number the first counts
            by_target.setdefault(one.target, one)
        for target in by_target:
            self._counts[target] = self._counts.get(target, 0) + 1
        self._frames.append(_Frame(time_s, took_s, by_target))
        while self._frames[0].time_s < time_s - self._window_s:
            self._frames.popleft()

    def state(self) -> LiveState:
        """How it goes now."""
        frames = list(self._frames)
        apart = frames[-1].time_s - frames[0].time_s if frames else 0.0
        return LiveState(
            images=self._images,
            seconds=self._now_s - self._begun_s,
            frame_rate_hz=(len(frames) - 1) / apart if apart > 0.0 else np.nan,
            detection_ms=1e3 * float(np.median([f.took_s for f in frames])) if frames else np.nan,
            targets=tuple(self._target(target, frames) for target in self._counts),
        )

    def _target(self, target: PlanarTarget, frames: Sequence[_Frame]) -> TargetState:
        seen = [f.found[target] for f in frames if target in f.found]
        points = np.array([d.point_px for d in seen]).reshape(-1, 2)
        sigma = np.array([d.sigma_px for d in seen]).reshape(-1, 2)
        nothing = np.full(2, np.nan)
        return TargetState(
            target=target,
            rate=len(seen) / len(frames) if frames else 0.0,
            total_rate=self._counts[target] / max(self._images, 1),
            point_px=points.mean(axis=0) if len(seen) else nothing,
            noise_px=points.std(axis=0, ddof=1) if len(seen) > 2 else nothing,
            sigma_px=np.sqrt((sigma**2).mean(axis=0)) if len(seen) else nothing,
        )


def watch(
    images: Iterable[NDArray[np.uint8]],
    finders: Sequence[Finder],
    statistics: LiveStatistics,
    clock: Callable[[], float],
    *,
    seconds: float | None = None,
    show: Callable[[LiveState], None] | None = None,
) -> bool:
    """Look at images until there are no more, or the time is over.

    Args:
        images: grey levels, one after the other.
        finders: what finds the targets.
        statistics: takes up what is found; valid whenever this is interrupted.
        clock: seconds of a steady clock.
        seconds: after which to end; None for never.
        show: called about each second with how it goes.

    Returns:
        Whether the time was over, not the images.

    Raises:
        ConfigurationError: the images have another size than the camera's.
    """
    begun = shown = clock()
    for image in images:
        before = clock()
        found = [one for finder in finders for one in finder(image)]
        now = clock()
        statistics.add(now, now - before, found)
        if show is not None and now - shown >= SHOWN_EVERY_S:
            show(statistics.state())
            shown = now
        if seconds is not None and now - begun >= seconds:
            return True
    return False
