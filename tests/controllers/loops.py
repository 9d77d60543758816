"""The closed loop, and what the eyes truly see in it."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from vergence.controllers import Controller
from vergence.envs.task import GazeTask
from vergence.eval.trials import metrics

Array = NDArray[np.float64]


def true_errors(task: GazeTask, controller: Controller, time_s: float, seed: int = 0) -> Array:
    """(steps + 1, num, 2, 2) true pixel errors of a trial of each head, by eye and image axis."""
    errors = [pixel_errors(begin(task, seed))]
    errors += [pixel_errors(task) for _ in drive(task, controller, time_s)]
    return np.array(errors)


def drive(
    task: GazeTask,
    controller: Controller,
    time_s: float,
    cover: Callable[[Array, int], object] = lambda observation, step: None,
) -> Iterator[Array]:
    """Yield the actions after each step of trials that have begun; `cover` hides what was seen."""
    state, start = None, np.ones(task.num, dtype=np.bool_)
    for step in range(round(time_s * task.head.timing.control_rate_hz)):
        observation = task.observation.copy()
        cover(observation, step)
        action, state = controller.predict(observation, state, start)
        start = np.zeros_like(start)
        task.step(action)
        yield action


def begin(task: GazeTask, seed: int = 0) -> GazeTask:
    """Begin trial i of a seed at each place i of a task, and return the task."""
    ids = np.arange(task.num)
    task.begin(ids, np.full(task.num, seed, dtype=np.uint64), ids.astype(np.uint64))
    return task


def pixel_errors(task: GazeTask) -> Array:
    """(num, 2, 2) the present true pixel errors by eye and image axis."""
    return task.truth().pixel_error.copy()


def settle_time(errors: Array, period_s: float, band_px: float = 1.0) -> Array:
    """(num,) times from which both eyes' errors stay within the band, s; nan where they do not."""
    return metrics.settle_time(np.arange(len(errors)) * period_s, errors, band_px)
