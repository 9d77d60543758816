"""Accepting a fit as a tag, and the library's corners of a tag whose paper is bent."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.models.tag_families import CORRECTED_BITS, TagFamilyCode
from vergence.vision.tags.decoding import decode
from vergence.vision.tags.library import FoundSquare
from vergence.vision.tags.report import Fit

LEAST_EDGE_PX: Final = 8.0
_LEAST_EXPLAINED: Final = 0.5
"""Share of the variance near the edges that the print explains."""
_LEAST_CONTRAST_GREY: Final = 5.0
_LEAST_RIM: Final = 0.1
"""Of the contrast, by which the light steps at the sides of the square: the inside of a border of
two bits, as kalibr's grids have it, reads like a tag."""
_MOST_FRAME: Final = 1
"""Cells of the frame around the code that may be wrong."""
_MOST_UNCLEAR: Final = 0.2
"""Of a quarter's cells; of 789 tags in public photographs none has more."""
_FOUND_SIGMA: Final = (0.3, 0.015)
"""Standard deviation of the library's own corners of a bent tag: the greater one of px, in the
image that was searched, and of the shortest edge. Measured on drawn tags bent by up to 8 mm in
150, whose worst corner lay 0.6 to 2.5 % of the edge aside (tests/vision/tags/test_bent.py)."""
_BENT_EXPLAINED: Final = 0.9
_BENT_WRONG: Final = 5
_BENT_UNCLEAR: Final = 0.25
"""What a plane print explains of a bent tag at least, and the cells that it reads wrong or not
clearly at most. With more, as many tags would be found whose side something covers."""


def reads_as_tag(fit: Fit, code: TagFamilyCode) -> bool:
    """Tell whether what was fitted is the tag that was asked for.

    Args:
        fit: of the tag's edges.
        code: its family.

    Returns:
        True where the print explains the light, the cells read as printed and the border is one
        cell wide.
    """
    if fit.contrast < _LEAST_CONTRAST_GREY or fit.explained < _LEAST_EXPLAINED:
        return False
    wrong, frame, unclear = fit.reading
    if wrong > CORRECTED_BITS[code.name] or frame > _MOST_FRAME or unclear > _MOST_UNCLEAR:
        return False
    return fit.rim >= _LEAST_RIM


def may_be_bent(fit: Fit) -> bool:
    """Tell whether a refused fit may be that of a tag on bent paper.

    Args:
        fit: one that `reads_as_tag` refuses.

    Returns:
        True where there is no fit, or nearly a good one: on bent paper a fit may not converge, and
        a good one reads cells near the corners wrong.
    """
    wrong, frame, unclear = fit.reading
    near = wrong <= _BENT_WRONG and frame <= _MOST_FRAME and unclear <= _BENT_UNCLEAR
    return fit.contrast == 0.0 or (near and fit.explained >= _BENT_EXPLAINED)


def sigma_as_found(
    image: NDArray[np.uint8], square: FoundSquare, scale: float, code: TagFamilyCode
) -> float | None:
    """Give the standard deviation of the library's own corners of a tag that may be bent.

    Args:
        image: grey levels, shape (height, width).
        square: the tag as the library found it, in the pixels of `image`.
        scale: pixels of the image by pixels of that in which the library looked.
        code: the family.

    Returns:
        Standard deviation, px; None for no tag: all bits must be right, another reading must agree,
        and the family be one in which chance does not make that so.
    """
    corners, edge = square.corners, shortest_edge(square.corners)
    height, width = image.shape
    # where the image's side cuts a tag, the library draws its corner in
    cell = edge / code.border
    inside = (corners > cell).all() and (corners < (width - cell, height - cell)).all()
    if not inside or edge < LEAST_EDGE_PX or not CORRECTED_BITS[code.name]:
        return None
    read = decode(image, corners, code)
    if square.wrong_bits or read is None or read.id != square.id:
        return None
    sigma = max(_FOUND_SIGMA[0] * scale, _FOUND_SIGMA[1] * edge)
    # something may cover a side, and moves its corners
    return sigma if read.plain == 1.0 else max(sigma, 0.5 * cell)


def shortest_edge(corners: NDArray[np.float64]) -> float:
    """Length of the shortest edge between four corners (4, 2), in their unit."""
    a, b, c, d = corners.tolist()
    return min(math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a))
