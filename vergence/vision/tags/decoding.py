"""Numbers of squares that may be tags, their cells read by the levels around each."""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.tag_families import CORRECTED_BITS, TagFamilyCode
from vergence.vision.tags.library import FoundSquare

_AROUND: Final = 5
"""Cells along the square around a cell whose lightest and darkest give its threshold."""
_LEAST_CONTRAST_GREY: Final = 8.0
_LEAST_PLAIN: Final = 0.8
"""Share of the border's cells that must have its colour."""


def decode(
    image: NDArray[np.uint8], corners: NDArray[np.float64], code: TagFamilyCode
) -> FoundSquare | None:
    """Which tag of a family a square may be.

    Unlike the libraries' own reading, which takes one plane of grey for all of the square, this one
    stands a shadow that ends within it.

    Args:
        image: grey levels, shape (height, width).
        corners: of the square that may be a tag's, in turn, px, shape (4, 2).
        code: the family.

    Returns:
        The tag with the fewest wrong bits, its corners from its upper left one; None where none is
        near enough.
    """
    start = (code.total - code.border) // 2
    size = code.border + 2
    square = code.border * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    transform = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    reach = code.total if not code.dark_inside else size
    origin = -start if not code.dark_inside else -1
    middles = np.arange(reach) + origin + 0.5
    probes = np.array([[0.0, 0.0], [0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]])
    cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 1, 2) + probes
    where = cv2.perspectiveTransform(cells.reshape(1, -1, 2), transform)
    remap: Any = cv2.remap
    grey = remap(
        image, where.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    grey = grey.reshape(reach, reach, len(probes)).astype(np.float32).mean(axis=-1)
    kernel = np.ones((_AROUND, _AROUND), np.uint8)
    light, dark = cv2.dilate(grey, kernel), cv2.erode(grey, kernel)
    if float(np.median(light - dark)) < _LEAST_CONTRAST_GREY:
        return None
    # light multiplies: the geometric mean lies below white in the shadow and above black in the sun
    white = grey > np.sqrt((light + 1.0) * (dark + 1.0))
    # the border's own ring has one colour, whichever way the square is turned
    inner = slice(-origin, -origin + code.border)
    ring = white[inner, inner].copy()
    ring[1:-1, 1:-1] = not code.dark_inside
    plain = float((ring != code.dark_inside).mean())
    if plain < _LEAST_PLAIN:
        return None
    x, y = code.places.T - origin
    best: tuple[int, int, int] | None = None
    for turn in range(4):
        bits = np.rot90(white, turn)[y, x]
        word = int("".join("1" if bit else "0" for bit in bits), 2)
        wrong = np.bitwise_count(code.words ^ np.uint64(word))
        number = int(np.argmin(wrong))
        if best is None or int(wrong[number]) < best[0]:
            best = (int(wrong[number]), number, turn)
    assert best is not None
    if best[0] > CORRECTED_BITS[code.name]:
        return None
    # turned by so many quarters against the clock, the corner after as many is the upper left one
    return FoundSquare(best[1], best[0], np.roll(corners, -best[2], axis=0), plain)
