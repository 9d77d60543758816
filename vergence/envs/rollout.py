"""Trials of a task: begin, let a policy act step by step, record.

`rollout` closes the task in any case; `run_trial` leaves it open for the next trial.
"""

from collections.abc import Callable

import numpy as np

from vergence.envs.plant import Simulation
from vergence.envs.streams import as_seed
from vergence.envs.task import GazeTask, Policy
from vergence.errors import HardwareError


def rollout(
    task: GazeTask, policy: Policy, steps: int, record: Callable[[int], None], *, seed: int = 0,
    first_trial: int = 0,
) -> None:  # fmt: skip
    """Run one trial in each environment of a task, and close the task in any case.

    Unless the plant is a simulation, all code is compiled before the heads move, see
    `GazeTask.prepare`. For the arguments and errors see `run_trial`.
    """
    try:
        if not isinstance(task.plant, Simulation):
            task.prepare(policy)
        run_trial(task, policy, steps, record, seed=seed, first_trial=first_trial)
    finally:
        task.close()


def run_trial(
    task: GazeTask, policy: Policy, steps: int, record: Callable[[int], None], *, seed: int = 0,
    first_trial: int = 0,
) -> None:  # fmt: skip
    """Run one trial in each environment of a task, and leave the task open for the next one."""
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
        if task.plant.fault:
            raise HardwareError(task.plant.fault)
        record(step)
