r"""A tag's corners, from all edges of its cells fitted to the light at once.

The edges are a homography from the image to the tag's plane, eight numbers; an edge is a step
blurred by a Gaussian. The pixels near the edges take part (`stages`). With T the blurred print
(`printed_at`) at the pixel's place in the tag's plane, and I the light of the pixel by the camera's
response,

    I = a_k + b_k (T(G p + d(p)) + e |dT|),    minimise  sum w_k (I - a_k - b_k ...)^2

over the homography G, the blurs across the edges along x and along y, the spread e by which white
reaches into black on all edges (ink, a response that is not the stated one, clipped white), and a
dark level and a contrast for each block k of the tag, so that shadows and ramps of light move no
edge. The levels are eliminated (variable projection, Golub and Pereyra 1973); Gauss-Newton steps
are composed with G (Baker and Matthews 2004).

Where the edges are bowed, as on bent paper, a bend d is sought as well: eight polynomials that
vanish at the corners, each with a prior of the size that all have in the mean of squares (empirical
Bayes). Pixels of clipped white count for nothing.

The inverse of the normal matrix is the covariance of the corners, scaled by what is left of each
block as a whole (`variance_of_blocks`).

A blur pulls the corner of a print inwards, and not the lines that meet in it.
"""

from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled, subroutine
from vergence.models.lens import CameraRow
from vergence.models.packed import camera_at
from vergence.models.parts import FloatArray
from vergence.vision.plane import View, ideal_of, look_along, ray_at
from vergence.vision.tags.bend import size_of_bend, usual_bow
from vergence.vision.tags.normal import variance_of_blocks
from vergence.vision.tags.report import NOTHING, Fit, report
from vergence.vision.tags.stages import ALL, BEND, NARROW, WIDE, Stage, begin_stage, scale_of
from vergence.vision.tags.steps import Compared, begin_steps, compare, improve
from vergence.vision.tags.workspace import (
    BOWS,
    SPREAD,
    UNKNOWNS,
    Sight,
    Sought,
    TagPrint,
    make_room,
    sides_of,
)

_SMALL_STEP_PX: Final = 0.02
"""Below it there is no further step: the next would be a tenth of it, where it was whole."""
_SMALL_BLUR_STEP: Final = 0.1
"""Of the log of a blur: the residuals of a wrong one would be taken for noise."""
_FIRST_STEP_PX: Final = 0.15
_HOLD: Final = 1e-5
_BOUNDS_PX: Final = 8.0
"""And a cell, around the corners: what is looked at."""
_CONVERGED_PX: Final = 0.05
_SPREAD_PX: Final = 0.1
"""Measured (`benchmarks.real_light`): standard deviation of the spread, a prior."""
_NO_SPREAD_PX: Final = 1e-6
"""Numerical: the same where no inner edges tell it from a smaller tag."""
_FAR_WORSE: Final = 2.5
"""Numerical: times what the outer edges leave that all edges leave where the sheet is bent."""
_LARGE_BOW: Final = 0.03
"""Numerical: standard deviation of such a bend's coefficients, half edges."""
_MOST_SHRUNK: Final = 0.06
"""Numerical: coefficient of the inside's scale along both axes, half edges, that no bend has: a tag
with a border of two cells, taken for one with a border of one, has 0.2."""
_BEYOND_BEND: Final = 0.3
"""Measured (`benchmarks.real_light`): standard deviation of a corner that the polynomials of a bend
leave, by that of their coefficients."""
_PRIOR_SQUARES: Final = 4.0
"""Numerical: so many squares of single pixels count beside those of blocks, which are few."""
_LONG_STEP_PX: Final = 3.0
_LEAST_EDGE_PX: Final = 8.0


@compiled
def fit_tag(
    image: NDArray[np.uint8],
    light: FloatArray,
    rays: NDArray[np.float32],
    row: FloatArray,
    cells: FloatArray,
    border: int,
    quiet: float,
    steps: tuple[int, int, int],
    most: tuple[int, int],
    start: FloatArray,
    points: FloatArray,
    sigmas: FloatArray,
) -> Fit:
    """Fit a tag's edges, and read its cells.

    Args:
        image: grey levels, shape (height, width).
        light: (256,) of each grey level, see `light_of_levels`.
        rays: (height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole.
        row: the camera, see `pack_camera`.
        cells: (n, n) the print, 0 black to 1 white, nan unknown.
        border: cells along the square whose corners are sought, in the middle of the print.
        quiet: how wide the quiet zone around the print's border is taken to be, cells.
        steps: at most, in each of the three stages: with a wide band along the outer edges, with a
            narrow one, and with the edges of the cells as well.
        most: pixels that take part in the first of them, and in each of the others.
        start: (4, 2) about where the corners are, px, from the upper left clockwise.
        points: (5, 2) result: the corners and the centre, px.
        sigmas: (5, 2) result: their standard deviations, px.

    Returns:
        How well it fits; no contrast where the square is too small, or not all of it in the image.
    """
    shortest, longest, _ = sides_of(start)
    if not (shortest >= _LEAST_EDGE_PX and longest < inf):
        return NOTHING
    camera, tag = camera_at(row, 0), TagPrint(cells, border, quiet)
    sight = _look(image, light, rays, camera, border, start)
    sought = Sought(
        np.empty((4, 2)), np.empty((3, 3)), np.empty((3, 3)), np.empty(2),
        np.zeros(UNKNOWNS - SPREAD),
    )  # fmt: skip
    for k in range(4):
        u, v = ideal_of(rays, sight.plane, start[k, 0], start[k, 1])
        sought.corners[k, 0], sought.corners[k, 1] = u, v
    scale = scale_of(sought.corners, border, most[1])
    room = make_room(max(most[0], most[1]), scale.along * scale.along)
    stage, left = Stage(0, 0, False), Compared(0.0, 0.0, 0.0)
    far = variance = bow = 0.0
    used = BOWS
    for which in range(4):
        if which == BEND:
            if bow == 0.0:
                break
            used = UNKNOWNS
        elif steps[which] == 0:
            continue
        else:
            blurred = which == ALL and steps[NARROW] > 0
            few = most[0] if which == WIDE else most[1]
            stage = begin_stage(which, blurred, sight, tag, scale, sought, room, few)
            if stage.pixels < 4 * UNKNOWNS:
                return NOTHING
        fine, number = which != WIDE, stage.along * stage.along
        begin_steps(room)
        for _ in range(steps[min(which, ALL)]):
            before = left.pixel
            left = compare(sought, tag, room, stage.pixels, stage.along)
            if left.contrast <= 0.0:
                return NOTHING
            worse = which == ALL and not stage.clipped and left.pixel > _FAR_WORSE * before > 0.0
            if worse and used == BOWS:
                # the outer edges do not tell where the inner ones lie: the sheet is bent
                bow, used = _LARGE_BOW, UNKNOWNS
            # blurs stay near where they are unless the pixels say otherwise
            blur = (_HOLD if fine else 1.0) * left.contrast * left.contrast * stage.pixels
            spread = left.pixel / (_SPREAD_PX if which >= ALL else _NO_SPREAD_PX) ** 2
            bend = left.pixel / max(bow, 1e-9) ** 2
            far, sharper = improve(
                sought, room, stage.pixels, number, used, blur, spread, bend, scale.most_blur_px
            )
            if not far < _LONG_STEP_PX + 0.5 * scale.cell_px:
                return NOTHING
            settled = not fine or sharper < _SMALL_BLUR_STEP
            if settled and far < (_SMALL_STEP_PX if fine else _FIRST_STEP_PX):
                break
        if which >= ALL:
            squares, independent = variance_of_blocks(
                room.matrix, room.step, room.blocks, number, used
            )
            variance = (squares + _PRIOR_SQUARES * left.pixel) / (independent + _PRIOR_SQUARES)
        if which == ALL and used == UNKNOWNS:
            bow = size_of_bend(sought.bent)
        elif which == ALL and far < _CONVERGED_PX:
            bow = usual_bow(room, stage.pixels, number, sought.bent, variance)
    shrunk = min(abs(sought.bent[3]), abs(sought.bent[8]))
    if not far < _CONVERGED_PX or shrunk > _MOST_SHRUNK:
        return NOTHING
    beyond = (_BEYOND_BEND * bow * 0.5 * scale.shortest_px) ** 2
    return report(
        sight, camera, tag, scale, sought, room, left, stage.along * stage.along, used, variance,
        beyond, start, points, sigmas,
    )  # fmt: skip


@subroutine
def _look(
    image: NDArray[np.uint8],
    light: FloatArray,
    rays: NDArray[np.float32],
    camera: CameraRow,
    border: int,
    start: FloatArray,
) -> Sight:
    """What is looked at: the image around the corners, and the plane across the rays to them."""
    view = View(len(rays) > 0, np.empty((3, 3)), np.empty((3, 3)))
    if view.lens:
        u = v = 0.0
        for k in range(4):
            u, v = u + start[k, 0], v + start[k, 1]
        x, y = ray_at(rays, u / 4.0, v / 4.0)
        look_along(camera, x, y, view)
    left, top = right, bottom = start[0, 0], start[0, 1]
    for k in range(4):
        left, right = min(left, start[k, 0]), max(right, start[k, 0])
        top, bottom = min(top, start[k, 1]), max(bottom, start[k, 1])
    margin = _BOUNDS_PX + max(right - left, bottom - top) / border
    return Sight(
        image, light, rays, view,
        int(left - margin), int(right + margin), int(top - margin), int(bottom + margin),
    )  # fmt: skip
