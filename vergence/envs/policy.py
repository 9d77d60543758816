"""What chooses actions: the signature of Stable-Baselines3, batched."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Policy(Protocol):
    """Anything with Stable-Baselines3's `predict`: a law, a network, a person's own."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """Choose actions.

        Args:
            observation: (num, size) the observations.
            state: what the last call returned; None at the start.
            episode_start: (num,) whether a trial has just begun.
            deterministic: whether to take the most likely action.

        Returns:
            (num, m) actions of m actuators, and the state for the next call.
        """
