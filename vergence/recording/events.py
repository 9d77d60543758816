"""A run as it happens: who listens, what is kept in memory, and the health of its loop.

```python
record = Recorder(task, steps, reading=("time_s", "positions"), truth=("pixel_error",))
rollout(task, controller, steps, record)
record.reading.positions                        # (steps + 1, n, 7) rad
```
"""

import warnings
from collections import deque
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np

from vergence.envs.reading import BoolArray, Image, Reading, Truth
from vergence.envs.task import GazeTask
from vergence.errors import VergenceWarning
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.recording.schema import LoggedCommand, LoggedDetection
from vergence.triangulation import triangulate_views
from vergence.triangulation.fix import gap_sigma
from vergence.vision.targets import PlanarTarget

MAX_GAP_RATIO: Final = 3.0
"""Root mean square of gaps over their predicted standard deviation above which they are reported
(chosen: 3 sigma; one posture's images share its encoder errors, so their mean is no surer)."""
_WINDOW: Final = 30
"""Number of images over which gaps are judged (chosen: a second of a webcam)."""
_MIN_IMAGES: Final = 5
"""Least number of images for a judgement (chosen)."""
_SLOW_RAD_S: Final = 0.05
"""Speed of the eyes' joints below which a gap is judged, rad/s; a date that is wrong by 10 ms then
turns them by less than 0.5 mrad (chosen)."""
_Part = TypeVar("_Part", Reading, Truth)


class RobotListener:
    """Receives all events of a running robot and ignores them; subclasses override some methods.

    Arrays that it receives do not change afterwards, but for readings and truths.

    Attributes:
        images: true to receive the eyes' images.
    """

    images: bool = False

    def begin(self) -> None:
        """Called at the start of a trial; the next reading is at its time zero."""

    def reading(self, reading: Reading, begun_s: float) -> None:
        """Receive a reading of one head, and the time of the trial's start, s of the clock."""

    def command(self, command: LoggedCommand) -> None:
        """Receive a command."""

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """Receive a measurement of the joints, see `LoggedJoints`."""

    def truth(self, truth: Truth) -> None:
        """Receive the ground truth of one head."""

    def detection(self, detection: LoggedDetection) -> None:
        """Receive the detection in an image of an eye."""

    def image(self, eye: int, image: Image, exposed_s: float) -> None:
        """Receive an image of an eye, 0 for left, exposed at a time, s of the clock."""

    def stopped(self, reason: str) -> None:
        """Receive the reason for a stop of the head."""


class BoardView(NamedTuple):
    """One view of a board by both eyes of a head at rest."""

    time_s: float  # time of the exposure, s; grows from view to view
    positions: FloatArray  # (7,) measured joint angles, rad
    corners_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) raw pixels of the board's corners by eye, nan for corners that were not found; None
    for an eye to which the board is not visible."""
    sigma_px: tuple[FloatArray | None, FloatArray | None]
    """(n, 2) standard deviations of the corners by eye, px; None as for the corners."""


class Looker(Protocol):
    """A head that can be turned, simulated or real, with a calibration board in front of it."""

    head: HeadModel  # the known model of the head
    target: PlanarTarget  # the board

    def look(self, q: FloatArray) -> BoardView:
        """Bring the head to rest near some joint angles, (7,) rad within the limits, and look once.

        Raises:
            VergenceError: the head has been stopped, or does not answer.
        """

    def close(self) -> None:
        """Bring the head to rest and release it."""


class Recorder:
    """Recorder of one run of a task: call it after every control period.

    All arrays that it then holds have leading axes (rows, n) for n heads: one row for the start and
    one for each recorded control period, so a trial that ended as planned has steps + 1 rows.

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
        length, self._rows = steps + 1, 0
        self._reading = _allocate(Reading.empty(task.num), reading, length)
        unknown = Truth.unknown(task.num) if truth else None
        self._truth = None if unknown is None else _allocate(unknown, truth, length)
        self._pixel_error = np.empty((length if "pixels" in reading else 0, task.num, 2, 2))
        self._lost = np.empty((length, task.num), dtype=np.bool_)

    def __call__(self, step: int) -> None:
        """Record the present as a row, the `record` of `vergence.envs.task.rollout`."""
        task = self._task
        self._rows = step + 1
        _store(self._reading, task.reading, step)
        if len(self._pixel_error):
            self._pixel_error[step] = task.pixel_error
        self._lost[step] = task.lost
        truth = None if self._truth is None else task.truth()
        if self._truth is None or truth is None:  # unknown once, unknown for good
            self._truth = None
        else:
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


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


class LoopHealth:
    """Judges a robot's readings, one after the other: gaps of the eyes' rays, and late periods."""

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._ratios: deque[float] = deque(maxlen=_WINDOW)
        self._gaps_m: deque[float] = deque(maxlen=_WINDOW)
        self._last_s, self._moved_s, self._exposure_s = np.inf, 0.0, np.nan
        self.missed_periods = self.periods = 0

    def add(self, reading: Reading) -> None:
        """Judge a reading, whose arrays lack the axis over heads."""
        time_s, period_s = float(reading.time_s), self._head.timing.period_s
        if time_s < self._last_s:  # a gaze begins
            self._moved_s = time_s
        else:
            passed = round((time_s - self._last_s) / period_s)
            self.periods += passed
            self.missed_periods += passed - 1
        self._last_s = time_s
        if (np.abs(reading.velocities[EYES]) > _SLOW_RAD_S).any():
            self._moved_s = time_s
        exposed_s = float(reading.exposure_s)
        if exposed_s != self._exposure_s and exposed_s > self._moved_s and reading.visible.all():
            self._exposure_s = exposed_s
            fix = triangulate_views(self._head, reading.positions_at_exposure, reading.pixels)
            sigma = gap_sigma(self._head, reading.positions_at_exposure, reading.pixels)
            if fix.valid and sigma > 0.0:
                self._ratios.append(float(fix.gap / sigma))
                self._gaps_m.append(float(fix.gap))

    @property
    def gap_ratio(self) -> float:
        """Root mean square of the last gaps over their predicted spread; nan if there are few."""
        return _root_mean_square(self._ratios) if len(self._ratios) >= _MIN_IMAGES else np.nan

    def gap_text(self) -> str:
        """Description of the last gaps, if there are any."""
        gap_mm, ratio = 1e3 * _root_mean_square(self._gaps_m), self.gap_ratio
        return f"gap of the eyes' rays {gap_mm:.2f} mm, {ratio:.1f} times its predicted spread"

    def words(self) -> list[str]:
        """Lines of text, in Markdown; warnings are bold."""
        ratio, lines = self.gap_ratio, []
        if np.isfinite(ratio):
            text = self.gap_text()
            if ratio > MAX_GAP_RATIO:
                text = f"**warning: {text}: has a camera moved?**"
            lines.append(text)
        if self.periods:
            late = f"{self.missed_periods} of the last {self.periods} periods late"
            lines.append(f"**{late}**" if self.missed_periods else late)
        return lines


def warn_of_gap(head: HeadModel, readings: Reading) -> None:
    """Warn if lines of sight of a gaze, arrays of (rows, 1, ...), miss each other beyond noise."""
    health = LoopHealth(head)
    for row in range(len(readings.time_s)):
        health.add(Reading._make(part[row, 0] for part in readings))
    if health.gap_ratio > MAX_GAP_RATIO:
        warnings.warn(
            f"expected lines of sight that meet at the target, got a {health.gap_text()}: a zero "
            "(zero_ticks) or a camera is off; cure: `vergence jog`, or calibrate the head",
            VergenceWarning,
            stacklevel=2,
        )
