"""Trials of controllers with a state, with what they believed and what was true."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.controllers.loops import begin, drive
from vergence import make_controller
from vergence.controllers.prediction.predictor import prediction_fields
from vergence.envs.task import GazeTask
from vergence.eval.trials.bound import settle_bound

Array = NDArray[np.float64]


class Trial(NamedTuple):
    """Record of a rollout by step and environment index."""

    errors: Array
    """(steps + 1, n, 2, 2) true pixel errors."""
    positions: Array
    """(steps + 1, n, 7) true joint angles."""
    predicted: list[Any]
    """Predictions, one a step, of controllers that predict."""
    bound_s: Array
    """(n,) the earliest time to settle."""


def run(task: GazeTask, name: str, steps: int, seed: int = 0, **options: Any) -> Trial:
    """Run one trial at each place of a task."""
    controller: Any = make_controller(name, head=task.head, layout=task.layout, **options)
    begin(task, seed)
    predicted: list[Any] = []
    update = controller.predictor.update

    def remember(*arguments: Any) -> Any:
        rows = update(*arguments)
        predicted.append(prediction_fields(rows.copy()).view(np.recarray))
        return rows

    controller.predictor.update = remember
    truth = task.truth()
    bound = settle_bound(task)
    errors, positions = [truth.pixel_error], [truth.positions]
    for _action in drive(task, controller, steps * task.head.timing.period_s):
        truth = task.truth()
        errors.append(truth.pixel_error)
        positions.append(truth.positions)
    return Trial(np.array(errors), np.array(positions), predicted, bound)
