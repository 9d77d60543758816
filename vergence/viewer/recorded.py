"""Recordings to look at again: the run folder of a gaze, or a robot's log."""

import bisect
import csv
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.reading import Reading, Truth
from vergence.envs.task import EyeImages
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.eval.gaze_trajectory import MM
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.recording.log import Log, LoggedTrial, read_jpeg, read_log
from vergence.viewer.moment import Moment, moment_of_reading, pixel_errors
from vergence.vision.targets import make_planar_target

_RUN_FILES: Final = ("trajectory.csv", "head.toml", "result.json", "config.toml")
"""Files that a gaze's run folder holds."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recording of one head."""

    path: Path
    head: HeadModel
    times_s: FloatArray
    """(n,) times of the moments since the first one, s, growing."""
    readings: Reading
    """Readings at these times, of shape (n, ...)."""
    truths: Truth
    """Ground truth at these times, likewise; nan where it is unknown."""
    images_at: Callable[[int], tuple[EyeImages | None, float]]
    """Newest images at a time's index, and their age, s."""
    begins: tuple[int, ...]
    """Indices at which gazes begin."""
    notes: tuple[str, ...] = ()
    """Remarks on the whole recording, such as a fault that stopped the head."""

    def index_at(self, time_s: float) -> int:
        """Index of the last moment at or before a time."""
        return max(0, int(np.searchsorted(self.times_s, time_s, "right")) - 1)

    def gaze_at(self, index: int) -> int:
        """Number of the gaze of a moment, counted from 1."""
        return bisect.bisect_right(self.begins, index)

    def reading(self, index: int) -> Reading:
        """Reading of an index; its arrays lack the axis over times."""
        return Reading._make(part[index] for part in self.readings)

    def moment(self, index: int) -> Moment:
        """Moment of an index; its time counts from the recording's first."""
        truth = Truth._make(part[index] for part in self.truths)
        shown = moment_of_reading(self.head, self.reading(index), truth, *self.images_at(index))
        return shown._replace(time_s=float(self.times_s[index]))

    def errors_px(self) -> FloatArray:
        """(n, 2) pixel errors of all moments, see `Moment`."""
        return pixel_errors(self.head, self.readings, self.truths)


def load_recorded(path: Path) -> Recorded:
    """Load the run folder of a gaze, or a robot's log.

    Args:
        path: a folder that `vergence gaze` wrote, or a log of `vergence deploy`.

    Raises:
        UnreadableFileError: a file cannot be read, or is something else.
        ConfigurationError: the content is inconsistent.
    """
    return _recorded_run(path) if path.is_dir() else _recorded_log(read_log(path))


def _recorded_log(log: Log) -> Recorded:
    if not log.trials:
        raise ConfigurationError(f"{log.path}: expected a log with a gaze, got one without")
    lengths = [trial.steps + 1 for trial in log.trials]
    begins = np.cumsum([0, *lengths[:-1]])
    readings = Reading._make(
        np.concatenate(parts)[:, 0]
        for parts in zip(*(one.readings for one in log.trials), strict=True)
    )
    truths = [
        Truth.unknown(count)
        if one.truths is None
        else Truth._make(part[:, 0] for part in one.truths)
        for one, count in zip(log.trials, lengths, strict=True)
    ]
    clock_s = readings.time_s + np.repeat([one.begun_s for one in log.trials], lengths)
    eyes = [_LoggedImages(trial) for trial in log.trials]

    def images_at(index: int) -> tuple[EyeImages | None, float]:
        return eyes[bisect.bisect_right(begins.tolist(), index) - 1].at(float(clock_s[index]))

    notes = [f"stopped: {reason}" for reason in log.stop_reasons]
    if log.truncation_reason:
        notes.append("the log is cut off, as by a crash")
    return Recorded(
        path=log.path,
        head=log.head,
        times_s=_growing(clock_s, begins.tolist(), log.head.timing.period_s),
        readings=readings,
        truths=Truth._make(np.concatenate(parts) for parts in zip(*truths, strict=True)),
        images_at=images_at,
        begins=tuple(begins.tolist()),
        notes=tuple(notes),
    )


def _growing(clock_s: FloatArray, begins: Sequence[int], period_s: float) -> FloatArray:
    """Times since the first one; a gaze that does not begin after the last one is moved there."""
    times_s: FloatArray = clock_s - clock_s[0]
    for begin in begins[1:]:
        times_s[begin:] += max(0.0, times_s[begin - 1] + period_s - times_s[begin])
    return times_s


class _LoggedImages:
    """Images of a trial by time; the last pair is kept decoded.

    Args:
        trial: the trial.
    """

    def __init__(self, trial: LoggedTrial) -> None:
        self._trial = trial
        self._exposed_s = [[at for at, _ in images] for images in trial.images]
        self._decoded: dict[tuple[int, int], Any] = {}

    def at(self, now_s: float) -> tuple[EyeImages | None, float]:
        """Newest images of both eyes at a time of the clock, and the age of the older one, s."""
        places = [bisect.bisect_right(times, now_s) - 1 for times in self._exposed_s]
        if min(places) < 0:
            return None, 0.0
        found = [self._image(eye, place) for eye, place in enumerate(places)]
        if any(image is None for image in found):
            return None, 0.0
        oldest_s = min(self._exposed_s[eye][place] for eye, place in enumerate(places))
        return EyeImages(found[0], found[1], False), now_s - oldest_s

    def _image(self, eye: int, place: int) -> Any:
        if (eye, place) not in self._decoded:
            self._decoded = {key: one for key, one in self._decoded.items() if key[0] != eye}
            self._decoded[eye, place] = read_jpeg(self._trial.images[eye][place][1])
        return self._decoded[eye, place]


def _recorded_run(folder: Path) -> Recorded:
    missing = [name for name in _RUN_FILES if not (folder / name).is_file()]
    if missing:
        raise UnreadableFileError(
            str(folder), f"it has no {missing[0]}", "the run folder of a gaze, or a robot's log"
        )
    head = load_head(str(folder / "head.toml"))
    try:
        with (folder / "trajectory.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        config = tomllib.loads((folder / "config.toml").read_text(encoding="utf-8"))["config"]
        drawn = config["plant"] != "hardware"
        readings, truths = _readings_and_truths(head, columns, result["truth_mm"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise UnreadableFileError(
            str(folder), f"damaged: {error}", "the run folder of a gaze"
        ) from error
    renderer = BoardImageRenderer(head, make_planar_target("tag"))

    def images_at(index: int) -> tuple[EyeImages | None, float]:
        target = truths.target[index]
        if not drawn or np.isnan(target).any():
            return None, 0.0
        left, right = renderer.draw(readings.positions[index], np.zeros(7), target)
        return EyeImages(left.copy(), right.copy(), True), 0.0

    return Recorded(
        path=folder,
        head=head,
        times_s=readings.time_s,
        readings=readings,
        truths=truths,
        images_at=images_at,
        begins=(0,),
    )


def _readings_and_truths(
    head: HeadModel, columns: Mapping[str, Sequence[str]], target_mm: Sequence[float | None]
) -> tuple[Reading, Truth]:
    """Readings and ground truth, of shape (rows, ...), of a gaze's trajectory.

    Raises:
        LookupError: a column is missing.
        ValueError: a cell is no number.
    """

    def numbers(name: str) -> FloatArray:
        return np.array([float(text) if text else np.nan for text in columns[name]])

    def by_eye(what: str) -> FloatArray:
        eyes = [[numbers(f"{what}_{eye}_{axis}_px") for axis in "uv"] for eye in EYE_NAMES]
        return np.moveaxis(np.array(eyes), -1, 0)

    def by_joint(what: str) -> FloatArray:
        missing = np.zeros(len(columns["time_s"]))
        named = [numbers(what.format(name)) if name else missing for name in head.joints]
        return np.stack(named, axis=-1)

    count = len(columns["time_s"])
    pixels, positions = by_eye("pixel"), by_joint("position_{}_rad")
    time_s, exposure_s = numbers("time_s"), numbers("exposure_s")
    if not (count and np.isfinite(time_s).all() and (np.diff(time_s) > 0.0).all()):
        raise ValueError("trajectory.csv: expected times that grow")
    if not np.isfinite(positions).all():
        raise ValueError("trajectory.csv: expected joint angles in each row")
    reading = Reading.empty(count)._replace(
        time_s=time_s,
        pixels=pixels,
        visible=np.asarray(np.isfinite(pixels).all(axis=-1)),
        exposure_s=exposure_s,
        positions=positions,
        positions_at_exposure=np.stack(
            [np.interp(exposure_s, time_s, joint) for joint in positions.T], axis=-1
        ),
        velocities=by_joint("velocity_{}_rad_s"),
    )
    target = np.array([np.nan if value is None else value for value in target_mm]) / MM
    if target.shape != (3,):
        raise ValueError(f"result.json: truth_mm: expected three numbers, got {len(target)}")
    truth = Truth.unknown(count)._replace(
        target=np.tile(target, (count, 1)),
        pixels=by_eye("true_pixel"),
        pixel_error=by_eye("true_error"),
    )
    return reading, truth
