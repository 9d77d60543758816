"""Search for an image point that was named in one eye, in both eyes' images.

The eye in which the point was named is its origin; the other eye's point is matched from it. What
both eyes see must lie in one plane with the baseline, else the other eye's point is dropped and
matched anew. An eye that has lost the point is searched where the other one sees it.
"""

import threading
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import PointRefusedError
from vergence.models.camera import Camera
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.vision.detection import Detection, as_pixel
from vergence.vision.objects.matching import match_point
from vergence.vision.objects.patches import PointTracker, TrackedPoint
from vergence.vision.objects.targets import PointTarget

_PAIR_S: Final = 0.05
"""Greatest time between two images in which a point is matched, s (chosen: cameras that are not in
step)."""
_AGREE_PX: Final = 3.0
"""Largest distance of both eyes' points from a common place, px, besides three standard deviations
(chosen: errors of encoders, and of eyes that are not in step)."""
_REMEMBERED_S: Final = 1.0
"""Time for which the distance of a point is remembered, s (chosen: objects that move)."""


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


class _Sight(NamedTuple):
    """A point in an eye's image."""

    seen: SeenImage
    point: TrackedPoint

    def ray(self, camera: Camera) -> FloatArray:
        """Unit vector to the point in frame 0."""
        ray = self.seen.T_0_C[:3, :3] @ np.append(camera.rays(self.point.pixel[None])[0], 1.0)
        return np.asarray(ray / np.linalg.norm(ray))


class PointSeed:
    """The point that both eyes follow: where it was named, and where each eye saw it last.

    Attributes:
        generation: number of points that have been named; what belongs to an earlier one is void.
        named: the eye and pixel that wait for the eye's next image.
        origin: the eye that the point was named in, once it is followed there.
        sights: where each eye sees the point, None if it does not.
        place: where both eyes saw it last in frame 0, m, and when.
    """

    def __init__(self, cameras: Sequence[Camera], target: PointTarget) -> None:
        self.cameras, self.lock, self.generation = cameras, threading.RLock(), 0
        self._target = target
        self.forget()

    def forget(self) -> None:
        """Start again from the pixel that the target names."""
        target = self._target
        with self.lock:
            self.clicked = False
            if target.eye is not None and target.pixel is not None:
                self._name(target.eye, np.array(target.pixel))
            else:
                self._name(None, None)

    def click(self, eye: int, pixel: ArrayLike) -> None:
        """Follow another point from the eye's next image on; both eyes drop the present one."""
        place = as_pixel("pixel", pixel)
        with self.lock:
            self.clicked = True
            self._name(eye, place)

    def _name(self, eye: int | None, pixel: FloatArray | None) -> None:
        self.generation += 1
        self.named = None if eye is None or pixel is None else (eye, pixel)
        self.origin: int | None = None
        self.sights: list[_Sight | None] = [None, None]
        self.place: tuple[FloatArray, float] | None = None
        self.refusal = ""


class PointSearch:
    """Search for an image point that was named in one of the eyes."""

    def __init__(self, eye: int, seed: PointSeed) -> None:
        self._eye, self._seed = eye, seed
        self._camera = seed.cameras[eye]
        self._tracker = PointTracker(self._camera)
        self._found: Found | None = None
        self._generation, self._begun = -1, False

    def forget(self) -> None:
        """See `EyeSearch.forget`."""
        self._found = None
        self._seed.forget()

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        """See `EyeSearch.look`."""
        seed, seen = self._seed, SeenImage(np.asarray(image), T_0_C, time_s)
        with seed.lock:
            generation, named, place = seed.generation, seed.named, seed.place
            other, origin = seed.sights[1 - self._eye], seed.origin
            if named is not None and named[0] == self._eye:
                seed.named, seed.origin, origin = None, self._eye, self._eye
            if place is not None and abs(place[1] - time_s) > _REMEMBERED_S:
                place = None
        if generation != self._generation:
            self._generation, self._begun = generation, False
            self._tracker.forget()
        if other is not None and abs(other.seen.time_s - time_s) > _PAIR_S:
            other = None
        point, refusal = None, None
        try:
            if named is not None and named[0] == self._eye:
                self._tracker.begin(seen.image, named[1], T_0_C)
                self._begun = True
            if origin == self._eye:
                point = self._follow(seen, other, place)
            elif origin is not None:
                point = self._accompany(seen, other, place)
        except PointRefusedError as error:
            if named is not None and not seed.clicked:
                raise
            refusal = str(error) if named is not None else f"{EYE_NAMES[self._eye]} eye: {error}"
        with seed.lock:
            if generation != seed.generation:
                point = None  # another one was clicked meanwhile
            else:
                self._keep(seen, point, refusal)
            detection = None if point is None else Detection(point.pixel, point.sigma_px)
            self._found = Found(detection, time_s)

    def found(self) -> Found | None:
        """See `EyeSearch.found`."""
        found, self._found = self._found, None
        return found

    def _keep(self, seen: SeenImage, point: TrackedPoint | None, refusal: str | None) -> None:
        """Share what this eye sees with the other one; a refused point is followed no longer."""
        seed, eye = self._seed, self._eye
        if refusal is not None and seed.origin == eye and not self._begun:
            seed.origin = None
        seed.sights[eye] = None if point is None else _Sight(seen, point)
        if refusal is not None or (point is not None and eye != seed.origin):
            seed.refusal = refusal or ""
        both = seed.sights[0], seed.sights[1]
        if both[0] is None or both[1] is None:
            return
        if abs(both[0].seen.time_s - both[1].seen.time_s) <= _PAIR_S:
            place = _meeting(both, seed.cameras)
            seed.place = None if place is None else (place, seen.time_s)

    def _follow(
        self, seen: SeenImage, other: _Sight | None, place: tuple[FloatArray, float] | None
    ) -> TrackedPoint | None:
        """Follow the point in the eye that it was named in."""
        if not self._begun:
            return None
        point = self._tracker.find(seen.image, seen.T_0_C, renew=other is not None)
        if point is not None or other is None:
            return point
        matched, _ = self._match(seen, other, place)
        found = self._tracker.find(seen.image, seen.T_0_C, matched.pixel)
        apart = np.inf if found is None else float(np.linalg.norm(found.pixel - matched.pixel))
        return found if apart < _AGREE_PX else None

    def _accompany(
        self, seen: SeenImage, other: _Sight | None, place: tuple[FloatArray, float] | None
    ) -> TrackedPoint | None:
        """Follow the point that the other eye was named, and that is matched from there."""
        tracker = self._tracker
        point = tracker.find(seen.image, seen.T_0_C, renew=False) if self._begun else None
        if other is None:
            return point
        if point is not None:
            apart_px = self._off_line_px(_Sight(seen, point), other)
            if apart_px > _tolerance(point, other):
                point = None
        if point is not None and not tracker.faint:
            return point
        try:
            match, model_sigma_px = self._match(seen, other, place)
        except PointRefusedError:
            if point is not None:
                return point
            self._begun = False
            tracker.forget()
            raise
        tracker.begin(seen.image, match.pixel, seen.T_0_C, checked=False, sigma_px=model_sigma_px)
        self._begun = True
        return match

    def _off_line_px(self, sight: _Sight, other: _Sight) -> float:
        """Distance of this eye's point from the other one's epipolar line."""
        baseline = other.seen.T_0_C[:3, 3] - sight.seen.T_0_C[:3, 3]
        normal = np.cross(baseline, other.ray(self._seed.cameras[1 - self._eye]))
        normal /= np.linalg.norm(normal)
        return abs(float(normal @ sight.ray(self._camera))) * float(self._camera.focal.mean())

    def _match(
        self, seen: SeenImage, other: _Sight, place: tuple[FloatArray, float] | None
    ) -> tuple[TrackedPoint, FloatArray]:
        """Find the point that the other eye sees, at the distance that it had if it rests.

        Noise of this image moves the match, and does not move what is then followed of it: the
        second result is the standard deviation without noise.
        """
        seed, eye = self._seed, self._eye
        pair = (seen, other.seen) if eye == 0 else (other.seen, seen)
        images, poses = [one.image for one in pair], [one.T_0_C for one in pair]
        T_0_other, expected, near_m = other.seen.T_0_C, None, None
        if place is not None:
            pixel = _seen_at(seed.cameras[1 - eye], T_0_other, place[0])
            if np.linalg.norm(pixel - other.point.pixel) <= _tolerance(other.point, other):
                near_m = float(np.linalg.norm(place[0] - T_0_other[:3, 3]))
                expected = _seen_at(
                    self._camera, seen.T_0_C, T_0_other[:3, 3] + near_m * other.ray(
                        seed.cameras[1 - eye])
                )  # fmt: skip
        match = match_point(
            seed.cameras, images, poses, other.point.pixel, 1 - eye, near_depth_m=near_m
        )
        # noise of the other eye's image moves its point and the match, which make up for it
        excess = np.maximum(other.point.sigma_px**2 - match.sigma_px**2, 0.0)
        point = TrackedPoint(match.pixel, np.sqrt(match.sigma_px**2 + excess))
        if expected is not None and not np.linalg.norm(expected - match.pixel) <= _tolerance(
            point, other
        ):
            raise PointRefusedError(
                "pixel: expected the distance that the point had, got another one where it rests"
            )
        return point, np.sqrt(match.model_sigma_px**2 + excess)


def _tolerance(point: TrackedPoint, other: _Sight) -> float:
    """Largest disagreement of two sights of a point, px."""
    sigma_px = np.linalg.norm([np.max(point.sigma_px), np.max(other.point.sigma_px)])
    return _AGREE_PX + 3.0 * float(sigma_px)


def _seen_at(camera: Camera, T_0_C: FloatArray, place: FloatArray) -> FloatArray:
    """Pixel of a place in frame 0, (2,)."""
    return np.asarray(camera.project(((place - T_0_C[:3, 3]) @ T_0_C[:3, :3])[None])[0])


def _meeting(both: Sequence[Any], cameras: Sequence[Camera]) -> FloatArray | None:
    """Place in frame 0 where the rays of both eyes are nearest to each other; None if nowhere."""
    rays = [sight.ray(camera) for sight, camera in zip(both, cameras, strict=True)]
    starts = [sight.seen.T_0_C[:3, 3] for sight in both]
    along = np.linalg.lstsq(
        np.column_stack([rays[0], -rays[1]]), starts[1] - starts[0], rcond=None
    )[0]
    if not (along > 0.0).all():
        return None
    return np.asarray(0.5 * (starts[0] + along[0] * rays[0] + starts[1] + along[1] * rays[1]))
