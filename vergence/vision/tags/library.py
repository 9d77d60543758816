"""Find squares that read as tags with the AprilTag library."""

import threading
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import pyapriltags
from numpy.typing import NDArray

from vergence.vision.tag_families import CORRECTED_BITS, library_family

_LEAST_SIDE_PX: Final = 24
"""Smallest side of an image that is searched, px: the library fails on images of a few pixels
(chosen: with a margin)."""
_SHARPENING: Final = 0.25
"""Strength of sharpening, the library's default; it helps with small tags, and the binding would
round it down to 0 (chosen: by the library)."""


class FoundSquare(NamedTuple):
    """A square that reads as a tag."""

    id: int
    wrong_bits: int
    corners: NDArray[np.float64]
    """Corners from the tag's upper left one, clockwise in the image, in OpenCV's pixels, shape
    (4, 2)."""
    border_fraction: float = 1.0
    """Fraction of the border's cells that have its colour; 1 if the cells were not read."""


class _Detectors(threading.local):
    """The library's detectors of this thread; they keep state during a search."""

    def __init__(self) -> None:
        self.of_family: dict[str, Any] = {}
        self.of_all: Any = None


_DETECTORS: Final = _Detectors()


def find_squares(image: NDArray[np.uint8], family: str) -> list[FoundSquare]:
    """Search an image for all tags of a family.

    Args:
        image: grey levels, shape (height, width).
        family: see `vergence.vision.tag_families`.

    Returns:
        Squares that read as tags, sorted by number and wrong bits.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return []
    detector = _DETECTORS.of_family.get(family)
    if detector is None:
        detector = _make({family: CORRECTED_BITS[family]})
        _DETECTORS.of_family[family] = detector
    # the library's origin is the corner of the first pixel; its corners begin at the lower left
    found = [
        FoundSquare(each.tag_id, each.hamming, np.asarray(each.corners, float)[::-1] - 0.5)
        for each in detector.detect(image)
    ]
    return sorted(found, key=lambda each: (each.id, each.wrong_bits))


def families_in(image: NDArray[np.uint8]) -> list[str]:
    """Families that seem to have tags in an image, from one search for all families.

    Args:
        image: grey levels, shape (height, width).

    Returns:
        Families with at least one square that reads as a tag without a wrong bit, the most
        frequent first.
    """
    if min(image.shape) < _LEAST_SIDE_PX:
        return []
    if _DETECTORS.of_all is None:
        _DETECTORS.of_all = _make(dict.fromkeys(CORRECTED_BITS, 0))
    names = (each.tag_family.decode() for each in _DETECTORS.of_all.detect(image))
    return [name.removeprefix("tag") for name, _ in Counter(names).most_common()]


def _make(corrected: Mapping[str, int]) -> Any:
    """Make a detector of the library, given the number of corrected bits of each family.

    The binding itself lacks some families, and adds the others with two corrected bits each,
    regardless of the cost.
    """
    detector: Any = pyapriltags.Detector(families="", nthreads=1, quad_decimate=1.0)
    for family, bits in corrected.items():
        made = library_family(detector.libc, family)
        detector.libc.apriltag_detector_add_family_bits(detector.tag_detector_ptr, made, bits)
    detector.tag_detector_ptr.contents.decode_sharpening = _SHARPENING
    return detector
