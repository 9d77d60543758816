"""A Gauss-Newton step of a tag's fit."""

from math import exp, hypot, inf
from typing import Final, NamedTuple

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import back_of, through
from vergence.vision.tags.cholesky import factorise, solve
from vergence.vision.tags.levels import block_levels, block_weights
from vergence.vision.tags.normal import hold_near, normal_equations
from vergence.vision.tags.slopes import evaluate_print
from vergence.vision.tags.workspace import SPREAD, UNKNOWNS, Room, Sought, TagPrint, place_of

_LEAST_BLUR_PX: Final = 0.3
_LONGEST_BLUR_STEP: Final = 0.7
"""Numerical: of the log of a blur."""
_LEAST_PACE: Final = 0.2
_FASTER: Final = 1.5
"""Numerical: bounds of the share of a step that is taken, and by what it grows again."""


class Compared(NamedTuple):
    """What the print leaves of the light of all pixels."""

    contrast: float
    """Of all blocks in the mean; 0 where none has any."""
    unexplained: float
    """Weighted sum of the squares that are left."""
    pixel: float
    """Variance of a pixel."""


@subroutine
def compare(sought: Sought, tag: TagPrint, room: Room, count: int, along: int) -> Compared:
    """Compare the print with the pixels, by blocks.

    Args:
        sought: where the tag is now.
        tag: what is printed.
        room: its places are read; its pixels, and what is known of the blocks but for the normal
            equations, are the result.
        count: pixels.
        along: blocks along an edge.
    """
    blocks, number = room.blocks, along * along
    evaluate_print(sought, tag, room, count, along)
    contrast = block_levels(blocks, number)
    if contrast <= 0.0:
        return Compared(0.0, 0.0, 0.0)
    unexplained = block_weights(room.pixels, count, blocks, number)
    free = -float(UNKNOWNS)
    for k in range(number):
        if blocks.levels[k, 1] > 0.0:
            free += blocks.weights[k] * blocks.plain[k, 0] - 2.0
    return Compared(contrast, unexplained, unexplained / max(free, 1.0))


@subroutine
def begin_steps(room: Room) -> None:
    """Take the next step whole, whatever the ones before did."""
    room.pace[0], room.pace[1], last = 1.0, 0.0, room.last
    for k in range(UNKNOWNS):
        last[k] = 0.0


@subroutine
def improve(
    sought: Sought,
    room: Room,
    count: int,
    number: int,
    used: int,
    blur: float,
    spread: float,
    bow: float,
    most_blur: float,
) -> tuple[float, float]:
    """Take a step, or a part of it where the one before went too far.

    That is so where the slope along it has changed its sign; the secant says how far would have
    been right. Without this, steps go to and fro where edges are sharpened, or seen at a low angle.

    Args:
        sought: where the tag is, and result.
        room: as `compare` and the step before leave it; the step and the factor of its normal
            matrix are the result.
        count: pixels.
        number: of blocks.
        used: unknowns that are sought, the first ones.
        blur: how firmly blurs are held where they are, see `hold_near`.
        spread: how firmly the spread is held at 0.
        bow: the bend.
        most_blur: the largest blur, px.

    Returns:
        How far the corner moves that moves farthest, px, infinitely where the pixels do not tell;
        and by how much the log of a blur changes most.
    """
    matrix, step = room.matrix, room.step
    normal_equations(room.pixels, count, room.blocks, number, used, matrix, step)
    hold_near(matrix, step, sought.bent, blur, spread, bow, used)
    slope, pace, began, last = 0.0, room.pace[0], room.pace[1], room.last
    for k in range(used):
        slope += step[k] * last[k]
        last[k] = step[k]
    if slope < 0.0:
        pace = max(pace * began / (began - slope), _LEAST_PACE)
    else:
        pace = min(_FASTER * pace, 1.0)
    if not factorise(matrix, used):
        return inf, inf
    solve(matrix, step, used)
    slope = 0.0
    for k in range(used):
        step[k] *= pace
        slope += step[k] * last[k]
        last[k] = step[k]
    room.pace[0], room.pace[1] = pace, slope
    _move_plane(sought.G, step)
    sharper = 0.0
    for axis in range(2):
        change = min(max(step[8 + axis], -_LONGEST_BLUR_STEP), _LONGEST_BLUR_STEP)
        sharper = max(sharper, abs(change))
        blur_px = sought.blurs[axis] * exp(change)
        sought.blurs[axis] = min(max(blur_px, _LEAST_BLUR_PX), most_blur)
    for k in range(used - SPREAD):
        sought.bent[k] += step[SPREAD + k]
    return _move_corners(sought), sharper


@subroutine
def _move_plane(G: FloatArray, step: FloatArray) -> None:
    """Move the plane: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


@subroutine
def _move_corners(sought: Sought) -> float:
    """Move corners and the way back to where the plane is; how far the farthest moves, px."""
    corners, H = sought.corners, sought.H
    back_of(sought.G, H)
    far = 0.0
    for k in range(4):
        u, v = through(H, *place_of(k))
        far = max(far, hypot(u - corners[k, 0], v - corners[k, 1]))
        corners[k, 0], corners[k, 1] = u, v
    return far
