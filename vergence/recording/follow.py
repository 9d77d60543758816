"""Following of a robot's log that another process still writes, for a live view, and its clicks.

Old chunks are skipped without unpacking them, so that attaching to a log of hours is quick. The
file is only read, never locked, so the writer does not notice.
"""

import json
import os
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np

from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError, UnreadableFileError, VergenceError
from vergence.files import write_atomic
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording import schema
from vergence.recording.log import (
    MAX_CHUNK_BYTES,
    LogContent,
    open_log,
    records_in,
    unreadable,
)
from vergence.recording.schema import Topic

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord, Message

_FRAME_BYTES: Final = 9
"""Size of a record's opcode and length (physical: defined by MCAP)."""
_FOLLOWED: Final = (schema.TRIAL, schema.READING, schema.TRUTH, schema.FAULT, schema.NOTES)
"""Topics whose messages are all decoded."""
_WARNING: Final = 3
"""Level of a warning in foxglove.Log (physical: defined by it)."""


class FollowedReading(NamedTuple):
    """A reading of the head."""

    trial: int  # number of the trial; 0 if its start was not found
    begun_s: float  # time of the trial's start, s of the robot's clock
    reading: Reading  # the reading; its arrays lack the axis over heads


class FollowedImage(NamedTuple):
    """An image of an eye."""

    exposed_s: float  # time of the exposure, s of the robot's clock
    jpeg: bytes  # the JPEG; see `vergence.recording.log.read_jpeg`


class FollowedNote(NamedTuple):
    """A warning or an error of the package's loggers."""

    level: int  # 3 for a warning, 4 for an error, 5 for a fatal one, as in foxglove.Log
    message: str


class NewEvents(NamedTuple):
    """Events appended to a log between two calls, in order."""

    readings: tuple[FollowedReading, ...]
    truths: tuple[Truth, ...]
    """Ground truth, if it is logged: each follows the reading of its time, maybe one call later."""
    images: tuple[FollowedImage | None, FollowedImage | None]
    """The newest image of the left and the right eye; None if there is no new one."""
    stop_reasons: tuple[str, ...]  # reasons for stops of the head
    notes: tuple[FollowedNote, ...]


class LogFollower:
    """A robot's log, read while it is written; use it in a `with` statement.

    Messages older than `history_s` against the newest that a call finds are skipped by chunks; of
    them, only the number of the current trial is looked up. `head`, the model that the controller
    uses, precedes all events. `closed` tells that the writer has closed the log and that all of it
    has been read; `ended`, that no more events will come: it is closed, or an error was raised.
    """

    def __init__(self, path: str | os.PathLike[str], *, history_s: float = 10.0) -> None:
        self._file = open_log(path)  # kept open, so that its number is given to no other file
        self.path = Path(path)
        self.head: HeadModel | None = None
        self.closed = False
        self.ended = False
        self._history_ns = 1e9 * history_s
        self._at = 0
        self._content = LogContent()
        self._trial = 0
        self._chunk: Chunk | None = None
        self._trial_chunk: Chunk | None = None
        self._error: VergenceError | None = None

    @property
    def facts(self) -> dict[str, str]:
        """Facts about the log, such as the controller, by name; empty before they are read."""
        return self._content.facts

    def __enter__(self) -> "LogFollower":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop following."""
        self.ended = True
        self._file.close()

    def poll(self) -> NewEvents | None:
        """What has been appended since the last call; None if there is nothing new.

        An error ends the following: it is raised once, after what was read before it.

        Raises:
            VergenceError: the file is no log or is damaged, or it was deleted, replaced or cut.
        """
        if self.ended:
            return None
        events = None if self._error is not None else self._read()
        if events is None and self._error is not None:
            self.ended = True
            raise self._error
        self.ended = self.closed and self._error is None
        return events

    def _read(self) -> NewEvents | None:
        """The new events; the first error in the file goes to `_error`."""
        lost = self._lost()  # before reading, so that all that was written until then is read
        recent: deque[Chunk] = deque()
        found: dict[str, list[Any]] = defaultdict(list)
        for read in (partial(self._scan, recent), partial(self._decode, recent, found)):
            try:  # an error of decoding lies before one of the scan
                read()
            except ConfigurationError as error:
                self._error = ConfigurationError(f"{self.path}: {error}")
            except VergenceError as error:
                self._error = error
        if lost and self._error is None and not self.closed:
            self._error = unreadable(self.path, lost)
        if not found:
            return None
        left, right = ((found[topic.name] or [None])[-1] for topic in schema.IMAGES)
        return NewEvents(
            readings=tuple(found[schema.READING.name]),
            truths=tuple(found[schema.TRUTH.name]),
            images=(left, right),
            stop_reasons=tuple(found[schema.FAULT.name]),
            notes=tuple(found[schema.NOTES.name]),
        )

    def _scan(self, recent: "deque[Chunk]") -> None:
        """Find the recent chunks, and keep the head, the facts and the channels."""
        from mcap.records import Attachment, Chunk, DataEnd, MessageIndex, Metadata

        newest_ns = 0
        for record in self._records():
            if isinstance(record, MessageIndex):
                if self._content.topics.get(record.channel_id) is schema.TRIAL:
                    self._trial_chunk = self._chunk
                continue
            if isinstance(record, Attachment | Metadata):
                self._content.add(record)
            begun = isinstance(record, Chunk | DataEnd) or schema.CONFIG_FILE in self._content.files
            if begun and self.head is None:
                self.head = self._content.head(self.path)
            if isinstance(record, Chunk):
                newest_ns = max(newest_ns, record.message_end_time)
                recent.append(record)
                while recent[0].message_end_time < newest_ns - self._history_ns:
                    recent.popleft()
                self._chunk = record
                if len(self._content.topics) < len(schema.TOPICS):  # a first chunk holds channels
                    for _ in self._messages(record):
                        pass
            elif isinstance(record, DataEnd):
                self.closed = True
                return

    def _records(self) -> "Iterator[McapRecord]":
        """Yield used records that have become whole; of a message index, only its channel."""
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.records import Attachment, Chunk, DataEnd, MessageIndex, Metadata
        from mcap.writer import MCAP0_MAGIC

        size = os.fstat(self._file.fileno()).st_size
        if size < self._at:
            raise unreadable(self.path, "it became shorter while it was followed")
        self._file.seek(self._at)
        if not self._at:
            magic = self._file.read(len(MCAP0_MAGIC))
            if not MCAP0_MAGIC.startswith(magic):
                raise unreadable(self.path, "it is no MCAP file")
            if len(magic) < len(MCAP0_MAGIC):
                return
            self._at = len(MCAP0_MAGIC)
        stream = ReadDataStream(self._file)
        used: dict[int, Any] = {
            Opcode.CHUNK: Chunk, Opcode.DATA_END: DataEnd,
            Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
        }  # fmt: skip
        while self._at + _FRAME_BYTES <= size:
            kind, length = stream.read1(), stream.read8()
            if not kind or length > MAX_CHUNK_BYTES:
                raise unreadable(self.path, f"it is damaged at byte {self._at}")
            end = self._at + _FRAME_BYTES + length
            if end > size:
                return
            if kind == Opcode.MESSAGE_INDEX:
                yield MessageIndex(stream.read2(), [])
            elif kind in used:
                try:
                    record = used[kind].read(ReadDataStream(BytesIO(stream.read(length))))
                except Exception as error:  # damage can make the library raise anything
                    raise self._damaged(error) from error
                yield record
            self._at = self._file.seek(end)

    def _decode(self, recent: "deque[Chunk]", found: dict[str, list[Any]]) -> None:
        """Gather the events of some chunks, and the newest trial's number from a skipped one."""
        skipped, self._trial_chunk = self._trial_chunk, None
        if skipped is not None and not any(one is skipped for one in recent):
            for topic, data in self._messages(skipped):
                if topic is schema.TRIAL:
                    self._trial = self._content.message(topic, data)
        images: dict[str, tuple[Topic, bytes]] = {}  # decoded at the end, as most are replaced
        for topic, data in chain.from_iterable(map(self._messages, recent)):
            if topic in schema.IMAGES:
                images[topic.name] = topic, data
            if topic not in _FOLLOWED:
                continue
            value = self._content.message(topic, data)
            if topic is schema.TRIAL:
                self._trial = value
            elif topic is schema.READING:
                found[topic.name].append(FollowedReading(self._trial, *value))
            elif topic is not schema.NOTES:
                found[topic.name].append(value)
            elif value["level"] >= _WARNING:
                found[topic.name].append(FollowedNote(value["level"], value["message"]))
        for name, message in images.items():
            found[name].append(FollowedImage(*self._content.message(*message)))

    def _messages(self, chunk: "Chunk") -> Iterator[tuple[Topic, bytes]]:
        """Yield topics and data of the messages in a chunk, and keep its channels."""
        try:
            records = records_in(chunk)
        except Exception as error:  # damage can make the library raise anything
            raise self._damaged(error) from error
        for record in records:
            topic = self._content.add(record)
            if topic is not None:
                yield topic, cast("Message", record).data

    def _lost(self) -> str:
        """Description of the file's loss, such as its deletion; empty while it is at its path."""
        try:
            now = os.stat(self.path)
        except FileNotFoundError:
            return "it was deleted while it was followed"
        same = os.path.samestat(now, os.fstat(self._file.fileno()))
        return "" if same else "it was replaced by another file while it was followed"

    def _damaged(self, error: Exception) -> UnreadableFileError:
        reason = f"{type(error).__name__} {error}".strip()
        return unreadable(
            self.path, f"it is damaged before byte {self._file.tell()}: {reason:.200}"
        )


def newest_log(folder: str | os.PathLike[str]) -> Path | None:
    """The log in a folder, such as `runs`, that was written to last; None if there is none."""
    found: list[tuple[int, Path]] = []
    for path in Path(folder).glob("*.mcap"):
        with suppress(OSError):  # deleted meanwhile
            found.append((path.stat().st_mtime_ns, path))
    return max(found, default=(0, None))[1]


# ---- clicks in the images: a small file beside the log ----


class Click(NamedTuple):
    """A click in an eye's image."""

    eye: int  # 0 for left, 1 for right
    pixel: FloatArray  # (2,) raw pixel (u, v)
    exposed_s: float  # time of the image's exposure, s of the robot's clock


def write_click(log: Path, click: Click) -> None:
    """Leave a click for the robot that writes a log."""
    u, v = click.pixel.tolist()
    write_atomic(log.with_suffix(".click"), json.dumps([click.eye, u, v, click.exposed_s]))


class ClickReader:
    """Reads the newest click beside a log, without ever waiting; `close` removes it."""

    def __init__(self, log: Path) -> None:
        self._file = log.with_suffix(".click")
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
