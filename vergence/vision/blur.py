"""Kernels of lens blur and motion blur."""

import math

import numpy as np
from numpy.typing import NDArray


def gaussian_radius_and_sigma(wanted_sigma: float) -> tuple[int, float]:
    """Radius of a Gaussian kernel and the sigma that gives its taps the wanted standard deviation.

    A kernel of three taps costs half as much as one of five and reaches a variance of 2/3.
    """
    share = 0.5 * wanted_sigma**2
    if share < 0.01:
        return 0, 0.0
    if share < 0.36:
        share = min(share, 0.333)
        return 1, math.sqrt(-0.5 / math.log(share / (1 - 2 * share)))
    return round(2.5 * wanted_sigma), wanted_sigma


def motion_blur_kernel(displacement: NDArray[np.float64]) -> NDArray[np.float32]:
    """Kernel of a uniform motion: a line through its centre with a displacement in samples."""
    count = max(math.ceil(4 * math.hypot(displacement[0], displacement[1])), 2)
    fraction = (np.arange(count) + 0.5) / count - 0.5
    half_x, half_y = (math.ceil(0.5 * abs(value)) + 1 for value in displacement.tolist())
    x, y = fraction * displacement[0] + half_x, fraction * displacement[1] + half_y
    kernel = np.zeros((2 * half_y + 1, 2 * half_x + 1), np.float32)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for column, row, weight in (
        (left, top, (left + 1 - x) * (top + 1 - y)),
        (left + 1, top, (x - left) * (top + 1 - y)),
        (left, top + 1, (left + 1 - x) * (y - top)),
        (left + 1, top + 1, (x - left) * (y - top)),
    ):
        np.add.at(kernel, (row, column), weight / count)
    return kernel
