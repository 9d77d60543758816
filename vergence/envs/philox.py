r"""Random numbers as a function of a key and a counter, in compiled code: NumPy's Philox.

Philox-4x64-10 (Salmon, Moraes, Dror and Shaw 2011, "Parallel random numbers: as easy as 1, 2,
3") turns a counter of four words into four random words. A kernel can therefore make the numbers
of any step of any trial where it needs them, without state and without memory. They are those
of `numpy.random.Philox` with the same key and the counter (lane - 1, 0, purpose, block), which
NumPy increments before use.
"""

from enum import IntEnum
from math import factorial, log, pi, sqrt
from typing import Any, Final

import numpy as np
from numba import types
from numba.extending import intrinsic

from vergence._jit import device

_MULTIPLIERS: Final = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_WEYL: Final = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))
_ROUNDS: Final = 10
_TO_DOUBLE: Final = 1.0 / 2**53
_ELEVEN: Final = np.uint64(11)
_ONE: Final = np.uint64(1)
_SINE: Final = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(8))
_COSINE: Final = tuple((-1.0) ** k / factorial(2 * k) for k in range(8))


class Purpose(IntEnum):
    """What a stream is for; each has its own numbers."""

    TASK = 0
    SENSOR = 1
    BEFORE = 2
    IMAGE = 3
    VARIATION = 4


def _multiply(typing_context: Any, a: Any, b: Any) -> Any:
    """The upper 64 bits of a product of two words."""

    def generate(context: Any, builder: Any, signature: Any, words: Any) -> Any:
        wide = words[0].type.__class__(128)
        product = builder.mul(builder.zext(words[0], wide), builder.zext(words[1], wide))
        return builder.trunc(builder.lshr(product, wide(64)), words[0].type)

    return types.uint64(types.uint64, types.uint64), generate


_high_word: Any = intrinsic(_multiply)


@device
def random_words(seed: Any, trial: Any, purpose: int, block: int, lane: int) -> Any:
    """Four random words: the lane-th four, from 1, of a block."""
    k0, k1 = seed, trial
    c0, c1, c2, c3 = np.uint64(lane), np.uint64(0), np.uint64(purpose), np.uint64(block)
    for _ in range(_ROUNDS):
        high0, low0 = _high_word(_MULTIPLIERS[0], c0), _MULTIPLIERS[0] * c0
        high1, low1 = _high_word(_MULTIPLIERS[1], c2), _MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0 += _WEYL[0]
        k1 += _WEYL[1]
    return c0, c1, c2, c3


@device
def to_uniform(word: Any) -> Any:
    """A number from 0 to below 1."""
    return (word >> _ELEVEN) * _TO_DOUBLE


@device
def to_normals(first: Any, second: Any) -> Any:
    """Two independent standard normal numbers (Box and Muller 1958).

    The angle is drawn within 45 degrees of an axis, where short series give sine and cosine to
    the last digit, and two bits say which axis: a processor cannot foresee the branches that
    library functions take for random arguments.
    """
    radius = sqrt(-2.0 * log(((first >> _ELEVEN) + 0.5) * _TO_DOUBLE))
    x = 0.5 * pi * (to_uniform(second) - 0.5)
    y = x * x
    sine = cosine = 0.0
    for k in range(7, -1, -1):
        sine = _SINE[k] + y * sine
        cosine = _COSINE[k] + y * cosine
    along, across = radius * cosine, radius * x * sine
    sign = 1.0 - 2.0 * (second & _ONE)
    swap = 1.0 * ((second >> _ONE) & _ONE)
    stay = 1.0 - swap
    return sign * (stay * along + swap * across), sign * (stay * across + swap * along)
