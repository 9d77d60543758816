"""Reading of a robot's log, complete or truncated by a crash; its content is untrusted."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Image, Reading, Truth
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording import schema
from vergence.recording.content import LogContent
from vergence.recording.jpeg import read_jpeg
from vergence.recording.records import read_records
from vergence.recording.schema import (
    CommandOrigin,
    LoggedCommand,
    LoggedDetection,
    LoggedJoints,
    Topic,
)

if TYPE_CHECKING:
    from mcap.records import Message

_MAX_TRIAL_S: Final = 1e5
"""Upper limit of times in a trial, s: a day; a log with later ones is refused (chosen)."""


@dataclass(frozen=True, kw_only=True)
class LoggedTrial:
    """One trial of a log."""

    number: int
    begun_s: float
    """Time of the trial's start, s of the robot's clock."""
    readings: Reading
    """Readings of shape (steps + 1, 1, ...), from time zero."""
    truths: Truth | None
    """Ground truth at the times of the readings; None if they end early, as where a point was
    named meanwhile; nan if one is missing."""
    commands: tuple[LoggedCommand, ...]
    """The policy's commands, one before each reading but the first; one more if a fault prevented
    the last reading."""
    images: tuple[list[tuple[float, bytes]], list[tuple[float, bytes]]]
    """Exposure times, s of the clock, and JPEGs, of the left and the right eye."""

    @property
    def steps(self) -> int:
        """Number of control periods with a reading at their end."""
        return len(self.readings.time_s) - 1

    def requested_velocities(self) -> FloatArray:
        """(steps, 7) velocities that the policy asked for, rad/s."""
        return np.array([one.asked for one in self.commands[: self.steps]]).reshape(-1, 7)

    def frames(self, step: int) -> tuple[Image, Image] | None:
        """Newest images of both eyes at a step, grey levels; None if one is missing or broken."""
        now_s = self.begun_s + float(self.readings.time_s[step, 0])
        found = []
        for images in self.images:
            jpeg = next((data for at, data in reversed(images) if at <= now_s), None)
            if jpeg is None:
                return None
            image = read_jpeg(jpeg)
            if image is None:
                return None
            found.append(image)
        return found[0], found[1]


@dataclass(frozen=True, kw_only=True)
class Log:
    """Content of a log."""

    path: Path
    head: HeadModel
    config: str
    """Text of the file that describes the robot."""
    facts: dict[str, str]
    """Further facts, such as the controller, by name."""
    trials: tuple[LoggedTrial, ...]
    joints: tuple[LoggedJoints, ...]
    detections: tuple[LoggedDetection, ...]
    stop_reasons: tuple[str, ...]
    """Reasons for stops of the head, in order."""
    truncation_reason: str
    """Reason for a truncated log; empty for one that was closed."""


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read a log up to its end or to where it is truncated. None of its content is executed.

    Args:
        path: path of the file.

    Raises:
        UnreadableFileError: the file cannot be read, or is no log.
        ConfigurationError: a message does not match its topic, a trial is inconsistent, or mcap is
            not installed.
    """
    parts = _LogBuilder()
    for record in read_records(path, parts.broken):
        topic = parts.add(record)
        if topic is not None:
            try:
                parts.add_message(topic, cast("Message", record).data)
            except ConfigurationError as error:
                raise ConfigurationError(f"{path}: {error}") from error
    head = parts.head(path, "it is cut off before its head" if parts.cut_off else "it has no head")
    try:
        trials = tuple(trial.finish() for trial in parts.trials if trial.readings)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    return Log(
        path=Path(path),
        head=head,
        config=parts.files.get(schema.CONFIG_FILE, ""),
        facts=parts.facts,
        trials=trials,
        joints=tuple(parts.joints),
        detections=tuple(parts.detections),
        stop_reasons=tuple(parts.faults),
        truncation_reason=parts.cut_off,
    )


@dataclass
class _OpenTrial:
    """A trial while its messages are being read."""

    number: int
    begun_s: float = np.nan
    readings: list[Reading] = field(default_factory=list)
    truths: dict[int, Truth] = field(default_factory=dict)
    commands: list[LoggedCommand] = field(default_factory=list)
    images: tuple[list[tuple[float, bytes]], list[tuple[float, bytes]]] = field(
        default_factory=lambda: ([], [])
    )

    def finish(self) -> LoggedTrial:
        """Convert the trial to arrays, and refuse inconsistent ones."""
        reading = Reading._make(_columns(self.readings))
        times = reading.time_s[:, 0]
        if not ((np.diff(times) > 0.0).all() and 0.0 <= times[0] <= times[-1] < _MAX_TRIAL_S):
            raise ConfigurationError(
                f"{schema.READING.name}: time_s: expected times that grow, from 0 up to "
                f"{_MAX_TRIAL_S:g} s"
            )
        steps, commands = len(self.readings) - 1, len(self.commands)
        if commands not in (steps, steps + 1):
            raise ConfigurationError(
                f"{schema.COMMAND.name}: expected one before each of {steps} readings, and at most "
                f"one after them, got {commands}"
            )
        known = max(self.truths, default=0) >= steps - 1  # the last one may be missing
        unknown = Truth._make(value[0] for value in Truth.unknown(1))
        truths = [self.truths.get(step, unknown) for step in range(len(self.readings))]
        return LoggedTrial(
            number=self.number,
            begun_s=self.begun_s,
            readings=reading,
            truths=Truth._make(_columns(truths)) if self.truths and known else None,
            commands=tuple(self.commands),
            images=self.images,
        )


def _columns(rows: Sequence[Reading] | Sequence[Truth]) -> Iterator[NDArray[Any]]:
    """Stack the fields of some rows, with axes over times and heads."""
    for column in zip(*rows, strict=True):
        yield np.stack(column)[:, None]


class _LogBuilder(LogContent):
    """Content of the log read so far."""

    def __init__(self) -> None:
        super().__init__()
        self.trials: list[_OpenTrial] = []
        self.joints: list[LoggedJoints] = []
        self.detections: list[LoggedDetection] = []
        self.faults: list[str] = []
        self.cut_off = ""

    def broken(self, reason: str) -> None:
        """Note that the file ends early."""
        self.cut_off = reason

    def add_message(self, topic: Topic, data: bytes) -> None:
        """Add a message of the file."""
        value = self.message(topic, data)
        if topic is schema.TRIAL:
            self.trials.append(_OpenTrial(value))
        elif topic is schema.DETECTION:
            self.detections.append(value)
        elif topic is schema.JOINTS:
            self.joints.append(value)
        elif topic is schema.FAULT:
            self.faults.append(value)
        elif not self.trials:
            return
        elif topic is schema.READING:
            self.trials[-1].begun_s, reading = value
            self.trials[-1].readings.append(reading)
        elif topic is schema.TRUTH:
            self.trials[-1].truths[len(self.trials[-1].readings) - 1] = value
        elif topic is schema.COMMAND:
            if value.by == CommandOrigin.POLICY.value:
                self.trials[-1].commands.append(value)
        elif topic in schema.IMAGES:
            self.trials[-1].images[schema.IMAGES.index(topic)].append(value)
