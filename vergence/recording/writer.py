"""Writing of a robot's log: the control loop queues messages, a thread writes them every 50 ms.

So a kill loses at most 50 ms, and a slow disk never delays the loop.
"""

import json
import logging
import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from vergence.envs.reading import Image, Reading, Truth
from vergence.errors import ConfigurationError, VergenceWarning
from vergence.models.head import HeadModel
from vergence.models.head_file import head_to_toml
from vergence.models.parts import FloatArray
from vergence.recording import schema
from vergence.recording.events import RobotListener
from vergence.recording.schema import (
    LoggedCommand,
    LoggedDetection,
    LoggedJoints,
    Topic,
    encode_message,
    import_mcap_writer,
)

_LOGGER: Final = logging.getLogger("vergence")
_FLUSH_S: Final = 0.05
"""Time between two writes, s; a kill loses at most this (chosen: little loss, few flushes)."""
_MAX_QUEUED: Final = 5000
"""Largest number of queued messages, about ten seconds; beyond it the log ends (chosen)."""
_JPEG_QUALITY: Final = 90
"""JPEG quality of logged images, 0 to 100 (chosen: detail against size of the log)."""


class LogWriter(RobotListener):
    """A robot's log, written from its opening to `close`; use it in a `with` statement.

    It also keeps messages of the package's loggers from level INFO.

    Args:
        path: path of the new file.
        head: the model that the controller uses.
        config: text of the file that describes the robot.
        facts: further facts about the log, by name.
        images: true to log all images of the eyes.
        clock: function that returns the robot's steady clock, s.
        wall_ns: function that returns the time of day, ns since 1970.

    Attributes:
        begun_s: time of the current trial's start, s of the clock.
        commanded: true if any command has been kept.
        reason: reason for a stop since the start of the current trial; empty if there is none.
        fault: reason for an early end of the log, such as a full disk; empty if there is none.

    Raises:
        ConfigurationError: the file exists, it cannot be written, or mcap is not installed.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        head: HeadModel,
        config: str = "",
        facts: Mapping[str, str] | None = None,
        images: bool = False,
        clock: Callable[[], float] = time.monotonic,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        make_writer = import_mcap_writer()
        self.path = Path(path)
        self.images = images
        self.begun_s = np.nan
        self.commanded = False
        self.reason = self.fault = ""
        self._clock = clock
        self._zero_ns = wall_ns() - round(1e9 * clock())
        self._waiting: deque[tuple[Topic, float, dict[str, Any]]] = deque()
        self._trials = 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb")
        except OSError as error:
            raise _unwritable(path, error) from error
        self._mcap = make_writer(self._file)
        try:
            self._begin_file(head, config, facts or {}, wall_ns())
        except OSError as error:  # such as a full disk
            with suppress(OSError):
                self._file.close()
            self.path.unlink(missing_ok=True)
            raise _unwritable(path, error) from error
        self._closing = threading.Event()
        self._writing = threading.Lock()
        self._handler = _Handler(self)
        _LOGGER.addHandler(self._handler)
        self._thread = threading.Thread(target=self._run, daemon=True, name="vergence log")
        self._thread.start()

    def _begin_file(
        self, head: HeadModel, config: str, more: Mapping[str, str], now_ns: int
    ) -> None:
        """Write the facts, the attachments and the schemas."""
        self._mcap.start(library="vergence")
        facts = {"schema": schema.SCHEMA_VERSION, "head": head.name, "head_digest": head.digest}
        facts |= {"clock_zero_ns": str(self._zero_ns), **more}
        self._mcap.add_metadata(schema.FACTS_RECORD_NAME, facts)
        for name, text in ((schema.HEAD_FILE, head_to_toml(head)), (schema.CONFIG_FILE, config)):
            self._mcap.add_attachment(now_ns, now_ns, name, "application/toml", text.encode())
        self._channels = {}
        for topic in schema.TOPICS:
            form = json.dumps(topic.schema).encode()
            number = self._mcap.register_schema(topic.schema_name, "jsonschema", form)
            self._channels[topic.name] = self._mcap.register_channel(topic.name, "json", number)
        self._mcap.flush()

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def begin(self) -> None:
        """Mark the start of a trial; the next reading is at its time zero."""
        self._trials += 1
        self.reason = ""
        self._put(schema.TRIAL, self._clock(), {"number": self._trials})

    def reading(self, reading: Reading, begun_s: float) -> None:
        """Keep a reading of one head, and the time of the trial's start, s of the clock."""
        self.begun_s = begun_s
        self._put(schema.READING, self._clock(), {"begun_s": begun_s, **_of_one_head(reading)})

    def command(self, command: LoggedCommand) -> None:
        """Keep a command; its `sent` array must not change afterwards."""
        self.commanded = True
        asked = command.asked.copy()
        self._put(schema.COMMAND, command.clock_s, command._replace(asked=asked)._asdict())

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """Keep a measurement of the joints, see `LoggedJoints`; it must not change afterwards."""
        joints = LoggedJoints(clock_s, positions, velocities)
        self._put(schema.JOINTS, clock_s, joints._asdict())

    def truth(self, truth: Truth) -> None:
        """Keep the ground truth of one head."""
        self._put(schema.TRUTH, self._clock(), _of_one_head(truth))

    def detection(self, detection: LoggedDetection) -> None:
        """Keep the detection in an image of an eye; its arrays must not change afterwards."""
        self._put(schema.DETECTION, detection.ready_s, detection._asdict())

    def image(self, eye: int, image: Image, exposed_s: float) -> None:
        """Keep an image of an eye as a JPEG."""
        topic = schema.IMAGES[eye]
        self._put(topic, exposed_s, {"frame_id": topic.name, "data": image, "format": "jpeg"})

    def stopped(self, reason: str) -> None:
        """Keep the reason for a stop of the head; repeats are ignored."""
        if reason != self.reason:
            self.reason = reason
            self._put(schema.FAULT, self._clock(), {"text": reason})

    def sync(self) -> None:
        """Flush all kept messages, so that a kill loses none of them; not for use in a loop."""
        if not self._closing.is_set():
            self._attempt(self._write)

    def close(self) -> None:
        """Write remaining messages and the end; warn if it ends early. Later calls do nothing."""
        if self._closing.is_set():
            return
        _LOGGER.removeHandler(self._handler)
        self._closing.set()
        self._thread.join()
        if self.fault:
            warnings.warn(self.fault, VergenceWarning, stacklevel=2)

    # ---- the thread ----

    def _put(self, topic: Topic, clock_s: float, message: dict[str, Any]) -> None:
        if len(self._waiting) > _MAX_QUEUED:
            self.fault = self.fault or f"log: {self.path} ends early: its disk is too slow"
        if not self.fault:
            self._waiting.append((topic, clock_s, message))

    def _run(self) -> None:
        while not self.fault and not self._closing.wait(_FLUSH_S):
            self._attempt(self._write)
        for last in (self._write, self._mcap.finish, self._file.close):
            self._attempt(last)
        with suppress(OSError):  # the failure is reported already
            self._file.close()

    def _attempt(self, write: Callable[[], object]) -> None:
        """Write, unless an earlier write has failed."""
        with self._writing:
            if self.fault:
                return
            try:
                write()
            except Exception as error:  # no error of the log may stop the robot
                reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
                self.fault = f"log: {self.path} ends early: {reason}"

    def _write(self) -> None:
        while self._waiting:
            topic, clock_s, message = self._waiting.popleft()
            time_ns = self._zero_ns + round(1e9 * clock_s)
            if topic in schema.IMAGES:
                quality = (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY)
                message["data"] = cv2.imencode(".jpg", message["data"], quality)[1].tobytes()
            if topic in schema.IMAGES or topic is schema.NOTES:
                sec, nsec = divmod(time_ns, 10**9)
                message = {"timestamp": {"sec": sec, "nsec": nsec}, **message}
            data = encode_message(message)
            self._mcap.add_message(self._channels[topic.name], time_ns, data, time_ns)
        self._mcap.flush()


def _of_one_head(values: Reading | Truth) -> dict[str, Any]:
    return {name: value[0].copy() for name, value in values._asdict().items()}


def _unwritable(path: str | os.PathLike[str], error: OSError) -> ConfigurationError:
    return ConfigurationError(
        f"log: expected a new file that can be written, got {os.fspath(path)}: {error.strerror}"
    )


class _Handler(logging.Handler):
    """Passes messages of loggers to a log."""

    def __init__(self, log: LogWriter) -> None:
        super().__init__(logging.INFO)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`."""
        message = {
            "level": min(record.levelno // 10, 5),  # Foxglove's, 1 to 5, of Python's 10 to 50
            "message": record.getMessage(),
            "name": record.name,
            "file": record.filename,
            "line": record.lineno,
        }
        self._log._put(schema.NOTES, self._log._clock(), message)
