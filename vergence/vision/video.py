"""Read the images of a camera, a video file or a stream one after the other."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from glob import glob
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.vision.image import grey_if_channels_equal, suppress_opencv_log

MANUAL_EXPOSURE: Final = 1
"""Value of CAP_PROP_AUTO_EXPOSURE for a locked exposure (physical: V4L2_EXPOSURE_MANUAL of
linux/v4l2-controls.h)."""
EXPOSURE_STEP_S: Final = 1e-4
"""Unit of CAP_PROP_EXPOSURE, s (physical: V4L2_CID_EXPOSURE_ABSOLUTE)."""
_MAX_MISSED_IMAGES: Final = 10
"""Consecutive images that a camera may fail to deliver (chosen)."""


@contextmanager
def open_video(source: str) -> Iterator[Iterator[NDArray[np.uint8]]]:
    """Open a camera, a video file or a stream.

    Args:
        source: the number of a camera, its path such as /dev/video0, a video file, or a URL.

    Yields:
        Its images, (height, width) grey or (height, width, 3) BGR, until there are no more.

    Raises:
        ConfigurationError: the source does not exist, or cannot be opened.
    """
    device = is_local_camera(source)
    capture = open_capture(source, "live")
    try:
        yield _images(capture, _MAX_MISSED_IMAGES if device else 0)
    finally:
        capture.release()


def open_capture(
    source: str,
    option_name: str,
    *,
    pixel_format: str = "",
    size: tuple[int, int] | None = None,
    frame_rate_hz: float | None = None,
    exposure_s: float | None = None,
) -> cv2.VideoCapture:
    """Open a camera, a video file or a stream with OpenCV.

    The options below are requests to a camera of this machine, which may choose other values.

    Args:
        source: see `open_video`.
        option_name: name of the option or field that gives the source, for messages.
        pixel_format: four letters, such as MJPG; empty for the camera's default.
        size: (width, height), px; None for the camera's default.
        frame_rate_hz: images a second; None for the camera's default.
        exposure_s: exposure time to lock, s; None leaves the exposure control unchanged.

    Raises:
        ConfigurationError: the source does not exist, or cannot be opened.
    """
    device = is_local_camera(source)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg has a log of its own
    with suppress_opencv_log():
        capture = _open(source, device, option_name)
        # pixels are those of the sensor, whatever a file says of how it was held
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if device:  # the format first, since it limits sizes and rates
            if pixel_format:
                capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*pixel_format))
            if size is not None:
                capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
                capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
            if frame_rate_hz is not None:
                capture.set(cv2.CAP_PROP_FPS, frame_rate_hz)
            if exposure_s is not None:
                capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE)
                capture.set(cv2.CAP_PROP_EXPOSURE, round(exposure_s / EXPOSURE_STEP_S))
    if not capture.isOpened():
        capture.release()
        raise ConfigurationError(_why(source, device, option_name))
    return capture


def is_local_camera(source: str) -> bool:
    """True if a source is a camera of this machine."""
    return source.isdecimal() or source.startswith("/dev/")


def list_camera_devices() -> list[str]:
    """Device files of this machine's cameras, persistent names first."""
    return sorted(glob("/dev/v4l/by-id/*")) + sorted(glob("/dev/video*"))


def _device_path(source: str) -> str:
    return f"/dev/video{int(source)}" if source.isdecimal() else os.path.realpath(source)


def _open(source: str, device: bool, what: str) -> cv2.VideoCapture:
    if device:
        path = _device_path(source)
        number = re.fullmatch(r"/dev/video(\d+)", path)
        if not os.path.exists(path):
            raise ConfigurationError(
                f"{what}: expected a camera, got {source}: no such device; there are: "
                f"{', '.join(list_camera_devices()) or 'none'}"
            )
        # V4L2 only: FFmpeg and GStreamer open cameras too, but queue old images
        if number:
            return cv2.VideoCapture(int(number[1]), cv2.CAP_V4L2)
        return cv2.VideoCapture(path, cv2.CAP_V4L2)
    if "://" not in source and not Path(source).is_file():
        raise ConfigurationError(
            f"{what}: expected the number of a camera, a path such as /dev/video0, a video file or "
            f"a URL, got {source!r:.200}: no such file"
        )
    if "://" not in source:
        return cv2.VideoCapture(source)
    # detects a stalled stream within seconds instead of half a minute
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 5000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 2000]
    return cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)


def _why(source: str, device: bool, what: str) -> str:
    if device:
        expected = f"{what}: expected a camera that can be opened, got {source}"
        if not os.access(_device_path(source), os.R_OK | os.W_OK):
            return (
                f"{expected}, for which there is no permission (on most Linux systems, users of "
                "the group video have it: sudo usermod -aG video $USER, then log in again)"
            )
        return (
            f"{expected} (does another program use it, as fuser -v {_device_path(source)} tells, "
            "or is it a camera's second device, without images?)"
        )
    return f"{what}: expected a video that OpenCV can read, got {source!r:.200}"


def _images(capture: cv2.VideoCapture, misses: int) -> Iterator[NDArray[np.uint8]]:
    missed = 0
    while missed <= misses:
        there, image = capture.read()
        if not there or image is None:
            missed += 1
            continue
        missed = 0
        yield grey_if_channels_equal(np.asarray(image, np.uint8))
