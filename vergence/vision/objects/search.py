"""Search of one eye's images for any target: one interface for printed targets and for objects.

A detector works in a thread of its own, a user's in a process of its own. What it finds belongs to
the exposure of its image; from there the target is carried to the present image by tracking, and
from image to image until the detector answers again. Where tracking does not see it, the target is
taken to rest: images say where it was seen last, by the joints' angles, until the next answer. A
law that was given old exposures instead would turn by them after it has turned already.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError, PointRefusedError
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.vision.detection import Detection
from vergence.vision.objects.detectors import make_object_detector
from vergence.vision.objects.identity import Identity
from vergence.vision.objects.patches import PointTracker
from vergence.vision.objects.points import PointSearch, PointSeed
from vergence.vision.objects.sights import (
    EyeSearch,
    Found,
    SeenImage,
    SharedSearch,
    line_of_sight,
    pixel_of,
)
from vergence.vision.objects.targets import (
    ColourTarget,
    FaceTarget,
    GazeTarget,
    ObjectTarget,
    OwnTarget,
    PlaceTarget,
    PointTarget,
)
from vergence.vision.objects.worker import WorkerDetector
from vergence.vision.tracking import Tracker, make_detector

_WAIT_FRAMES: Final = 0.5
"""Longest wait of an image for a quick detector's answer, frames (chosen: no delay by a slow
one)."""
_ANSWER_S: Final = 10.0
"""Longest time that a detector may take for an image, s (chosen: it hangs)."""
_CARRIED_HALF: Final = 0.55
"""Half width of what is tracked, in sizes of the object (chosen: its outline counts, little beside
it)."""
_INSIDE: Final = 0.4
"""Radius of what is certainly the object, in its sizes (chosen)."""
_AROUND: Final = (0.6, 1.0)
"""Radii of what surrounds it, in its sizes (chosen)."""
_LEAST_PIXELS: Final = 9
"""Least number of pixels of either for a mixture of colours (chosen: a scatter of three)."""
_LEVEL_NOISE: Final = 6.0
"""Noise of a level against which a mixture's weights are chosen (chosen: webcams' and JPEG's)."""
_SIZES_PX: Final = (24.0, 34.0, 48.0, 68.0, 96.0, 136.0, 192.0)
"""Sizes of which an object that states none has one, px (chosen: from a ball to a face)."""
_SAMPLES: Final = 40.0
"""Samples along an object's size for a mixture of colours (chosen: time)."""
_STEPS: Final = 16
"""Images between a slow detector's and the present one through which its answer is tracked
(chosen: motion from one to the next against time)."""
_MOTION_S: Final = (0.015, 0.2)
"""Least and greatest time over which the motion of a line of sight is measured, s (chosen: noise
against accelerations)."""
_RECENT: Final = 32
"""Most images that are kept for that, older ones thinned out (chosen: memory)."""
_TRACK: Final = 512
"""Most images whose carried pixels are remembered (chosen: 4 s at 120 Hz)."""
_LOST_S: Final = 0.5
"""Time for which tracking looks for what it has lost, s (chosen: the blur of a saccade)."""
_HELD_S: Final = 4.5
"""Time after a sighting for which the target is taken to rest, s (chosen: two answers of a detector
that takes 2 s)."""
_VIEW_SHARE: Final = 0.8
"""Share of the view within which a place stands that is out of view (chosen: the lens model
holds)."""
_PLACE_SIGMA_PX: Final = 0.1
"""Standard deviation of a place's pixel, px (chosen: encoders' noise)."""


class _PrintedSearch(EyeSearch):
    """Search for a printed target."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker

    def forget(self) -> None:
        self._tracker.forget()

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        self._found = Found(self._tracker.find(image, T_0_C=T_0_C, search=search))


class _Answer(NamedTuple):
    """A detector's candidates in an image."""

    candidates: Sequence[Detection]
    seen: SeenImage


class _Source(SharedSearch):
    """Answers of a detector: at once, delayed as it states, or from a thread of its own.

    Args:
        target: an object.
        cameras: the left and the right eye's camera.
        frame_s: time between two images of a real camera, for a thread of its own; None for a
            simulation, whose time stands still meanwhile.
    """

    def __init__(
        self, target: ObjectTarget, cameras: Sequence[Camera], frame_s: float | None
    ) -> None:
        in_process = isinstance(target, OwnTarget) and frame_s is not None
        make: Any = WorkerDetector if in_process else make_object_detector
        detectors: list[Any] = [make(target, cameras[0])]
        own = getattr(detectors[0], "own", None)
        if not getattr(own, "both_eyes", False):
            detectors.append(make(target, cameras[1]))
        self._target, self._detectors, self._frame_s = target, detectors, frame_s
        self.identity = Identity(cameras)
        self._latency_s = _stated(own, "latency_s", "a time of 0 s or more")
        rate_hz = _stated(own, "rate_hz", "a rate, Hz, or 0 or None for that of the images")
        self._period_s = 1.0 / rate_hz if rate_hz else 0.0
        self._pool = None if frame_s is None else ThreadPoolExecutor(len(detectors), "vergence eye")
        self._lock = threading.Lock()
        self.searches: list[_ObjectSearch] = []
        # not forgotten: a detector is asked for one image at a time
        self._running: list[Future[None] | None] = [None] * len(detectors)
        self._asked_s = [np.inf] * len(detectors)
        self.forget()

    @property
    def _both(self) -> bool:
        return len(self._detectors) == 1

    @property
    def in_step(self) -> "Sequence[_ObjectSearch]":
        """Searches that answers of the last image concern; in threads each asks for itself."""
        return self.searches if self._both and self._pool is None else ()

    def forget(self) -> None:
        """Drop all answers, and the target; an answer that is still being found is ignored."""
        self.identity.forget()
        with self._lock:
            self._newest: list[tuple[SeenImage, Any] | None] = [None, None]
            self._answers: tuple[deque[_Answer], deque[_Answer]] = (deque(), deque())
            self._due_s = [-np.inf] * len(self._detectors)
            self._quick = [True] * len(self._detectors)

    def ask(self, eye: int, seen: SeenImage, hint: FloatArray | None) -> None:
        """Have an eye's image searched, unless the detector is still at work on an earlier one."""
        place = 0 if self._both else eye
        with self._lock:
            self._newest[eye] = seen, hint
            if self._both and None in self._newest:
                return
            jobs = [one for one in (self._newest if self._both else [self._newest[eye]]) if one]
            running = self._running[place]
            if running is not None and not running.done():
                if time.monotonic() - self._asked_s[place] > _ANSWER_S:
                    raise ConfigurationError(
                        f"target {self._target}: expected its detector to answer within "
                        f"{_ANSWER_S:g} s, got nothing"
                    )
                return
            if running is not None:
                running.result()  # raises what the detector raised
            if self._pool is None:
                if seen.time_s < self._due_s[place] or len(self._answers[place]) >= _RECENT:
                    return
                self._due_s[place] = seen.time_s + self._period_s - 1e-9
            if self._both:
                self._newest = [None, None]
            answers = self._answers
            if self._pool is not None:
                running = self._pool.submit(self._detect, place, jobs, answers)
                self._running[place], self._asked_s[place] = running, time.monotonic()
        if self._pool is None:
            self._detect(place, jobs, answers)
        elif self._quick[place] and self._frame_s is not None and running is not None:
            try:
                running.result(_WAIT_FRAMES * self._frame_s)
            except TimeoutError:
                self._quick[place] = False

    def _detect(self, place: int, jobs: Sequence[tuple[SeenImage, Any]], answers: Any) -> None:
        images, hints = [seen.image for seen, _ in jobs], [hint for _, hint in jobs]
        detect = self._detectors[place].detect
        found = detect(images, hints) if self._both else [detect(images[0], hints[0])]
        for eye, (candidates, (seen, _)) in enumerate(zip(found, jobs, strict=True)):
            answers[eye if self._both else place].append(_Answer(candidates, seen))

    def answer(self, eye: int, now_s: float) -> _Answer | None:
        """The newest answer for an eye that is known by now; None if there is no new one."""
        answers, newest = self._answers[eye], None
        while answers and answers[0].seen.time_s + self._latency_s <= now_s + 1e-9:
            newest = answers.popleft()
        return newest

    @property
    def refused(self) -> int:  # type: ignore[override]
        return self.identity.refused

    @property
    def remark(self) -> str:  # type: ignore[override]
        known = self.identity
        if all(known.taken):
            return ""
        for eye, name in enumerate(EYE_NAMES):
            if not known.offered[eye]:
                return f"its detector has found nothing in the {name} eye's images"
        return "what it finds in both eyes never agrees in line of sight, depth and size"

    def rehearse(self, images: Sequence[Any]) -> None:
        if self._both:
            self._detectors[0].detect(images, [None, None])
            return
        for detector, image in zip(self._detectors, images, strict=True):
            detector.detect(image, None)

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        for detector in self._detectors:
            if isinstance(detector, WorkerDetector):
                detector.close()


class _ObjectSearch(EyeSearch):
    """Search for an object, carried by tracking while its detector is at work."""

    def __init__(self, eye: int, camera: Camera, source: _Source) -> None:
        self._eye, self._source, self._identity = eye, source, source.identity
        self._tracker = PointTracker(camera)
        self._camera = camera
        source.searches.append(self)
        self.forget()

    def forget(self) -> None:
        self._seen: SeenImage | None = None
        self._answer: _Answer | None = None
        self._waiting: _Answer | None = None
        self._target: Detection | None = None
        self._recent: list[SeenImage] = []
        self._track: deque[tuple[float, FloatArray, FloatArray]] = deque(maxlen=_TRACK)
        self._last: Detection | None = None
        self._doubted = False

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        seen = SeenImage(_as_colour(image, self._camera), T_0_C, time_s)
        self._recent.append(seen)
        if len(self._recent) > _RECENT:
            del self._recent[1:-1:2]
        self._source.ask(self._eye, seen, self._identity.hint(self._eye, T_0_C, time_s))
        self._seen, self._answer = seen, None
        self.take_answer()

    def take_answer(self) -> None:
        """Take the detector's newest answer for the present image, if there is one."""
        if self._seen is None:
            return
        answer, self._waiting = self._waiting, None
        answer = self._source.answer(self._eye, self._seen.time_s) or answer
        if answer is not None:
            self._answer = answer
            candidates, of = answer
            self._identity.post(self._eye, candidates, of.T_0_C, of.time_s)

    def found(self) -> Found | None:
        for one in self._source.in_step:  # one detector of both eyes answers after the second image
            one.take_answer()
        seen, answer = self._seen, self._answer
        if seen is None:
            return None
        self._seen = None
        if answer is None:
            return self._carry(seen) or self._hold(seen)
        target, then_s = self._identity.choose(self._eye), answer.seen.time_s
        if target is None and self._identity.waits(self._eye):
            self._waiting = answer
            return None
        since = self._recent = [one for one in self._recent if one.time_s > then_s]
        if target is None and then_s < seen.time_s and not self._doubted:
            self._doubted = True  # a blurred image, say; tracking knows more of later ones
            if (carried := self._carry(seen)) is not None:
                return carried
        if target is None or then_s == seen.time_s:
            self._start(seen, target)
            return Found(target)
        carried = self._carry(seen)
        before = [pixel for at_s, pixel, _ in self._track if at_s == then_s]
        if carried is not None and before:
            shift = target.pixel - before[0]
            later = [one for one in self._track if one[0] >= then_s]
            self._track = deque(((at_s, px + shift, pose) for at_s, px, pose in later), _TRACK)
            moved = carried.detection.pixel + shift
        else:
            self._track.clear()
            self._start(answer.seen, target)
            for between in since[:: -max(len(since) // _STEPS, 1)][::-1]:  # ends with the present
                carried = self._carry(between)
            if carried is None:
                return self._hold(seen)
            moved = carried.detection.pixel
        target = target._replace(pixel=moved, sigma_px=np.asarray(target.sigma_px))
        self._start(seen, target)
        return Found(target)

    def _start(self, seen: SeenImage, target: Detection | None) -> None:
        """Follow the image around the target from here."""
        self._target, self._started, self._from = target, False, seen
        self._last, self._lost_s, self._doubted = target, np.inf, False
        if target is not None:
            self._note(seen, np.asarray(target.pixel))

    def _carry(self, seen: SeenImage) -> Found | None:
        """The target carried to an image; None if nothing is followed, or it is not seen."""
        target = self._target
        if target is None:
            return None
        try:
            if not self._started:
                sizes = [target.size_px] if target.size_px else _SIZES_PX
                size_px, self._mix = _contrast(self._from.image, target.pixel, sizes)
                self._tracker.begin(
                    cv2.transform(self._from.image, self._mix), target.pixel,
                    self._from.T_0_C, half_px=_CARRIED_HALF * size_px, checked=False,
                )  # fmt: skip
                self._started = True
            mixed = cv2.transform(seen.image, self._mix)
            point = self._tracker.find(mixed, seen.T_0_C, self._predict(seen))
        except PointRefusedError:
            self._target = point = None
        if point is None:
            self._lost_s = min(self._lost_s, seen.time_s)
            if seen.time_s - self._lost_s > _LOST_S:
                self._target = None
            return None
        self._lost_s = np.inf
        pixel, sigma_px = point
        self._note(seen, pixel)
        sigma_px = np.hypot(sigma_px, target.sigma_px)
        return Found(target._replace(pixel=pixel, sigma_px=sigma_px))

    def _note(self, seen: SeenImage, pixel: FloatArray) -> None:
        """Remember where the target was in an image."""
        while self._track and self._track[-1][0] >= seen.time_s:
            self._track.pop()
        self._track.append((seen.time_s, pixel, seen.T_0_C))

    def _place(self, place: int) -> FloatArray:
        """(3,) where the target was in a remembered image, in frame 0, m."""
        _, pixel, T_0_C = self._track[place]
        ray = line_of_sight(self._camera, T_0_C, pixel)
        return np.asarray(T_0_C[:3, 3] + self._identity.depth_m * ray)

    def _predict(self, seen: SeenImage) -> FloatArray | None:
        """(2,) pixel at which the motion in frame 0 leads; None if it cannot be seen."""
        now_s, ahead = self._track[-1][0], self._place(-1)
        for i in range(len(self._track) - 2, -1, -1):
            since_s = now_s - self._track[i][0]
            if since_s > _MOTION_S[1]:
                break
            if since_s >= _MOTION_S[0]:
                lead_s = min(seen.time_s - now_s, _MOTION_S[1])
                ahead = ahead + lead_s / since_s * (ahead - self._place(i))
                break
        pixel = pixel_of(self._camera, seen.T_0_C, ahead)
        return pixel if np.isfinite(pixel).all() else None

    def _hold(self, seen: SeenImage) -> Found | None:
        """The target at rest where it was seen last; None if the last answer had none."""
        if self._last is None:
            return None
        pixel = pixel_of(self._camera, seen.T_0_C, self._place(-1))
        if seen.time_s - self._track[-1][0] > _HELD_S or not np.isfinite(pixel).all():
            return Found(None)
        return Found(self._last._replace(pixel=pixel))


def _contrast(
    image: NDArray[np.uint8], pixel: FloatArray, sizes_px: Sequence[float]
) -> tuple[float, FloatArray]:
    """Size, px, and mixture (1, 4) of blue, green and red that tell an object best from the rest.

    Fisher's linear discriminant of the pixels inside the object and of those around it, scaled so
    that their means are a quarter of the range apart from the middle.
    """
    u, v = pixel
    best = 0.0, float(np.median(sizes_px)), np.array([[0.114, 0.587, 0.299, 0.0]])  # grey
    for size_px in sizes_px:
        step = max(round(size_px / _SAMPLES), 1)
        reach = step * (int(np.ceil(size_px / step)) + 2)
        left, top = max(int(u) - reach, 0), max(int(v) - reach, 0)
        part = image[top : int(v) + reach + 1 : step, left : int(u) + reach + 1 : step].astype(
            float
        )
        y, x = np.indices(part.shape[:2]) * step
        away = np.hypot(x + left - u, y + top - v) / size_px
        inside, around = part[away < _INSIDE], part[(away > _AROUND[0]) & (away < _AROUND[1])]
        if min(len(inside), len(around)) < _LEAST_PIXELS:
            continue
        apart = inside.mean(axis=0) - around.mean(axis=0)
        scatter = np.cov(inside.T) + np.cov(around.T) + _LEVEL_NOISE**2 * np.eye(3)
        mix = np.linalg.solve(scatter, apart)
        between = float(mix @ apart)
        if between > best[0]:
            mix *= 128.0 / between
            middle = 0.5 * float(mix @ (inside.mean(axis=0) + around.mean(axis=0)))
            best = between, size_px, np.array([[*mix, 128.0 - middle]])
    return best[1:]


class _PlaceSearch(EyeSearch):
    """The pixel at which the head's model has a place in space, at the time of each image.

    One out of view stands at the edge of the view on the way to it, until the eye has turned.
    """

    def __init__(self, camera: Camera, place: FloatArray) -> None:
        self._camera, self._place = camera, place

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        x, y, z = T_0_C[:3, :3].T @ (self._place - T_0_C[:3, 3])
        away = max(float(np.hypot(x, y)), 1e-12)
        edge = _VIEW_SHARE * float((self._camera.size / self._camera.focal).min()) / 2
        tangent = min(away / z if z > 0.0 else np.inf, edge)
        pixel = self._camera.project([[tangent * x / away, tangent * y / away, 1.0]])[0]
        self._found = Found(Detection(pixel, np.full(2, _PLACE_SIGMA_PX)))


class HeadSearch:
    """Search of both eyes' images for a target.

    Args:
        target: the target.
        head: the model of the head.
        frame_s: time between two images of real cameras, whose slow detectors get threads of their
            own; None for a simulation.

    Attributes:
        eyes: the left and the right eye's search, which may run in two threads.
        shared: what both share.

    Raises:
        ConfigurationError: the target's network or class cannot be loaded.
    """

    def __init__(self, target: GazeTarget, head: HeadModel, frame_s: float | None = None) -> None:
        cameras = [Camera.of(head, eye) for eye in range(2)]
        self.eyes: tuple[EyeSearch, EyeSearch]
        self.shared = SharedSearch()
        if isinstance(target, PointTarget):
            seed = self.shared = PointSeed(cameras, target, waits=frame_s is not None)
            self.eyes = PointSearch(0, seed), PointSearch(1, seed)
        elif isinstance(target, ColourTarget | FaceTarget | OwnTarget):
            source = self.shared = _Source(target, cameras, frame_s)
            self.eyes = _ObjectSearch(0, cameras[0], source), _ObjectSearch(1, cameras[1], source)
        elif isinstance(target, PlaceTarget):
            T_0_N = head.base_pose(head.rest())
            place = T_0_N[:3, :3] @ (np.array(target.point_mm) / 1000.0) + T_0_N[:3, 3]
            self.eyes = _PlaceSearch(cameras[0], place), _PlaceSearch(cameras[1], place)
        else:
            left, right = (Tracker(make_detector(target, camera)) for camera in cameras)
            self.eyes = _PrintedSearch(left), _PrintedSearch(right)

    def forget(self) -> None:
        """Drop the track of the target in both eyes, and name a point anew."""
        self.shared.forget()
        for eye in self.eyes:
            eye.forget()


def _stated(own: object, name: str, expected: str) -> float:
    """A number of 0 or more that a user's detector may state; 0 if it does not."""
    value = getattr(own, name, None)
    try:
        number = 0.0 if value is None else float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not 0.0 <= number < np.inf:
        raise ConfigurationError(
            f"target: expected {type(own).__name__}.{name} to be {expected}, got {value!r:.80}"
        )
    return number


def _as_colour(image: Any, camera: Camera) -> NDArray[np.uint8]:
    """Blue, green and red levels of an image of any form."""
    array = np.asarray(image)
    if array.shape[:2] != (camera.height, camera.width):
        raise ConfigurationError(
            f"image: expected {camera.width} x {camera.height} px, got shape {array.shape}"
        )
    if array.ndim == 2 or array.shape[2] == 1:
        return np.asarray(cv2.cvtColor(array, cv2.COLOR_GRAY2BGR), np.uint8)
    return array
