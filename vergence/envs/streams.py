"""Random streams keyed by (seed, trial), so that a trial is the same wherever it runs.

Philox is a counter-based generator: its key is (seed, trial) and its counter begins at
(purpose, block), so any part of any trial's randomness can be drawn at any time, in any order,
alone or among a thousand others, and comes out the same.
"""

import numpy as np
from numpy.typing import NDArray

from vergence.envs.philox import Purpose
from vergence.errors import ConfigurationError

__all__ = ["IntArray", "Purpose", "Streams", "as_seed"]

IntArray = NDArray[np.int64]


class Streams:
    """The random streams of a batch of trials.

    Args:
        num: the number of trials that run side by side.
    """

    def __init__(self, num: int) -> None:
        self.seeds = np.zeros(num, dtype=np.uint64)
        self.trials = np.zeros(num, dtype=np.uint64)
        self._make_generator()

    def _make_generator(self) -> None:
        self._bits = np.random.Philox(key=0)
        self._state = self._bits.state
        self._rng = np.random.Generator(self._bits)

    def __getstate__(self) -> dict[str, NDArray[np.uint64]]:
        return {"seeds": self.seeds, "trials": self.trials}

    def __setstate__(self, state: dict[str, NDArray[np.uint64]]) -> None:
        vars(self).update(state)
        self._make_generator()

    def start(self, ids: IntArray, seeds: NDArray[np.uint64], trials: NDArray[np.uint64]) -> None:
        """Key the streams of some places anew.

        Args:
            ids: (n,) the places.
            seeds: (n,) their seeds.
            trials: (n,) their trials.
        """
        self.seeds[ids] = seeds
        self.trials[ids] = trials

    def at(self, place: int, purpose: Purpose, block: int = 0) -> np.random.Generator:
        """The generator of one place, purpose and block, valid until the next call.

        Args:
            place: which trial of the batch.
            purpose: what the numbers are for.
            block: which block of the purpose's numbers.

        Returns:
            A generator at the block's first number.
        """
        state = self._state
        inner = state["state"]
        inner["key"][0] = self.seeds[place]
        inner["key"][1] = self.trials[place]
        inner["counter"][:] = (0, 0, purpose, block)
        state["buffer_pos"] = 4
        state["has_uint32"] = 0
        self._bits.state = state
        return self._rng


def as_seed(value: object) -> int:
    """A seed as a number from 0 to 2**64 - 1.

    Raises:
        ConfigurationError: it is no whole number or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ConfigurationError(f"seed: expected a whole number, got {value!r}")
    if not 0 <= int(value) < 2**64:
        raise ConfigurationError(f"seed: expected 0 to 2**64 - 1, got {value}")
    return int(value)
