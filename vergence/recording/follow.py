"""Following of a robot's log that another process still writes, for a live view.

A call returns what was appended since the last one. Memory stays flat: nothing is kept but the
head, the facts and the configuration. Old messages are skipped without decoding them, so that
attaching to a log of hours is quick.
"""

import json
import os
import struct
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np

from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError, UnreadableFileError, VergenceError
from vergence.files import write_atomic
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording import schema
from vergence.recording.log import (
    EXPECTED_FILE,
    MAX_CHUNK_BYTES,
    ChunkUnpacker,
    LogContent,
    open_regular,
    require_mcap,
)
from vergence.recording.schema import LoggedCommand, LoggedDetection, LoggedJoints, Topic

if TYPE_CHECKING:
    from mcap.records import McapRecord

MAGIC: Final = b"\x89MCAP0\r\n"
_FRAME: Final = struct.Struct("<BQ")
"""A record's opcode and the size of its content."""
_OPENING: Final = 16
"""Number of bytes of a content that are read at once (numerical: times of chunks and messages)."""


class Place(NamedTuple):
    """Place of one whole record in the file."""

    opcode: int
    start: int
    """Offset of the content, bytes."""
    size: int
    """Size of the content, bytes."""
    opening: bytes
    """The first bytes of the content, at most 16."""


class GrowingFile:
    """A growing MCAP file, open for reading; close it after use.

    Args:
        path: path of the file; it may still be empty.

    Attributes:
        path: see the arguments.

    Raises:
        UnreadableFileError: the file cannot be opened.
        ConfigurationError: mcap is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        require_mcap()
        self.path = Path(path)
        self._file = open_regular(path)
        self._at = 0
        self._unpacker = ChunkUnpacker()

    def close(self) -> None:
        """Close the file; nothing can be read afterwards."""
        self._file.close()

    def places(self) -> Iterator[Place]:
        """Yield the places of records that have become whole since the last call, in order.

        Raises:
            UnreadableFileError: the file has become shorter, is no MCAP file or is damaged.
        """
        size = os.fstat(self._file.fileno()).st_size
        if size < self._at:
            raise self.unreadable("it became shorter while it was followed")
        if not self._at:
            if not MAGIC.startswith(self.part(0, min(size, len(MAGIC)))):
                raise self.unreadable("it is no MCAP file")
            if size < len(MAGIC):
                return
            self._at = len(MAGIC)
        while self._at + _FRAME.size <= size:
            found = self.part(self._at, min(size - self._at, _FRAME.size + _OPENING))
            opcode, length = _FRAME.unpack_from(found)
            start = self._at + _FRAME.size
            if not opcode or length > MAX_CHUNK_BYTES:
                raise self.unreadable(f"it is damaged at byte {self._at}")
            if start + length > size:
                return
            self._at = start + length
            yield Place(opcode, start, length, found[_FRAME.size :][:length])

    def part(self, start: int, size: int) -> bytes:
        """Bytes of the file.

        Raises:
            UnreadableFileError: the file cannot be read, or has become shorter.
        """
        try:
            self._file.seek(start)
            data = self._file.read(size)
        except OSError as error:
            raise self.unreadable(error.strerror or str(error)) from error
        if len(data) != size:
            raise self.unreadable("it became shorter while it was followed")
        return data

    def number(self, place: Place, form: struct.Struct, offset: int = 0) -> int:
        """One number in the opening of a record's content.

        Args:
            place: place of the record.
            form: form of the number.
            offset: offset of the number in the content, bytes.

        Raises:
            UnreadableFileError: the record is too short.
        """
        try:
            number: int = form.unpack_from(place.opening, offset)[0]
        except struct.error as error:
            raise self.damaged(f"a record of kind {place.opcode} and {place.size} bytes") from error
        return number

    def records(self, place: Place) -> "list[McapRecord]":
        """Records at a place: those in a chunk, or a single one.

        Raises:
            UnreadableFileError: the file cannot be read, or is damaged there.
        """
        from mcap.stream_reader import StreamReader

        data = _FRAME.pack(place.opcode, place.size) + self.part(place.start, place.size)
        self._unpacker.allow(len(data))
        reader = StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True)
        try:
            return self._unpacker.records_in(next(iter(reader.records)))
        except (Exception, MemoryError) as error:  # damage can make the library raise anything
            raise self.damaged(f"{type(error).__name__} {error}".strip()) from error

    def lost(self) -> str:
        """Description of the file's loss, such as its deletion; empty while it is at its path."""
        try:
            now = os.stat(self.path)
        except FileNotFoundError:
            return "it was deleted while it was followed"
        except OSError as error:
            return error.strerror or str(error)
        same = os.path.samestat(now, os.fstat(self._file.fileno()))
        return "" if same else "it was replaced by another file while it was followed"

    def unreadable(self, reason: str) -> UnreadableFileError:
        """An error about the file."""
        return UnreadableFileError(os.fspath(self.path), reason, EXPECTED_FILE)

    def damaged(self, reason: str) -> UnreadableFileError:
        """An error about damage before the byte up to which the file has been read."""
        return self.unreadable(f"it is damaged before byte {self._at}: {reason:.200}")


class FollowedReading(NamedTuple):
    """A reading of the head."""

    trial: int
    """Number of the trial; 0 if its start was not found."""
    begun_s: float
    """Time of the trial's start, s of the robot's clock."""
    reading: Reading
    """The reading; its arrays lack the axis over heads."""


class FollowedImage(NamedTuple):
    """An image of an eye."""

    exposed_s: float
    """Time of the exposure, s of the robot's clock."""
    jpeg: bytes
    """The JPEG; see `vergence.recording.log.read_jpeg`."""


class FollowedNote(NamedTuple):
    """A warning or an error of the package's loggers."""

    level: int
    """3 for a warning, 4 for an error, 5 for a fatal one, as in foxglove.Log."""
    message: str


class NewEvents(NamedTuple):
    """Events appended to a log between two calls, in order; at most 10 000 of a kind."""

    readings: tuple[FollowedReading, ...]
    truths: tuple[Truth, ...]
    """Ground truth, if it is logged: each follows the reading of its time, maybe one call later."""
    commands: tuple[LoggedCommand, ...]
    """All commands, also those of the robot's own code."""
    detections: tuple[LoggedDetection, ...]
    joints: LoggedJoints | None
    """The newest measurement of the joints, also between trials; None if there is no new one."""
    images: tuple[FollowedImage | None, FollowedImage | None]
    """The newest image of the left and the right eye; None if there is no new one."""
    stop_reasons: tuple[str, ...]
    """Reasons for stops of the head."""
    notes: tuple[FollowedNote, ...]


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


class Click(NamedTuple):
    """A click in an eye's image."""

    eye: int
    """0 for left, 1 for right."""
    pixel: FloatArray
    """(2,) raw pixel (u, v)."""
    exposed_s: float
    """Time of the image's exposure, s of the robot's clock."""


def _file_beside(log: Path) -> Path:
    return log.with_suffix(".click")


def write_click(log: Path, click: Click) -> None:
    """Leave a click for the robot that writes a log.

    Raises:
        OSError: the folder cannot be written to.
    """
    u, v = click.pixel.tolist()
    write_atomic(_file_beside(log), json.dumps([click.eye, u, v, click.exposed_s]))


class ClickReader:
    """Reads the newest click beside a log, without ever waiting; remove it with `close`."""

    def __init__(self, log: Path) -> None:
        self._file = _file_beside(log)
        self.close()
        self._seen: tuple[int, int] | None = None

    def poll(self) -> Click | None:
        """The newest click; None if there is no new one."""
        try:
            stat = self._file.stat()
            if (stat.st_ino, stat.st_mtime_ns) == self._seen:
                return None
            self._seen = stat.st_ino, stat.st_mtime_ns
            eye, u, v, exposed_s = json.loads(self._file.read_text())
            return Click(int(eye) & 1, np.array([float(u), float(v)]), float(exposed_s))
        except (OSError, ValueError, TypeError):  # none yet, or not written by a viewer
            return None

    def close(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)
