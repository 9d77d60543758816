"""Decode squares that may be tags: threshold each cell by the levels around it."""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.tag_families import CORRECTED_BITS, TagFamilyCode
from vergence.vision.tags.library import FoundSquare

_THRESHOLD_WINDOW_CELLS: Final = 5
"""Side, in cells, of the window around a cell whose lightest and darkest cell give its threshold
(chosen: both colours in the window against shadows within it)."""
_LEAST_CONTRAST_GREY: Final = 8.0
"""Smallest median contrast within these windows, grey levels (chosen: dim tags against clutter)."""
_LEAST_BORDER_FRACTION: Final = 0.8
"""Smallest fraction of the border's cells that have its colour (chosen: covered tags against
clutter)."""


def decode_tag(
    image: NDArray[np.uint8], corners: NDArray[np.float64], code: TagFamilyCode
) -> FoundSquare | None:
    """Decode a square that may be a tag of a family.

    The libraries fit one plane of grey levels to the whole square; the local thresholds used here
    also read a square in which a shadow ends.

    Args:
        image: grey levels, shape (height, width).
        corners: corners of the square, in order around it, px, shape (4, 2).
        code: the family.

    Returns:
        The tag with the fewest wrong bits, its corners from its upper left one; None if it has more
        wrong bits than the family corrects, or if the contrast or the border is not a tag's.
    """
    start = (code.total_width - code.width_at_border) // 2
    size = code.width_at_border + 2
    square = code.width_at_border * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    transform = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    reach = code.total_width if not code.dark_inside else size
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
    kernel = np.ones((_THRESHOLD_WINDOW_CELLS, _THRESHOLD_WINDOW_CELLS), np.uint8)
    light, dark = cv2.dilate(grey, kernel), cv2.erode(grey, kernel)
    if float(np.median(light - dark)) < _LEAST_CONTRAST_GREY:
        return None
    # shadow scales levels: the geometric mean lies below white in shadow and above black in sun
    white = grey > np.sqrt((light + 1.0) * (dark + 1.0))
    # the border's ring has one colour in every orientation of the square
    inner = slice(-origin, -origin + code.width_at_border)
    ring = white[inner, inner].copy()
    ring[1:-1, 1:-1] = not code.dark_inside
    border_fraction = float((ring != code.dark_inside).mean())
    if border_fraction < _LEAST_BORDER_FRACTION:
        return None
    x, y = code.bit_cells.T - origin
    best: tuple[int, int, int] | None = None
    for turn in range(4):
        bits = np.rot90(white, turn)[y, x]
        word = int("".join("1" if bit else "0" for bit in bits), 2)
        wrong = np.bitwise_count(code.code_words ^ np.uint64(word))
        number = int(np.argmin(wrong))
        if best is None or int(wrong[number]) < best[0]:
            best = (int(wrong[number]), number, turn)
    assert best is not None
    if best[0] > CORRECTED_BITS[code.name]:
        return None
    # after `turn` quarter turns anticlockwise, corner number `turn` is the upper left one
    return FoundSquare(best[1], best[0], np.roll(corners, -best[2], axis=0), border_fraction)
