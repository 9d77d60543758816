"""Topics of a log, their fields, and their JSON schemas.

A log is an MCAP file of JSON messages. `null` stands for nan. An array is a flat list of numbers,
the last axis running fastest, with its shape in the schema, as Foxglove's schemas have no lists of
lists. Arrays are of one head; those of `Reading` and `Truth` lack the axis over heads.

Times in `Reading` and `Truth` count from the trial's start, s. All other times are of the robot's
steady clock, s. A reading's `begun_s` is the time of the trial's start on that clock.

`SCHEMA_VERSION` grows with every change that affects readers.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Reading, Truth
from vergence.models.parts import EYE_NAMES, FloatArray

SCHEMA_VERSION: Final = "1"
FACTS_RECORD_NAME: Final = "vergence"
"""Name of the metadata record with the facts of a log."""
HEAD_FILE: Final = "head.toml"
CONFIG_FILE: Final = "hardware.toml"
"""Names of the attachments."""


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


Form = NDArray[Any] | type[str] | type[bytes] | type[dict[str, int]]
"""Type of a field: an array with the field's shape and dtype, in which a length of 0 means any
length; text; bytes in base64; or a time of day, as seconds and nanoseconds."""


@dataclass(frozen=True, kw_only=True)
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

    @property
    def encoded_schema(self) -> bytes:
        """The JSON schema of the topic as bytes, for the MCAP file (not a message)."""
        return json.dumps(self.schema).encode()


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
    return {
        "type": "array",
        "items": {"type": kind},
        "description": f"of the shape {shape_text(form)}",
    }


def shape_text(form: NDArray[Any]) -> str:
    """The shape of a field in words."""
    return f"({', '.join(str(length) if length else 'n' for length in form.shape)})"


def _of_head(empty: Reading | Truth) -> dict[str, Form]:
    """Forms of the fields of a reading or truth of one head."""
    return {name: np.array(value[0]) for name, value in empty._asdict().items()}


# Forms by shape: scalar float, scalar integer, seven joints, one pixel, any number of pixels
# (numerical).
_NUMBER: Final[Form] = np.zeros(())
_INTEGER: Final[Form] = np.zeros((), dtype=np.int64)
_JOINT_VECTOR: Final[Form] = np.zeros(7)
_PIXEL: Final[Form] = np.zeros(2)
_PIXELS: Final[Form] = np.zeros((0, 2))
TRIAL: Final = Topic(name="/trial", schema_name="vergence.Trial", fields={"number": _INTEGER})
"""Start of a trial; the next reading is at its time zero."""
READING: Final = Topic(
    name="/reading",
    schema_name="vergence.Reading",
    fields={"begun_s": _NUMBER, **_of_head(Reading.empty(1))},
)
"""One per control period, see `vergence.envs.reading.Reading`."""
COMMAND: Final = Topic(
    name="/command",
    schema_name="vergence.Command",
    fields={
        "clock_s": _NUMBER,
        "asked": _JOINT_VECTOR,
        "sent": _JOINT_VECTOR,
        "verdict": str,
        "by": str,
    },
)
"""Each command; a policy's precedes the reading at its period's end, see `LoggedCommand`."""
JOINTS: Final = Topic(
    name="/joints",
    schema_name="vergence.Joints",
    fields={"clock_s": _NUMBER, "positions": _JOINT_VECTOR, "velocities": _JOINT_VECTOR},
)
"""Each measurement of the joints, in trials and while moving to their start, see `LoggedJoints`."""
TRUTH: Final = Topic(name="/truth", schema_name="vergence.Truth", fields=_of_head(Truth.unknown(1)))
"""Ground truth after a reading, if it is known, see `vergence.envs.reading.Truth`."""
DETECTION: Final = Topic(
    name="/detection",
    schema_name="vergence.Detection",
    fields={
        "eye": str,
        "exposed_s": _NUMBER,
        "ready_s": _NUMBER,
        "positions": _JOINT_VECTOR,
        "point_px": _PIXEL,
        "sigma_px": _PIXEL,
        "corners_px": _PIXELS,
        "corners_sigma_px": _PIXELS,
    },
)
"""One per image of an eye, see `LoggedDetection`."""
FAULT: Final = Topic(name="/fault", schema_name="vergence.Fault", fields={"text": str})
"""Reason for a stop of the head."""
NOTES: Final = Topic(
    name="/log",
    schema_name="foxglove.Log",
    fields={
        "timestamp": dict[str, int],
        "level": _INTEGER,
        "message": str,
        "name": str,
        "file": str,
        "line": _INTEGER,
    },
)
"""Messages of the package's loggers."""
IMAGES: Final = tuple(
    Topic(
        name=f"/image/{eye}",
        schema_name="foxglove.CompressedImage",
        fields={"timestamp": dict[str, int], "frame_id": str, "data": bytes, "format": str},
    )
    for eye in EYE_NAMES
)
"""JPEGs of both eyes, if asked for, at the times of their exposures."""
TOPICS: Final = (TRIAL, READING, COMMAND, JOINTS, TRUTH, DETECTION, FAULT, NOTES, *IMAGES)
