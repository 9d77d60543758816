"""Faults of an emulated head: their names and values, and their effects on servos and images.

An example in JSON:

    {"what": "late", "ids": [1, 2], "probability": 0.5, "for_s": 0.4, "value": 0.012}

A fault is one of a camera if it has the key `eye`, or if only cameras have a fault of its name.
"""

import logging
import tomllib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from vergence.envs.reading import Image
from vergence.errors import HeadFileError, UnreadableFileError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.servo import ENCODER_ERROR, LOAD_ERROR, EmulatedServo
from vergence.models.parts import EYE_NAMES
from vergence.models.toml_table import Rule, Table

Place = Literal["line", "servo", "cable", "camera"]

_BOTH_EYES: Final = "both"
_RULES: Final[dict[str, Rule]] = {
    "at_s": (lambda x: 0.0 <= x <= 3600.0, "seconds since torque was switched on, 0 to 3600"),
    "for_s": (lambda x: 0.0 < x <= 3600.0, "seconds, 0 to 3600"),
    "probability": (lambda x: 0.0 < x <= 1.0, "a probability, more than 0 to 1"),
}
_DELAY: Final[Rule] = (lambda x: 0.0 < x <= 10.0, "seconds, 0 to 10")


class _Kind(NamedTuple):
    """Properties of the faults of one name."""

    place: Place
    keys: tuple[str, ...]
    rule: Rule | None = None
    """Rule of its value; None for faults without a value."""
    default: float | None = None
    """Default of its value; None if a value has to be given."""


def _valued(rule: Rule) -> _Kind:
    return _Kind("servo", ("ids", "for_s", "value"), rule)


_LINE: Final = _Kind("line", ("ids", "for_s", "probability"))
_SERVO: Final = _Kind("servo", ("ids", "for_s"))
_ONCE: Final = _Kind("servo", ("ids",))
_CAMERA: Final = _Kind("camera", ("eye", "for_s"))
_IMAGE: Final = _Kind("camera", ("eye", "for_s", "probability"))

_KINDS: Final = {
    **dict.fromkeys(("bad-crc", "short"), _LINE),
    "late": _Kind("line", (*_LINE.keys, "value"), _DELAY, 0.012),
    **dict.fromkeys(("lost", "doubled"), _LINE),
    **dict.fromkeys(("overload", "reboot"), _ONCE),
    "voltage": _valued((lambda x: 0.0 <= x <= 60.0, "V, 0 to 60")),
    "temperature": _valued((lambda x: 0.0 <= x <= 255.0, "degrees Celsius, 0 to 255")),
    "load": _valued((lambda x: -100.0 <= x <= 100.0, "percent of the greatest load, -100 to 100")),
    **dict.fromkeys(
        ("silent", "frozen", "stuck", "wrong-way", "blind", "blind-told", "inverted"), _SERVO
    ),
    **dict.fromkeys(
        ("goal-scale", "speed-scale"),
        _valued((lambda x: 0.1 <= abs(x) <= 10.0, "a ratio, 0.1 to 10 in size")),
    ),
    "unplug": _Kind("cable", ()),
}
"""Faults of servos, line and cable by name."""

_CAMERA_KINDS: Final = {
    "frozen": _CAMERA,
    "torn": _IMAGE,
    "late": _Kind("camera", (*_CAMERA.keys, "value"), _DELAY, 0.1),
    "dropped": _IMAGE,
    **dict.fromkeys(("ended", "stalled", "mirrored", "upside-down"), _CAMERA),
    "out-of-step": _Kind("camera", ("for_s", "value"), _DELAY, 0.0167),
}
"""Faults of cameras by name."""

FAULT_NAMES: Final = tuple(dict.fromkeys((*_KINDS, *_CAMERA_KINDS)))


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Faults of the line affect single answers of servos: `bad-crc`, `short` (cut off), `late` (by
    `value` in s), `lost`, `doubled`.

    Faults of a servo: `overload` and `reboot` happen once. `voltage` (V), `temperature` (degrees
    Celsius) and `load` (percent) set its measurements to `value`. `silent` acts as if its plug were
    pulled out, `frozen` reports one position while its joint moves, `stuck` does not move,
    `wrong-way` turns against its commands. `blind` is an encoder whose servo sees no motion either
    and turns on at a goal of zero, `blind-told` one that reports the encoder's error, `inverted` a
    motor with its wires exchanged, which runs away. `goal-scale` and `speed-scale` multiply its
    speed and the speed that it reports by `value`, as other units would.

    Fault of the cable: `unplug`, permanent.

    Faults of a camera: `frozen` repeats one image, `torn` sends the old image's lower half below
    the new one's upper half; `late` sends images later by `value` in s; `dropped` does not send an
    image; `ended` closes the stream, `stalled` keeps it open without images; `mirrored` and
    `upside-down` images; `out-of-step` exposes the right camera later by `value` in s.
    """

    what: str
    """Name, one of `FAULT_NAMES`."""
    place: Place
    """Part that it affects."""
    ids: tuple[int, ...] = ()
    """Ids of the affected servos."""
    eye: str = _BOTH_EYES
    """Affected camera: "left", "right" or "both"."""
    probability: float = 1.0
    """Probability to affect each answer or image."""
    for_s: float = inf
    """Duration, s."""
    value: float = 0.0
    """Value, in the unit given above."""
    at_s: float = 0.0
    """Time of its beginning in a script, s after torque was switched on."""

    def to_plain(self) -> dict[str, Any]:
        """Plain values for `parse_fault`, without servos and times; for faults of cameras."""
        keys = [key for key in _CAMERA_KINDS[self.what].keys if key != "for_s"]
        return {"what": self.what, **{key: getattr(self, key) for key in keys}}


def parse_fault(values: object, ids: Collection[int], path: str = "fault", *, timed: bool) -> Fault:
    """Make a fault from plain values, from JSON or TOML.

    One that names no `ids` affects all of these; one that is `timed` gives its beginning, `at_s`.

    Raises:
        HeadFileError: a key or value is unknown, missing or impossible.
    """
    table = Table(values, path)
    what = table.choice("what", FAULT_NAMES)
    has_eye = table.has("eye")
    kind = _KINDS.get(what)
    if kind is None or (has_eye and what in _CAMERA_KINDS):
        kind = _CAMERA_KINDS[what]
    keys = ("at_s", *kind.keys) if timed else kind.keys
    for name in table.names():
        if name not in keys:
            expected = f"a key that {what} takes: {', '.join(('what', *keys))}"
            raise HeadFileError(table.key(name), table.peek(name), expected)
    given: dict[str, Any] = {
        name: table.number(name, rule)
        for name, rule in _RULES.items()
        if table.has(name) or (timed and name == "at_s")
    }
    if has_eye:
        given["eye"] = table.choice("eye", (*EYE_NAMES, _BOTH_EYES))
    if kind.rule is not None:
        needed = kind.default is None or table.has("value")
        given["value"] = table.number("value", kind.rule) if needed else kind.default
    if "ids" in kind.keys:
        given["ids"] = _ids(table, ids)
    return Fault(what=what, place=kind.place, **given)


def load_faults(path: Path, ids: Collection[int]) -> tuple[Fault, ...]:
    """Read a script: a TOML file with a table [[fault]] for each fault, which also gives `at_s`."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        said = error.strerror or str(error)
        raise UnreadableFileError(str(path), said, "a TOML file of faults") from error
    except (ValueError, RecursionError) as error:  # not UTF-8, too deep, a number too long
        raise UnreadableFileError(str(path), f"no TOML ({error})", "a TOML file") from error
    try:
        tables = Table(document, "")
        listed = tables.take("fault", "tables [[fault]]")
        tables.close()
        tables.expect(isinstance(listed, list), "fault", listed, "tables [[fault]]")
        return tuple(
            parse_fault(values, ids, f"fault[{i}]", timed=True) for i, values in enumerate(listed)
        )
    except HeadFileError as error:
        raise HeadFileError(error.key, error.value, error.expected, str(path)) from error


def _ids(table: Table, ids: Collection[int]) -> tuple[int, ...]:
    if not table.has("ids"):
        return tuple(ids)
    expected = f"a list of ids of servos, of {', '.join(map(str, ids))}"
    named = table.take("ids", expected)
    whole = isinstance(named, list) and all(type(one) is int and one in ids for one in named)
    table.expect(whole and named, "ids", named, expected)
    return tuple(named)


_LOG: Final = logging.getLogger(__name__)
_FAULT_REGISTERS: Final = {
    "voltage": (table.PRESENT_INPUT_VOLTAGE, 10.0),
    "temperature": (table.PRESENT_TEMPERATURE, 1.0),
    "load": (table.PRESENT_LOAD, 10.0),
}
"""Register, and register units per unit of a fault's value, by the fault's name."""


class ActiveFaults:
    """The active faults, and those that a script will begin."""

    def __init__(self, servos: Iterable[EmulatedServo]) -> None:
        self.unplugged = False  # True once the line's cable has been pulled
        self._servos = tuple(servos)
        self._healthy = [
            {name: servo.get(register) for name, (register, _) in _FAULT_REGISTERS.items()}
            for servo in self._servos
        ]
        self._on: list[tuple[float, Fault]] = []  # with their end times, s
        self._script: list[Fault] = []
        self._script_s = inf  # until the script begins

    @property
    def due_s(self) -> float:
        """Time at which the next fault begins or ends by itself, s; inf for none."""
        ends_s = [end_s for end_s, _ in self._on]
        return min([*ends_s, *(self._script_s + one.at_s for one in self._script)], default=inf)

    def active_on(self, place: Place) -> list[Fault]:
        """Active faults of one kind of part, in the order in which they began."""
        return [fault for _, fault in self._on if fault.place == place]

    def schedule(self, script: Iterable[Fault]) -> None:
        """Set the script: faults that begin by themselves."""
        self._script = sorted(script, key=lambda fault: fault.at_s)

    def start_script(self, now_s: float) -> None:
        """Start the script's time; a second call does nothing."""
        self._script_s = min(self._script_s, now_s)

    def begin(self, fault: Fault, now_s: float) -> None:
        """Begin a fault."""
        _tell(fault, "begins")
        if fault.what == "unplug":
            self.unplugged = True
            return
        if fault.what in ("overload", "reboot"):
            for servo in self._servos:
                if servo.id not in fault.ids:
                    continue
                if fault.what == "reboot":
                    servo.reboot()
                else:
                    servo.set_hardware_errors(LOAD_ERROR)
            return
        self._on.append((now_s + fault.for_s, fault))
        self._apply()

    def advance_to(self, now_s: float) -> None:
        """Begin and end the faults that are due; the servos have to be advanced to this time."""
        self._end([one for one in self._on if one[0] > now_s])
        while self._script and self._script_s + self._script[0].at_s <= now_s:
            self.begin(self._script.pop(0), now_s)

    def clear(self) -> None:
        """End all active faults; those that happen once, and a pulled cable, stay."""
        self._end([])

    def _end(self, left: list[tuple[float, Fault]]) -> None:
        for one in self._on:
            if one not in left:
                _tell(one[1], "ends")
        self._on = left
        self._apply()

    def _apply(self) -> None:
        for servo, healthy in zip(self._servos, self._healthy, strict=True):
            faults = [fault for fault in self.active_on("servo") if servo.id in fault.ids]
            own = {fault.what: fault.value for fault in faults}
            servo.silent, servo.stuck = "silent" in own, "stuck" in own
            servo.blind = "blind" in own or "blind-told" in own
            servo.inverted = "inverted" in own
            servo.goal_scale = -1.0 if "wrong-way" in own else own.get("goal-scale", 1.0)
            servo.speed_scale = own.get("speed-scale", 1.0)
            servo.freeze("frozen" in own or servo.blind)
            if "blind-told" in own:
                servo.set_hardware_errors(ENCODER_ERROR)
            for name, (register, units) in _FAULT_REGISTERS.items():
                servo.set(register, round(own[name] * units) if name in own else healthy[name])


def _tell(fault: Fault, what: str) -> None:
    whose = fault.eye if fault.place == "camera" else ", ".join(map(str, fault.ids))
    _LOG.info("fault %s: %s of %s %s", what, fault.what, fault.place, whose)


class CameraFaults:
    """Applies the active faults of the cameras to their images and times."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._on: tuple[Fault, ...] = ()
        self._old: list[Image | None] = [None for _ in EYE_NAMES]

    def set_active(self, faults: Iterable[Fault]) -> None:
        """Replace the active faults."""
        self._on = tuple(faults)

    @property
    def right_exposure_delay_s(self) -> float:
        """Extra delay of the right camera's exposures, s."""
        return sum(fault.value for fault in self._on if fault.what == "out-of-step")

    def send_delay_s(self, eye: int) -> float:
        """Extra delay at which an eye's images are sent, s."""
        return sum(fault.value for fault in self._of(eye, "late"))

    def has_ended(self, eye: int) -> bool:
        """True if an eye's stream is closed."""
        return bool(self._of(eye, "ended"))

    def apply_to_image(self, eye: int, new: Image) -> Image | None:
        """Apply the faults to an eye's new image; None if no image is sent."""
        old = self._old[eye]
        if old is not None and self._of(eye, "frozen"):
            new = old
        self._old[eye] = new = new.copy()  # the caller reuses the array for the next image
        if self._of(eye, "mirrored"):
            new = new[:, ::-1]
        if self._of(eye, "upside-down"):
            new = new[::-1, ::-1]
        if self._of(eye, "stalled") or self._falls(eye, "dropped"):
            return None
        if old is not None and self._falls(eye, "torn"):
            middle = len(new) // 2
            return np.concatenate([new[:middle], old[middle:]])
        return new

    def _of(self, eye: int, what: str) -> list[Fault]:
        eyes = (_BOTH_EYES, EYE_NAMES[eye])
        return [fault for fault in self._on if fault.what == what and fault.eye in eyes]

    def _falls(self, eye: int, what: str) -> bool:
        return any(self._rng.random() < fault.probability for fault in self._of(eye, what))
