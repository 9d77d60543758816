"""Decoding of JPEGs from untrusted logs."""

from typing import Final

import cv2
import numpy as np

from vergence.envs.reading import Image

_SOI_MARKER: Final = b"\xff\xd8"
_MAX_PIXELS: Final = 64 * 10**6
"""Largest number of pixels of an image (chosen: above any camera's; a corrupt file of a few KB may
claim ten times as many)."""
_SOF_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of the start-of-frame segment, which holds the size (physical: JPEG standard)."""
_SOS_MARKER: Final = 0xDA
"""Marker of the start-of-scan segment, after which no size follows (physical: JPEG standard)."""


def read_jpeg(data: bytes) -> Image | None:
    """Decode a JPEG to grey levels, (height, width); None if it is no JPEG, broken or too large."""
    if not 0 < _pixels(data) <= _MAX_PIXELS:
        return None
    try:
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)


def _pixels(data: bytes) -> int:
    """Number of pixels that a JPEG's header claims; 0 if it is no JPEG."""
    at = len(_SOI_MARKER)
    if not data.startswith(_SOI_MARKER):
        return 0
    while at + 9 <= len(data) and data[at] == 0xFF and data[at + 1] != _SOS_MARKER:
        if data[at + 1] in _SOF_MARKERS:
            height, width = (int.from_bytes(data[at + i : at + i + 2], "big") for i in (5, 7))
            return height * width
        at += 1 if data[at + 1] == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return 0
