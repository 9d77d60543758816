"""The arrays of a tag's fit: what it looks at, what is sought, and the room that steps work in."""

from math import hypot, inf
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import View
from vergence.vision.tags.printed import MOST_REACHED

UNKNOWNS: Final = 19
"""Of a fit: eight of the homography, two logs of blurs, the spread of white, eight of a bend."""
SPREAD: Final = 10
"""Column of how far white reaches into black, px."""
BOWS: Final = 11
"""First column of the bend, in half edges, see `bend_at`."""
COLUMNS: Final = 3 + UNKNOWNS
"""Of a pixel: its grey, its block, the print, and the derivatives."""


class Sight(NamedTuple):
    """The image that a tag is looked for in, and where."""

    image: NDArray[np.uint8]
    """Grey levels, shape (height, width)."""
    light: FloatArray
    """(256,) of each of them."""
    rays: NDArray[np.float32]
    """(height, width, 2) undistorted, or (0, 0, 2) for pixels that are such."""
    plane: View
    """The plane that the lens does not bend."""
    left: int
    """The first pixel that is looked at along u, maybe outside of the image; and so on."""
    right: int
    top: int
    bottom: int


class TagPrint(NamedTuple):
    """What is printed."""

    cells: FloatArray
    """(n, n) 0 black to 1 white, nan unknown."""
    border: int
    """Cells along the square whose corners are sought, in the middle of the print."""
    quiet: float
    """How wide the quiet zone around it is taken to be, cells."""


class Sought(NamedTuple):
    """Where a tag is, and how it looks."""

    corners: FloatArray
    """(4, 2) undistorted, px."""
    G: FloatArray
    """(3, 3) homography from the undistorted image to the tag's plane, see `plane_of`."""
    H: FloatArray
    """(3, 3) its inverse, see `back_of`."""
    blurs: FloatArray
    """(2,) across the edges along x and along y, px."""
    bent: FloatArray
    """(9,) the spread, px, and the bend's coefficients, see `bend_at`."""


class Blocks(NamedTuple):
    """What is known of each block: sums over its pixels, and what they come to."""

    plain: FloatArray
    """(K, 5) sums of 1, T, T^2, I, T I."""
    slopes: FloatArray
    """(K, 2, unknowns) of the derivatives of T, and of T times them."""
    normal: FloatArray
    """(K, unknowns, unknowns) of the derivatives' products, levels eliminated."""
    scores: FloatArray
    """(K, unknowns) of the derivatives times what the print leaves."""
    levels: FloatArray
    """(K, 2) dark level and contrast, no contrast for those that say nothing."""
    weights: FloatArray
    """(K,) how much they count."""


class Room(NamedTuple):
    """What steps work in."""

    places: FloatArray
    """(pixels, 3) undistorted place and light of those that take part."""
    pixels: FloatArray
    """(pixels, `COLUMNS`) see `evaluate_print`."""
    along_x: FloatArray
    """(4, `MOST_REACHED`) see `printed_at`."""
    along_y: FloatArray
    """The same."""
    blocks: Blocks
    matrix: FloatArray
    """(unknowns, unknowns) normal matrix, and its lower Cholesky factor after a step."""
    step: FloatArray
    """(unknowns,) right side, and the step."""
    last: FloatArray
    """(unknowns,) the step before, 0 before the first one of a stage."""
    pace: FloatArray
    """(2,) the share of a step that was taken, and the slope along it where it began."""


@subroutine
def make_room(pixels: int, blocks: int) -> Room:
    """Room for so many pixels and blocks."""
    return Room(
        np.empty((pixels, 3)),
        np.empty((pixels, COLUMNS)),
        np.empty((4, MOST_REACHED)),
        np.empty((4, MOST_REACHED)),
        Blocks(
            np.empty((blocks, 5)),
            np.empty((blocks, 2, UNKNOWNS)),
            np.empty((blocks, UNKNOWNS, UNKNOWNS)),
            np.empty((blocks, UNKNOWNS)),
            np.empty((blocks, 2)),
            np.empty(blocks),
        ),
        np.empty((UNKNOWNS, UNKNOWNS)),
        np.empty(UNKNOWNS),
        np.empty(UNKNOWNS),
        np.empty(2),
    )


@subroutine
def place_of(k: int) -> tuple[float, float]:
    """The place of a corner in the tag's plane, half edges, or of the centre after the last."""
    if k == 4:
        return 0.0, 0.0
    return -1.0 if k == 0 or k == 3 else 1.0, -1.0 if k < 2 else 1.0


class Sides(NamedTuple):
    """Lengths of the sides of a square in an image."""

    shortest: float
    longest: float
    """Infinite where a corner is nowhere."""
    perimeter: float


@subroutine
def sides_of(corners: FloatArray) -> Sides:
    """The lengths of the sides between (4, 2) corners."""
    shortest, longest, perimeter = inf, 0.0, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, perimeter = min(shortest, side), perimeter + side
        longest = max(longest, side) if side < inf else inf
    return Sides(shortest, longest, perimeter)
