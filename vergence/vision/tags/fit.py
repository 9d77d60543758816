r"""A tag's corners, from all edges of its cells fitted to the light at once.

The edges are a homography from the tag's plane to the image, eight numbers; an edge is a step
blurred by a Gaussian. The pixels near the edges take part. With T the blurred print
(`printed_cells`) at the pixel's place in the tag's plane, and I the light of the pixel by the
camera's response,

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

from math import exp, hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled, subroutine
from vergence.models.lens import CameraRow
from vergence.models.packed import camera_at
from vergence.models.parts import FloatArray
from vergence.vision.plane import (
    View,
    back_of,
    ideal_of,
    look_along,
    plane_of,
    ray_at,
    seen_at,
    through,
)
from vergence.vision.tags.levels import block_levels, block_weights
from vergence.vision.tags.pixels import (
    BOWS,
    COLUMNS,
    SPREAD,
    UNKNOWNS,
    Sums,
    evaluate_print,
    gather_pixels,
    without_clipped,
)
from vergence.vision.tags.printed import MOST_REACHED
from vergence.vision.tags.reading import Reading, read_cells
from vergence.vision.tags.steps import (
    covariances_of,
    factorise,
    hold_near,
    move_plane,
    normal_equations,
    solve,
    usual_bow,
    variance_of_blocks,
)

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
_BLURS_PX: Final = (0.3, 6.0)
_FIRST_BLUR_PX: Final = 0.8
_MOST_BLUR_CELLS: Final = 0.7
_SMALL_STEP_PX: Final = 0.02
"""Below it there is no further step: the next would be a tenth of it at most."""
_SMALL_BLUR_STEP: Final = 0.1
"""Of the log of a blur: the residuals of a wrong one would be taken for noise."""
_FIRST_STEP_PX: Final = 0.15
_HOLD: Final = 1e-5
_BOUNDS_PX: Final = 8.0
"""And a cell, around the corners: what is looked at."""
_CONVERGED_PX: Final = 0.05
_WIDE, _NARROW, _ALL, _BEND = range(4)
"""Stages: a wide band along the outer edges, a narrow one, the edges of all cells, and a bend."""
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


@subroutine
def _corners_of(G: FloatArray, H: FloatArray, corners: FloatArray) -> None:
    """Where the corners of the square lie in the image, and the way back to it."""
    back_of(G, H)
    for k in range(4):
        x = -1.0 if k == 0 or k == 3 else 1.0
        y = -1.0 if k < 2 else 1.0
        corners[k, 0], corners[k, 1] = through(H, x, y)


class Fit(NamedTuple):
    """What a fit came to."""

    contrast: float
    """Grey levels; 0 where nothing was fitted."""
    explained: float
    """The share of the variance near the edges that the print explains."""
    reading: Reading
    moved_px: float
    """How far the corner lies that lies farthest from where it was expected."""
    sigma_px: float
    """The greatest standard deviation of a point."""


_NOTHING: Final = Fit(0.0, 0.0, Reading(0, 0, 0.0), 0.0, 0.0)
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
    least = inf
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(start[other, 0] - start[k, 0], start[other, 1] - start[k, 1])
        if not side < inf:
            return _NOTHING
        least = min(least, side)
    if least < _LEAST_EDGE_PX:
        return _NOTHING
    camera = camera_at(row, 0)
    view = View(len(rays) > 0, np.empty((3, 3)), np.empty((3, 3)))
    if view.lens:
        x, y = ray_at(rays, start[:, 0].mean(), start[:, 1].mean())
        look_along(camera, x, y, view)
    corners, bounds = np.empty((4, 2)), np.empty(4, np.int64)
    left, top = right, bottom = start[0, 0], start[0, 1]
    for k in range(4):
        corners[k, 0], corners[k, 1] = ideal_of(rays, view, start[k, 0], start[k, 1])
        left, right = min(left, start[k, 0]), max(right, start[k, 0])
        top, bottom = min(top, start[k, 1]), max(bottom, start[k, 1])
    margin = _BOUNDS_PX + max(right - left, bottom - top) / border
    bounds[0], bounds[1] = int(left - margin), int(right + margin)
    bounds[2], bounds[3] = int(top - margin), int(bottom + margin)
    G, H, moved = np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 2))
    room = max(most[0], most[1])
    places, pixels = np.empty((room, 3)), np.empty((room, COLUMNS))
    along_x, along_y = np.empty((4, MOST_REACHED)), np.empty((4, MOST_REACHED))
    matrix, step = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    blurs, bent, covariances = np.empty(2), np.zeros(UNKNOWNS - SPREAD), np.empty((5, 2, 2))
    shortest, longest = inf, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, longest = min(shortest, side), max(longest, side)
    cell_px = shortest / border
    # never one for each cell: a block of one colour has no contrast of its own
    most_blocks = min(max(int(0.5 * (shortest + longest) / _BLOCK_PX), 1), _MOST_BLOCKS, border)
    most_blocks = min(most_blocks, 1 + most[1] // (4 * _PIXELS_PER_BLOCK))
    square = most_blocks * most_blocks
    sums = Sums(
        np.empty((square, 5)),
        np.empty((square, 2, UNKNOWNS)),
        np.empty((square, UNKNOWNS, UNKNOWNS)),
        np.empty((square, UNKNOWNS)),
    )
    levels, weights = np.empty((square, 2)), np.empty(square)
    most_blur = min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _BLURS_PX[1])
    contrast = unexplained = far = pixel = variance = bow = 0.0
    blocks, count, gathered, used = 0, 0, 0, BOWS
    for stage in range(4):
        if stage < _BEND:
            if steps[stage] == 0:
                continue
            plane_of(corners, G)
            blocks = min(most_blocks, _FIRST_BLOCKS) if stage == _WIDE else most_blocks
            square = blocks * blocks
            blur_px, reach_px = _FIRST_BLUR_PX, _REACH_PX + _REACH_BLURS * _FIRST_BLUR_PX
            if stage == _WIDE:
                reach_px = min(_WIDE_PX, max(cell_px, 2.0))
                blur_px = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * cell_px, _FIRST_BLUR_PX))
            if stage < _ALL or steps[_NARROW] == 0:
                blurs[0] = blurs[1] = blur_px
            whole = cell_px < reach_px + 2.0 * blur_px
            unseen_px = _QUIET_BLURS * _FIRST_BLUR_PX
            within = stage == _ALL
            count = gather_pixels(
                image, light, rays, view, G, corners, bounds, border, cells, reach_px, unseen_px,
                quiet, whole, within, most[0] if stage == _WIDE else most[1], places,
            )  # fmt: skip
            gathered = count
            if within:
                count = without_clipped(places, count, light)
            if count < 4 * UNKNOWNS:
                return _NOTHING
        elif bow > 0.0:
            used = UNKNOWNS
        else:
            break
        fine = stage != _WIDE
        for _ in range(steps[min(stage, _ALL)]):
            evaluate_print(
                places, count, G, blurs, bent, cells, border, blocks, pixels, along_x, along_y, sums
            )
            contrast = block_levels(sums, levels, square)
            if contrast <= 0.0:
                return _NOTHING
            unexplained = block_weights(pixels, count, sums, levels, weights, square)
            free = -float(UNKNOWNS)
            for k in range(square):
                if levels[k, 1] > 0.0:
                    free += weights[k] * sums.plain[k, 0] - 2.0
            before, pixel = pixel, unexplained / max(free, 1.0)
            worse = stage == _ALL and gathered == count and pixel > _FAR_WORSE * before > 0.0
            if worse and used == BOWS:
                # the outer edges do not tell where the inner ones lie: the sheet is bent
                bow, used = _LARGE_BOW, UNKNOWNS
            normal_equations(pixels, count, sums, levels, square, weights, used, matrix, step)
            # blurs stay near where they are unless the pixels say otherwise
            hold = (_HOLD if fine else 1.0) * contrast * contrast * count
            spread = pixel / (_SPREAD_PX if stage >= _ALL else _NO_SPREAD_PX) ** 2
            hold_near(matrix, step, bent, hold, spread, pixel / max(bow, 1e-9) ** 2, used)
            if not factorise(matrix, used):
                return _NOTHING
            solve(matrix, step, used)
            move_plane(G, step)
            sharper = 0.0
            for axis in range(2):
                change = min(max(step[8 + axis], -0.7), 0.7)
                sharper = max(sharper, abs(change))
                blurs[axis] = min(max(blurs[axis] * exp(change), _BLURS_PX[0]), most_blur)
            for k in range(used - SPREAD):
                bent[k] += step[SPREAD + k]
            _corners_of(G, H, moved)
            far = 0.0
            for k in range(4):
                far = max(far, hypot(moved[k, 0] - corners[k, 0], moved[k, 1] - corners[k, 1]))
            if not far < _LONG_STEP_PX + 0.5 * cell_px:
                return _NOTHING
            for k in range(4):
                corners[k, 0], corners[k, 1] = moved[k, 0], moved[k, 1]
            settled = not fine or sharper < _SMALL_BLUR_STEP
            if settled and far < (_SMALL_STEP_PX if fine else _FIRST_STEP_PX):
                break
        if stage >= _ALL:
            squares, independent = variance_of_blocks(matrix, step, sums, levels, square, used)
            variance = (squares + _PRIOR_SQUARES * pixel) / (independent + _PRIOR_SQUARES)
        if stage == _ALL and used == UNKNOWNS:
            bow = 0.0
            for k in range(BOWS - SPREAD, UNKNOWNS - SPREAD):
                bow += bent[k] ** 2 / (UNKNOWNS - BOWS)
            bow = sqrt(bow)
        elif stage == _ALL and far < _CONVERGED_PX:
            for k in range(BOWS, UNKNOWNS):
                step[k] = 0.0
            bow = usual_bow(pixels, count, sums, levels, square, weights, step, bent, variance)
    shrunk = min(abs(bent[3]), abs(bent[8]))
    if not far < _CONVERGED_PX or shrunk > _MOST_SHRUNK:
        return _NOTHING
    total = 0.0
    for k in range(blocks * blocks):
        if levels[k, 1] > 0.0:
            n, t, tt = sums.plain[k, 0], sums.plain[k, 1], sums.plain[k, 2]
            total += weights[k] * levels[k, 1] * levels[k, 1] * (tt - t * t / n)
    covariances_of(matrix, used, G, H, variance, covariances)
    beyond = (_BEYOND_BEND * bow * 0.5 * shortest) ** 2
    for k in range(5):  # the centre lies between four corners
        covariances[k, 0, 0] += beyond if k < 4 else 0.25 * beyond
        covariances[k, 1, 1] += beyond if k < 4 else 0.25 * beyond
        if k < 4:
            u, v = corners[k, 0], corners[k, 1]
        else:
            u, v = through(H, 0.0, 0.0)
        _report(camera, view, u, v, covariances[k], points[k], sigmas[k])
    height, width = image.shape
    farthest = largest = 0.0
    for k in range(5):
        u, v = points[k, 0], points[k, 1]
        if not (-0.5 < u < width - 0.5 and -0.5 < v < height - 0.5):
            return _NOTHING
        if not sigmas[k, 0] + sigmas[k, 1] < inf:
            return _NOTHING
        largest = max(largest, max(sigmas[k, 0], sigmas[k, 1]))
        if k < 4:
            farthest = max(farthest, max(abs(u - start[k, 0]), abs(v - start[k, 1])))
    offset = 0.5 * (len(cells) - border)
    ring, greys = 1 if len(cells) == border + 2 else 0, np.empty(cells.shape)
    blur = max(blurs[0], blurs[1]) / cell_px
    reading = read_cells(
        image, H, bent, camera, view, cells, blur, offset, offset, float(border), float(border),
        ring, True, greys,
    )  # fmt: skip
    if reading.wrong > 0 and ring > 0:
        inner = read_cells(
            image, H, bent, camera, view, cells, blur, offset, offset, float(border), float(border),
            ring, False, greys,
        )  # fmt: skip
        reading = inner if inner.wrong < reading.wrong else reading
    return Fit(contrast, total / (total + unexplained), reading, farthest, largest)


@subroutine
def _report(
    camera: CameraRow,
    view: View,
    u: float,
    v: float,
    covariance: FloatArray,
    point: FloatArray,
    sigma: FloatArray,
) -> None:
    """A point and its standard deviations as the lens shows them.

    Args:
        camera: the eye's.
        view: the plane that the lens does not bend.
        u: of the point, undistorted.
        v: the same.
        covariance: (2, 2) of the point, undistorted.
        point: (2,) result.
        sigma: (2,) result.
    """
    point[0], point[1] = seen_at(camera, view, u, v)
    a, b, c = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    if view.lens:
        left_u, left_v = seen_at(camera, view, u - 0.5, v)
        right_u, right_v = seen_at(camera, view, u + 0.5, v)
        above_u, above_v = seen_at(camera, view, u, v - 0.5)
        below_u, below_v = seen_at(camera, view, u, v + 0.5)
        p, q, r, s = right_u - left_u, below_u - above_u, right_v - left_v, below_v - above_v
        a, c = (
            p * p * a + 2.0 * p * q * b + q * q * c,
            r * r * a + 2.0 * r * s * b + s * s * c,
        )
    sigma[0], sigma[1] = sqrt(a), sqrt(c)
