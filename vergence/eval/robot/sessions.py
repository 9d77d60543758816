"""The record of an evaluation on a robot: logs, and a journal of the trials that are whole.

A folder `recording` in the run folder has `asked.json`, what is compared; a log for each time that
the robot was connected; and `journal.jsonl`, a line for each trial that went to its end, written
when it had. What a kill, a fault or Ctrl-C ends is missing in the journal, and is run again.
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
from vergence.files import write_whole
from vergence.models.parts import FloatArray
from vergence.recording.log import LoggedTrial, read_log

FOLDER: Final = "recording"
"""Name of the folder in a run folder."""
_ASKED: Final = "asked.json"
_JOURNAL: Final = "journal.jsonl"


class Key(NamedTuple):
    """What a trial is found by."""

    scenario: str
    controller: str
    trial: int


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A line of the journal."""

    scenario: str
    controller: str
    trial: int
    log: str
    """Name of the log in the folder."""
    number: int
    """Of the trial in the log, counted from 1."""
    point_m: tuple[float, float, float] | None
    """Where the target stood, in N; None where nobody knows, or the log has the truth."""
    controller_sha256: str
    """Of a controller's file; empty for one of the registry."""
    options: str
    """The controller's, as JSON."""
    stopped: str = ""
    """Why the robot was stopped, where the controller let it swing; empty for a whole trial."""

    def check(self) -> None:
        """Refuse values that no journal has.

        Raises:
            TypeError: one is none of its kind.
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
    def key(self) -> Key:
        """What it is found by."""
        return Key(self.scenario, self.controller, self.trial)


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A trial that went to its end."""

    entry: Entry
    trial: LoggedTrial

    @property
    def point(self) -> FloatArray:
        """(3,) where the target stood, m; nan where the journal does not say."""
        found = self.entry.point_m
        return np.full(3, np.nan) if found is None else np.array(found)


class Sessions:
    """The record in a run folder.

    Args:
        run: the run folder; the record is made in it with the first log.
        asked: what is compared, as plain values; None to take what stands there.

    Attributes:
        folder: the record's.
        asked: what is compared.
        unreadable: logs that cannot be read, by name, and why.

    Raises:
        ConfigurationError: it has none and nothing is asked, or cannot be read.
    """

    def __init__(self, run: Path, asked: Mapping[str, Any] | None = None) -> None:
        self.folder = run / FOLDER
        self.unreadable: dict[str, str] = {}
        place = self.folder / _ASKED
        try:
            self.asked: dict[str, Any] = (
                json.loads(place.read_text(encoding="utf-8")) if asked is None else dict(asked)
            )
            if not isinstance(self.asked, dict):
                raise ValueError("expected a table")
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"resume: expected a run folder of vergence evaluate on a robot, got {run}: "
                f"{place}: {getattr(error, 'strerror', None) or error}"
            ) from error

    def new_log(self) -> Path:
        """The path of the next log, which is not there yet.

        Raises:
            ConfigurationError: the record cannot be written.
        """
        place = self.folder / _ASKED
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not place.exists():
                write_whole(place, json.dumps(self.asked, indent=2) + "\n")
        except OSError as error:
            raise ConfigurationError(
                f"out: expected a folder that can be written, got {self.folder}: {error.strerror}"
            ) from error
        names = {path.name for path in self.folder.glob("*.mcap")}
        number = 1
        while (name := f"trials-{number}.mcap") in names:
            number += 1
        return self.folder / name

    def add(self, entry: Entry) -> None:
        """Tell that a trial went to its end.

        Raises:
            ConfigurationError: the journal cannot be written.
        """
        line = json.dumps(asdict(entry)).encode() + b"\n"
        try:
            # what a kill has cut off ends with this line's beginning
            with (self.folder / _JOURNAL).open("ab+") as file:
                if file.tell():
                    file.seek(-1, os.SEEK_END)
                    line = line if file.read(1) == b"\n" else b"\n" + line
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ConfigurationError(
                f"out: expected a journal that can be written, got {self.folder / _JOURNAL}: "
                f"{error.strerror}"
            ) from error

    def count(self) -> int:
        """How many trials went to their end."""
        return len({entry.key for entry in self._entries()})

    def whole(self, steps: Callable[[str], int]) -> dict[Key, Recorded]:
        """The trials that went to their end, by what they are found by.

        Args:
            steps: control periods of a whole trial of a scenario.

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
            # a kill may have come between the journal and the log
            if logged and logged[0].steps >= (1 if entry.stopped else steps(entry.scenario)):
                found[entry.key] = Recorded(entry=entry, trial=logged[0])
        return found

    def _entries(self) -> Iterator[Entry]:
        place = self.folder / _JOURNAL
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
                entry = Entry(**fields)
                entry.check()
            except TypeError as error:
                raise ConfigurationError(
                    f"{place}: line {number}: expected a trial, got {error}"
                ) from error
            yield entry
