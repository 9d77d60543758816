"""Following of a robot's log that another process still writes, for a live view.

A call returns what was appended since the last one. Memory stays flat: nothing is kept but the
head, the facts and the configuration. Old messages are skipped without decoding them, so that
attaching to a log of hours is quick.
"""

import os
import struct
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, cast

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.head import HeadModel
from vergence.recording import schema
from vergence.recording.content import LogContent
from vergence.recording.events import FollowedImage, FollowedNote, FollowedReading, NewEvents
from vergence.recording.growing import GrowingFile, Place
from vergence.recording.schema import Topic

if TYPE_CHECKING:
    from mcap.records import Message

_MAX_EVENTS: Final = 10_000
"""Largest number of events of one kind in one call, the newest (chosen: over two minutes)."""
_LISTED: Final = (
    schema.READING,
    schema.TRUTH,
    schema.COMMAND,
    schema.DETECTION,
    schema.FAULT,
    schema.NOTES,
)
"""Topics of which all new messages are returned, in the order of `NewEvents`."""
_WARNING: Final = 3
"""Level of a warning in foxglove.Log (physical: defined by it)."""
# Opcodes of records (physical: defined by MCAP).
_CHANNEL: Final = 0x04
_MESSAGE: Final = 0x05
_CHUNK: Final = 0x06
_MESSAGE_INDEX: Final = 0x07
_ATTACHMENT: Final = 0x09
_METADATA: Final = 0x0C
_DATA_END: Final = 0x0F
_NEWEST_AT: Final = {_CHUNK: 8, _MESSAGE: 6}
"""Offset of the newest message's time in a record's content, bytes (physical: defined by MCAP)."""
_TIME_FORM: Final = struct.Struct("<Q")
_NUMBER_FORM: Final = struct.Struct("<H")


class LogFollower:
    """A robot's log, read while it is written; use it in a `with` statement.

    An error ends the following: `poll` raises it once, after what was read before it, and returns
    None from then on. To follow a new log at the path, create a new follower.

    Args:
        path: path of the log; it may still be empty.
        history_s: greatest age, s, of messages that a call decodes, against the newest that it
            finds, so that a first call, or one after a long pause, is quick; inf for all. Older
            ones are skipped by chunks; of them, only the number of the current trial is looked up.

    Attributes:
        path: see the arguments.
        head: the model that the controller uses; None until it has been read. It precedes all
            events.
        facts: facts about the log, such as the controller, by name; empty before they are read.
        config: text of the file that describes the robot.
        closed: true if the writer has closed the log and all of it has been read.
        ended: true if no more events will come: the log is closed, or an error was raised.

    Raises:
        UnreadableFileError: the file cannot be opened.
        ConfigurationError: mcap is not installed.
    """

    def __init__(self, path: str | os.PathLike[str], *, history_s: float = 10.0) -> None:
        if not history_s >= 0.0:
            raise ConfigurationError(f"history_s: expected a time from 0 s, got {history_s!r}")
        self._file = GrowingFile(path)
        self.path = self._file.path
        self.head: HeadModel | None = None
        self.closed = False
        self.ended = False
        self._history_ns = 1e9 * history_s
        self._content = LogContent()
        self._trial = 0
        self._chunk: Place | None = None
        self._trial_chunk: Place | None = None
        self._error: VergenceError | None = None
        self._gathered: dict[str, deque[Any]] = defaultdict(lambda: deque(maxlen=_MAX_EVENTS))
        self._newest: dict[str, bytes] = {}

    @property
    def facts(self) -> dict[str, str]:
        """See the class."""
        return self._content.facts

    @property
    def config(self) -> str:
        """See the class."""
        return self._content.files.get(schema.CONFIG_FILE, "")

    def __enter__(self) -> "LogFollower":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop following."""
        self.ended = True
        self._file.close()

    def poll(self) -> NewEvents | None:
        """Read what has been appended since the last call.

        Returns:
            The new events; None if there are none.

        Raises:
            UnreadableFileError: the file is no log or is damaged, or it was deleted, replaced or
                cut.
            ConfigurationError: the head is invalid, or a message does not match its topic.
        """
        if self.ended:
            return None
        if self._error is None:
            self._read()
        events = self._taken()
        if events is None and self._error is not None:
            self.ended = True
            raise self._error
        self.ended = self.closed and self._error is None
        return events

    # ---- reading ----

    def _read(self) -> None:
        """Gather new events; the first error in the file goes to `_error`."""
        lost = self._file.lost()  # before reading, so that all that was written until then is read
        recent: deque[tuple[int, Place]] = deque()
        try:
            self._scan(recent)
        except VergenceError as error:
            self._error = error
        try:
            self._find_trial(recent)
            for _, place in recent:
                self._decode(place)
        except VergenceError as error:  # it lies before one of the scan
            self._error = error
        if lost and self._error is None and not self.closed:
            self._error = self._file.unreadable(lost)

    def _scan(self, recent: "deque[tuple[int, Place]]") -> None:
        """Find the records to decode, and keep the head, the facts and the channels.

        Args:
            recent: receives times, ns, and places of recent chunks and messages.
        """
        newest_ns = 0
        for place in self._file.places():
            if place.opcode in _NEWEST_AT:
                self._need_head()
                time_ns = self._file.number(place, _TIME_FORM, _NEWEST_AT[place.opcode])
                newest_ns = max(newest_ns, time_ns)
                recent.append((time_ns, place))
                while recent and recent[0][0] < newest_ns - self._history_ns:
                    recent.popleft()
                self._chunk = place
                if len(self._content.topics) < len(schema.TOPICS):  # a first chunk holds channels
                    self._keep(place)
            elif place.opcode == _MESSAGE_INDEX:
                channel = self._file.number(place, _NUMBER_FORM)
                if self._content.topics.get(channel) is schema.TRIAL:
                    self._trial_chunk = self._chunk
            elif place.opcode in (_CHANNEL, _ATTACHMENT, _METADATA):
                self._keep(place)
                if self._content.has_head and schema.CONFIG_FILE in self._content.files:
                    self._need_head()
            elif place.opcode == _DATA_END:
                self._need_head()
                self.closed = True
                return

    def _keep(self, place: Place) -> None:
        """Keep the records at a place, but for messages."""
        for record in self._file.records(place):
            self._content.add(record)

    def _need_head(self) -> None:
        """Convert the head, once."""
        if self.head is None:
            self.head = self._content.head(self.path)

    def _find_trial(self, recent: "deque[tuple[int, Place]]") -> None:
        """Read the number of the newest trial if it began in a skipped chunk."""
        place, self._trial_chunk = self._trial_chunk, None
        if place is not None and (not recent or place.start < recent[0][1].start):
            for topic, data in self._messages(place):
                if topic is schema.TRIAL:
                    self._trial = self._value(topic, data)

    def _decode(self, place: Place) -> None:
        """Gather the events at a place."""
        for topic, data in self._messages(place):
            if topic is schema.JOINTS or topic in schema.IMAGES:
                self._newest[topic.name] = data  # decoded at the end, as most are replaced
                continue
            value = self._value(topic, data)
            if topic is schema.TRIAL:
                self._trial = value
            elif topic is schema.READING:
                self._gathered[topic.name].append(FollowedReading(self._trial, *value))
            elif topic is not schema.NOTES:
                self._gathered[topic.name].append(value)
            elif value["level"] >= _WARNING:
                self._gathered[topic.name].append(FollowedNote(value["level"], value["message"]))

    def _messages(self, place: Place) -> Iterator[tuple[Topic, bytes]]:
        """Yield topics and data of the messages at a place."""
        for record in self._file.records(place):
            topic = self._content.add(record)
            if topic is not None:
                yield topic, cast("Message", record).data

    def _value(self, topic: Topic, data: bytes) -> Any:
        """Decode a message, see `LogContent.message`."""
        try:
            return self._content.message(topic, data)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.path}: {error}") from error

    def _taken(self) -> NewEvents | None:
        """Take the gathered events."""
        newest: dict[str, Any] = {}
        for topic in (schema.JOINTS, *schema.IMAGES):
            data = self._newest.pop(topic.name, None)
            newest[topic.name] = None
            if data is not None:
                try:
                    newest[topic.name] = self._value(topic, data)
                except ConfigurationError as error:
                    self._error = self._error or error
        lists = {topic.name: tuple(self._gathered.pop(topic.name, ())) for topic in _LISTED}
        if not any(lists.values()) and all(value is None for value in newest.values()):
            return None
        left, right = (
            None if value is None else FollowedImage(*value)
            for value in (newest[topic.name] for topic in schema.IMAGES)
        )
        readings, truths, commands, detections, stop_reasons, notes = lists.values()
        return NewEvents(
            readings, truths, commands, detections, newest[schema.JOINTS.name], (left, right),
            stop_reasons, notes,
        )  # fmt: skip


def newest_log(folder: str | os.PathLike[str]) -> Path | None:
    """The log in a folder, such as `runs`, that was written to last; None if there is none."""
    found: list[tuple[int, Path]] = []
    for path in Path(folder).glob("*.mcap"):
        with suppress(OSError):  # deleted meanwhile
            found.append((path.stat().st_mtime_ns, path))
    return max(found, default=(0, None))[1]
