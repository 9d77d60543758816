"""The closed loop of controllers that remember."""

import numpy as np
from numpy.typing import NDArray

from vergence.controllers import Controller
from vergence.envs.task import GazeTask


def closed_loop(
    task: GazeTask, controller: Controller, time_s: float, seed: int = 0
) -> NDArray[np.float64]:
    """Run a trial of each head, handing the controller's state on.

    Args:
        task: the heads and what they look at.
        controller: what turns them.
        time_s: for how long.
        seed: the trials' seed.

    Returns:
        (steps + 1, num, 2, 2) true pixel errors by eye and image axis, from time zero on.
    """
    ids = np.arange(task.num)
    task.begin(ids, np.full(task.num, seed, dtype=np.uint64), ids.astype(np.uint64))
    truth = task.truth()
    assert truth is not None
    errors, state, start = [truth.pixel_error.copy()], None, np.ones(task.num, dtype=np.bool_)
    for _ in range(round(time_s * task.head.timing.control_rate_hz)):
        action, state = controller.predict(task.observation, state, start)
        start = np.zeros_like(start)
        task.step(action)
        truth = task.truth()
        assert truth is not None
        errors.append(truth.pixel_error.copy())
    return np.array(errors)
