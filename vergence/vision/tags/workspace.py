"""The arrays of a tag's fit: the image, the unknowns, and the working arrays of its steps."""

from math import hypot, inf
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import UndistortedView
from vergence.vision.tags.printed import MAX_BLURRED_CELLS

MAX_UNKNOWNS: Final = 23
"""Unknowns of a fit: eight of the homography, two logarithms of blurs, the spread of white into
black, twelve of a bend (numerical)."""
WHITE_SPREAD_INDEX: Final = 10
"""Index of the spread, px, among the unknowns (numerical)."""
BEND_START: Final = 11
"""Index of the bend's first coefficient, half edges, see `bend_displacement` (numerical)."""
CUBIC_START: Final = 15
"""Index of the first cubic coefficient of the bend, half edges (numerical)."""
PIXEL_COLUMNS: Final = 3 + MAX_UNKNOWNS
"""Columns of a pixel: its light, its block, the print, and the derivatives (numerical)."""


class SearchRegion(NamedTuple):
    """The image that a tag is searched in, and the region of the search."""

    image: NDArray[np.uint8]
    """Grey levels, shape (height, width)."""
    light_by_grey: FloatArray
    """(256,) light of each grey level."""
    rays: NDArray[np.float32]
    """(height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole."""
    undistorted_view: UndistortedView
    """The undistorted plane."""
    left: int
    """First pixel of the region along u; it may lie outside of the image, as the next three may."""
    right: int
    top: int
    bottom: int


class TagPrint(NamedTuple):
    """The print of a tag."""

    cells: FloatArray
    """(n, n) 0 black to 1 white, nan unknown."""
    side_cells: int
    """Side of the square whose corners are sought, cells; centred in the print."""
    quiet_zone_cells: float
    """Assumed width of the quiet zone around the square, cells."""


class FitState(NamedTuple):
    """The unknowns of a fit: a tag's pose, blurs, spread and bend."""

    corners: FloatArray
    """(4, 2) undistorted, px."""
    G: FloatArray
    """(3, 3) homography from the undistorted image to the tag's plane, see
    `image_to_square_homography`."""
    H: FloatArray
    """(3, 3) its inverse, see `square_to_image_homography`."""
    blurs_px: FloatArray
    """(2,) across the edges along x and along y, px."""
    white_spread_and_bend: FloatArray
    """(13,) the spread, px, and the bend's coefficients, see `bend_displacement`."""


class Blocks(NamedTuple):
    """Sums over the pixels of each block, and the levels and weights that follow from them."""

    moments: FloatArray
    """(K, 5) sums of 1, T, T^2, I, T I."""
    derivative_sums: FloatArray
    """(K, 2, unknowns) sums of the derivatives of T, and of T times them."""
    normal_matrices: FloatArray
    """(K, unknowns, unknowns) normal matrices, levels eliminated."""
    scores: FloatArray
    """(K, unknowns) sums of the derivatives times the residuals."""
    levels: FloatArray
    """(K, 2) dark level and contrast; contrast 0 for blocks that are not used."""
    weights: FloatArray
    """(K,) weights."""


class FitBuffers(NamedTuple):
    """Working arrays of the steps."""

    samples: FloatArray
    """(pixels, 3) undistorted position and light of the pixels that take part."""
    pixel_rows: FloatArray
    """(pixels, `PIXEL_COLUMNS`) see `evaluate_print`."""
    cell_weights_x: FloatArray
    """(4, `MAX_BLURRED_CELLS`) see `sample_print`."""
    cell_weights_y: FloatArray
    """(4, `MAX_BLURRED_CELLS`) see `sample_print`."""
    blocks: Blocks
    normal_matrix: FloatArray
    """(unknowns, unknowns) normal matrix; its lower Cholesky factor after a step."""
    step: FloatArray
    """(unknowns,) right side of the normal equations; the step after it is solved."""
    previous_step: FloatArray
    """(unknowns,) previous step; 0 before the first one of a stage."""
    step_fraction_and_slope: FloatArray
    """(2,) fraction of the previous step that was taken, and the slope along it at its start."""


@subroutine
def allocate_buffers(max_pixels: int, max_blocks: int) -> FitBuffers:
    """Allocate working arrays."""
    return FitBuffers(
        np.empty((max_pixels, 3)),
        np.empty((max_pixels, PIXEL_COLUMNS)),
        np.empty((4, MAX_BLURRED_CELLS)),
        np.empty((4, MAX_BLURRED_CELLS)),
        Blocks(
            np.empty((max_blocks, 5)),
            np.empty((max_blocks, 2, MAX_UNKNOWNS)),
            np.empty((max_blocks, MAX_UNKNOWNS, MAX_UNKNOWNS)),
            np.empty((max_blocks, MAX_UNKNOWNS)),
            np.empty((max_blocks, 2)),
            np.empty(max_blocks),
        ),
        np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS)),
        np.empty(MAX_UNKNOWNS),
        np.empty(MAX_UNKNOWNS),
        np.empty(2),
    )


@subroutine
def point_in_half_edges(point_index: int) -> tuple[float, float]:
    """Position of corner k in the tag's plane, half edges; of the centre for k = 4."""
    if point_index == 4:
        return 0.0, 0.0
    return (
        -1.0 if point_index == 0 or point_index == 3 else 1.0,
        -1.0 if point_index < 2 else 1.0,
    )


class SideLengths(NamedTuple):
    """Lengths of the sides of a square in an image."""

    shortest: float
    longest: float
    """Infinite if a corner is not finite."""
    perimeter: float


@subroutine
def side_lengths(corners: FloatArray) -> SideLengths:
    """Lengths of the sides between (4, 2) corners."""
    shortest, longest, perimeter = inf, 0.0, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, perimeter = min(shortest, side), perimeter + side
        longest = max(longest, side) if side < inf else inf
    return SideLengths(shortest, longest, perimeter)
