"""Recorder of trials: readings and ground truth in every control period.

```python
record = Recorder(task, steps, reading=("time_s", "positions"), truth=("pixel_error",))
rollout(task, controller, steps, record)
record.reading.positions                        # (steps + 1, n, 7) rad
```
"""

from collections.abc import Collection
from typing import TypeVar

import numpy as np

from vergence.envs.reading import BoolArray, Reading, Truth
from vergence.envs.task import GazeTask
from vergence.models.parts import FloatArray

_Part = TypeVar("_Part", Reading, Truth)


class Recorder:
    """Recorder of one run of a task: call it after every control period.

    It then holds the readings of the sensors and the ground truth of all periods, one row each, see
    `reading`, `truth`, `pixel_error` and `lost`.

    All arrays have leading axes (rows, n) for n heads: one row for the start and one for each
    recorded control period, so a trial that ended as planned has steps + 1 rows.

    Args:
        task: the task to record.
        steps: largest number of control periods.
        reading: fields of the readings to keep; the others have no rows.
        truth: fields of the ground truth to keep; the others have no rows.
    """

    def __init__(
        self,
        task: GazeTask,
        steps: int,
        *,
        reading: Collection[str] = Reading._fields,
        truth: Collection[str] = Truth._fields,
    ) -> None:
        self._task = task
        self._length = steps + 1
        self._rows = 0
        self._reading = _allocate(Reading.empty(task.num), reading, self._length)
        self._truth_fields = truth
        self._truth: Truth | None = None
        seen = self._length if "pixels" in reading else 0
        self._pixel_error = np.empty((seen, task.num, 2, 2))
        self._lost = np.empty((self._length, task.num), dtype=np.bool_)

    def __call__(self, step: int) -> None:
        """Record the present; the `record` callback of `vergence.envs.task.rollout`.

        Args:
            step: row to write, counted from 0; later rows are dropped.
        """
        task = self._task
        self._rows = step + 1
        _store(self._reading, task.reading, step)
        if len(self._pixel_error):
            self._pixel_error[step] = task.pixel_error
        self._lost[step] = task.lost
        truth = task.truth() if self._truth_fields else None
        if truth is None:
            self._truth, self._truth_fields = None, ()
            return
        if self._truth is None:
            self._truth = _allocate(Truth.unknown(task.num), self._truth_fields, self._length)
        _store(self._truth, truth, step)

    @property
    def reading(self) -> Reading:
        """Recorded readings of the sensors."""
        return Reading._make(part[: self._rows] for part in self._reading)

    @property
    def truth(self) -> Truth | None:
        """Recorded ground truth; None if it was unknown once, or no field was asked for."""
        if self._truth is None:
            return None
        return Truth._make(part[: self._rows] for part in self._truth)

    @property
    def pixel_error(self) -> FloatArray:
        """(rows, n, 2, 2) `GazeTask.pixel_error`, px; no rows if `pixels` is not kept."""
        return self._pixel_error[: self._rows]

    @property
    def lost(self) -> BoolArray:
        """(rows, n) true if the target was lost, by the task's rule."""
        return self._lost[: self._rows]


def _allocate(one: _Part, fields: Collection[str], length: int) -> _Part:
    """Allocate `length` rows for the fields that are asked for, and none for others."""
    rows = {
        name: np.repeat(part[None], length if name in fields else 0, axis=0)
        for name, part in one._asdict().items()
    }
    return one._replace(**rows)


def _store(rows: _Part, present: _Part, step: int) -> None:
    for part, now in zip(rows, present, strict=True):
        if len(part):
            part[step] = now
