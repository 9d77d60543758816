"""White grey-level noise for images by table look-up."""

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

NOISE_MEAN: Final = 128
"""Stored level of noise 0 (numerical: middle of 8 bits)."""
NOISE_UNIT: Final = 24.0
"""Stored levels per standard deviation; 127 levels cover five of them (chosen: resolution
against clipping)."""


def noise_window(
    rng: np.random.Generator, shape: tuple[int, int], longest_side_px: int
) -> NDArray[np.uint8]:
    """Independent normal numbers for the pixels of a region.

    Sampling normal numbers for each frame would cost as much as rendering the board. Instead they
    come from a bank, a fixed table of normal numbers that is equal in every process; the frame's
    generator picks the region's start in it among more than a million positions. The noise of a
    pixel is then independent from frame to frame, except if two windows start within a few pixels
    of each other, about once in 10,000 pairs of frames.

    Args:
        rng: generator that picks the start; one number is drawn.
        shape: (height, width) of the region.
        longest_side_px: longest side of the frame, which determines the size of the bank.

    Returns:
        Numbers stored as ``NOISE_MEAN + NOISE_UNIT * n``, n standard normal; a read-only view of
        the given shape.
    """
    bank = _bank(max(2048, 1 << (longest_side_px + longest_side_px // 2 - 1).bit_length()))
    height, width = shape
    columns = bank.shape[1] - width
    y, x = divmod(int(rng.integers((bank.shape[0] - height) * columns)), columns)
    return bank[y : y + height, x : x + width]


@lru_cache(maxsize=2)
def _bank(side: int) -> NDArray[np.uint8]:
    numbers = np.random.default_rng(side).standard_normal((side, side), np.float32)
    bank = np.rint(NOISE_MEAN + NOISE_UNIT * numbers).clip(0, 255)
    levels: NDArray[np.uint8] = bank.astype(np.uint8)
    levels.setflags(write=False)
    return levels
