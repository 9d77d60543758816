"""Frame rates and settings of cameras, measured while all of them are open.

Two cameras on one USB controller share its bandwidth, so their rates are measured together. A slow
camera is measured alone too, to distinguish its own rate from the controller's limit.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Protocol

import cv2
import numpy as np

from vergence.errors import ConfigurationError
from vergence.hardware.config import HardwareConfig
from vergence.vision.image import (
    EXPOSURE_STEP_S,
    MANUAL_EXPOSURE,
    is_local_camera,
    open_capture,
    suppress_opencv_log,
)

FIRST_IMAGE_TIMEOUT_S: Final = 5.0
"""Longest wait for the first image, s (chosen)."""
_MIN_RATE_RATIO: Final = 0.8
"""Least measured frame rate as a fraction of the requested one (chosen)."""
_WARM_UP_S: Final = 0.5
"""Time after the first image in which buffers empty and the exposure settles, s (chosen)."""


class CaptureDevice(Protocol):
    """The part of `cv2.VideoCapture` that the checks use."""

    def grab(self) -> bool:
        """Wait for the next image; False if there is none."""

    def retrieve(self) -> tuple[bool, Any]:
        """Decode the image that was grabbed last."""

    def get(self, propId: int) -> float:
        """Read a setting back."""

    def release(self) -> None:
        """Close the camera."""


@dataclass(frozen=True, kw_only=True)
class CameraRequest:
    """One camera and the settings requested from it."""

    name: str
    """Name in messages."""
    source: str
    """Camera number, device file or URL."""
    size: tuple[int, int] | None = None
    """(width, height), px; None for the camera's own."""
    frame_rate_hz: float | None = None
    """Frame rate, Hz; None for the camera's own."""
    pixel_format: str = ""
    """Pixel format, four letters; empty for the camera's own."""
    exposure_s: float | None = None
    """Exposure time to lock, s; None leaves the setting."""


@dataclass(frozen=True, kw_only=True)
class CameraState:
    """Actual settings and frame rate of a camera."""

    request: CameraRequest
    """Requested settings."""
    size: tuple[int, int] | None
    """(width, height) of its images, px; None if none arrived."""
    pixel_format: str
    """Pixel format that it reports; empty if unknown."""
    reported_hz: float
    """Frame rate that it reports, Hz; nan if unknown."""
    rate_hz: float
    """Frame rate measured while all cameras gave images, Hz."""
    alone_hz: float = np.nan
    """Frame rate measured while the others were closed, Hz; nan if not measured."""
    exposure_locked: bool | None
    """True if its exposure is locked; None if unknown."""
    exposure_s: float
    """Exposure time that it reports, s; nan if unknown."""

    @property
    def too_slow(self) -> bool:
        """True if the frame rate was well below the requested one, or no images arrived."""
        return self.rate_hz < _MIN_RATE_RATIO * (self.request.frame_rate_hz or 1e-9)

    @property
    def slowed_by_others(self) -> bool:
        """True if it was too slow, but fast enough while the others were closed."""
        return self.too_slow and self.alone_hz >= _MIN_RATE_RATIO * (
            self.request.frame_rate_hz or 0.0
        )


def camera_requests(config: HardwareConfig) -> tuple[CameraRequest, ...]:
    """Requests for a robot's cameras."""
    sizes = config.head.cameras.size.tolist()
    return tuple(
        CameraRequest(
            name=camera.name,
            source=camera.source,
            size=(sizes[camera.eye][0], sizes[camera.eye][1]),
            frame_rate_hz=config.head.timing.frame_rate_hz,
            pixel_format=camera.pixel_format,
            exposure_s=camera.exposure_s,
        )
        for camera in config.cameras
    )


def measure_cameras(
    requests: Sequence[CameraRequest],
    *,
    open: Callable[..., CaptureDevice] = open_capture,
    clock: Callable[[], float] = time.monotonic,
    seconds: float = 1.0,
) -> tuple[list[CameraState], dict[str, str]]:
    """Open cameras, all at once, and measure their rates.

    Args:
        requests: the cameras.
        open: opens a camera, as `vergence.vision.image.open_capture` does.
        clock: a monotonic clock, s; called by a thread for each camera.
        seconds: duration of the measurement of the rates, s.

    Returns:
        States of the cameras that could be opened, and the reasons of the others by name.
    """
    unopened: dict[str, str] = {}
    with suppress_opencv_log(), ExitStack() as opened:
        captures: list[tuple[CameraRequest, CaptureDevice]] = []
        for request in requests:
            try:
                capture = _open(request, open)
            except ConfigurationError as error:
                unopened[request.name] = str(error).removeprefix(f"{request.name}: ")
                continue
            opened.callback(capture.release)
            captures.append((request, capture))
        with ThreadPoolExecutor(max(len(captures), 1)) as pool:
            watched = list(pool.map(lambda one: _watch(one[1], clock, seconds), captures))
        states = [
            _state(request, capture, seen)
            for (request, capture), seen in zip(captures, watched, strict=True)
        ]
        opened.close()  # so that slow cameras can be opened alone
        if len(states) > 1:
            states = [_with_alone(state, open, clock, seconds) for state in states]
    return states, unopened


class _Watched(NamedTuple):
    """Image size and frame rate of a camera over a time."""

    size: tuple[int, int] | None
    rate_hz: float


def _open(request: CameraRequest, open: Callable[..., CaptureDevice]) -> CaptureDevice:
    return open(
        request.source,
        request.name,
        pixel_format=request.pixel_format,
        size=request.size,
        frame_rate_hz=request.frame_rate_hz,
        exposure_s=request.exposure_s,
    )


def _watch(capture: CaptureDevice, clock: Callable[[], float], seconds: float) -> _Watched:
    begun_s = clock()
    until_s = begun_s + FIRST_IMAGE_TIMEOUT_S
    times: list[float] = []
    size = None
    while clock() < until_s and capture.grab():
        times.append(clock())
        if size is None:
            there, image = capture.retrieve()
            size = (int(image.shape[1]), int(image.shape[0])) if there else None
        if len(times) == 1:
            until_s = times[0] + _WARM_UP_S + seconds
    if not times:
        return _Watched(None, 0.0)
    counted = [time_s for time_s in times if time_s - times[0] >= _WARM_UP_S]
    if len(counted) < 2:
        return _Watched(size, len(times) / (_WARM_UP_S + seconds))
    return _Watched(size, (len(counted) - 1) / (counted[-1] - counted[0]))


def _state(request: CameraRequest, capture: CaptureDevice, watched: _Watched) -> CameraState:
    size, rate_hz = watched
    if not is_local_camera(request.source):  # a stream's settings are those of its server
        return CameraState(
            request=request, size=size, pixel_format="", reported_hz=np.nan, rate_hz=rate_hz,
            exposure_locked=None, exposure_s=np.nan,
        )  # fmt: skip
    mode = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    steps = capture.get(cv2.CAP_PROP_EXPOSURE)
    letters = int(capture.get(cv2.CAP_PROP_FOURCC))
    set_hz = capture.get(cv2.CAP_PROP_FPS)
    return CameraState(
        request=request,
        size=size,
        pixel_format=letters.to_bytes(4, "little").decode("latin-1") if letters > 0 else "",
        reported_hz=set_hz if set_hz > 0.0 else np.nan,
        rate_hz=rate_hz,
        exposure_locked=mode == MANUAL_EXPOSURE if mode >= 0.0 else None,
        exposure_s=EXPOSURE_STEP_S * steps if steps > 0.0 else np.nan,
    )


def _with_alone(
    state: CameraState,
    open: Callable[..., CaptureDevice],
    clock: Callable[[], float],
    seconds: float,
) -> CameraState:
    """Measure a slow camera's rate while the others are closed; return its completed state."""
    if not state.too_slow:
        return state
    try:
        capture = _open(state.request, open)
    except ConfigurationError:  # it has been removed meanwhile
        return state
    try:
        watched = _watch(capture, clock, seconds)
    finally:
        capture.release()
    return replace(state, size=state.size or watched.size, alone_hz=watched.rate_hz)
