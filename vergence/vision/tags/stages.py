"""The stages of a tag's fit: the pixels that take part in each, and their division into blocks."""

from typing import Final, NamedTuple

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import image_to_square_homography
from vergence.vision.tags.pixels import drop_clipped_pixels, gather_edge_pixels
from vergence.vision.tags.workspace import (
    FitBuffers,
    FitState,
    SearchRegion,
    TagPrint,
    side_lengths,
)

WIDE, NARROW, ALL, BEND = range(4)
"""Stages: a wide band along the outer edges, a narrow one, the edges of all cells, and a bend
(numerical)."""
_LEAST_BLOCK_SIDE_PX: Final = 8.0
"""Smallest side of a block, which has one dark level and one contrast, px (chosen: shadows and
gradients against noise)."""
_MOST_BLOCKS: Final = 8
"""Most blocks along an edge (chosen: as above)."""
_PIXELS_PER_BLOCK: Final = 24
"""Pixels that take part per block, from which the number of blocks follows (chosen: as above)."""
_BAND_HALF_WIDTH_PX: Final = 1.0
"""Constant part of the half width of the band along the edges, px (chosen: evidence against time
and neighbouring edges)."""
_BAND_HALF_WIDTH_BLURS: Final = 2.2
"""Part of this half width that grows with the blur, in blurs of `_INITIAL_BLUR_PX` (chosen: as
above)."""
_MAX_BAND_HALF_WIDTH_PX: Final = 4.0
"""Largest half width of the band in the first stage, px, for poor initial corners (chosen: reach
against neighbouring edges)."""
_WIDE_BLUR_PX: Final = 2.0
"""Largest initial blur of the print in the first stage, px; so blurred, pixels far from an edge
carry evidence on it (chosen: reach against accuracy)."""
_WIDE_BLUR_CELLS: Final = 0.35
"""Initial blur of the print in the first stage, cells (chosen: as above)."""
_EXCLUDED_QUIET_BLURS: Final = 1.8
"""Width of the outer part of the quiet zone that is left out, in blurs of `_INITIAL_BLUR_PX`: the
background blurs into it (chosen: evidence against this background)."""
_MAX_FIRST_BLOCKS: Final = 3
"""Most blocks along an edge in the first stage, which has few pixels (chosen: shadows against
noise)."""
_INITIAL_BLUR_PX: Final = 0.8
"""Initial blur of the print after the first stage, px; the smallest in it (chosen: a typical
blur)."""
_MOST_BLUR_PX: Final = 6.0
"""Largest blur of a fit, px (chosen: blurred tags against fits that diverge)."""
_MOST_BLUR_CELLS: Final = 0.7
"""Largest blur of a fit, cells (chosen: as above)."""


class TagScale(NamedTuple):
    """Size of a tag in the image, px, and upper bounds of blocks and blur that follow from it."""

    shortest_edge_px: float
    """Length of its shortest edge."""
    cell_px: float
    max_blocks_per_edge: int
    """Most blocks along an edge."""
    max_blur_px: float


@subroutine
def tag_scale(corners: FloatArray, side_cells: int, max_pixels: int) -> TagScale:
    """Scale of a tag.

    Args:
        corners: (4, 2) approximate corners, undistorted, px.
        side_cells: cells along the square between them.
        max_pixels: most pixels that take part.
    """
    shortest, longest, _ = side_lengths(corners)
    cell_px = shortest / side_cells
    # at most one block per cell of the border: a block of one colour has no contrast
    blocks_per_edge = min(
        max(int(0.5 * (shortest + longest) / _LEAST_BLOCK_SIDE_PX), 1), _MOST_BLOCKS, side_cells
    )
    blocks_per_edge = min(blocks_per_edge, 1 + max_pixels // (4 * _PIXELS_PER_BLOCK))
    return TagScale(
        shortest, cell_px, blocks_per_edge, min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _MOST_BLUR_PX)
    )


class FitStage(NamedTuple):
    """Numbers of pixels and blocks that take part in a stage."""

    pixel_count: int
    blocks_per_edge: int
    """Blocks along an edge."""
    dropped_clipped: bool
    """True if pixels of clipped white were left out."""


@subroutine
def begin_stage(
    stage: int,
    blurs_known: bool,
    region: SearchRegion,
    tag: TagPrint,
    scale: TagScale,
    state: FitState,
    buffers: FitBuffers,
    max_pixels: int,
) -> FitStage:
    """Begin a stage other than `BEND`, with the homography through the corners.

    Args:
        stage: the stage, see `WIDE`.
        blurs_known: True if an earlier stage has found the blurs.
        region: the image.
        tag: the print.
        scale: size of the tag in the image.
        state: its corners are read; `G` is a result, and so are the blurs unless `blurs_known`.
        buffers: its `samples` are a result.
        max_pixels: most pixels that take part.
    """
    image_to_square_homography(state.corners, state.G)
    blocks_per_edge, blur_px = scale.max_blocks_per_edge, _INITIAL_BLUR_PX
    reach_px = _BAND_HALF_WIDTH_PX + _BAND_HALF_WIDTH_BLURS * _INITIAL_BLUR_PX
    if stage == WIDE:
        blocks_per_edge = min(blocks_per_edge, _MAX_FIRST_BLOCKS)
        reach_px = min(_MAX_BAND_HALF_WIDTH_PX, max(scale.cell_px, 2.0))
        blur_px = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * scale.cell_px, _INITIAL_BLUR_PX))
    if not blurs_known:
        state.blurs_px[0] = state.blurs_px[1] = blur_px
    count = gathered = gather_edge_pixels(
        region, tag, state, reach_px, _EXCLUDED_QUIET_BLURS * _INITIAL_BLUR_PX,
        scale.cell_px < reach_px + 2.0 * blur_px, stage == ALL, max_pixels, buffers.samples,
    )  # fmt: skip
    if stage == ALL:
        count = drop_clipped_pixels(buffers.samples, count, region.light_by_grey)
    return FitStage(count, blocks_per_edge, count < gathered)
