"""Random streams keyed by (seed, trial), and states of simulations saved bit by bit.

Philox-4x64-10 (Salmon, Moraes, Dror and Shaw 2011, "Parallel random numbers: as easy as 1, 2,
3") turns a key of two words and a counter of four into four random words. Here the key is
(seed, trial) and the counter is (lane - 1, 0, purpose, block). So any random number of any trial
can be drawn at any time, in any order, alone or among a thousand others, and is always the same.
`RandomStreams` does this with NumPy's generator; `random_words` computes the same words in compiled
code, without a generator's state or memory. (NumPy increments the counter before use.)
"""

from collections.abc import Mapping
from enum import IntEnum
from math import factorial, log, pi, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.kernels import inlined

IntArray = NDArray[np.int64]
KeyArray = NDArray[np.uint64]
Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]

# Philox-4x64-10: multipliers, increments of the key, number of rounds; then the factor and the
# shift that make a double of a word's upper 53 bits, and the mask of its lowest bit (numerical)
_MULTIPLIERS: Final = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_WEYL: Final = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))
_ROUNDS: Final = 10
_TO_DOUBLE: Final = 1.0 / 2**53
_MANTISSA_SHIFT: Final = np.uint64(11)
_LOWEST_BIT: Final = np.uint64(1)
_SINE: Final = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(8))
_COSINE: Final = tuple((-1.0) ** k / factorial(2 * k) for k in range(8))


class StreamPurpose(IntEnum):
    """Purpose of a random stream; each purpose has its own numbers."""

    TASK = 0
    SENSOR = 1
    SENSOR_BEFORE_START = 2
    IMAGE = 3
    VARIATION = 4
    FEEDBACK = 5
    COMMAND = 6


class StreamKeys(NamedTuple):
    """Keys of the random streams of a batch of trials."""

    seeds: KeyArray  # (n,) the trials' seeds
    trials: KeyArray  # (n,) the trials' numbers


class StreamKey(NamedTuple):
    """Key of one trial's random stream."""

    seed: np.uint64
    trial: np.uint64


class RandomStreams:
    """The random streams of a batch of trials."""

    def __init__(self, num: int) -> None:
        self.seeds, self.trials = np.zeros((2, num), dtype=np.uint64)
        self._make_generator()

    @property
    def keys(self) -> StreamKeys:
        """Keys of the batch, in arrays that the start of other trials changes."""
        return StreamKeys(self.seeds, self.trials)

    def keys_of(self, ids: IntArray) -> StreamKeys:
        """Copies of the keys of some environments."""
        return StreamKeys(self.seeds[ids], self.trials[ids])

    def _make_generator(self) -> None:
        self._bits = np.random.Philox(key=0)
        self._state = self._bits.state
        self._rng = np.random.Generator(self._bits)

    def __getstate__(self) -> dict[str, KeyArray]:
        return self.keys._asdict()

    def __setstate__(self, state: dict[str, KeyArray]) -> None:
        vars(self).update(state)
        self._make_generator()

    def start(self, ids: IntArray, seeds: KeyArray, trials: KeyArray) -> None:
        """Set the keys of some environments."""
        self.seeds[ids] = seeds
        self.trials[ids] = trials

    def generator_at(self, n: int, purpose: StreamPurpose, block: int = 0) -> np.random.Generator:
        """The generator of one environment, purpose and block, valid until the next call."""
        state = self._state
        inner = state["state"]
        inner["key"][0] = self.seeds[n]
        inner["key"][1] = self.trials[n]
        inner["counter"][:] = (0, 0, purpose, block)
        state["buffer_pos"] = 4
        state["has_uint32"] = 0
        self._bits.state = state
        return self._rng


def as_seed(value: object, name: str = "seed") -> int:
    """Check a seed or a trial number, and return it as an integer from 0 to 2**64 - 1."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ConfigurationError(f"{name}: expected a whole number, got {value!r}")
    if not 0 <= int(value) < 2**64:
        raise ConfigurationError(f"{name}: expected 0 to 2**64 - 1, got {value}")
    return int(value)


def _multiply(typing_context: Any, a: Any, b: Any) -> Any:
    """The upper 64 bits of a product of two words."""

    def generate(context: Any, builder: Any, signature: Any, words: Any) -> Any:
        wide = words[0].type.__class__(128)
        product = builder.mul(builder.zext(words[0], wide), builder.zext(words[1], wide))
        return builder.trunc(builder.lshr(product, wide(64)), words[0].type)

    return types.uint64(types.uint64, types.uint64), generate


_high_word: Any = intrinsic(_multiply)


@inlined
def random_words(seed: np.uint64, trial: np.uint64, purpose: int, block: int, lane: int) -> Words:
    """Four random words of a block; `lane` numbers its groups of four, from 1."""
    k0, k1 = seed, trial
    c0, c1, c2, c3 = np.uint64(lane), np.uint64(0), np.uint64(purpose), np.uint64(block)
    for _ in range(_ROUNDS):
        high0, low0 = _high_word(_MULTIPLIERS[0], c0), _MULTIPLIERS[0] * c0
        high1, low1 = _high_word(_MULTIPLIERS[1], c2), _MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0 += _WEYL[0]
        k1 += _WEYL[1]
    return c0, c1, c2, c3


@inlined
def to_uniform(word: np.uint64) -> float:
    """Convert a word to a uniform number in [0, 1)."""
    return (word >> _MANTISSA_SHIFT) * _TO_DOUBLE


@inlined
def to_normals(first: np.uint64, second: np.uint64) -> tuple[float, float]:
    """Convert two words to two independent standard normal numbers (Box and Muller 1958).

    The angle is drawn within 45 degrees of an axis, where short series give sine and cosine to
    the last digit, and two bits choose the axis. This avoids library functions, whose branches a
    processor cannot predict for random arguments.
    """
    radius = sqrt(-2.0 * log(((first >> _MANTISSA_SHIFT) + 0.5) * _TO_DOUBLE))
    x = 0.5 * pi * (to_uniform(second) - 0.5)
    y = x * x
    sine = cosine = 0.0
    for k in range(7, -1, -1):
        sine = _SINE[k] + y * sine
        cosine = _COSINE[k] + y * cosine
    along, across = radius * cosine, radius * x * sine
    sign = 1.0 - 2.0 * (second & _LOWEST_BIT)
    swap = 1.0 * ((second >> _LOWEST_BIT) & _LOWEST_BIT)
    stay = 1.0 - swap
    return sign * (stay * along + swap * across), sign * (stay * across + swap * along)


@inlined
def four_normals(words: Words, sigma: float) -> tuple[float, float, float, float]:
    """Convert a block's words to independent normal numbers of a standard deviation."""
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


Arrays = dict[str, NDArray[Any]]
"""Arrays by name."""
SavedState = dict[str, Arrays]
"""Complete state of a simulation: the arrays of each of its parts."""


def join_parts(**parts: Mapping[str, NDArray[Any]]) -> Arrays:
    """Join the arrays of several parts, each named `part.name`."""
    return {f"{part}.{name}": a for part, arrays in parts.items() for name, a in arrays.items()}


def copy_arrays(arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """Copy all arrays."""
    return {name: array.copy() for name, array in arrays.items()}


def restore_arrays(arrays: Mapping[str, NDArray[Any]], saved: Mapping[str, NDArray[Any]]) -> None:
    """Restore the saved values of arrays."""
    forms = [{name: (a.shape, a.dtype) for name, a in part.items()} for part in (arrays, saved)]
    if forms[0] != forms[1]:
        wrong = sorted(name for name, _form in set(forms[0].items()) ^ set(forms[1].items()))
        raise ConfigurationError(
            f"state: expected that of {', '.join(wrong)} as this simulation has it, got another"
        )
    for name, array in arrays.items():
        np.copyto(array, saved[name])
