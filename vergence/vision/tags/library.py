"""Squares that read as tags, by the AprilTag library."""

import threading
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.models.tag_families import CORRECTED_BITS, library_family

_LEAST_SIDE_PX: Final = 24
"""Of an image; the library's own arithmetic fails on images of a few pixels."""
_SHARPENING: Final = 0.25
"""The library's default, which helps with small tags; the binding rounds it down to none."""


class FoundSquare(NamedTuple):
    """A square that reads as a tag."""

    id: int
    wrong_bits: int
    corners: NDArray[np.float64]
    """From the tag's upper left one, clockwise as it is seen, OpenCV's pixels, shape (4, 2)."""
    plain: float = 1.0
    """Share of the border's cells that have its colour; 1 where they were not read one by one."""


class _Detectors(threading.local):
    """The library's detectors of this thread: they keep state while they look."""

    def __init__(self) -> None:
        self.of_family: dict[str, Any] = {}
        self.of_all: Any = None


_DETECTORS: Final = _Detectors()


def find_squares(image: NDArray[np.uint8], family: str) -> list[FoundSquare]:
    """Look through an image for all tags of a family.

    Args:
        image: grey levels, shape (height, width).
        family: see `vergence.models.tag_families`.

    Returns:
        What reads as a tag, by its number.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return []
    detector = _DETECTORS.of_family.get(family)
    if detector is None:
        detector = _make({family: CORRECTED_BITS[family]})
        _DETECTORS.of_family[family] = detector
    # the library counts pixels from the corner of the first one, and corners from the lower left
    found = [
        FoundSquare(each.tag_id, each.hamming, np.asarray(each.corners, float)[::-1] - 0.5)
        for each in detector.detect(image)
    ]
    return sorted(found, key=lambda each: (each.id, each.wrong_bits))


def families_in(image: NDArray[np.uint8]) -> list[str]:
    """The families of which there seem to be tags, all of them looked for at once.

    Args:
        image: grey levels, shape (height, width).

    Returns:
        Those of which something reads as a tag without a wrong bit; by how often.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return []
    if _DETECTORS.of_all is None:
        _DETECTORS.of_all = _make(dict.fromkeys(CORRECTED_BITS, 0))
    names = (each.tag_family.decode() for each in _DETECTORS.of_all.detect(image))
    return [name.removeprefix("tag") for name, _ in Counter(names).most_common()]


def _make(corrected: Mapping[str, int]) -> Any:
    """A detector of the library for families, with so many corrected bits of each.

    The binding adds families itself with two corrected bits, whatever that takes, and knows not
    all of them.
    """
    detector: Any = pyapriltags.Detector(families="", nthreads=1, quad_decimate=1.0)
    for family, bits in corrected.items():
        made = library_family(detector.libc, family)
        detector.libc.apriltag_detector_add_family_bits(detector.tag_detector_ptr, made, bits)
    detector.tag_detector_ptr.contents.decode_sharpening = _SHARPENING
    return detector
