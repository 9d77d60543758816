"""Decide if a fit is a tag, and give a sigma to the library's corners of a tag on bent paper."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.vision.tag_families import CORRECTED_BITS, TagFamilyCode
from vergence.vision.tags.decoding import decode_tag
from vergence.vision.tags.library import FoundSquare
from vergence.vision.tags.report import TagFit

LEAST_EDGE_PX: Final = 8.0
"""Shortest edge of a tag that is read, px (chosen: smaller tags against clutter)."""
_LEAST_EXPLAINED_FRACTION: Final = 0.5
"""Smallest fraction of the variance near the edges that the print explains (chosen: tags in bad
light against false tags)."""
_LEAST_CONTRAST_GREY: Final = 5.0
"""Smallest mean contrast of a tag, grey levels of light (chosen: dim tags against noise)."""
_LEAST_BORDER_STEP: Final = 0.1
"""Smallest mean step of the light across the square's sides, as a fraction of the contrast. It
rejects the inside of a border two cells wide, as in kalibr's grids, which reads like a tag
(chosen: blurred tags against such insides)."""
_MAX_WRONG_RIM_CELLS: Final = 1
"""Most wrong cells in the frame around the code (chosen: dirty tags against false ones)."""
_MAX_UNCLEAR_FRACTION: Final = 0.2
"""Largest fraction of wrong or unclear cells in any quarter of the tag (measured: none of 789 tags
in public photographs has more)."""
_LIBRARY_CORNER_SIGMA: Final = (0.3, 0.015)
"""Standard deviation of the library's own corners of a bent tag: the larger of 0.3 px in the image
that was searched, and 0.015 of the shortest edge. Drawn tags bent by up to 8 mm in 150 had their
worst corner 0.6 to 2.5 % of the edge off (measured: tests/vision/tags/test_bent.py)."""
_LEAST_BENT_EXPLAINED: Final = 0.9
"""Smallest fraction of the variance that a plane print explains of a tag on bent paper (chosen:
bent tags against tags with a covered side)."""
_MAX_BENT_WRONG_CELLS: Final = 5
"""Most cells of a bent tag that a plane print reads wrong (chosen: as above)."""
_MAX_BENT_UNCLEAR: Final = 0.25
"""Largest fraction of unclear cells in a quarter of a bent tag (chosen: looser bounds would accept
as many tags with a covered side)."""


def reads_as_tag(fit: TagFit, code: TagFamilyCode) -> bool:
    """Check that a fit is the tag that was asked for.

    Args:
        fit: fit of the tag's edges.
        code: the tag's family.

    Returns:
        True if the print explains the light, the cells read as printed and the border is one
        cell wide.
    """
    if fit.contrast < _LEAST_CONTRAST_GREY or fit.explained_fraction < _LEAST_EXPLAINED_FRACTION:
        return False
    wrong, frame, unclear = fit.reading
    if (
        wrong > CORRECTED_BITS[code.name]
        or frame > _MAX_WRONG_RIM_CELLS
        or unclear > _MAX_UNCLEAR_FRACTION
    ):
        return False
    return fit.relative_border_step >= _LEAST_BORDER_STEP


def refused_tag_may_be_bent(refused_fit: TagFit) -> bool:
    """Check if a refused fit may be of a tag on bent paper.

    Args:
        refused_fit: a fit that `reads_as_tag` refuses.

    Returns:
        True if there is no fit, or one that is nearly good: on bent paper a fit may fail to
        converge, and a converged fit reads cells near the corners wrong.
    """
    wrong, frame, unclear = refused_fit.reading
    near = (
        wrong <= _MAX_BENT_WRONG_CELLS
        and frame <= _MAX_WRONG_RIM_CELLS
        and unclear <= _MAX_BENT_UNCLEAR
    )
    return refused_fit.contrast == 0.0 or (
        near and refused_fit.explained_fraction >= _LEAST_BENT_EXPLAINED
    )


def library_corner_sigma_px(
    image: NDArray[np.uint8], square: FoundSquare, upscaling: float, code: TagFamilyCode
) -> float | None:
    """Standard deviation of the library's own corners of a tag that may be bent.

    Args:
        image: grey levels, shape (height, width).
        square: the tag as the library found it, in the pixels of `image`.
        upscaling: pixels of `image` per pixel of the image that the library searched.
        code: the family.

    Returns:
        Standard deviation, px; None if this is no tag. A tag has no wrong bit, `decode_tag` reads
        the same number, and its family corrects bits: in other families clutter often reads as
        a tag.
    """
    corners, edge = square.corners, shortest_edge(square.corners)
    height, width = image.shape
    # if the image's side cuts a tag, the library moves its corner into the image
    cell = edge / code.width_at_border
    inside = (corners > cell).all() and (corners < (width - cell, height - cell)).all()
    if not inside or edge < LEAST_EDGE_PX or not CORRECTED_BITS[code.name]:
        return None
    read = decode_tag(image, corners, code)
    if square.wrong_bits or read is None or read.id != square.id:
        return None
    sigma = max(_LIBRARY_CORNER_SIGMA[0] * upscaling, _LIBRARY_CORNER_SIGMA[1] * edge)
    # an object that covers part of a side would move its corners
    return sigma if read.border_fraction == 1.0 else max(sigma, 0.5 * cell)


def shortest_edge(corners: NDArray[np.float64]) -> float:
    """Length of the shortest edge between four corners, shape (4, 2), in their unit."""
    a, b, c, d = corners.tolist()
    return min(math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a))
