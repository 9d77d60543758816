"""Images in any form as grey levels: arrays, files, videos and cameras of the desk."""

import math
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from glob import glob
from pathlib import Path
from typing import Any, Final, overload

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.camera import CameraResponse, light_table, parse_response, to_light

_EXPECTED_IMAGE: Final = (
    "expected an array (height, width), or (height, width, 3 or 4) in OpenCV's order BGR(A), of "
    "whole numbers or floats"
)
_BIT_DEPTHS: Final = (8, 10, 12, 14, 16)
"""Bits per pixel of cameras; more than 8 come in 16 bits, mostly unscaled (physical: sensors)."""
_MAXIMUM_PERCENTILE: Final = 99.9
"""Percentile that stands for the largest value of an image (chosen: ignores hot pixels)."""
_MAX_UNIT_FLOAT: Final = 2.0
"""Largest value of a float image that is taken to have its white at 1 (chosen: allows overshoot
of interpolation)."""
_LOW_NOISE_GREY: Final = 1.5
"""Noise up to which an image is searched without smoothing, standard deviation in grey levels
(chosen: sharpness against search time)."""
_HIGH_NOISE_GREY: Final = 8.0
"""Noise above which an image is smoothed more, standard deviation in grey levels (chosen)."""
_MEDIAN_SECOND_DIFFERENCE: Final = 1.652
"""Median of |2 a - b - c| of normal numbers with standard deviation 1 (numerical)."""
_LEAST_RANGE_GREY: Final = 6.0
"""Smallest range of grey levels, beyond noise, of an image worth searching (chosen)."""
_LEAST_SIDE_PX: Final = 16
"""Smallest side of an image that is searched (chosen)."""
_COLOURS_EVERY_PX: Final = 8
"""Spacing of the pixels that decide whether a video's image is grey, px (chosen: noise alone
colours some pixels, and fewer samples cost less)."""
_MAX_CHANNEL_DIFFERENCE: Final = 3
"""Largest difference of the channels of a grey image, grey levels, due to the rounding in video
codecs (chosen)."""

_EXIF_MARKS: Final = {b"\xff\xd8": b"Exif\0\0", b"\x89P": b"eXIf", b"RI": b"EXIF"}
"""Marks before the EXIF of JPEG, PNG and WebP files, by their first bytes (physical: formats)."""
_TIFF_HEADER: Final = re.compile(rb"II\*\0|MM\0\*")
"""Start of a TIFF file, and of EXIF (physical: TIFF 6.0)."""
_MARK_TO_HEADER_BYTES: Final = 20
"""Bytes from a mark's start within which the header of EXIF ends (physical: formats)."""
_ORIENTATION_TAG: Final = 0x0112
"""TIFF's number of the orientation (physical: TIFF 6.0)."""


@overload
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: None = None
) -> NDArray[np.uint8]: ...
@overload
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: CameraResponse
) -> NDArray[np.float32]: ...
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: CameraResponse | None = None
) -> NDArray[Any]:
    """Convert an image to 8-bit grey levels, or to light.

    Args:
        image: (height, width) or (height, width, 1) grey, (height, width, 3) BGR or
            (height, width, 4) BGRA. uint8 stays as it is. Wider integers are scaled by the smallest
            depth of 8, 10, 12, 14, 16 bits that holds 99.9 % of them (the rest may be hot pixels).
            Floats have the range 0 to 1 or, if they exceed 2, that of a depth in the same way.
            bool is black and white. NaN is black.
        size: required (width, height), such as the camera's; None for any.
        response: light by grey level, see `parse_response`; None for grey levels.

    Returns:
        Grey levels, uint8, shape (height, width), contiguous and writable; the image itself if it
        has this form already. With a response, light, float32, 0 to 255: colours are weighted as
        light, and no bit depth is lost.

    Raises:
        ConfigurationError: the image is invalid, empty or of another size, or the response is
            invalid.
    """
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:  # a tensor on a GPU, rows of different lengths
        raise ConfigurationError(f"image: {_EXPECTED_IMAGE}; got {type(image).__name__}") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    colour = has_colour_channels(array)
    if array.dtype.kind not in "buif" or not (colour or array.ndim == 2):
        in_a_line = " ".join(repr(image).split())[:80]
        what = f"shape {array.shape} of {array.dtype}" if array.shape else in_a_line
        raise ConfigurationError(f"image: {_EXPECTED_IMAGE}; got {what}")
    if array.size == 0:
        raise ConfigurationError(f"image: expected pixels, got an empty array of {array.shape}")
    height, width = array.shape[:2]
    if size is not None and (width, height) != size:
        raise ConfigurationError(
            f"image: expected the camera's {size[0]} x {size[1]} px, got {width} x {height}"
        )
    if response is not None:
        curve = parse_response(response)
        if array.dtype == np.uint8:
            light = light_table(curve)[array]
        else:
            light = 255.0 * to_light(_levels(array) / 255.0, curve)
        array = np.asarray(light, np.float32)
    elif array.dtype != np.uint8:
        array = np.rint(_levels(array)).astype(np.uint8)
    if colour:
        code = cv2.COLOR_BGRA2GRAY if array.shape[2] == 4 else cv2.COLOR_BGR2GRAY
        array = np.asarray(cv2.cvtColor(np.ascontiguousarray(array), code))
    grey: NDArray[Any] = np.ascontiguousarray(array)
    # kernels are compiled for writable arrays
    return grey if grey.flags.writeable else grey.copy()


def has_colour_channels(image: ArrayLike) -> bool:
    """True if an image has colour channels."""
    shape = np.shape(image)
    return len(shape) == 3 and shape[2] in (3, 4)


def measurement_channel(image: ArrayLike, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """8-bit levels in which targets are measured: grey, or the green channel of a colour image.

    Green has half of the pixels of a Bayer mosaic, and lies between red and blue in the chromatic
    aberration of a lens. See `as_grey`.
    """
    return as_grey(np.asarray(image)[..., 1] if has_colour_channels(image) else image, size)


def grey_if_channels_equal(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert a video frame of a grey camera back to grey: OpenCV decodes grey as BGR.

    It stays as it is unless all channels are equal up to the rounding of codecs.
    """
    if not has_colour_channels(frame):
        return frame
    some = frame[::_COLOURS_EVERY_PX, ::_COLOURS_EVERY_PX]
    return frame if np.ptp(some, axis=2).max() > _MAX_CHANNEL_DIFFERENCE else as_grey(frame)


def _levels(array: NDArray[Any]) -> NDArray[np.float32]:
    """Convert levels of any depth to floats from 0 to 255, without rounding."""
    if array.dtype.kind == "b":
        return np.where(array, np.float32(255.0), np.float32(0.0))
    with np.errstate(over="ignore"):  # values beyond float32 are not a camera's levels
        values = np.asarray(array, np.float32)
    floats = array.dtype.kind == "f"
    if floats:
        values = np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=0.0)
    elif float(values.min()) < 0.0:
        raise ConfigurationError(f"image: expected grey levels of at least 0, got {values.min():g}")
    # ignores hot pixels, and overshoot of interpolation
    some = values[:: max(values.shape[0] // 400, 1), :: max(values.shape[1] // 400, 1)]
    finite = some[np.isfinite(some)]
    greatest = float(np.percentile(finite, _MAXIMUM_PERCENTILE)) if finite.size else 1.0
    full = next((2.0**bits - 1.0 for bits in _BIT_DEPTHS if greatest < 2.0**bits), greatest)
    if floats and greatest <= _MAX_UNIT_FLOAT:
        full = 1.0
    scaled: NDArray[np.float32] = np.clip(values * (255.0 / full), 0.0, 255.0)
    return scaled


def smooth_for_square_search(image: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Smooth an image for searches for squares; itself if it has little noise, None if only noise.

    Noise, the median of second differences, makes such a search take ten times as long.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return None
    part = image[:: max(image.shape[0] // 200, 1)].astype(np.int16)  # a subset of rows suffices
    second = np.abs(2 * part[:, 1:-1] - part[:, :-2] - part[:, 2:])
    noise = float(np.median(second)) / _MEDIAN_SECOND_DIFFERENCE
    left, smooth = noise, image
    if noise > _LOW_NOISE_GREY:
        blur_px = 1.0 if noise <= _HIGH_NOISE_GREY else 2.0
        smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8)
        # smoothing divides white noise by 2 sqrt(pi) blur; its extremes are at about five sigma
        left = noise / (2.0 * math.sqrt(math.pi) * blur_px)
    plain = int(smooth.max()) - int(smooth.min()) < _LEAST_RANGE_GREY + 10.0 * left
    return None if plain else smooth


@contextmanager
def suppress_opencv_log() -> Iterator[None]:
    """Suppress OpenCV's log messages on unreadable files; the package raises its own error."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read an image file as 8-bit grey levels, shape (height, width).

    Args:
        path: path of a PNG, JPEG, TIFF or other format that OpenCV reads, of any depth.

    Raises:
        UnreadableFileError: the file is missing, empty, or no image.
    """
    return as_grey(read_pixels(path))


def read_pixels(path: str | Path) -> NDArray[Any]:
    """Read an image file, see `read_image`, with its own bit depth and colours.

    (height, width) grey or (height, width, 3) BGR: pixels as stored, so those of the sensor; an
    orientation tag is not applied.
    """

    def unreadable(path: str, reason: str) -> UnreadableFileError:
        return UnreadableFileError(path, reason, "an image that OpenCV reads, such as PNG or JPEG")

    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise unreadable(str(path), (error.strerror or str(error)).lower()) from error
    except ValueError as error:  # a null byte in the path
        raise unreadable(repr(str(path)), str(error)) from error
    if not content:
        raise unreadable(str(path), "empty")
    levels = np.frombuffer(content, np.uint8)
    _, start = _find_orientation(content)
    if start and _TIFF_HEADER.match(content):  # which OpenCV turns whatever the flags
        levels = levels.copy()
        levels[start : start + 2] = [1, 0] if content[:1] == b"I" else [0, 1]
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    read: Any = None
    cause: cv2.error | None = None
    try:
        with suppress_opencv_log():
            read = cv2.imdecode(levels, flags)
    except cv2.error as error:  # sizes beyond OpenCV's limits, damaged headers
        cause = error
    if read is None or read.size == 0:
        raise unreadable(str(path), "no image, or a damaged one") from cause
    return np.asarray(read)


def has_orientation_tag(path: str | Path) -> bool:
    """True if a file asks to be shown turned or mirrored, by its EXIF or TIFF orientation."""
    try:
        return _find_orientation(Path(path).read_bytes())[0] != 1
    except (OSError, ValueError):
        return False


def _find_orientation(content: bytes) -> tuple[int, int]:
    """Orientation of an image file, 1 (as stored) to 8, and its place; 1 and 0 without one."""
    mark = content.find(_EXIF_MARKS.get(content[:2], b""))
    header = _TIFF_HEADER.search(content, mark, mark + _MARK_TO_HEADER_BYTES) if mark >= 0 else None
    if header is None:
        return 1, 0
    order = "<" if header[0][:1] == b"I" else ">"
    try:
        first = header.start() + struct.unpack_from(f"{order}I", content, header.end())[0]
        (count,) = struct.unpack_from(f"{order}H", content, first)
        for start in range(first + 2, first + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", content, start)
            if tag == _ORIENTATION_TAG:
                return value, start + 8
    except struct.error:  # it ends before its tags
        pass
    return 1, 0


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
    capture = open_capture(source, "live")
    try:
        yield _images(capture, _MAX_MISSED_IMAGES if is_local_camera(source) else 0)
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

    The options are requests to a camera of this machine, which may choose other values: the pixel
    format is four letters, such as MJPG, the size (width, height), and an exposure is locked. By
    default the camera's own settings stay. The name is that of the option or field that gives the
    source, for messages. `ConfigurationError` as in `open_video`.
    """
    device = is_local_camera(source)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg has a log of its own
    with suppress_opencv_log():
        capture = _open(source, option_name)
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
    if capture.isOpened():
        return capture
    capture.release()
    what = f"{option_name}: expected a"
    if not device:
        raise ConfigurationError(f"{what} video that OpenCV can read, got {source!r:.200}")
    path, what = _device_path(source), f"{what} camera that can be opened, got {source}"
    if not os.access(path, os.R_OK | os.W_OK):
        raise ConfigurationError(
            f"{what}, for which there is no permission (on most Linux systems, users of the group "
            "video have it: sudo usermod -aG video $USER, then log in again)"
        )
    raise ConfigurationError(
        f"{what} (does another program use it, as fuser -v {path} tells, or is it a camera's "
        "second device, without images?)"
    )


def is_local_camera(source: str) -> bool:
    """True if a source is a camera of this machine."""
    return source.isdecimal() or source.startswith("/dev/")


def list_camera_devices() -> list[str]:
    """Device files of this machine's cameras, persistent names first."""
    return sorted(glob("/dev/v4l/by-id/*")) + sorted(glob("/dev/video*"))


def _device_path(source: str) -> str:
    return f"/dev/video{int(source)}" if source.isdecimal() else os.path.realpath(source)


def _open(source: str, what: str) -> cv2.VideoCapture:
    if is_local_camera(source):
        path = _device_path(source)
        if not os.path.exists(path):
            raise ConfigurationError(
                f"{what}: expected a camera, got {source}: no such device; there are: "
                f"{', '.join(list_camera_devices()) or 'none'}"
            )
        # V4L2 only: FFmpeg and GStreamer open cameras too, but queue old images
        number = re.fullmatch(r"/dev/video(\d+)", path)
        return cv2.VideoCapture(int(number[1]) if number else path, cv2.CAP_V4L2)
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


def _images(capture: cv2.VideoCapture, misses: int) -> Iterator[NDArray[np.uint8]]:
    missed = 0
    while missed <= misses:
        there, image = capture.read()
        missed = 0 if there and image is not None else missed + 1
        if missed == 0:
            yield grey_if_channels_equal(np.asarray(image, np.uint8))
