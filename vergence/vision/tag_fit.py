r"""A tag's corners, from the four lines of its edge fitted to the grey levels at once.

The four edges are a homography from the tag's plane to the image, eight numbers; an edge is a step
blurred by a Gaussian. All pixels near the edges take part, and for a small tag those of the code
as well, whose cells blur into the edge. With T the blurred print (`printed_cells`) at the pixel's
place in the tag's plane,

    I = a_k + b_k T(G p),    minimise  sum w_k (I - a_k - b_k T)^2

over the homography G, the blurs across the edges along x and along y, and a dark level and a
contrast for each block k of the tag, so that shadows and ramps of light move no edge. The levels
are eliminated (variable projection, Golub and Pereyra 1973); Gauss-Newton steps are composed with
G (Baker and Matthews 2004). The inverse of the normal matrix, scaled by what is left, is the
covariance of the corners.

A blur pulls the corner of a print inwards, and not the lines that meet in it.
"""

from math import exp, hypot, log, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled, device, subroutine
from vergence.models.lens import CameraRow, distort
from vergence.models.packed import camera_at
from vergence.models.parts import FloatArray
from vergence.vision.cell_reading import wrong_cells
from vergence.vision.plane import ideal_of, pixel_of, plane_of, seen_at
from vergence.vision.printed_cells import MOST_REACHED, printed_at

_UNKNOWNS: Final = 10
"""Eight of the homography, two logs of blurs."""
_COLUMNS: Final = 3 + _UNKNOWNS
"""Of a pixel: its grey, its block, the print, and the derivatives."""
_BLOCK_PX: Final = 8.0
"""Length of a block of one pair of levels along the edge."""
_MOST_BLOCKS: Final = 8
"""Along an edge."""
_PIXELS_PER_BLOCK: Final = 24
_LEAST_PIXELS: Final = 6
"""Of a block, below which it says nothing."""
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
_LEAST_QUIET: Final = 0.45
"""Cells of it that are looked at in any case."""
_FIRST_BLOCKS: Final = 3
"""Along an edge in the first steps, which few pixels take part in."""
_BLURS_PX: Final = (0.3, 6.0)
_FIRST_BLUR_PX: Final = 0.8
_MOST_BLUR_CELLS: Final = 0.7
_SMALL_STEP_PX: Final = 0.01
"""Below it there is no further step: the next would be its square."""
_FIRST_STEP_PX: Final = 0.15
_HOLD: Final = 1e-5
_BOUNDS_PX: Final = 8.0
"""And a cell, around the corners: what is looked at."""
_CONVERGED_PX: Final = 0.05
_LONG_STEP_PX: Final = 3.0


class Sums(NamedTuple):
    """Sums over the pixels of each block."""

    plain: FloatArray
    """(K, 5) of 1, T, T^2, I, T I."""
    slopes: FloatArray
    """(K, 2, unknowns) of the derivatives of T, and of T times them."""


@subroutine
def _corners_of(G: FloatArray, corners: FloatArray) -> None:
    """Where the corners of the square lie in the image."""
    for k in range(4):
        x = -1.0 if k == 0 or k == 3 else 1.0
        y = -1.0 if k < 2 else 1.0
        corners[k, 0], corners[k, 1] = pixel_of(G, x, y)


@subroutine
def _gather(
    image: NDArray[np.uint8],
    rays: NDArray[np.float32],
    focal_px: float,
    G: FloatArray,
    corners: FloatArray,
    bounds: NDArray[np.int64],
    border: int,
    reach_px: float,
    unseen_px: float,
    whole: bool,
    most: int,
    places: FloatArray,
) -> int:
    """Take the pixels near the edges, evenly thinned out where there are more than `most`.

    Args:
        image: grey levels.
        rays: (height, width, 2) undistorted, or (0, 0, 2) for pixels that are such.
        focal_px: what rays are scaled by.
        G: from the undistorted image to the plane.
        corners: (4, 2) undistorted.
        bounds: (4,) first and last pixel along u, and along v, of the raw image.
        border: cells along the square.
        reach_px: half width of the band.
        unseen_px: how much of the quiet zone's outer part is left out.
        whole: whether all pixels within the square take part.
        most: pixels.
        places: (most, 3) result: undistorted place and grey level.

    Returns:
        How many.
    """
    height, width = image.shape
    lens = len(rays) > 0
    left, right = max(bounds[0], 0), min(bounds[1], width - 1)
    top, bottom = max(bounds[2], 0), min(bounds[3], height - 1)
    half = 0.5 * border
    perimeter = 0.0
    for k in range(4):
        other = (k + 1) % 4
        perimeter += hypot(
            corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1]
        )
    expected = 2.0 * reach_px * perimeter
    if whole:
        expected = max(expected, 1.5 * (0.25 * perimeter + 2.0) ** 2)
    stride = int(expected / most) + 1
    phase = int(0.618 * stride + 0.5)
    count = 0
    for row in range(top, bottom + 1):
        first = left + (-(left + phase * row)) % stride
        for column in range(first, right + 1, stride):
            u, v = float(column), float(row)
            if lens:
                u, v = focal_px * rays[row, column, 0], focal_px * rays[row, column, 1]
            w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
            x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
            y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
            # px for a unit of the plane across the edges along x, and along y
            px_x = w / hypot(G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1])
            px_y = w / hypot(G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1])
            px_x, px_y = abs(px_x), abs(px_y)
            out_x, out_y = (abs(x) - 1.0) * px_x, (abs(y) - 1.0) * px_y
            out = max(out_x, out_y)
            if out_x > max(px_x / half - unseen_px, _LEAST_QUIET * px_x / half):
                continue
            if out_y > max(px_y / half - unseen_px, _LEAST_QUIET * px_y / half):
                continue
            if not (out <= reach_px and (whole or out >= -reach_px)) or count == most:
                continue
            places[count, 0], places[count, 1], places[count, 2] = u, v, image[row, column]
            count += 1
    return count


@subroutine
def _evaluate(
    places: FloatArray,
    count: int,
    G: FloatArray,
    blurs: FloatArray,
    cells: FloatArray,
    border: int,
    blocks: int,
    pixels: FloatArray,
    along_x: FloatArray,
    along_y: FloatArray,
    sums: Sums,
) -> None:
    """The print and its derivatives at all pixels, and their sums by block."""
    half, start = 0.5 * border, 0.5 * (len(cells) - border)
    sums.plain[:] = 0.0
    sums.slopes[:] = 0.0
    for n in range(count):
        u, v, grey = places[n, 0], places[n, 1], places[n, 2]
        w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
        x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
        y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
        s_x = blurs[0] * half * hypot(G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]) / abs(w)
        s_y = blurs[1] * half * hypot(G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]) / abs(w)
        at = printed_at(
            cells, (x + 1.0) * half + start, (y + 1.0) * half + start, s_x, s_y, along_x, along_y
        )
        if not at.known:
            pixels[n, 1] = -1.0
            continue
        by_x, by_y = half * at.by_x, half * at.by_y
        turn = -(by_x * x + by_y * y)
        pixels[n, 0] = grey
        pixels[n, 2] = at.value
        pixels[n, 3], pixels[n, 4], pixels[n, 5] = by_x * x, by_x * y, by_x
        pixels[n, 6], pixels[n, 7], pixels[n, 8] = by_y * x, by_y * y, by_y
        pixels[n, 9], pixels[n, 10] = turn * x, turn * y
        pixels[n, 11], pixels[n, 12] = at.by_blur_x, at.by_blur_y
        share = 0.5 * blocks / (half + 1.0)
        column = min(max(int((x * half + half + 1.0) * share), 0), blocks - 1)
        row = min(max(int((y * half + half + 1.0) * share), 0), blocks - 1)
        k = row * blocks + column
        pixels[n, 1] = k
        plain = sums.plain[k]
        plain[0] += 1.0
        plain[1] += at.value
        plain[2] += at.value * at.value
        plain[3] += grey
        plain[4] += at.value * grey
        for j in range(_UNKNOWNS):
            sums.slopes[k, 0, j] += pixels[n, 3 + j]
            sums.slopes[k, 1, j] += at.value * pixels[n, 3 + j]


@subroutine
def _levels(sums: Sums, levels: FloatArray) -> float:
    """The dark level and the contrast of each block, and the mean contrast of all.

    A block of one colour, or of the wrong contrast, has none.
    """
    total, number = 0.0, 0.0
    for k in range(len(levels)):
        n, t, tt, i, ti = sums.plain[k]
        levels[k, 0] = levels[k, 1] = 0.0
        if n < _LEAST_PIXELS:
            continue
        spread = tt - t * t / n
        if spread < 0.02 * n:
            continue
        contrast = (ti - t * i / n) / spread
        if contrast <= 0.0:
            continue
        levels[k, 0], levels[k, 1] = (i - contrast * t) / n, contrast
        total += n * contrast
        number += n
    return total / number if number > 0.0 else 0.0


@subroutine
def _weights(
    pixels: FloatArray, count: int, sums: Sums, levels: FloatArray, weights: FloatArray
) -> float:
    """What blocks count, less where the print does not explain what is seen; the variance left."""
    weights[:] = 0.0
    for n in range(count):
        k = int(pixels[n, 1])
        if k >= 0 and levels[k, 1] > 0.0:
            r = pixels[n, 0] - levels[k, 0] - levels[k, 1] * pixels[n, 2]
            weights[k] += r * r
    squares, number = 0.0, 0.0
    for k in range(len(weights)):
        if levels[k, 1] > 0.0:
            weights[k] /= sums.plain[k, 0]
            # the geometric mean, which few bad blocks do not lift
            squares += sums.plain[k, 0] * log(weights[k] + 0.05)
            number += sums.plain[k, 0]
    if number == 0.0:
        return 0.0
    usual = exp(squares / number)
    left = 0.0
    for k in range(len(weights)):
        if levels[k, 1] > 0.0:
            own = weights[k]
            weights[k] = 1.0 if own < 4.0 * usual else (4.0 * usual / own)
            left += weights[k] * own * sums.plain[k, 0]
    return left


@subroutine
def _normal(
    pixels: FloatArray,
    count: int,
    sums: Sums,
    levels: FloatArray,
    weights: FloatArray,
    matrix: FloatArray,
    right: FloatArray,
) -> None:
    """The normal equations of a step, levels eliminated."""
    matrix[:] = 0.0
    right[:] = 0.0
    for n in range(count):
        k = int(pixels[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixels[n, 0] - levels[k, 0] - contrast * pixels[n, 2]
        weight = weights[k] * contrast
        for j in range(_UNKNOWNS):
            slope = weight * pixels[n, 3 + j]
            right[j] += slope * r
            slope *= contrast
            # all of the row: loops of one length run several numbers at once
            for i in range(_UNKNOWNS):
                matrix[j, i] += slope * pixels[n, 3 + i]
    for k in range(len(levels)):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums.plain[k, 0], sums.plain[k, 1], sums.plain[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(_UNKNOWNS):
            one, by_print = sums.slopes[k, 0, j], sums.slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            for i in range(j + 1):
                matrix[j, i] -= weight * (
                    p * sums.slopes[k, 0, i] + q * sums.slopes[k, 1, i]
                )


@subroutine
def _factor(matrix: FloatArray) -> bool:
    """The lower Cholesky factor in place; False where the matrix is not positive definite."""
    size = len(matrix)
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-12:
                    return False
                matrix[j, j] = sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@subroutine
def _solve(factor: FloatArray, right: FloatArray) -> None:
    """Solve with a lower Cholesky factor, in place."""
    size = len(right)
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@device
def _compose(G: FloatArray, step: FloatArray) -> None:
    """Move the plane: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


class Fit(NamedTuple):
    """What a fit came to."""

    contrast: float
    """Grey levels; 0 where nothing was fitted."""
    explained: float
    """The share of the variance near the edges that the print explains."""
    wrong: int
    """Cells that do not have the grey that is printed there."""


_NOTHING: Final = Fit(0.0, 0.0, 0)


@compiled
def fit_tag(
    image: NDArray[np.uint8],
    rays: NDArray[np.float32],
    row: FloatArray,
    cells: FloatArray,
    border: int,
    steps: tuple[int, int],
    most: tuple[int, int],
    start: FloatArray,
    points: FloatArray,
    sigmas: FloatArray,
) -> Fit:
    """Fit a tag's edges, and read its cells.

    Args:
        image: grey levels, shape (height, width).
        rays: (height, width, 2) undistorted ray of each pixel; (0, 0, 2) for a pinhole.
        row: the camera, see `pack_camera`.
        cells: (n, n) the print, 0 black to 1 white, nan unknown.
        border: cells along the square whose corners are sought, in the middle of the print.
        steps: at most, in each of the two stages: first with a wide band, then with a narrow one.
        most: pixels that take part in each of them.
        start: (4, 2) about where the corners are, px, from the upper left clockwise.
        points: (5, 2) result: the corners and the centre, px.
        sigmas: (5, 2) result: their standard deviations, px.

    Returns:
        How well it fits.
    """
    camera, lens = camera_at(row, 0), len(rays) > 0
    focal_px = camera.focal_u if lens else 1.0
    corners, bounds = np.empty((4, 2)), np.empty(4, np.int64)
    least, greatest = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(4):
        corners[k, 0], corners[k, 1] = ideal_of(rays, focal_px, start[k, 0], start[k, 1])
        for i in range(2):
            least[i] = min(least[i], start[k, i])
            greatest[i] = max(greatest[i], start[k, i])
    margin = _BOUNDS_PX + max(greatest[0] - least[0], greatest[1] - least[1]) / border
    bounds[0], bounds[1] = int(least[0] - margin), int(greatest[0] + margin)
    bounds[2], bounds[3] = int(least[1] - margin), int(greatest[1] + margin)
    G, moved = np.empty((3, 3)), np.empty((4, 2))
    room = max(most[0], most[1])
    places, pixels = np.empty((room, 3)), np.empty((room, _COLUMNS))
    along_x, along_y = np.empty((3, MOST_REACHED)), np.empty((3, MOST_REACHED))
    matrix, step = np.empty((_UNKNOWNS, _UNKNOWNS)), np.empty(_UNKNOWNS)
    blurs, covariances = np.full(2, _FIRST_BLUR_PX), np.empty((5, 2, 2))
    shortest, longest = np.inf, 0.0
    for k in range(4):
        other = (k + 1) % 4
        side = hypot(corners[other, 0] - corners[k, 0], corners[other, 1] - corners[k, 1])
        shortest, longest = min(shortest, side), max(longest, side)
    cell_px = shortest / border
    most_blocks = min(max(int(0.5 * (shortest + longest) / _BLOCK_PX), 1), _MOST_BLOCKS)
    most_blocks = min(most_blocks, 1 + most[1] // (4 * _PIXELS_PER_BLOCK))
    all_plain = np.empty((most_blocks * most_blocks, 5))
    all_slopes = np.empty((most_blocks * most_blocks, 2, _UNKNOWNS))
    all_levels = np.empty((most_blocks * most_blocks, 2))
    all_weights = np.empty(most_blocks * most_blocks)
    most_blur = min(max(_MOST_BLUR_CELLS * cell_px, 0.5), _BLURS_PX[1])
    contrast = left = far = 0.0
    blocks = count = 0
    for stage in range(2):
        plane_of(corners, G)
        blocks = min(most_blocks, _FIRST_BLOCKS) if stage == 0 else most_blocks
        square = blocks * blocks
        sums = Sums(all_plain[:square], all_slopes[:square])
        levels, weights = all_levels[:square], all_weights[:square]
        if stage == 0:
            reach_px = min(_WIDE_PX, max(cell_px, 2.0))
            blurs[:] = min(_WIDE_BLUR_PX, max(_WIDE_BLUR_CELLS * cell_px, _FIRST_BLUR_PX))
        else:
            blurs[:] = _FIRST_BLUR_PX
            reach_px = _REACH_PX + _REACH_BLURS * _FIRST_BLUR_PX
        whole = cell_px < reach_px + 2.0 * blurs[0]
        unseen_px = _QUIET_BLURS * (_FIRST_BLUR_PX if stage == 0 else blurs[0])
        count = _gather(
            image, rays, focal_px, G, corners, bounds, border, reach_px, unseen_px, whole,
            most[stage], places,
        )  # fmt: skip
        if count < 4 * _UNKNOWNS:
            return _NOTHING
        for _ in range(steps[stage]):
            _evaluate(
                places, count, G, blurs, cells, border, blocks, pixels, along_x, along_y, sums
            )
            contrast = _levels(sums, levels)
            if contrast <= 0.0:
                return _NOTHING
            left = _weights(pixels, count, sums, levels, weights)
            _normal(pixels, count, sums, levels, weights, matrix, step)
            # blurs stay near where they are unless the pixels say otherwise
            hold = (_HOLD if stage == 1 else 1.0) * contrast * contrast * count
            matrix[8, 8] += hold
            matrix[9, 9] += hold
            if not _factor(matrix):
                return _NOTHING
            _solve(matrix, step)
            _compose(G, step)
            for axis in range(2):
                change = min(max(step[8 + axis], -0.7), 0.7)
                blurs[axis] = min(max(blurs[axis] * exp(change), _BLURS_PX[0]), most_blur)
            _corners_of(G, moved)
            far = 0.0
            for k in range(4):
                far = max(far, hypot(moved[k, 0] - corners[k, 0], moved[k, 1] - corners[k, 1]))
            if not far < _LONG_STEP_PX + 0.5 * cell_px:
                return _NOTHING
            corners[:] = moved
            if far < (_SMALL_STEP_PX if stage == 1 else _FIRST_STEP_PX):
                break
    if not far < _CONVERGED_PX:
        return _NOTHING
    # what is left, by the pixels that are more than the unknowns
    free, total = -float(_UNKNOWNS), 0.0
    for k in range(len(levels)):
        if levels[k, 1] > 0.0:
            n, t, tt = sums.plain[k, 0], sums.plain[k, 1], sums.plain[k, 2]
            free += weights[k] * n - 2.0
            total += weights[k] * levels[k, 1] * levels[k, 1] * (tt - t * t / n)
    variance = left / max(free, 1.0)
    _spread(matrix, G, variance, covariances)
    for k in range(5):
        if k < 4:
            u, v = corners[k, 0], corners[k, 1]
        else:
            u, v = pixel_of(G, 0.0, 0.0)
        _report(camera, lens, focal_px, u, v, covariances[k], points[k], sigmas[k])
    offset = 0.5 * (len(cells) - border)
    wrong = wrong_cells(
        image, G, camera, lens, focal_px, cells, offset, offset, float(border), float(border),
        np.empty(cells.shape),
    )  # fmt: skip
    return Fit(contrast, total / (total + left), wrong)


@subroutine
def _report(
    camera: CameraRow,
    lens: bool,
    focal_px: float,
    u: float,
    v: float,
    covariance: FloatArray,
    point: FloatArray,
    sigma: FloatArray,
) -> None:
    """A point and its standard deviations as the lens shows them.

    Args:
        camera: the eye's.
        lens: whether it bends the image.
        focal_px: see `seen_at`.
        u: of the point, undistorted.
        v: the same.
        covariance: (2, 2) of the point, undistorted.
        point: (2,) result.
        sigma: (2,) result.
    """
    point[0], point[1] = seen_at(camera, lens, focal_px, u, v)
    a, b, c = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    if lens:
        bent = distort(camera, u / focal_px, v / focal_px)
        xx, xy, yy = bent.dxx, bent.dxy, bent.dyy
        a, c = xx * xx * a + 2.0 * xx * xy * b + xy * xy * c, (
            xy * xy * a + 2.0 * xy * yy * b + yy * yy * c
        )
    sigma[0], sigma[1] = sqrt(a), sqrt(c)


@subroutine
def _spread(factor: FloatArray, G: FloatArray, variance: float, covariances: FloatArray) -> None:
    """The covariances of corners and centre by that of the unknowns: J N^-1 J^T and the variance."""
    J, column = np.zeros((2, _UNKNOWNS)), np.empty(_UNKNOWNS)
    g, h, i = G[2, 0], G[2, 1], G[2, 2]
    for point in range(5):
        x = -1.0 if point == 0 or point == 3 else 1.0
        y = -1.0 if point < 2 else 1.0
        if point == 4:
            x = y = 0.0
        u, v = pixel_of(G, x, y)
        w = g * u + h * v + i
        # the plane's coordinates by pixels
        a, b = (G[0, 0] - x * g) / w, (G[0, 1] - x * h) / w
        c, d = (G[1, 0] - y * g) / w, (G[1, 1] - y * h) / w
        det = a * d - b * c
        for j in range(8):
            by_x = x if j == 0 else y if j == 1 else 1.0 if j == 2 else 0.0
            by_y = x if j == 3 else y if j == 4 else 1.0 if j == 5 else 0.0
            if j == 6:
                by_x, by_y = -x * x, -x * y
            if j == 7:
                by_x, by_y = -x * y, -y * y
            J[0, j] = -(d * by_x - b * by_y) / det
            J[1, j] = -(a * by_y - c * by_x) / det
        for r in range(2):
            for j in range(_UNKNOWNS):
                column[j] = J[r, j]
            _solve(factor, column)
            for s in range(2):
                total = 0.0
                for j in range(_UNKNOWNS):
                    total += J[s, j] * column[j]
                covariances[point, r, s] = variance * total
