"""One rollout: begin trials, let a controller act step by step, record, and always close."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vergence.envs.streams import as_seed
from vergence.envs.task import GazeTask


class Policy(Protocol):
    """What chooses actions: the signature of Stable-Baselines3, batched."""

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


def rollout(
    task: GazeTask,
    policy: Policy,
    steps: int,
    record: Callable[[int], None],
    *,
    seed: int = 0,
    first_trial: int = 0,
) -> None:
    """Run one trial at each place of a task, and close the task whatever happens.

    Args:
        task: what to run; it is at rest and closed when this returns or raises.
        policy: what chooses the actions.
        steps: how many control periods.
        record: called with 0 when the trials have begun, and with k after step k.
        seed: seed of all trials.
        first_trial: number of the first place's trial; the others follow it.

    Raises:
        VergenceError: the trials cannot begin, or an action has another shape or is nan.
        Exception: whatever the policy or `record` raises.
    """
    try:
        ids = np.arange(task.num)
        seeds = np.full(task.num, as_seed(seed), dtype=np.uint64)
        task.begin(ids, seeds, (first_trial + ids).astype(np.uint64))
        record(0)
        state, start = None, np.ones(task.num, dtype=np.bool_)
        for step in range(1, steps + 1):
            # a copy: the task writes its next observation into the same array
            action, state = policy.predict(
                task.observation.copy(), state=state, episode_start=start, deterministic=True
            )
            start = np.zeros(task.num, dtype=np.bool_)
            task.step(task.as_action(action))
            record(step)
    finally:
        task.close()
