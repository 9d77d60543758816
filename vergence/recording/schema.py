"""Topics of a log, their fields, and their JSON.

A log is an MCAP file of JSON messages. `null` stands for nan. An array is a flat list of numbers,
the last axis running fastest, with its shape in the schema, as Foxglove's schemas have no lists of
lists. Arrays are of one head; those of `Reading` and `Truth` lack the axis over heads.

Times in `Reading` and `Truth` count from the trial's start, s. All other times are of the robot's
steady clock, s. A reading's `begun_s` is the time of the trial's start on that clock.

`SCHEMA_VERSION` grows with every change that affects readers.
"""

import base64
import json
import reprlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError, how_to_install
from vergence.models.parts import EYE_NAMES, FloatArray

SCHEMA_VERSION: Final = "1"
FACTS_RECORD_NAME: Final = "vergence"
"""Name of the metadata record with the facts of a log."""
HEAD_FILE: Final = "head.toml"
CONFIG_FILE: Final = "hardware.toml"
"""Names of the attachments."""
_MAX_NUMBER: Final = 1e15
"""Largest absolute value of a number (chosen: above any measurement, and products stay finite)."""
_JSON_TYPES: Final[dict[str, set[type]]] = {"b": {bool}, "i": {int}, "f": {int, float, type(None)}}
"""Types of a JSON value by the kind of its array."""
_MAX_UNIX_TIME_S: Final = 2**33
"""Upper limit of times of day, s since 1970: some 270 years (chosen)."""


def import_mcap_writer() -> Callable[[BinaryIO], Any]:
    """The class `mcap.writer.Writer`, some of whose methods have no types."""
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise ConfigurationError(
            f"log: expected mcap to be installed: {how_to_install('robot')}"
        ) from error
    return Writer


class CommandOrigin(Enum):
    """Origin of a command."""

    POLICY = "policy"
    """The policy, in a trial."""
    ROBOT = "robot"
    """The robot's own code: to move to a start, to replace a late policy, or to come to rest."""


class LoggedCommand(NamedTuple):
    """A command of one control period."""

    clock_s: float
    """Time of sending, s of the clock."""
    asked: FloatArray
    """(7,) requested velocities of the neck's joints and the eyes' actuators, rad/s."""
    sent: FloatArray
    """(7,) velocities sent after the supervisor's limits, rad/s."""
    verdict: str
    """Supervisor's decision, a value of `vergence.hardware.safety.supervisor.Verdict`; `go` sends
    the requested velocities, limited to the bounds."""
    by: str
    """Origin of the command, a value of `CommandOrigin`."""


class LoggedJoints(NamedTuple):
    """One measurement of all joints."""

    clock_s: float
    """Time of the measurement, s of the clock."""
    positions: FloatArray
    """(7,) rad."""
    velocities: FloatArray
    """(7,) rad/s."""


class LoggedDetection(NamedTuple):
    """Result of the search for the target in one image of one eye."""

    eye: str
    """`left` or `right`."""
    exposed_s: float
    """Time of the exposure, s of the clock."""
    ready_s: float
    """Time at which the search in the image ended, s of the clock."""
    positions: FloatArray
    """(7,) joint angles at the exposure, rad."""
    point_px: FloatArray
    """(2,) raw pixel of the target; nan where it was not found."""
    sigma_px: FloatArray
    """(2,) standard deviations of the target's pixel, px."""
    corners_px: FloatArray
    """(n, 2) raw pixels of the target's corners; n = 0 if it was not found."""
    corners_sigma_px: FloatArray
    """(n, 2) standard deviations of the corners, px."""


# ---- topics ----

Form = NDArray[Any] | type[str] | type[bytes] | type[dict[str, int]]
"""Type of a field: an array with the field's shape and dtype, in which a length of 0 means any
length; text; bytes in base64; or a time of day, as seconds and nanoseconds."""


@dataclass(frozen=True)
class Topic:
    """A topic of the log: the name and the fields of one kind of message."""

    name: str
    schema_name: str
    fields: Mapping[str, Form]

    @property
    def schema(self) -> dict[str, Any]:
        """The JSON schema."""
        properties = {name: _property(form) for name, form in self.fields.items()}
        return {"title": self.schema_name, "type": "object", "properties": properties}


def _property(form: Form) -> dict[str, Any]:
    """The JSON schema of a field."""
    if form is str:
        return {"type": "string"}
    if form is bytes:
        return {"type": "string", "contentEncoding": "base64"}
    if not isinstance(form, np.ndarray):
        parts = {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}
        return {"type": "object", "properties": parts}
    kind = {"b": "boolean", "i": "integer"}.get(form.dtype.kind, "number")
    if not form.ndim:
        return {"type": kind}
    return {"type": "array", "items": {"type": kind}, "description": f"of the shape {_shape(form)}"}


def _shape(form: NDArray[Any]) -> str:
    return f"({', '.join(str(length) if length else 'n' for length in form.shape)})"


def _of_head(empty: Reading | Truth) -> dict[str, Form]:
    """Forms of the fields of a reading or truth of one head."""
    return {name: np.array(value[0]) for name, value in empty._asdict().items()}


_NUMBER: Final[Form] = np.zeros(())
_INTEGER: Final[Form] = np.zeros((), dtype=np.int64)
_JOINTS: Final[Form] = np.zeros(7)
_PIXEL: Final[Form] = np.zeros(2)
_PIXELS: Final[Form] = np.zeros((0, 2))
_COMMAND_FORMS: Final = (_NUMBER, _JOINTS, _JOINTS, str, str)
_JOINTS_FORMS: Final = (_NUMBER, _JOINTS, _JOINTS)
_DETECTION_FORMS: Final = (str, _NUMBER, _NUMBER, _JOINTS, _PIXEL, _PIXEL, _PIXELS, _PIXELS)
TRIAL: Final = Topic("/trial", "vergence.Trial", {"number": _INTEGER})
"""Start of a trial; the next reading is at its time zero."""
READING: Final = Topic(
    "/reading", "vergence.Reading", {"begun_s": _NUMBER, **_of_head(Reading.empty(1))}
)
"""One per control period, see `vergence.envs.reading.Reading`."""
COMMAND: Final = Topic(
    "/command", "vergence.Command", dict(zip(LoggedCommand._fields, _COMMAND_FORMS, strict=True))
)
"""Each command; a policy's precedes the reading at its period's end, see `LoggedCommand`."""
JOINTS: Final = Topic(
    "/joints", "vergence.Joints", dict(zip(LoggedJoints._fields, _JOINTS_FORMS, strict=True))
)
"""Each measurement of the joints, in trials and while moving to their start, see `LoggedJoints`."""
TRUTH: Final = Topic("/truth", "vergence.Truth", _of_head(Truth.unknown(1)))
"""Ground truth after a reading, if it is known, see `vergence.envs.reading.Truth`."""
DETECTION: Final = Topic(
    "/detection",
    "vergence.Detection",
    dict(zip(LoggedDetection._fields, _DETECTION_FORMS, strict=True)),
)
"""One per image of an eye, see `LoggedDetection`."""
FAULT: Final = Topic("/fault", "vergence.Fault", {"text": str})
"""Reason for a stop of the head."""
NOTES: Final = Topic(
    "/log",
    "foxglove.Log",
    {"timestamp": dict[str, int], "level": _INTEGER, "message": str, "name": str, "file": str,
     "line": _INTEGER},
)  # fmt: skip
"""Messages of the package's loggers."""
IMAGES: Final = tuple(
    Topic(
        f"/image/{eye}",
        "foxglove.CompressedImage",
        {"timestamp": dict[str, int], "frame_id": str, "data": bytes, "format": str},
    )
    for eye in EYE_NAMES
)
"""JPEGs of both eyes, if asked for, at the times of their exposures."""
TOPICS: Final = (TRIAL, READING, COMMAND, JOINTS, TRUTH, DETECTION, FAULT, NOTES, *IMAGES)


# ---- messages ----


def encode_message(message: dict[str, Any]) -> bytes:
    """Encode a message of plain values and arrays as JSON."""
    return json.dumps({name: _json_value(value) for name, value in message.items()}).encode()


def _json_value(value: Any) -> Any:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float | np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = array.astype(object)
            array[~np.isfinite(np.asarray(value))] = None
        return array.ravel().tolist() if array.ndim else array.tolist()
    return value


def decode_message(topic: Topic, data: bytes) -> dict[str, Any]:
    """Values of a message by field: arrays, numbers, text, bytes, or ns since 1970."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{topic.name}: expected JSON, got {data[:40]!r}") from error
    if not isinstance(found, dict):
        raise ConfigurationError(f"{topic.name}: expected an object, got {_shown(found)}")
    fields = {}
    for name, form in topic.fields.items():
        fields[name] = _decoded(form, found.get(name))
        if fields[name] is None:
            raise ConfigurationError(
                f"{topic.name}: {name}: expected {_words(form)}, got {_shown(found.get(name))}"
            )
    return fields


def _decoded(form: Form, value: Any) -> Any:
    """Decode a field; None if the value does not match the form."""
    if isinstance(form, np.ndarray):
        return _array(form, value)
    if form is str:
        return escape_control_characters(value) if isinstance(value, str) else None
    if form is bytes:
        with suppress(TypeError, ValueError):
            return base64.b64decode(value, validate=True)
        return None
    sec, nsec = (value.get("sec"), value.get("nsec")) if isinstance(value, dict) else (None, None)
    if type(sec) is not int or type(nsec) is not int:
        return None
    return sec * 10**9 + nsec if abs(sec) < _MAX_UNIX_TIME_S and 0 <= nsec < 10**9 else None


def _array(form: NDArray[Any], value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    if isinstance(value, list) != bool(form.ndim):
        return None
    if not _JSON_TYPES[form.dtype.kind].issuperset(map(type, items)):
        return None
    if form.dtype.kind == "f" and not all(
        one is None or -_MAX_NUMBER <= one <= _MAX_NUMBER for one in items
    ):
        return None
    with suppress(ValueError, OverflowError):  # wrong number of items, or integer out of range
        found = np.array(value, dtype=form.dtype)
        found = found.reshape((-1, *form.shape[1:]) if 0 in form.shape else form.shape)
        return found if form.ndim else found.item()
    return None


def _words(form: Form) -> str:
    """A form in words, for error messages."""
    if not isinstance(form, np.ndarray):
        return "a text" if form is str else "base64" if form is bytes else "a time of day"
    kind = {"b": "true or false", "i": "a whole number"}.get(
        form.dtype.kind, f"a number up to {_MAX_NUMBER:g} in size, or null"
    )
    return f"{kind}, in the shape {_shape(form)}" if form.ndim else kind


def escape_control_characters(text: str) -> str:
    """Escape control characters, so that the text stays in one line."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def _shown(value: Any) -> str:
    return f"{reprlib.repr(value):.80}"
