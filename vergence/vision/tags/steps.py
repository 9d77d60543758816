"""Gauss-Newton steps of a tag's fit: levels of blocks, normal equations, priors, variance."""

from math import exp, hypot, inf, log, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import subroutine
from vergence.models.fixation import cholesky_factorise, cholesky_solve, forward_substitute
from vergence.models.parts import FloatArray
from vergence.vision.optics import square_to_image_homography, transform_point
from vergence.vision.tags.samples import (
    BEND_START,
    CUBIC_START,
    MAX_UNKNOWNS,
    POINTS,
    WHITE_SPREAD_INDEX,
    FitStage,
    FitState,
    TagSearch,
    evaluate_print,
)


@subroutine
def _build_normal_equations(
    stage: FitStage, unknown_count: int, matrix: FloatArray, right_side: FloatArray
) -> None:
    """Build the normal equations of a step with the levels eliminated, by block and in total."""
    pixel_rows, levels, weights, sums, slopes = (
        stage.pixel_rows, stage.levels, stage.weights, stage.moments, stage.derivative_sums
    )  # fmt: skip
    every_score, every_normal = stage.scores, stage.normal_matrices
    right_side[:] = 0.0
    matrix[:] = 0.0
    every_score[:] = 0.0
    every_normal[:] = 0.0
    for n in range(len(pixel_rows)):
        k = int(pixel_rows[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixel_rows[n, 0] - levels[k, 0] - contrast * pixel_rows[n, 2]
        weight = weights[k] * contrast
        scores, normal = every_score[k], every_normal[k]
        for j in range(unknown_count):
            slope = weight * pixel_rows[n, 3 + j]
            scores[j] += slope * r
            slope *= contrast
            # full rows, not only a triangle: loops of equal length are vectorised
            for i in range(unknown_count):
                normal[j, i] += slope * pixel_rows[n, 3 + i]
    for k in range(len(levels)):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums[k, 0], sums[k, 1], sums[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(unknown_count):
            one, by_print = slopes[k, 0, j], slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            right_side[j] += every_score[k, j]
            for i in range(unknown_count):
                less = weight * (p * slopes[k, 0, i] + q * slopes[k, 1, i])
                every_normal[k, j, i] -= less
                matrix[j, i] += every_normal[k, j, i]


@subroutine
def _add_priors(
    matrix: FloatArray, right_side: FloatArray, white_spread_and_bend: FloatArray,
    prior_weights: tuple[float, float, float, float], unknown_count: int,
) -> None:  # fmt: skip
    """Add Gaussian priors to normal equations: blurs stay, white spread and bend are near 0.

    Weights, pixel variance / prior variance, are those of blurs, spread, and bend by degree.
    """
    matrix[8, 8] += prior_weights[0]
    matrix[9, 9] += prior_weights[0]
    for k in range(WHITE_SPREAD_INDEX, unknown_count):
        weight = prior_weights[2] if k < CUBIC_START else prior_weights[3]
        if k == WHITE_SPREAD_INDEX:
            weight = prior_weights[1]
        matrix[k, k] += weight
        right_side[k] -= weight * white_spread_and_bend[k - WHITE_SPREAD_INDEX]


@subroutine
def block_squares_and_dof(stage: FitStage, unknown_count: int) -> tuple[float, float]:
    """Sum of squares of whole blocks' residuals after the last step, and its degrees of freedom.

    Their ratio estimates the variance of a pixel. Residuals that are correlated from pixel to pixel
    add up: their sum over a block of N pixels scatters by more than the square root of N. With the
    blocks' scores s_k and normal matrices N_k, and N their sum,
    ``E s_k^T N^-1 s_k = sigma^2 (tr A_k - tr A_k^2)``, ``A_k = N^-1 N_k``.
    """
    factor, step = stage.normal_matrix, stage.step
    scores, normal, levels = stage.scores, stage.normal_matrices, stage.levels
    score, part = np.empty(MAX_UNKNOWNS), np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS))
    squares = free = 0.0
    for k in range(len(levels)):
        if levels[k, 1] <= 0.0:
            continue
        for j in range(unknown_count):
            score[j] = scores[k, j]
            for i in range(unknown_count):
                score[j] -= normal[k, j, i] * step[i]
                part[i, j] = normal[k, j, i]
        forward_substitute(factor, score, unknown_count)
        # L^-1 N_k L^-T, both sides by rows
        for _ in range(2):
            for j in range(unknown_count):
                forward_substitute(factor, part[j], unknown_count)
            for j in range(unknown_count):
                for i in range(j):
                    part[i, j], part[j, i] = part[j, i], part[i, j]
        for j in range(unknown_count):
            squares += score[j] * score[j]
            free += part[j, j]
            for i in range(unknown_count):
                free -= part[j, i] * part[j, i]
    return squares, max(free, 0.0)


_LEAST_PIVOT: Final = 1e-12
"""Least pivot of a normal matrix that is positive definite (numerical)."""
_WEAK_SIGMA: Final = 0.1
"""Sigma of a weak prior on spread, px, and bend, half edges: pixels outweigh it (numerical)."""
_LEAST_BEND_SIGNIFICANCES: Final = ((8, 2.25), (12, 8.0))
"""Numbers of coefficients, the first ones, and ratios to its expectation by noise of the squared
Mahalanobis norm of so many, of which one must be exceeded (chosen: one flat tag in 16 exceeds the
first; the last four coefficients follow other errors of small tags, too)."""


@subroutine
def rms_bend_coefficients(white_spread_and_bend: FloatArray) -> tuple[float, float]:
    """Root mean squares of a bend's quadratic and cubic coefficients."""
    first, end = CUBIC_START - WHITE_SPREAD_INDEX, MAX_UNKNOWNS - WHITE_SPREAD_INDEX
    return (
        sqrt(np.square(white_spread_and_bend[1:first]).mean()),
        sqrt(np.square(white_spread_and_bend[first:end]).mean()),
    )


@subroutine
def estimate_bend_prior_sigmas(
    stage: FitStage, white_spread_and_bend: FloatArray, pixel_variance: float
) -> tuple[float, float]:
    """Prior standard deviations of a bend's coefficients by empirical Bayes, after a flat fit.

    They are the root mean squares of the quadratic and the cubic coefficients, weighted by how well
    the pixels determine each; 0 if they are no larger than noise makes them. Noise is included:
    without it, a coefficient that is as large as its noise would be held at 0.
    """
    matrix, solution = np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS)), np.empty(MAX_UNKNOWNS)
    _build_normal_equations(stage, MAX_UNKNOWNS, matrix, solution)
    for j in range(MAX_UNKNOWNS):
        for i in range(BEND_START):
            solution[j] -= matrix[j, i] * stage.step[i]
    weak = pixel_variance / _WEAK_SIGMA**2
    blur_weight = 1e-5 * (matrix[8, 8] + matrix[9, 9])
    weights = blur_weight, weak, weak, weak
    _add_priors(matrix, solution, white_spread_and_bend, weights, MAX_UNKNOWNS)
    if not cholesky_factorise(matrix, MAX_UNKNOWNS, _LEAST_PIVOT):
        return 0.0, 0.0
    # of a flat sheet these are independent, with a pixel's variance
    forward_substitute(matrix, solution, MAX_UNKNOWNS)
    significant = False
    for count, least in _LEAST_BEND_SIGNIFICANCES:
        squares = np.square(solution[BEND_START : BEND_START + count]).sum()
        significant |= squares > least * count * pixel_variance
    if not significant:
        return 0.0, 0.0
    cubic = _mean_square(matrix, solution, CUBIC_START, MAX_UNKNOWNS, 0.0)
    quadratic = _mean_square(matrix, solution, BEND_START, CUBIC_START, cubic)
    return sqrt(quadratic), sqrt(cubic)


@subroutine
def _mean_square(
    factor: FloatArray, whitened: FloatArray, first: int, end: int, later_mean_square: float
) -> float:
    """Mean square of some unknowns, weighted by their information, given that of later ones."""
    squares = information = 0.0
    for j in range(first, end):
        squares += whitened[j] * whitened[j]
        for i in range(j, MAX_UNKNOWNS):
            if i < end:
                information += factor[i, j] * factor[i, j]
            else:
                squares -= later_mean_square * factor[i, j] * factor[i, j]
    return max(squares / information, 0.0)


_LEAST_BLUR_PX: Final = 0.3
"""Smallest blur of a fit, px (chosen: sharp images against edges that few pixels show)."""
_LONGEST_BLUR_STEP: Final = 0.7
"""Largest step of a blur's logarithm (numerical)."""
_LEAST_STEP_FRACTION: Final = 0.2
"""Smallest fraction of a step that is taken after an overshoot (numerical)."""
_FRACTION_GROWTH: Final = 1.5
"""Factor by which this fraction grows again after a step without overshoot (numerical)."""


@subroutine
def gauss_newton_step(
    state: FitState, stage: FitStage, unknown_count: int,
    prior_weights: tuple[float, float, float, float], max_blur_px: float,
) -> tuple[float, float]:  # fmt: skip
    """Take a Gauss-Newton step: its largest move of a corner, px, and change of a log blur.

    A step overshot if the slope along it has changed sign; the secant then gives the right fraction
    for the next. Without this, steps oscillate if edges are sharpened or seen at a low angle. The
    move is infinite if the normal matrix is not positive definite.
    """
    matrix, step, last = stage.normal_matrix, stage.step, stage.previous_step
    G, H, corners = state.G, state.H, state.corners
    _build_normal_equations(stage, unknown_count, matrix, step)
    _add_priors(matrix, step, state.white_spread_and_bend, prior_weights, unknown_count)
    fraction, start_slope = stage.step_fraction_and_slope
    slope = 0.0
    for k in range(unknown_count):
        slope += step[k] * last[k]
    if slope < 0.0:
        fraction = max(fraction * start_slope / (start_slope - slope), _LEAST_STEP_FRACTION)
    else:
        fraction = min(_FRACTION_GROWTH * fraction, 1.0)
    last[:] = step
    if not cholesky_factorise(matrix, unknown_count, _LEAST_PIVOT):
        return inf, inf
    cholesky_solve(matrix, step, unknown_count)
    slope = 0.0
    for k in range(unknown_count):
        step[k] *= fraction
        slope += step[k] * last[k]
    last[:] = step
    stage.step_fraction_and_slope[0], stage.step_fraction_and_slope[1] = fraction, slope
    # G becomes (1 + step) G
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c
    square_to_image_homography(G, H)
    corner_step_px = blur_step = 0.0
    for k in range(4):
        u, v = transform_point(H, POINTS[k, 0], POINTS[k, 1])
        corner_step_px = max(corner_step_px, hypot(u - corners[k, 0], v - corners[k, 1]))
        corners[k, 0], corners[k, 1] = u, v
    for axis in range(2):
        change = min(max(step[8 + axis], -_LONGEST_BLUR_STEP), _LONGEST_BLUR_STEP)
        blur_step = max(blur_step, abs(change))
        blur_px = state.blurs_px[axis] * exp(change)
        state.blurs_px[axis] = min(max(blur_px, _LEAST_BLUR_PX), max_blur_px)
    for k in range(WHITE_SPREAD_INDEX, unknown_count):
        state.white_spread_and_bend[k - WHITE_SPREAD_INDEX] += step[k]
    return corner_step_px, blur_step


_LEAST_BLOCK_PIXELS: Final = 6
"""Fewest pixels of a block that is used (chosen: small tags against noisy levels)."""
_LEAST_PRINT_VARIANCE: Final = 0.02
"""Variance of the print in a block below which its contrast is undetermined (chosen: as above)."""
_OUTLIER_VARIANCE_RATIO: Final = 4.0
"""Residual variance, by the usual one, above which a block's weight falls (chosen: robustness)."""


@subroutine
def _estimate_levels(stage: FitStage) -> float:
    """Estimate the dark level and contrast of each block; return the mean contrast.

    A block of one colour, or with a contrast of the wrong sign, gets contrast 0: it is not used.
    """
    sums, levels, total, pixels = stage.moments, stage.levels, 0.0, 0.0
    for k in range(len(sums)):
        n, t, tt, i, ti = sums[k]
        levels[k, 0] = levels[k, 1] = 0.0
        if n < _LEAST_BLOCK_PIXELS:
            continue
        print_squares = tt - t * t / n
        if print_squares < _LEAST_PRINT_VARIANCE * n:
            continue
        contrast = (ti - t * i / n) / print_squares
        if contrast <= 0.0:
            continue
        levels[k, 0], levels[k, 1] = (i - contrast * t) / n, contrast
        total += n * contrast
        pixels += n
    return total / pixels if pixels > 0.0 else 0.0


class PrintResiduals(NamedTuple):
    """Residuals of all pixels' light after the print."""

    contrast: float
    """Mean contrast of all blocks; 0 if none has any."""
    explained_fraction: float
    """Fraction of the weighted squares of light that the print explains."""
    pixel_variance: float
    """Variance of a pixel."""


@subroutine
def compare_print(search: TagSearch, state: FitState, stage: FitStage) -> PrintResiduals:
    """Compare the print with the pixels; weight each block, less if its residuals are large."""
    evaluate_print(search, state, stage)
    contrast = _estimate_levels(stage)
    if contrast <= 0.0:
        return PrintResiduals(0.0, 0.0, 0.0)
    sums, levels, weights, pixel_rows = (
        stage.moments, stage.levels, stage.weights, stage.pixel_rows
    )  # fmt: skip
    weights[:] = 0.0
    for n in range(len(pixel_rows)):
        k = int(pixel_rows[n, 1])
        if k >= 0 and levels[k, 1] > 0.0:
            r = pixel_rows[n, 0] - levels[k, 0] - levels[k, 1] * pixel_rows[n, 2]
            weights[k] += r * r
    log_total = total = 0.0
    for k in range(len(sums)):
        if levels[k, 1] > 0.0:
            weights[k] /= sums[k, 0]
            # the geometric mean, which a few bad blocks hardly raise
            log_total += sums[k, 0] * log(weights[k] + 0.05)
            total += sums[k, 0]
    usual = exp(log_total / total)
    explained = unexplained = 0.0
    free = -float(MAX_UNKNOWNS)
    for k in range(len(sums)):
        if levels[k, 1] > 0.0:
            n, t, tt = sums[k, 0], sums[k, 1], sums[k, 2]
            own = weights[k]
            inlying = own < _OUTLIER_VARIANCE_RATIO * usual
            weights[k] = 1.0 if inlying else _OUTLIER_VARIANCE_RATIO * usual / own
            unexplained += weights[k] * own * n
            explained += weights[k] * levels[k, 1] * levels[k, 1] * (tt - t * t / n)
            free += weights[k] * n - 2.0
    fraction = explained / (explained + unexplained)
    return PrintResiduals(contrast, fraction, unexplained / max(free, 1.0))
