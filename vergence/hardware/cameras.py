"""One eye's camera: a thread reads it, dates each image, and finds the target in it.

Cameras and streams buffer their images: one that is not read at once is old when it is read. So a
thread reads every image as it arrives. It also runs the detection, as OpenCV and the compiled
detectors release Python's global interpreter lock.

The exposure time of an image is its time of receipt less the camera's latency; for a camera of this
machine the driver stamps the receipt. The first images of a stream arrive in a burst, so their
times mean nothing; an eye is ready once its images arrive at the head's frame rate.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Final

import cv2
import numpy as np

from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.reading import Image
from vergence.errors import HardwareError, PointRefusedError, VergenceError
from vergence.hardware.config import CameraConfig, HardwareConfig
from vergence.hardware.drive import JointHistory
from vergence.hardware.pairing import (
    PairCounts,
    Pairing,
    SearchedImage,
    SearchedPair,
    pixels_at_common_time,
)
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import LoggedDetection
from vergence.vision.image import (
    as_grey,
    grey_if_channels_equal,
    is_local_camera,
    open_capture,
    suppress_opencv_log,
)
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.sights import EyeSearch
from vergence.vision.objects.targets import GazeTarget, ObjectTarget, OwnTarget, PointTarget
from vergence.vision.targets import PlanarTarget, TagFamily
from vergence.vision.tracking import Tracker, make_detector

_LOG: Final = logging.getLogger(__name__)
_AT_ONCE: Final = 0.25
"""Wait for an image, frames, below which the image has waited for us (chosen: above decoding)."""
_MOST_LATE: Final = 9
"""Images in succession that have waited, of which the last one is searched all the same (chosen:
buffers of streams)."""
_STEADY_INTERVALS: Final = 5
"""Consecutive intervals outside a burst after which the times of images are trusted (chosen)."""
_BURST_FRACTION: Final = 0.5
"""Intervals below this fraction of the frame period belong to a burst (chosen)."""
_STALLED_S: Final = 1.0
"""Time without an image after which a camera counts as lost, s (chosen)."""
_MOVED_RAD: Final = 0.01
"""Joint motion after which two images cannot be identical, rad: several px of a webcam (chosen)."""
_JOIN_S: Final = 3.0
"""Longest wait for the thread to end, which may be inside OpenCV, s (chosen)."""


class EyeThread(threading.Thread):
    """Thread that reads every image of one eye's camera and detects the target in it."""

    def __init__(
        self,
        config: CameraConfig,
        head: HeadModel,
        search: EyeSearch,
        history: JointHistory,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(daemon=True, name=f"vergence {config.name}")
        self.config = config
        self.frame: Image | None = None
        self.images = self.found = 0
        self._history, self._clock, self._head, self._search = history, clock, head, search
        self._new: deque[SearchedImage] = deque(maxlen=64)
        self._forget = self._ended = self._target_visible = False
        self._steady = threading.Event()
        self._last_s = self.newest_received_s = clock()
        self._fault = ""
        self._seen_q = head.rest()  # joint angles at the last image that differed
        self._device = is_local_camera(config.source)
        width, height = head.cameras.size[config.eye].tolist()
        self._capture = open_capture(
            config.source,
            config.name,
            pixel_format=config.pixel_format,
            size=(width, height),
            frame_rate_hz=head.timing.frame_rate_hz,
            exposure_s=config.exposure_s,
        )
        opened = config.name, config.source, width, height, head.timing.frame_rate_hz
        _LOG.info("%s: opened %s for %d x %d px at %g Hz", *opened)

    def run(self) -> None:
        """Read images until the stream ends or the eye is closed."""
        try:
            self._run()
        except Exception as error:
            named = "" if isinstance(error, VergenceError) else f"{type(error).__name__}: "
            self._fault = self._fault or f"{named}{error}"
        finally:
            if self._fault:
                _LOG.warning("%s: %s", self.config.name, self._fault)
            self._capture.release()

    def _run(self) -> None:
        in_pace = late = 0
        taken_s = np.inf
        frame_s = self._head.timing.frame_s
        least_s = _BURST_FRACTION * frame_s
        while not self._ended:
            asked_s = self._clock()
            if not self._capture.grab():
                self._fault = self._fault or "the stream ended"
                return
            grabbed_s, received_s = self._clock(), self._received_s()
            waited = asked_s - taken_s > frame_s and grabbed_s - asked_s < _AT_ONCE * frame_s
            late = late + 1 if waited and self.ready else 0
            if 0 < late < _MOST_LATE:  # it came while the last one was searched: nobody knows when
                continue
            taken_s = grabbed_s
            there, image = self._capture.retrieve()
            gap_s = received_s - self._last_s
            if self.ready and gap_s > _STALLED_S:
                _LOG.warning("%s: images again, after none for %.1f s", self.config.name, gap_s)
            in_pace = in_pace + 1 if gap_s >= least_s else 0
            self._last_s = received_s
            if not there or (in_pace < _STEADY_INTERVALS and not self._steady.is_set()):
                continue
            self._look(np.asarray(image, np.uint8), received_s)
            self._steady.set()

    def _received_s(self) -> float:
        """Time of receipt of the image that has just been grabbed, s."""
        now = self._clock()
        if not self._device:
            return now
        # V4L2 stamps images by the same clock, without the delay until this thread wakes
        stamped_s = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        return stamped_s if 0.0 <= now - stamped_s < _STALLED_S else now

    def _look(self, image: Image, received_s: float) -> None:
        width, height = self._head.cameras.size[self.config.eye].tolist()
        if image.shape[:2] != (height, width):
            self._fault = (
                f"expected images of {width} x {height}, as {self._head.name} has them, got "
                f"{image.shape[1]} x {image.shape[0]}"
            )
            self._ended = True
            return
        image = grey_if_channels_equal(image)
        grey = as_grey(image)
        exposed_s = received_s - self.config.latency_s
        q = self._history.at(exposed_s)
        alike = self.frame is not None and np.array_equal(grey, self.frame)
        if alike and np.abs(q - self._seen_q).max() > _MOVED_RAD:
            return
        if not alike:
            self._seen_q = q
        self.newest_received_s = received_s
        if self._forget:
            self._forget = False
            self._search.forget()
        T_0_C = (self._head.base_pose(q) @ self._head.camera_poses(q))[self.config.eye]
        self._search.look(image, T_0_C, exposed_s)
        answer = self._search.found()
        found = None if answer is None else answer.detection
        pixel = np.full(2, np.nan) if found is None else np.array(found.pixel)
        if not self.images:
            _LOG.info("%s: first image", self.config.name)
        if self._target_visible != (found is not None):
            self._target_visible = found is not None
            _LOG.debug("%s: target %s", self.config.name, "found" if found is not None else "lost")
        self.images += 1
        self.found += found is not None
        self.frame = grey
        if answer is not None:  # else a slow detector has yet to answer
            self._new.append(SearchedImage(exposed_s, self._clock(), pixel, found, grey))

    @property
    def ready(self) -> bool:
        """True once images arrive at the frame rate and the first of them has been searched."""
        return self._steady.is_set()

    def check(self) -> None:
        """Raise a `HardwareError` if the camera has ended or stalled."""
        if self._fault:
            raise HardwareError(f"{self.config.name}: {self.config.source}: {self._fault}")
        silent_s = self._clock() - self._last_s
        if self.ready and silent_s > _STALLED_S + self.config.latency_s:
            raise HardwareError(
                f"{self.config.name}: {self.config.source}: expected images, got none for "
                f"{silent_s:.1f} s"
            )

    def take_searched_images(self) -> list[SearchedImage]:
        """Searched images since the last call, in the order of exposure."""
        return [self._new.popleft() for _ in range(len(self._new))]

    def look_for(self, search: EyeSearch) -> None:
        """Search for another target from the next image on."""
        self._search = search

    def forget_track(self) -> None:
        """Drop the track of the target: the whole next image is searched."""
        self._forget = True

    def close(self) -> None:
        """Stop the thread and release the camera."""
        self._ended = True
        if self.is_alive():
            self.join(_JOIN_S)
        elif self.ident is None:  # never started
            self._capture.release()


_READY_TIMEOUT_S: Final = 10.0
"""Longest wait for images at the frame rate after the cameras open, s (chosen)."""


class HeadEyes:
    """The eyes of one head: `threads` of the left and the right, and the `search` in both.

    While closed there are no threads; before `open` there is no search.
    """

    def __init__(
        self,
        config: HardwareConfig,
        history: JointHistory,
        log: RobotListener | None,
        clock: Callable[[], float],
    ) -> None:
        self.threads: list[EyeThread] = []
        self.search: HeadSearch | None = None
        self._target = config.target
        self._config, self._history, self._log, self._clock = config, history, log, clock
        self._pairing = Pairing(config.pairing_tolerance_s, config.head.timing.frame_s)
        self._settings = ExitStack()

    def open(self, idle: Callable[[], None]) -> None:
        """Open both cameras, and call `idle`, which sleeps a little, until images come in pace."""
        head = self._config.head
        self.search = HeadSearch(self._target, head, head.timing.frame_s)
        rng = np.random.default_rng(0)
        sizes = head.cameras.size.tolist()
        self.search.shared.rehearse(
            [rng.integers(256, size=(h, w, 3), dtype=np.uint8) for w, h in sizes]
        )
        # errors of streams are reported by our own messages
        self._settings.enter_context(suppress_opencv_log())
        for camera, search in zip(self._config.cameras, self.search.eyes, strict=True):
            self.threads.append(EyeThread(camera, head, search, self._history))
        for eye in self.threads:
            eye.start()
        until = self._clock() + _READY_TIMEOUT_S
        while not all(eye.ready for eye in self.threads):
            self.check()
            for eye in self.threads:
                if not eye.ready and self._clock() > until:
                    raise HardwareError(
                        f"{eye.config.name}: expected {head.timing.frame_rate_hz:g} images a "
                        f"second from {eye.config.source}, got none at that pace within "
                        f"{_READY_TIMEOUT_S:g} s"
                    )
            idle()

    @property
    def counts(self) -> PairCounts:
        """Counts of paired and unpaired images so far."""
        return self._pairing.counts

    @property
    def newest_s(self) -> FloatArray:
        """(2,) time of receipt of each eye's newest image, s of the clock."""
        return np.array([eye.newest_received_s for eye in self.threads])

    def check(self) -> None:
        """Raise a `HardwareError` if a camera has ended or stalled."""
        for eye in self.threads:
            eye.check()

    def newest(self) -> SearchedPair | None:
        """The newest pair or lone image since the last call; None if there is none."""
        for eye, thread in enumerate(self.threads):
            for image in thread.take_searched_images():
                self._pairing.add(eye, image)
                if self._log is not None:
                    self._keep(self._log, eye, image)
        newest, now = None, self._clock()
        while (pair := self._pairing.next(now)) is not None:
            newest = pair
        return newest

    def _keep(self, log: RobotListener, eye: int, searched: SearchedImage) -> None:
        """Log the detection of an eye, and its image if the log takes images."""
        found, nothing = searched.detection, np.empty((0, 2))
        log.detection(
            LoggedDetection(
                eye=EYE_NAMES[eye],
                exposed_s=searched.exposed_s,
                ready_s=searched.ready_s,
                positions=self._history.at(searched.exposed_s),
                point_px=searched.pixel,
                sigma_px=np.full(2, np.nan) if found is None else found.sigma_px,
                corners_px=getattr(found, "corners_px", nothing),
                corners_sigma_px=getattr(found, "corners_sigma_px", nothing),
            )
        )
        if log.images and searched.image is not None:
            log.image(eye, searched.image, searched.exposed_s)

    def look_for(self, target: GazeTarget) -> None:
        """Search for another target from the next images on."""
        head, before = self._config.head, self.search
        self._target, self.search = target, HeadSearch(target, head, head.timing.frame_s)
        for eye, search in zip(self.threads, self.search.eyes, strict=False):
            eye.look_for(search)
        if before is not None:
            before.shared.close()

    def forget(self) -> None:
        """Drop the track of the target in both eyes, and name a point anew."""
        if self.search is not None:
            self.search.shared.forget()
        for eye in self.threads:
            eye.forget_track()

    def frames(self) -> tuple[Image, Image] | None:
        """The newest images of both eyes, grey levels; None if an eye has none yet."""
        left, right = [eye.frame for eye in self.threads] or (None, None)
        return None if left is None or right is None else (left, right)

    def close(self) -> None:
        """Stop the threads and release the cameras; a second call does nothing."""
        threads, self.threads = self.threads, []
        for eye in threads:
            eye.close()
        if self.search is not None:
            self.search.shared.close()
        self._settings.close()


_CELL_PX: Final = 8.0
"""Cell size of the board that is drawn for the compilation, px (chosen)."""


def compile_loop_kernels(head: HeadModel, target: GazeTarget) -> None:
    """Call every kernel of the loop once, on images with the target and on one without."""
    q, still = head.rest(), np.zeros(7)
    pixels_at_common_time(head, head.cameras.principal, np.stack([q, q]), q)
    if not isinstance(target, PlanarTarget | TagFamily):
        if not isinstance(target, OwnTarget):  # which runs in a process of its own
            _search_once(head, target)
        return
    board = target.tag(0) if isinstance(target, TagFamily) else target
    views = BoardImageRenderer(head, board)
    poses = head.base_pose(q) @ head.camera_poses(q)
    for eye, T_N_C in enumerate(head.camera_poses(q)):
        away_m = float(head.cameras.focal[eye].mean()) * board.cell_m / _CELL_PX
        point = T_N_C[:3, 3] + away_m * T_N_C[:3, 2]
        tracker = Tracker(make_detector(target, Camera.of(head, eye)))
        image = views.draw(q, still, point)[eye].copy()
        for seen in (image, image, np.full_like(image, image[0, 0])):
            tracker.find(seen, T_0_C=poses[eye])


def _search_once(head: HeadModel, target: ObjectTarget) -> None:
    """Call an object's detector on images of noise, and track in them."""
    q = head.rest()
    poses = head.base_pose(q) @ head.camera_poses(q)
    if isinstance(target, PointTarget):
        u, v = head.cameras.principal[0].tolist()
        target = PointTarget(eye=0, pixel=(u, v))
    search, rng = HeadSearch(target, head), np.random.default_rng(0)
    levels = rng.integers(256, size=(60, 80, 3), dtype=np.uint8)
    for time_s in (0.0, 0.1):
        for eye, (width, height) in enumerate(head.cameras.size.tolist()):
            image = np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_CUBIC))
            with suppress(PointRefusedError):  # of noise, which is not what will be followed
                search.eyes[eye].look(image, poses[eye], time_s)
            search.eyes[eye].found()
