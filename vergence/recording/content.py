"""Content of a log's records: the head, the facts, and messages by topic; it is untrusted."""

import os
import re
from typing import TYPE_CHECKING, Any, Final

from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError, UnreadableFileError, VergenceError
from vergence.models.head import HeadModel
from vergence.models.head_file import parse_head
from vergence.models.parts import EYE_NAMES
from vergence.recording import schema
from vergence.recording.messages import decode_message, escape_control_characters
from vergence.recording.records import EXPECTED_FILE
from vergence.recording.schema import LoggedCommand, LoggedDetection, LoggedJoints, Topic

if TYPE_CHECKING:
    from mcap.records import McapRecord

_INTEGER_PATTERN: Final = re.compile("-?[0-9]{1,19}")
_TOPIC_BY_NAME: Final = {topic.name: topic for topic in schema.TOPICS}
_FILES: Final = (schema.HEAD_FILE, schema.CONFIG_FILE)


class LogContent:
    """Facts, attachments and channels of the records read so far, which decode the messages.

    Attributes:
        facts: facts about the log, by name; empty before they are read.
        files: texts of the attachments of a log, by name.
        topics: topics by the number of their channel in the file.
    """

    def __init__(self) -> None:
        self.facts: dict[str, str] = {}
        self.files: dict[str, str] = {}
        self.topics: dict[int, Topic] = {}

    def add(self, record: "McapRecord") -> Topic | None:
        """Keep a record, unless it is a message.

        Args:
            record: the record.

        Returns:
            The topic if the record is a message of a known one, else None.
        """
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

    @property
    def has_head(self) -> bool:
        """True if the head and the facts have been read."""
        return schema.HEAD_FILE in self.files and bool(self.facts)

    def head(self, path: str | os.PathLike[str], headless: str = "it has no head") -> HeadModel:
        """The model that the controller uses.

        Args:
            path: path of the file, for messages.
            headless: reason of the error if no head has been read.

        Raises:
            UnreadableFileError: no head has been read, or the log has another schema.
            ConfigurationError: the head is invalid.
        """
        if not self.has_head:
            raise UnreadableFileError(os.fspath(path), headless, EXPECTED_FILE)
        if self.facts.get("schema") != schema.SCHEMA_VERSION:
            raise UnreadableFileError(
                os.fspath(path),
                f"its schema is {self.facts.get('schema', 'unknown')!r:.40}",
                f"schema {schema.SCHEMA_VERSION}",
            )
        try:
            return parse_head(self.files[schema.HEAD_FILE])
        except VergenceError as error:
            raise ConfigurationError(f"{path}: {schema.HEAD_FILE}: {error}") from error

    def message(self, topic: Topic, data: bytes) -> Any:
        """Decode a message.

        Args:
            topic: topic of the message.
            data: JSON.

        Returns:
            The trial's number; `begun_s` and a `Reading`; a `LoggedCommand`, `LoggedJoints`,
            `Truth` or `LoggedDetection`; a fault's text; the exposure time, s of the clock, and
            the JPEG of an image; or the fields of a note. Arrays lack the axis over heads.

        Raises:
            ConfigurationError: the message does not match its topic, or `clock_zero_ns` is invalid.
        """
        fields = decode_message(topic, data)
        if topic is schema.TRIAL:
            return fields["number"]
        if topic is schema.READING:
            return fields.pop("begun_s"), Reading(**fields)
        if topic is schema.COMMAND:
            return LoggedCommand(**fields)
        if topic is schema.JOINTS:
            return LoggedJoints(**fields)
        if topic is schema.TRUTH:
            return Truth(**fields)
        if topic is schema.DETECTION:
            if fields["eye"] not in EYE_NAMES:
                raise ConfigurationError(
                    f"{topic.name}: eye: expected one of {', '.join(EYE_NAMES)}, got "
                    f"{fields['eye']!r:.40}"
                )
            return LoggedDetection(**fields)
        if topic is schema.FAULT:
            return fields["text"]
        if topic in schema.IMAGES:
            return 1e-9 * (fields["timestamp"] - self._clock_zero_ns()), fields["data"]
        return fields

    def _clock_zero_ns(self) -> int:
        text = self.facts.get("clock_zero_ns", "")
        if not _INTEGER_PATTERN.fullmatch(text):
            raise ConfigurationError(f"clock_zero_ns: expected ns, got {text!r:.40}")
        return int(text)
