"""Both eyes of a robot: the threads of their cameras, and the pairing of their images."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import numpy as np

from vergence.envs.reading import Image
from vergence.errors import HardwareError
from vergence.hardware.cameras import EyeThread
from vergence.hardware.config import HardwareConfig
from vergence.hardware.history import JointHistory
from vergence.hardware.pairing import PairCounts, Pairing, SearchedImage, SearchedPair
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import LoggedDetection
from vergence.vision.image import suppress_opencv_log
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.targets import GazeTarget

_READY_TIMEOUT_S: Final = 10.0
"""Longest wait for images at the frame rate after the cameras open, s (chosen)."""


class HeadEyes:
    """The eyes of one head.

    Args:
        config: the hardware configuration.
        history: joint angles by time.
        log: receives detections and images; None for no log.
        clock: a monotonic clock, s.

    Attributes:
        threads: camera threads of the left and the right eye; empty while closed.
        search: the search for the target in their images; None before `open`.
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
        """Open both cameras, and wait until their images arrive at the frame rate.

        Args:
            idle: called repeatedly while waiting; it has to sleep for a short time.

        Raises:
            HardwareError: a camera gives no images.
            ConfigurationError: a camera cannot be opened.
        """
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
        """Raise an error if a camera has ended or stalled.

        Raises:
            HardwareError: a camera has.
        """
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
        images = [eye.frame for eye in self.threads]
        if len(images) != 2 or images[0] is None or images[1] is None:
            return None
        return images[0], images[1]

    def close(self) -> None:
        """Stop the threads and release the cameras; a second call does nothing."""
        threads, self.threads = self.threads, []
        for eye in threads:
            eye.close()
        if self.search is not None:
            self.search.shared.close()
        self._settings.close()
