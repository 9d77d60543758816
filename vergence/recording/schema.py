"""Messages of a log: topics, JSON schemas, and arrays to JSON and back.

A log is an MCAP file of JSON messages. `null` stands for nan. An array is a list of numbers, the
last axis running fastest, and its shape stands in the schema: Foxglove's schemas have no lists of
lists. Arrays are of one head, those of `Reading` and `Truth` without the axis over heads.

Times in `Reading` and `Truth` count from the trial's start, s. All other times are of the robot's
steady clock, s; a reading's `begun_s` is the trial's start by that clock.

`SCHEMA_VERSION` grows with every change that a reader has to know of.
"""

import base64
import json
import reprlib
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

SCHEMA_VERSION: Final = "1"
FACTS: Final = "vergence"
"""Name of the metadata record with what a log is of."""
_MOST: Final = 1e15
"""Numbers beyond this are nobody's measurements, and their products overflow."""
HEAD_FILE: Final = "head.toml"
CONFIG_FILE: Final = "hardware.toml"
"""Names of the attachments."""


class Asked(Enum):
    """Who asked for a command."""

    POLICY = "policy"
    """The policy, in a trial."""
    HERE = "vergence"
    """The robot's own code: on the way to a start, in place of a late policy, to rest."""


class LoggedCommand(NamedTuple):
    """A command of one control period."""

    clock_s: float
    """When it was sent, s of the clock."""
    asked: FloatArray
    """(7,) velocities that were asked for, of the neck's joints and the actuators of the eyes,
    rad/s."""
    sent: FloatArray
    """(7,) velocities that were sent, rad/s."""
    verdict: str
    """Why they differ: `go`, `hold`, `search` or `stop`, see `vergence.hardware.safety`."""
    by: str
    """A value of `Asked`."""


class LoggedJoints(NamedTuple):
    """One measurement of all joints."""

    clock_s: float
    """When they were measured, s of the clock."""
    positions: FloatArray
    """(7,) rad."""
    velocities: FloatArray
    """(7,) rad/s."""


class LoggedDetection(NamedTuple):
    """What one eye saw in one image."""

    eye: str
    """`left` or `right`."""
    exposed_s: float
    """When the image was exposed, s of the clock."""
    ready_s: float
    """When the target had been looked for in it, s of the clock."""
    positions: FloatArray
    """(7,) joint angles at the exposure, rad."""
    point_px: FloatArray
    """(2,) raw pixel of the target; nan where it was not found."""
    sigma_px: FloatArray
    """(2,) its standard deviations."""
    corners_px: FloatArray
    """(n, 2) raw pixels of the target's corners; none where it was not found."""
    corners_sigma_px: FloatArray
    """(n, 2) their standard deviations."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One kind of message."""

    name: str
    schema_name: str
    schema: dict[str, Any]

    @property
    def encoded(self) -> bytes:
        """The JSON schema as text."""
        return json.dumps(self.schema).encode()


_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_STAMP: Final = {
    "type": "object",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}


def _array(form: NDArray[Any]) -> dict[str, Any]:
    """The schema of an array: a list of its numbers; a length of 0 stands for any."""
    kind = {"b": "boolean", "i": "integer"}.get(form.dtype.kind, "number")
    if not form.ndim:
        return {"type": kind}
    shape = ", ".join(str(length) if length else "n" for length in form.shape)
    return {"type": "array", "items": {"type": kind}, "description": f"of the shape ({shape})"}


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def forms_of(kind: type[Reading] | type[Truth]) -> dict[str, NDArray[Any]]:
    """An array of the shape and type of each field of one head, by name."""
    empty = Reading.empty(1) if kind is Reading else Truth.unknown(1)
    return {name: value[0] for name, value in empty._asdict().items()}


def _of_head(kind: type[Reading] | type[Truth], **more: Any) -> dict[str, Any]:
    fields = {name: _array(form) for name, form in forms_of(kind).items()}
    return _object(kind.__name__, {**more, **fields})


_SEVEN: Final = _array(np.zeros(7))
_PIXEL: Final = _array(np.zeros(2))
_PIXELS: Final = _array(np.zeros((0, 2)))
TRIAL: Final = Topic(
    name="/trial",
    schema_name="vergence.Trial",
    schema=_object("Trial", {"number": {"type": "integer"}}),
)
"""A trial begins: the next reading is that of its time zero."""
READING: Final = Topic(
    name="/reading",
    schema_name="vergence.Reading",
    schema=_of_head(Reading, begun_s=_NUMBER),
)
"""Once a control period, see `vergence.envs.reading.Reading`."""
COMMAND: Final = Topic(
    name="/command",
    schema_name="vergence.Command",
    schema=_object(
        "Command",
        {
            "clock_s": _NUMBER,
            "asked": _SEVEN,
            "sent": _SEVEN,
            "verdict": _TEXT,
            "by": _TEXT,
        },
    ),
)
"""Each command; a policy's comes before the reading at its period's end, see `LoggedCommand`."""
JOINTS: Final = Topic(
    name="/joints",
    schema_name="vergence.Joints",
    schema=_object("Joints", {"clock_s": _NUMBER, "positions": _SEVEN, "velocities": _SEVEN}),
)
"""Each measurement of the joints, in trials and on the way to them, see `LoggedJoints`."""
TRUTH: Final = Topic(name="/truth", schema_name="vergence.Truth", schema=_of_head(Truth))
"""After a reading, where the truth is known, see `vergence.envs.reading.Truth`."""
DETECTION: Final = Topic(
    name="/detection",
    schema_name="vergence.Detection",
    schema=_object(
        "Detection",
        {
            "eye": _TEXT,
            "exposed_s": _NUMBER,
            "ready_s": _NUMBER,
            "positions": _SEVEN,
            "point_px": _PIXEL,
            "sigma_px": _PIXEL,
            "corners_px": _PIXELS,
            "corners_sigma_px": _PIXELS,
        },
    ),
)
"""Once an image of an eye, see `LoggedDetection`."""
FAULT: Final = Topic(
    name="/fault", schema_name="vergence.Fault", schema=_object("Fault", {"text": _TEXT})
)
"""The head has been stopped, and why."""
NOTES: Final = Topic(
    name="/log",
    schema_name="foxglove.Log",
    schema=_object(
        "foxglove.Log",
        {
            "timestamp": _STAMP,
            "level": {"type": "integer"},
            "message": _TEXT,
            "name": _TEXT,
            "file": _TEXT,
            "line": {"type": "integer"},
        },
    ),
)
"""What the package's loggers say."""
IMAGES: Final = tuple(
    Topic(
        name=f"/image/{eye}",
        schema_name="foxglove.CompressedImage",
        schema=_object(
            "foxglove.CompressedImage",
            {
                "timestamp": _STAMP,
                "frame_id": _TEXT,
                "data": {"type": "string", "contentEncoding": "base64"},
                "format": _TEXT,
            },
        ),
    )
    for eye in EYE_NAMES
)
"""JPEGs of both eyes, where they were asked for; their time is that of the exposure."""
TOPICS: Final = (TRIAL, READING, COMMAND, JOINTS, TRUTH, DETECTION, FAULT, NOTES, *IMAGES)


def to_json(message: dict[str, Any]) -> bytes:
    """A message of plain values and arrays as JSON."""
    return json.dumps({name: _plain(value) for name, value in message.items()}).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float | np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = array.astype(object)
            array[~np.isfinite(np.asarray(value))] = None
        return array.ravel().tolist() if array.ndim else array.tolist()
    return value


def stamp(time_ns: int) -> dict[str, int]:
    """A time as Foxglove's schemas have it."""
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def as_array(topic: Topic, message: dict[str, Any], name: str, form: NDArray[Any]) -> NDArray[Any]:
    """A field of a message as an array.

    Args:
        topic: of the message.
        message: its fields.
        name: of the field.
        form: an array of the shape and type that it has to have; a length of 0 stands for any.

    Raises:
        ConfigurationError: it is missing or none.
    """
    value = message.get(name)
    items = value if isinstance(value, list) else [value]
    flat = isinstance(value, list) == bool(form.ndim)
    if flat and all(_is_of(form.dtype.kind, one) for one in items):
        with suppress(ValueError, OverflowError):  # another count, or beyond an integer's range
            found = np.array(value, dtype=form.dtype)
            return found.reshape((-1, *form.shape[1:]) if 0 in form.shape else form.shape)
    raise _other(topic, name, form, value)


def as_text(topic: Topic, message: dict[str, Any], name: str) -> str:
    """A field of a message as text.

    Raises:
        ConfigurationError: it is missing or none.
    """
    value = message.get(name)
    if not isinstance(value, str):
        raise ConfigurationError(f"{topic.name}: {name}: expected a text, got {shown(value)}")
    return value


def shown(value: Any) -> str:
    """A value in a message, however long and deep it is."""
    return f"{reprlib.repr(value):.80}"


def _is_of(kind: str, value: Any) -> bool:
    """Whether JSON has a value that an array of a kind holds: Python takes true for 1, too."""
    if kind == "b" or isinstance(value, bool):
        return kind == "b" and isinstance(value, bool)
    if kind == "i":
        return isinstance(value, int)
    return value is None or (isinstance(value, int | float) and -_MOST <= value <= _MOST)


def _other(topic: Topic, name: str, form: NDArray[Any], value: Any) -> ConfigurationError:
    """The error for a field of another type, size or shape."""
    kind = {"b": "true or false", "i": "a whole number"}.get(
        form.dtype.kind, f"a number up to {_MOST:g} in size, or null"
    )
    shape = f", in the shape {form.shape}" if form.shape else ""
    return ConfigurationError(f"{topic.name}: {name}: expected {kind}{shape}, got {shown(value)}")
