"""The stages of a tag's fit: which pixels take part in each, and how they are cut into blocks."""

from typing import Final, NamedTuple

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import plane_of
from vergence.vision.tags.pixels import gather_pixels, without_clipped
from vergence.vision.tags.workspace import Room, Sight, Sought, TagPrint, sides_of

WIDE, NARROW, ALL, BEND = range(4)
"""A wide band along the outer edges, a narrow one, the edges of all cells, and a bend."""
_BLOCK_PX: Final = 8.0
"""Length of a block of one pair of levels along the edge."""
_MOST_BLOCKS: Final = 8
"""Along an edge."""
_PIXELS_PER_BLOCK: Final = 24
"""Of those that take part, at least."""
_REACH_PX: Final = 1.0
_REACH_BLURS: Final = 2.2
"""Half width of the band of pixels along the edges: a pixel and so many blurs."""
_WIDE_PX: Final = 4.0
"""The same in the first steps, for corners that are beside the edges."""
_WIDE_BLUR_PX: Final = 2.0
_WIDE_BLUR_CELLS: Final = 0.35
"""Blur of the print in the first steps, so that a pixel tells of an edge that is far."""
_QUIET_BLURS: Final = 1.8
"""So many blurs of the quiet zone, which is a cell wide, are not looked at: what lies behind it
reaches into them."""
_FIRST_BLOCKS: Final = 3
"""Along an edge in the first steps, which few pixels take part in."""
_FIRST_BLUR_PX: Final = 0.8
_MOST_BLUR_PX: Final = 6.0
_MOST_BLUR_CELLS: Final = 0.7


class Scale(NamedTuple):
    """How large a tag is in the image, and what follows from that."""

    shortest_px: float
    """Of its edges."""
    cell_px: float
    along: int
    """Blocks along an edge, at most."""
    most_blur_px: float


@subroutine
def scale_of(corners: FloatArray, border: int, most: int) -> Scale:
    """The scale of a tag.

    Args:
        corners: (4, 2) about where they are, undistorted, px.
        border: cells along the square between them.
        most: pixels that take part.
    """
    shortest, longest, _ = sides_of(corners)
    cell_px = shortest / border
    # never one for each cell: a block of one colour has no contrast of its own
    along = min(max(int(0.5 * (shortest + longest) / _BLOCK_PX), 1), _MOST_BLOCKS, border)
    along = min(along, 1 + most // (4 * _PIXELS_PER_BLOCK))
    return Scale(shortest, cell_px, along, min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _MOST_BLUR_PX))


class Stage(NamedTuple):
    """What takes part in a stage."""

    pixels: int
    along: int
    """Blocks along an edge."""
    clipped: bool
    """Whether pixels of clipped white were left out."""


@subroutine
def begin_stage(
    which: int,
    blurred: bool,
    sight: Sight,
    tag: TagPrint,
    scale: Scale,
    sought: Sought,
    room: Room,
    most: int,
) -> Stage:
    """Begin a stage before that of the bend: with a plane through the corners.

    Args:
        which: see `WIDE`.
        blurred: whether an earlier stage has found the blurs.
        sight: the image.
        tag: what is printed.
        scale: how large it is.
        sought: its corners are read; the plane is the result, and the blurs if they are not found.
        room: its places are the result.
        most: pixels that take part.
    """
    plane_of(sought.corners, sought.G)
    along, blur_px = scale.along, _FIRST_BLUR_PX
    reach_px = _REACH_PX + _REACH_BLURS * _FIRST_BLUR_PX
    if which == WIDE:
        along = min(along, _FIRST_BLOCKS)
        reach_px = min(_WIDE_PX, max(scale.cell_px, 2.0))
        blur_px = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * scale.cell_px, _FIRST_BLUR_PX))
    if not blurred:
        sought.blurs[0] = sought.blurs[1] = blur_px
    count = gathered = gather_pixels(
        sight, tag, sought, reach_px, _QUIET_BLURS * _FIRST_BLUR_PX,
        scale.cell_px < reach_px + 2.0 * blur_px, which == ALL, most, room.places,
    )  # fmt: skip
    if which == ALL:
        count = without_clipped(room.places, count, sight.light)
    return Stage(count, along, count < gathered)
