"""White grey-level noise for images, at the cost of a table look-up."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

NOISE_MEAN = 128
NOISE_UNIT = 24.0
"""Stored levels of one standard deviation; 127 levels hold five of them."""


def noise_window(
    rng: np.random.Generator, shape: tuple[int, int], longest: int
) -> NDArray[np.uint8]:
    """Independent normal numbers for the pixels of a region.

    Drawing normal numbers for each frame costs as much as drawing the board. They come from a
    bank, a table of normal numbers that is the same in every process, and the frame's generator
    picks where the region starts in it, out of a million places and more. What a pixel gets is
    then independent from frame to frame but for windows that start within a few pixels of each
    other, which happens to two frames about once in 10,000 times.

    Args:
        rng: generator that picks the place; one number is drawn.
        shape: (height, width) of the region.
        longest: longest side of the frame, which sets the size of the bank.

    Returns:
        Numbers stored as ``NOISE_MEAN + NOISE_UNIT * n``, n standard normal, a view of the given
        shape.
    """
    bank = _bank(max(2048, 1 << (longest + longest // 2 - 1).bit_length()))
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
