"""Images as detectors take them: 8 bits of grey, out of whatever a camera or a file gives."""

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, UnreadableFileError

_EXPECTED: Final = (
    "expected an array (height, width), or (height, width, 3 or 4) in OpenCV's order BGR(A), of "
    "whole numbers or floats"
)
_DEPTHS: Final = (8, 10, 12, 14, 16)
"""Bits of a pixel that cameras have. What is wider than 8 comes in 16, mostly unscaled."""


def as_grey(image: ArrayLike, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """An image in grey levels of 8 bits.

    Args:
        image: (height, width) or (height, width, 1) grey, (height, width, 3) BGR or
            (height, width, 4) BGRA. uint8 is taken as it is; wider whole numbers by the least of
            8, 10, 12, 14, 16 bits that holds the greatest of them; floats as 0 to 1, or as 0 to 255
            (or to what 16 bits hold) where one is above 1; bool as black and white. A float that
            is not finite is black.
        size: (width, height) that it must have, a camera's; None for any.

    Returns:
        Grey levels, shape (height, width), in one piece of memory that can be written to; the
        image itself where it is such already.

    Raises:
        ConfigurationError: this is no image, it is empty, or of another size.
    """
    try:
        array = np.asarray(image)
    except (TypeError, ValueError) as error:  # a tensor elsewhere, rows of different lengths
        raise ConfigurationError(f"image: {_EXPECTED}; got {type(image).__name__}") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    colour = array.ndim == 3 and array.shape[2] in (3, 4)
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
    if array.dtype != np.uint8:
        array = _eight_bits(array)
    if colour:
        code = cv2.COLOR_BGRA2GRAY if array.shape[2] == 4 else cv2.COLOR_BGR2GRAY
        array = np.asarray(cv2.cvtColor(np.ascontiguousarray(array), code))
    # numba would compile the kernels once more for arrays that cannot be written to
    grey: NDArray[np.uint8] = np.require(array, requirements=["C", "W"])
    return grey


def _in_a_line(image: object) -> str:
    return " ".join(repr(image).split())[:80]


def _eight_bits(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Any numbers as 8 bits."""
    if array.dtype.kind == "b":
        return np.where(array, np.uint8(255), np.uint8(0))
    with np.errstate(over="ignore"):  # what is beyond float32 is none of a camera's levels
        values = np.asarray(array, np.float32)
    if array.dtype.kind == "f":
        values = np.where(np.isfinite(values), values, np.float32(0.0))
    least, greatest = float(values.min()), float(values.max())
    if least < 0.0 and array.dtype.kind != "f":
        raise ConfigurationError(f"image: expected grey levels of at least 0, got {least:g}")
    if array.dtype.kind == "f" and greatest <= 1.0:
        full = 1.0
    else:
        full = next((2.0**bits - 1.0 for bits in _DEPTHS if greatest < 2.0**bits), greatest)
    scaled: NDArray[np.uint8] = np.rint(np.clip(values * (255.0 / full), 0.0, 255.0)).astype(
        np.uint8
    )
    return scaled


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """The image in a file, in grey levels of 8 bits.

    Args:
        path: of a PNG, JPEG, TIFF or what else OpenCV reads, of any depth; turned as its EXIF says.

    Returns:
        Grey levels, shape (height, width).

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
        read: Any = cv2.imdecode(
            np.frombuffer(content, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
        )
    except cv2.error as error:  # sizes beyond what OpenCV takes, damaged headers
        raise UnreadableFileError(str(path), "no image, or a damaged one", expected) from error
    if read is None or read.size == 0:
        raise UnreadableFileError(str(path), "no image, or a damaged one", expected)
    return as_grey(read)
