"""Reading of a robot's log, complete or truncated by a crash, its recovery and its replay."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile

from vergence.envs.plant import Plant
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.streams import IntArray
from vergence.errors import (
    ConfigurationError,
    HardwareError,
    UnreadableFileError,
    VergenceError,
)
from vergence.models.head import HeadModel
from vergence.models.head_file import parse_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.recording import schema
from vergence.recording.schema import (
    CommandOrigin,
    LoggedCommand,
    LoggedDetection,
    LoggedJoints,
    Topic,
    decode_message,
    escape_control_characters,
    import_mcap_writer,
)

if TYPE_CHECKING:
    from mcap.records import McapRecord, Message

MAX_CHUNK_BYTES: Final = 64 * 2**20
"""Largest size of an unpacked chunk, bytes (chosen: far above a log's, whose chunks span 50 ms)."""
_MAX_PIXELS: Final = 64 * 10**6
"""Largest size of an image, pixels (chosen: above any camera's)."""
_MAX_TRIAL_S: Final = 1e5
"""Upper limit of times in a trial, s: a day; a log with later ones is refused (chosen)."""
_TOPIC_BY_NAME: Final = {topic.name: topic for topic in schema.TOPICS}
_FILES: Final = (schema.HEAD_FILE, schema.CONFIG_FILE)
_TYPES: Final[dict[str, type]] = {
    "/command": LoggedCommand, "/joints": LoggedJoints, "/truth": Truth,
    "/detection": LoggedDetection,
}  # fmt: skip
"""Types of messages by the names of their topics."""
_KEPT: Final = (schema.JOINTS, schema.DETECTION, schema.FAULT)
"""Topics whose messages belong to the log, and not to a trial."""
REPLAYED_ENTRY_POINT: Final = f"{__name__}:ReplayedPlant"
"""Entry point of the plant that replays a log."""


# ---- records ----


def unreadable(path: str | os.PathLike[str], reason: str) -> UnreadableFileError:
    """The error of a file that is no log, or damaged."""
    expected = "a log of a robot in MCAP, as vergence deploy writes it"
    return UnreadableFileError(os.fspath(path), reason, expected)


def open_log(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading; refuse others, and all without the package mcap."""
    import_mcap_writer()
    if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
        raise unreadable(path, "no regular file")
    try:
        return open(path, "rb")
    except OSError as error:
        raise unreadable(path, error.strerror or str(error)) from error


def records_in(chunk: "McapRecord") -> "list[McapRecord]":
    """Records in a chunk of bounded size, or the record alone; damage can raise anything."""
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    if not isinstance(chunk, Chunk):
        return [chunk]
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk packed by {chunk.compression!r:.40}, not by zstd or lz4")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"a chunk of other than the {size} bytes that it says")
    return breakup_chunk(replace(chunk, compression="", data=data), True)


def read_records(
    path: str | os.PathLike[str], on_truncation: Callable[[str], None] = lambda reason: None
) -> "Iterator[McapRecord]":
    """Yield a file's records, also those in chunks, up to its end or `on_truncation(reason)`."""
    with open_log(path) as file:
        from mcap.stream_reader import StreamReader

        size = os.fstat(file.fileno()).st_size
        reader = iter(StreamReader(file, emit_chunks=True, record_size_limit=size).records)
        begun = False
        while True:
            try:
                inside = records_in(next(reader))
            except StopIteration:
                return
            except Exception as error:  # damage can make the library raise anything
                if not begun:
                    reason = "it is no MCAP file" if size else "it is empty"
                    raise unreadable(path, reason) from error
                on_truncation(f"{type(error).__name__} {error}".strip())
                return
            begun = True
            yield from inside


def recover_log(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> None:
    """Copy all readable records of a truncated MCAP file to a new, complete one."""
    from mcap.records import Attachment, Channel, Message, Metadata, Schema

    schemas = {0: 0}
    channels: dict[int, int] = {}
    with open(out, "xb") as file:
        writer = import_mcap_writer()(file)
        writer.start()
        for one in read_records(path):
            if isinstance(one, Message) and one.channel_id in channels:
                number = channels[one.channel_id]
                writer.add_message(number, one.log_time, one.data, one.publish_time, one.sequence)
            elif isinstance(one, Schema) and one.id not in schemas:  # a file's end repeats them
                schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
            elif isinstance(one, Channel) and one.id not in channels:
                channels[one.id] = writer.register_channel(
                    one.topic, one.message_encoding, schemas.get(one.schema_id, 0), one.metadata
                )
            elif isinstance(one, Metadata):
                writer.add_metadata(one.name, one.metadata)
            elif isinstance(one, Attachment):
                writer.add_attachment(
                    one.create_time, one.log_time, one.name, one.media_type, one.data
                )
        writer.finish()


class LogContent:
    """Facts, attachments and channels of the records read so far, which decode the messages."""

    def __init__(self) -> None:
        self.facts: dict[str, str] = {}
        self.files: dict[str, str] = {}
        """Texts of the attachments of a log, by name."""
        self.topics: dict[int, Topic] = {}
        """Topics by the number of their channel in the file."""

    def add(self, record: "McapRecord") -> Topic | None:
        """Keep a record, unless it is a message: return the topic of one, if it is known."""
        from mcap.records import Attachment, Channel, Message, Metadata

        if isinstance(record, Message):
            return self.topics.get(record.channel_id)
        if isinstance(record, Channel) and record.topic in _TOPIC_BY_NAME:
            self.topics[record.id] = _TOPIC_BY_NAME[record.topic]
        elif isinstance(record, Metadata) and record.name == schema.FACTS_RECORD_NAME:
            self.facts = {
                name: escape_control_characters(text) for name, text in record.metadata.items()
            }
        elif isinstance(record, Attachment) and record.name in _FILES:
            self.files[record.name] = record.data.decode("utf-8", "replace")
        return None

    def head(self, path: str | os.PathLike[str], headless: str = "it has no head") -> HeadModel:
        """The model that the controller uses, of the log at a path."""
        if schema.HEAD_FILE not in self.files or not self.facts:
            raise unreadable(path, headless)
        version = self.facts.get("schema", "unknown")
        if version != schema.SCHEMA_VERSION:
            raise UnreadableFileError(
                os.fspath(path), f"its schema is {version!r:.40}", f"schema {schema.SCHEMA_VERSION}"
            )
        try:
            return parse_head(self.files[schema.HEAD_FILE])
        except VergenceError as error:
            raise ConfigurationError(f"{schema.HEAD_FILE}: {error}") from error

    def message(self, topic: Topic, data: bytes) -> Any:
        """Decode a message; its arrays lack the axis over heads.

        Gives the trial's number; `begun_s` and a `Reading`; a `LoggedCommand`, `LoggedJoints`,
        `Truth` or `LoggedDetection`; a fault's text; the exposure time, s of the clock, and the
        JPEG of an image; or the fields of a note.
        """
        fields = decode_message(topic, data)
        if topic is schema.TRIAL:
            return fields["number"]
        if topic is schema.READING:
            return fields.pop("begun_s"), Reading(**fields)
        if topic is schema.FAULT:
            return fields["text"]
        if topic is schema.DETECTION and fields["eye"] not in EYE_NAMES:
            raise ConfigurationError(
                f"{topic.name}: eye: expected one of {', '.join(EYE_NAMES)}, got "
                f"{fields['eye']!r:.40}"
            )
        if topic.name in _TYPES:
            return _TYPES[topic.name](**fields)
        if topic in schema.IMAGES:
            zero_ns = self.facts.get("clock_zero_ns", "")
            try:
                return 1e-9 * (fields["timestamp"] - int(zero_ns)), fields["data"]
            except (ValueError, OverflowError) as error:
                raise ConfigurationError(
                    f"clock_zero_ns: expected ns, got {zero_ns!r:.40}"
                ) from error
        return fields


def read_jpeg(data: bytes) -> Image | None:
    """Decode a JPEG to grey levels, (height, width); None if it is broken or too large."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        if np.prod(JpegImageFile(BytesIO(data)).size) > _MAX_PIXELS:  # it reads the header alone
            return None
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except (SyntaxError, OSError, cv2.error):
        return None
    return None if image is None else np.asarray(image, np.uint8)


# ---- whole logs ----


_Images = tuple[list[tuple[float, bytes]], list[tuple[float, bytes]]]


@dataclass(frozen=True, kw_only=True)
class LoggedTrial:
    """One trial of a log."""

    number: int
    begun_s: float  # time of the trial's start, s of the robot's clock
    readings: Reading  # readings of shape (steps + 1, 1, ...), from time zero
    truths: Truth | None
    """Ground truth at the times of the readings; None if they end early, as where a point was
    named meanwhile; nan if one is missing."""
    commands: tuple[LoggedCommand, ...]
    """The policy's commands, one before each reading but the first; one more if a fault prevented
    the last reading."""
    images: _Images  # exposure times, s of the clock, and JPEGs, of the left and the right eye

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
        left, right = (
            read_jpeg(next((data for at, data in reversed(images) if at <= now_s), b""))
            for images in self.images
        )
        return None if left is None or right is None else (left, right)


@dataclass(frozen=True, kw_only=True)
class Log:
    """Content of a log."""

    path: Path
    head: HeadModel
    config: str  # text of the file that describes the robot
    facts: dict[str, str]  # further facts, such as the controller, by name
    trials: tuple[LoggedTrial, ...]
    joints: tuple[LoggedJoints, ...]
    detections: tuple[LoggedDetection, ...]
    stop_reasons: tuple[str, ...]  # reasons for stops of the head, in order
    truncation_reason: str  # reason for a truncated log; empty for one that was closed


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read a log up to its end or to where it is truncated. None of its content is executed.

    Args:
        path: path of the file.

    Raises:
        UnreadableFileError: the file cannot be read, or is no log.
        ConfigurationError: a message does not match its topic, a trial is inconsistent, or mcap is
            not installed.
    """
    import_mcap_writer()  # whose absence is no fault of this file
    content, reasons = LogContent(), [""]
    trials: list[_OpenTrial] = []
    kept: dict[str, list[Any]] = {one.name: [] for one in _KEPT}
    try:
        for record in read_records(path, reasons.append):
            topic = content.add(record)
            if topic is None:
                continue
            value = content.message(topic, cast("Message", record).data)
            if topic is schema.TRIAL:
                trials.append(_OpenTrial(value))
            elif topic in _KEPT:
                kept[topic.name].append(value)
            elif trials:
                trials[-1].add(topic, value)
        cut = "it is cut off before its head" if reasons[-1] else "it has no head"
        return Log(
            path=Path(path),
            head=content.head(path, cut),
            config=content.files.get(schema.CONFIG_FILE, ""),
            facts=content.facts,
            trials=tuple(trial.finish() for trial in trials if trial.readings),
            joints=tuple(kept[schema.JOINTS.name]),
            detections=tuple(kept[schema.DETECTION.name]),
            stop_reasons=tuple(kept[schema.FAULT.name]),
            truncation_reason=reasons[-1],
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


@dataclass
class _OpenTrial:
    """A trial while its messages are being read."""

    number: int
    begun_s: float = np.nan
    readings: list[Reading] = field(default_factory=list)
    truths: dict[int, Truth] = field(default_factory=dict)
    commands: list[LoggedCommand] = field(default_factory=list)
    images: _Images = field(default_factory=lambda: ([], []))

    def add(self, topic: Topic, value: Any) -> None:
        """Add a message."""
        if topic is schema.READING:
            self.begun_s, reading = value
            self.readings.append(reading)
        elif topic is schema.TRUTH:
            self.truths[len(self.readings) - 1] = value
        elif topic is schema.COMMAND and value.by == CommandOrigin.POLICY.value:
            self.commands.append(value)
        elif topic in schema.IMAGES:
            self.images[schema.IMAGES.index(topic)].append(value)

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


# ---- replay ----


class ReplayedPlant(Plant):
    """One head with a log's readings; each reset begins the log's next trial.

    `commands` lists the velocities, (7,) rad/s, that the policy has commanded in the current trial.
    """

    max_num = 1

    def __init__(self, head: HeadModel, num: int = 1, *, trials: Sequence[LoggedTrial]) -> None:
        self.head, self.num = head, num
        self.commands: list[FloatArray] = []
        self._trials = list(trials)
        self._place, self._step = -1, 0

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Begin the next trial; the positions are the log's, the arguments are ignored."""
        if self._place + 1 >= len(self._trials):
            raise HardwareError(f"the log has no more than {len(self._trials)} trials")
        self._place += 1
        self.commands, self._step = [], 0
        return self._reading()

    def step(self, command: FloatArray) -> Reading:
        """Keep the command, and return the log's next reading."""
        if self._step >= self._trial.steps:
            raise HardwareError(f"the trial has no more than {self._trial.steps} control periods")
        self.commands.append(np.array(command[0]))
        self._step += 1
        return self._reading()

    @property
    def _trial(self) -> LoggedTrial:
        return self._trials[self._place]

    def _reading(self) -> Reading:
        return Reading._make(values[self._step] for values in self._trial.readings)

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """See `Plant.frames`."""
        return self._trial.frames(self._step)

    def truth(self) -> Truth | None:
        """Logged ground truth of the present; None if none is logged."""
        truths = self._trial.truths
        return None if truths is None else Truth._make(values[self._step] for values in truths)

    def close(self) -> None:
        """Do nothing: no resource is held."""
