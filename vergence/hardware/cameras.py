"""One eye's camera: a thread drains it, dates each image, and finds the target in it.

Buffers of cameras and streams are queues: what is not taken at once is old when it is taken. So a
thread takes every image as it comes; detection is part of it, as OpenCV and the compiled detectors
work without Python's lock.

An image is dated by its receipt less the camera's latency; of a camera of this machine the receipt
is the driver's. The first images of a stream come in a burst, all at once, and tell nothing; an eye
is ready when its images come at the pace of the head's frame rate.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import cv2
import numpy as np

from vergence.envs.reading import Image
from vergence.errors import HardwareError
from vergence.hardware.config import CameraConfig
from vergence.hardware.history import JointHistory
from vergence.hardware.pairing import Sight
from vergence.models.boards import Target
from vergence.models.head import HeadModel
from vergence.vision.detectors import make_detector
from vergence.vision.image import as_grey, as_taken
from vergence.vision.optics import EyeCamera
from vergence.vision.tracking import Tracker
from vergence.vision.video import is_device, open_capture

_LOG: Final = logging.getLogger(__name__)
_STEADY: Final = 5
"""Intervals in a row, none of a burst, after which the times of images are believed."""
_BURST: Final = 0.5
"""Share of the time between two frames below which images come in a burst."""
_STALLED_S: Final = 1.0
"""Time without an image after which an eye counts as gone, s."""
_MOVED_RAD: Final = 0.01
"""Way of a joint after which two images cannot be alike, rad: several px of a webcam."""
_JOIN_S: Final = 3.0
"""Wait for a thread that may be inside OpenCV, s."""


class EyeThread(threading.Thread):
    """Takes every image of one eye's camera and looks for the target in it.

    Args:
        config: the camera.
        head: the model of the head.
        target: what to look for.
        history: the joints' angles by time, for following the target while the eye turns.
        clock: a steady clock, s.

    Raises:
        HardwareError: the camera cannot be opened.
    """

    def __init__(
        self,
        config: CameraConfig,
        head: HeadModel,
        target: Target,
        history: JointHistory,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(daemon=True, name=f"vergence {config.name}")
        self.config = config
        self.frame: Image | None = None
        self.images = self.found = 0
        self._history = history
        self._clock = clock
        self._head = head
        self._tracker = self._tracker_of(target)
        self._new: deque[Sight] = deque(maxlen=64)
        self._forget = self._ended = self._sees = False
        self._steady = threading.Event()
        self._last_s = self._newest_s = clock()
        self._fault = ""
        self._seen_q = head.rest()  # where the head stood when the newest image was another
        self._device = is_device(config.source)
        width, height = head.cameras.size[config.eye].tolist()
        self._capture = open_capture(
            config.source,
            config.name,
            pixel_format=config.pixel_format,
            size=(width, height),
            frame_rate_hz=head.timing.frame_rate_hz,
            exposure_s=config.exposure_s,
        )
        _LOG.info(
            "%s: opened %s for %d x %d px at %g Hz",
            config.name,
            config.source,
            width,
            height,
            head.timing.frame_rate_hz,
        )

    def run(self) -> None:
        """Take images until the camera ends or the eye is closed."""
        try:
            self._run()
        except Exception as error:
            self._fault = self._fault or f"{type(error).__name__}: {error}"
        finally:
            if self._fault:
                _LOG.warning("%s: %s", self.config.name, self._fault)
            self._capture.release()

    def _run(self) -> None:
        in_pace = 0
        least_s = _BURST * self._head.timing.frame_s
        while not self._ended:
            if not self._capture.grab():
                self._fault = self._fault or "the stream ended"
                return
            received_s = self._received_s()
            there, image = self._capture.retrieve()
            gap_s = received_s - self._last_s
            if self.ready and gap_s > _STALLED_S:
                _LOG.warning("%s: images again, after none for %.1f s", self.config.name, gap_s)
            in_pace = in_pace + 1 if gap_s >= least_s else 0
            self._last_s = received_s
            if not there or (in_pace < _STEADY and not self._steady.is_set()):
                continue
            self._look(np.asarray(image, np.uint8), received_s)
            self._steady.set()

    def _received_s(self) -> float:
        """When the image that has just been grabbed came."""
        now = self._clock()
        if not self._device:
            return now
        # V4L2's stamp is of the same clock, and knows nothing of when this thread was woken
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
        image = as_taken(image)
        grey = as_grey(image)
        exposed_s = received_s - self.config.latency_s
        q = self._history.at(exposed_s)
        alike = self.frame is not None and np.array_equal(grey, self.frame)
        if alike and np.abs(q - self._seen_q).max() > _MOVED_RAD:
            return
        if not alike:
            self._seen_q = q
        self._newest_s = received_s
        if self._forget:
            self._forget = False
            self._tracker.forget()
        T_0_C = (self._head.base_pose(q) @ self._head.camera_poses(q))[self.config.eye]
        found = self._tracker.find(image, T_0_C=T_0_C)
        pixel = np.full(2, np.nan) if found is None else found.point_px.copy()
        if not self.images:
            _LOG.info("%s: first image", self.config.name)
        if self._sees != (found is not None):
            self._sees = not self._sees
            _LOG.debug("%s: target %s", self.config.name, "found" if self._sees else "lost")
        self.images += 1
        self.found += found is not None
        self.frame = grey
        self._new.append(Sight(exposed_s, self._clock(), pixel, found, grey))

    @property
    def newest_s(self) -> float:
        """When the newest image came, s.

        A camera that hangs may send its last image for ever: one that has not changed while the eye
        turned is none.
        """
        return self._newest_s

    @property
    def ready(self) -> bool:
        """Whether images have come at the frames' pace, and the newest has been looked at."""
        return self._steady.is_set()

    def check(self) -> None:
        """Refuse a camera that has ended or stalled.

        Raises:
            HardwareError: it has.
        """
        if self._fault:
            raise HardwareError(f"{self.config.name}: {self.config.source}: {self._fault}")
        silent_s = self._clock() - self._last_s
        if self.ready and silent_s > _STALLED_S + self.config.latency_s:
            raise HardwareError(
                f"{self.config.name}: {self.config.source}: expected images, got none for "
                f"{silent_s:.1f} s"
            )

    def take(self) -> list[Sight]:
        """What has been seen since the last call, in the order of exposure."""
        sights = []
        while self._new:
            sights.append(self._new.popleft())
        return sights

    def look_for(self, target: Target) -> None:
        """Look for another target from the next image on."""
        self._tracker = self._tracker_of(target)

    def _tracker_of(self, target: Target) -> Tracker:
        return Tracker(make_detector(target, EyeCamera.of(self._head, self.config.eye)))

    def forget(self) -> None:
        """Lose the target's track: the next image is searched as a whole."""
        self._forget = True

    def close(self) -> None:
        """Stop, and release the camera."""
        self._ended = True
        if self.is_alive():
            self.join(_JOIN_S)
        elif self.ident is None:  # never started
            self._capture.release()
