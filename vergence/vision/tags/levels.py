"""Dark level, contrast and weight of each block of a tag."""

from math import exp, log
from typing import Final

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.tags.workspace import Blocks

_LEAST_BLOCK_PIXELS: Final = 6
"""Fewest pixels of a block that is used (chosen: small tags against noisy levels)."""
_LEAST_PRINT_VARIANCE: Final = 0.02
"""Variance of the print in a block below which its contrast is undetermined (chosen: as above)."""
_OUTLIER_VARIANCE_RATIO: Final = 4.0
"""Ratio of a block's residual variance to the usual one above which its weight falls (chosen:
robustness against efficiency)."""


@subroutine
def estimate_block_levels(blocks: Blocks, block_count: int) -> float:
    """Estimate the dark level and contrast of each block; return the mean contrast.

    A block of one colour, or with a contrast of the wrong sign, gets contrast 0: it is not used.
    """
    sums, levels, total, pixels = blocks.moments, blocks.levels, 0.0, 0.0
    for k in range(block_count):
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


@subroutine
def reweight_and_sum_squares(
    pixel_rows: FloatArray, pixel_count: int, blocks: Blocks, block_count: int
) -> float:
    """Set the weight of each block, lower if its residuals are unusually large.

    Return the sum of all squared residuals by these weights.
    """
    sums, levels, weights = blocks.moments, blocks.levels, blocks.weights
    for k in range(block_count):
        weights[k] = 0.0
    for n in range(pixel_count):
        k = int(pixel_rows[n, 1])
        if k >= 0 and levels[k, 1] > 0.0:
            r = pixel_rows[n, 0] - levels[k, 0] - levels[k, 1] * pixel_rows[n, 2]
            weights[k] += r * r
    log_total, total = 0.0, 0.0
    for k in range(block_count):
        if levels[k, 1] > 0.0:
            weights[k] /= sums[k, 0]
            # the geometric mean, which a few bad blocks hardly raise
            log_total += sums[k, 0] * log(weights[k] + 0.05)
            total += sums[k, 0]
    if total == 0.0:
        return 0.0
    usual = exp(log_total / total)
    weighted = 0.0
    for k in range(block_count):
        if levels[k, 1] > 0.0:
            own = weights[k]
            weights[k] = (
                1.0
                if own < _OUTLIER_VARIANCE_RATIO * usual
                else _OUTLIER_VARIANCE_RATIO * usual / own
            )
            weighted += weights[k] * own * sums[k, 0]
    return weighted
