"""Gauss-Newton steps of a tag's fit."""

from math import exp, hypot, inf
from typing import Final, NamedTuple

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import back_of, through
from vergence.vision.tags.cholesky import factorise, solve
from vergence.vision.tags.levels import block_levels, block_weights
from vergence.vision.tags.normal import hold_near, normal_equations
from vergence.vision.tags.slopes import evaluate_print
from vergence.vision.tags.workspace import (
    SPREAD,
    UNKNOWNS,
    FitBuffers,
    FitState,
    TagPrint,
    place_of,
)

_LEAST_BLUR_PX: Final = 0.3
"""Smallest blur of a fit, px (chosen: sharp images against edges that few pixels show)."""
_LONGEST_BLUR_STEP: Final = 0.7
"""Largest step of a blur's logarithm (numerical)."""
_LEAST_PACE: Final = 0.2
"""Smallest fraction of a step that is taken after an overshoot (numerical)."""
_FASTER: Final = 1.5
"""Factor by which this fraction grows again after a step without overshoot (numerical)."""


class Compared(NamedTuple):
    """Residuals of all pixels' light after the print."""

    contrast: float
    """Mean contrast of all blocks; 0 if none has any."""
    unexplained: float
    """Weighted sum of squared residuals."""
    pixel: float
    """Variance of a pixel."""


@subroutine
def compare(sought: FitState, tag: TagPrint, room: FitBuffers, count: int, along: int) -> Compared:
    """Compare the print with the pixels, by blocks.

    Args:
        sought: the tag's current pose, blurs and bend.
        tag: the print.
        room: its `places` are read; its `pixels` and its blocks, except for their normal
            equations, are the result.
        count: number of pixels.
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
def begin_steps(room: FitBuffers) -> None:
    """Make `improve` take the next step in full, regardless of earlier steps."""
    room.pace[0], room.pace[1], last = 1.0, 0.0, room.last
    for k in range(UNKNOWNS):
        last[k] = 0.0


@subroutine
def improve(
    sought: FitState,
    room: FitBuffers,
    count: int,
    number: int,
    used: int,
    blur: float,
    spread: float,
    bow: float,
    most_blur: float,
) -> tuple[float, float]:
    """Take a Gauss-Newton step, shortened if the previous one overshot.

    A step overshot if the slope along it has changed sign; the secant then gives the right
    fraction. Without this, steps oscillate if edges are sharpened or seen at a low angle.

    Args:
        sought: the tag's pose, blurs and bend; also the result.
        room: working arrays after `compare` and the previous step; the step and the Cholesky factor
            of its normal matrix are the result.
        count: number of pixels.
        number: number of blocks.
        used: number of unknowns that are sought, the first ones.
        blur: weight that holds the blurs at their last values, see `hold_near`.
        spread: weight that holds the spread at 0.
        bow: weight that holds the bend at 0.
        most_blur: largest blur, px.

    Returns:
        Largest move of a corner, px, infinite if the normal matrix is not positive definite; and
        the largest change of a blur's logarithm.
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
    """Update the homography: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


@subroutine
def _move_corners(sought: FitState) -> float:
    """Update H and the corners from G; return the largest move of a corner, px."""
    corners, H = sought.corners, sought.H
    back_of(sought.G, H)
    far = 0.0
    for k in range(4):
        u, v = through(H, *place_of(k))
        far = max(far, hypot(u - corners[k, 0], v - corners[k, 1]))
        corners[k, 0], corners[k, 1] = u, v
    return far
