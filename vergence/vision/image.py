"""Images as detectors take them: 8 bits of grey, or light, of whatever a camera or file gives."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, overload

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.response import Response, light_of, light_of_levels, parse_response

_EXPECTED: Final = (
    "expected an array (height, width), or (height, width, 3 or 4) in OpenCV's order BGR(A), of "
    "whole numbers or floats"
)
_DEPTHS: Final = (8, 10, 12, 14, 16)
"""Bits of a pixel that cameras have. What is wider than 8 comes in 16, mostly unscaled."""
_USUAL_PERCENT: Final = 99.9
_MOST_UNIT: Final = 2.0
"""The greatest float of an image whose white is 1."""
_CALM_GREY: Final = 1.5
"""Noise, as a standard deviation, that searches for squares stand without smoothing."""
_LOUD_GREY: Final = 8.0
_MEDIAN_OF_SECOND: Final = 1.652
"""Of |2 a - b - c|, for normal numbers of standard deviation 1."""
_LEAST_RANGE_GREY: Final = 6.0
_LEAST_SIDE_PX: Final = 16
_COLOURS_EVERY_PX: Final = 8
"""Spacing of the pixels by which a video's image counts as grey; noise alone colours some."""
_SAME_GREY: Final = 3
"""By how much channels of a grey image differ: what video codecs round in brightness and colour."""


@overload
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: None = None
) -> NDArray[np.uint8]: ...
@overload
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: Response
) -> NDArray[np.float32]: ...
def as_grey(
    image: ArrayLike, size: tuple[int, int] | None = None, *, response: Response | None = None
) -> NDArray[Any]:
    """An image in grey levels of 8 bits, or in light.

    Args:
        image: (height, width) or (height, width, 1) grey, (height, width, 3) BGR or
            (height, width, 4) BGRA. uint8 is taken as it is; wider whole numbers by the least of
            8, 10, 12, 14, 16 bits that holds them, but for a thousandth that may be hot pixels;
            floats as 0 to 1, or as 0 to 255 (or to what 16 bits hold) where they are above 2; bool
            as black and white. NaN is black.
        size: (width, height) that it must have, a camera's; None for any.
        response: light by level, see `parse_response`; None for the levels as they are.

    Returns:
        Grey levels, uint8, shape (height, width), in one piece of memory that can be written; the
        image itself where it is such already. With a response light, float32, 0 to 255: colours
        are weighted as light, and no depth is lost.

    Raises:
        ConfigurationError: this is no image, it is empty, or of another size; this is no response.
    """
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:  # a tensor elsewhere, rows of different lengths
        raise ConfigurationError(f"image: {_EXPECTED}; got {type(image).__name__}") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    colour = has_colours(array)
    if array.dtype.kind not in "buif" or not (colour or array.ndim == 2):
        what = f"shape {array.shape} of {array.dtype}" if array.shape else _in_a_line(image)
        raise ConfigurationError(f"image: {_EXPECTED}; got {what}")
    if array.size == 0:
        raise ConfigurationError(f"image: expected pixels, got an empty array of {array.shape}")
    height, width = array.shape[:2]
    if size is not None and (width, height) != size:
        raise ConfigurationError(
            f"image: expected the camera's {size[0]} x {size[1]} px, got {width} x {height}"
        )
    if response is not None:
        array = _light(array, parse_response(response))
    elif array.dtype != np.uint8:
        array = _eight_bits(array)
    if colour:
        code = cv2.COLOR_BGRA2GRAY if array.shape[2] == 4 else cv2.COLOR_BGR2GRAY
        array = np.asarray(cv2.cvtColor(np.ascontiguousarray(array), code))
    grey: NDArray[Any] = np.ascontiguousarray(array)
    # kernels are compiled for arrays that can be written
    return grey if grey.flags.writeable else grey.copy()


def has_colours(image: ArrayLike) -> bool:
    """Whether an image that `as_grey` takes has colours, not grey levels alone."""
    shape = np.shape(image)
    return len(shape) == 3 and shape[2] in (3, 4)


def measured_levels(image: ArrayLike, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """The levels of 8 bits that targets are measured in: of colours, those of green.

    Green has half of a Bayer mosaic's pixels, and lies where it should where a lens bends red less
    and blue more.

    Args:
        image: see `as_grey`.
        size: the same.

    Raises:
        ConfigurationError: as `as_grey`.
    """
    return as_grey(np.asarray(image)[..., 1] if has_colours(image) else image, size)


def as_taken(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A video's image with colours only where its camera has them: OpenCV decodes grey as BGR.

    Args:
        frame: (height, width) or (height, width, 3) as OpenCV gives it.

    Returns:
        The frame, or its grey levels where all channels have the same.
    """
    if not has_colours(frame):
        return frame
    some = frame[::_COLOURS_EVERY_PX, ::_COLOURS_EVERY_PX]
    return frame if np.ptp(some, axis=2).max() > _SAME_GREY else as_grey(frame)


def _in_a_line(image: object) -> str:
    return " ".join(repr(image).split())[:80]


def _light(array: NDArray[Any], response: Response) -> NDArray[np.float32]:
    """Levels of any depth as light, 0 to 255."""
    if array.dtype == np.uint8:
        light = light_of_levels(response)[array]
    else:
        light = 255.0 * light_of(_levels(array) / 255.0, response)
    return np.asarray(light, np.float32)


def _eight_bits(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Any numbers as 8 bits."""
    return np.rint(_levels(array)).astype(np.uint8)


def _levels(array: NDArray[Any]) -> NDArray[np.float32]:
    """Any numbers as levels from 0 to 255, with what lies between whole ones."""
    if array.dtype.kind == "b":
        return np.where(array, np.float32(255.0), np.float32(0.0))
    with np.errstate(over="ignore"):  # what is beyond float32 is none of a camera's levels
        values = np.asarray(array, np.float32)
    floats = array.dtype.kind == "f"
    if floats:
        values = np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=0.0)
    elif float(values.min()) < 0.0:
        raise ConfigurationError(f"image: expected grey levels of at least 0, got {values.min():g}")
    # but for a hot pixel, or what an interpolation overshoots
    some = values[:: max(values.shape[0] // 400, 1), :: max(values.shape[1] // 400, 1)]
    finite = some[np.isfinite(some)]
    greatest = float(np.percentile(finite, _USUAL_PERCENT)) if finite.size else 1.0
    if floats and greatest <= _MOST_UNIT:
        full = 1.0
    else:
        full = next((2.0**bits - 1.0 for bits in _DEPTHS if greatest < 2.0**bits), greatest)
    scaled: NDArray[np.float32] = np.clip(values * (255.0 / full), 0.0, 255.0)
    return scaled


def smoothed(image: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """An image in which searches for squares do not drown: smoothed where it is noisy.

    They take ten times as long on an empty wall with noise as on one without. The noise is taken
    from the median of second differences, which few edges lift.

    Args:
        image: grey levels, shape (height, width).

    Returns:
        The image itself where it is calm; None where nothing stands out of the noise, and nothing
        is to be found.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return None
    part = image[:: max(image.shape[0] // 200, 1)].astype(np.int16)  # some rows tell of all
    second = np.abs(2 * part[:, 1:-1] - part[:, :-2] - part[:, 2:])
    noise = float(np.median(second)) / _MEDIAN_OF_SECOND
    if noise <= _CALM_GREY:
        plain = int(image.max()) - int(image.min()) < _LEAST_RANGE_GREY + 10.0 * noise
        return None if plain else image
    blur_px = 1.0 if noise <= _LOUD_GREY else 2.0
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8)
    # white noise is divided by 2 sqrt(pi) times the blur; its extremes are some five deviations
    left = noise / (2.0 * math.sqrt(math.pi) * blur_px)
    if int(smooth.max()) - int(smooth.min()) < _LEAST_RANGE_GREY + 10.0 * left:
        return None
    return smooth


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Keep OpenCV from logging several lines on what it cannot open, where one of ours says it."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """The image in a file, in grey levels of 8 bits.

    Args:
        path: see `read_pixels`.

    Returns:
        Grey levels, shape (height, width).

    Raises:
        UnreadableFileError: see `read_pixels`.
    """
    return as_grey(read_pixels(path))


def read_pixels(path: str | Path) -> NDArray[Any]:
    """The image in a file, with the depth and the colours that it has there.

    Args:
        path: of a PNG, JPEG, TIFF or what else OpenCV reads, of any depth; turned as its EXIF says.

    Returns:
        (height, width) grey or (height, width, 3) BGR.

    Raises:
        UnreadableFileError: it is not there, empty, or no image.
    """
    expected = "an image that OpenCV reads, such as PNG or JPEG"
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UnreadableFileError(str(path), reason, expected) from error
    except ValueError as error:  # a null byte in the path
        raise UnreadableFileError(repr(str(path)), str(error), expected) from error
    if not content:
        raise UnreadableFileError(str(path), "empty", expected)
    try:
        with silent_opencv():
            read: Any = cv2.imdecode(
                np.frombuffer(content, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
            )
    except cv2.error as error:  # sizes beyond what OpenCV takes, damaged headers
        raise UnreadableFileError(str(path), "no image, or a damaged one", expected) from error
    if read is None or read.size == 0:
        raise UnreadableFileError(str(path), "no image, or a damaged one", expected)
    return np.asarray(read)
