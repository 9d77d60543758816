"""The record of an evaluation on a robot: logs, and a journal of the completed trials.

The folder `recording` in the run folder holds `asked.json`, the configuration of the comparison;
one log per connection to the robot; and `journal.jsonl`, with a line for each completed trial,
written on its completion. A trial that a kill, a fault or Ctrl-C interrupts has no line in the
journal and is run again.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError, VergenceError
from vergence.files import write_atomic
from vergence.models.parts import FloatArray
from vergence.recording.log import LoggedTrial, read_log

RECORD_FOLDER: Final = "recording"
"""Name of the record's folder in a run folder."""
_CONFIG_FILE: Final = "asked.json"
_JOURNAL_FILE: Final = "journal.jsonl"


class TrialKey(NamedTuple):
    """Identity of a trial in an evaluation."""

    scenario: str
    controller: str
    trial: int


@dataclass(frozen=True, kw_only=True)
class JournalEntry:
    """A line of the journal: one completed trial."""

    scenario: str
    controller: str
    trial: int
    log: str
    """File name of the log in the record's folder."""
    number: int
    """Number of the trial in the log, counted from 1."""
    point_m: tuple[float, float, float] | None
    """Target position, in N; None if unknown, or if the log has the ground truth."""
    controller_sha256: str
    """SHA-256 of the controller's file; empty for a controller of the registry."""
    options: str
    """The controller's options, as JSON."""
    stopped: str = ""
    """Reason for the stop if the controller made the head oscillate; empty for a full trial."""

    def check(self) -> None:
        """Refuse values of wrong types.

        Raises:
            TypeError: a value has a wrong type, or the point has not three numbers.
        """
        point = [] if self.point_m is None else self.point_m
        for kind, values in (
            (str, (self.scenario, self.controller, self.log, self.controller_sha256)),
            (str, (self.options, self.stopped)),
            (int, (self.trial, self.number)),
            (float, point),
        ):
            for value in values:
                if type(value) is not kind:
                    raise TypeError(f"{value!r:.80} where a {kind.__name__} belongs")
        if len(point) not in (0, 3):
            raise TypeError(f"a point of {len(point)} numbers")

    @property
    def key(self) -> TrialKey:
        """Identity of the trial."""
        return TrialKey(self.scenario, self.controller, self.trial)


@dataclass(frozen=True, kw_only=True)
class RecordedTrial:
    """A completed trial: its journal entry and its log."""

    entry: JournalEntry
    trial: LoggedTrial

    @property
    def point(self) -> FloatArray:
        """(3,) target position, in N, m; nan if the journal has none."""
        found = self.entry.point_m
        return np.full(3, np.nan) if found is None else np.array(found)


class EvaluationRecord:
    """The record in a run folder.

    Args:
        run: the run folder; the record is made in it with the first log.
        configuration: the comparison's, as plain values; None to read it from the record.

    Attributes:
        folder: the record's folder.
        configuration: the comparison's.
        unreadable: reasons why logs cannot be read, by name.

    Raises:
        ConfigurationError: `configuration` is None and the record's is missing or unreadable.
    """

    def __init__(self, run: Path, configuration: Mapping[str, Any] | None = None) -> None:
        self.folder = run / RECORD_FOLDER
        self.unreadable: dict[str, str] = {}
        place = self.folder / _CONFIG_FILE
        try:
            self.configuration: dict[str, Any] = (
                json.loads(place.read_text(encoding="utf-8"))
                if configuration is None
                else dict(configuration)
            )
            if not isinstance(self.configuration, dict):
                raise ValueError("expected a table")
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"resume: expected a run folder of vergence evaluate on a robot, got {run}: "
                f"{place}: {getattr(error, 'strerror', None) or error}"
            ) from error

    def new_log(self) -> Path:
        """Path for the next log, which does not exist yet; makes the record if it is new.

        Raises:
            ConfigurationError: the record cannot be written.
        """
        place = self.folder / _CONFIG_FILE
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not place.exists():
                write_atomic(place, json.dumps(self.configuration, indent=2) + "\n")
        except OSError as error:
            raise ConfigurationError(
                f"out: expected a folder that can be written, got {self.folder}: {error.strerror}"
            ) from error
        names = {path.name for path in self.folder.glob("*.mcap")}
        number = 1
        while (name := f"trials-{number}.mcap") in names:
            number += 1
        return self.folder / name

    def add(self, entry: JournalEntry) -> None:
        """Append a completed trial to the journal, and sync it to disk.

        Raises:
            ConfigurationError: the journal cannot be written.
        """
        line = json.dumps(asdict(entry)).encode() + b"\n"
        try:
            # start a new line if a kill has cut off the last one
            with (self.folder / _JOURNAL_FILE).open("ab+") as file:
                if file.tell():
                    file.seek(-1, os.SEEK_END)
                    line = line if file.read(1) == b"\n" else b"\n" + line
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ConfigurationError(
                f"out: expected a journal that can be written, got {self.folder / _JOURNAL_FILE}: "
                f"{error.strerror}"
            ) from error

    def count(self) -> int:
        """Number of completed trials."""
        return len({entry.key for entry in self._entries()})

    def completed_trials(self, steps: Callable[[str], int]) -> dict[TrialKey, RecordedTrial]:
        """Read the completed trials, by their identity.

        Args:
            steps: function from a scenario's name to the control periods of a whole trial.

        Trials of a log that cannot be read are missing, see `unreadable`.
        """

        @cache
        def trials(log: str) -> tuple[LoggedTrial, ...]:
            try:
                return read_log(self.folder / log).trials
            except VergenceError as error:  # its trials are run again
                self.unreadable[log] = str(error)
                return ()

        found = {}
        for entry in self._entries():
            logged = [one for one in trials(entry.log) if one.number == entry.number]
            # after a kill the journal may have a trial that the log lacks
            if logged and logged[0].steps >= (1 if entry.stopped else steps(entry.scenario)):
                found[entry.key] = RecordedTrial(entry=entry, trial=logged[0])
        return found

    def _entries(self) -> Iterator[JournalEntry]:
        place = self.folder / _JOURNAL_FILE
        try:
            lines = place.read_bytes().split(b"\n") if place.exists() else []
        except OSError as error:
            raise VergenceError(f"{place}: {error.strerror}") from error
        for number, line in enumerate(lines, 1):
            try:
                fields = json.loads(line)
            except ValueError:  # empty, or cut off by a kill
                continue
            try:
                entry = JournalEntry(**fields)
                entry.check()
            except TypeError as error:
                raise ConfigurationError(
                    f"{place}: line {number}: expected a trial, got {error}"
                ) from error
            yield entry
