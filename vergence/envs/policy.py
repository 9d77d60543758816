"""Interface of policies, which choose actions: the `predict` of Stable-Baselines3, batched."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Policy(Protocol):
    """Any object with Stable-Baselines3's `predict`: a control law, a network, a user's class."""

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
            state: state returned by the last call; None at the start.
            episode_start: (num,) True where a trial has just begun.
            deterministic: True to choose the most likely action.

        Returns:
            (num, m) actions of m actuators, and the state for the next call.
        """
