"""A real head described in TOML: its servos, its cameras, and its target.

    head = "turrets"                # a preset, or a head file beside this one
    target = "tag:36h11:0:150"      # as `vergence detect` takes it

    [bus]
    port = "/dev/ttyUSB0"
    baud_rate = 1_000_000

    [[servos]]                      # one for every joint of the neck and actuator of the eyes
    name = "left_pan"
    id = 1
    zero_ticks = 2048               # servo position at the joint's zero angle
    sign = 1                        # -1 if the servo turns against the joint

    [cameras.left]
    source = "/dev/v4l/by-id/usb-...-video-index0"
    exposure_s = 0.008              # locked, if the camera is one of this machine

    [cameras.right]
    source = "http://192.168.1.20:8080/video"

    [[places]]                      # targets of `vergence evaluate` at measured points, if any
    target = "tag:36h11:5:120"
    point_mm = [150.0, -80.0, 900.0]

The control rate, the frame rate, the latency and the limits come from the head file.
"""

import dataclasses
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.entry_points import (
    EntryPoint,
    accepted_arguments,
    is_entry_point,
    user_error_with_place,
)
from vergence.envs.plants.conditions import (
    IMPERFECTIONS,
    Variation,
    is_valid_range,
    make_variation,
    valid_range_text,
)
from vergence.errors import (
    ConfigurationError,
    HeadFileError,
    MistakesError,
    UnreadableFileError,
    VergenceError,
    refuse_unknown,
)
from vergence.files import write_atomic
from vergence.hardware.dynamixel.servos import DynamixelServos
from vergence.hardware.safety.limits import SafetyConfig, parse_safety
from vergence.hardware.servos import ServoConfig, Servos, guard
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head, presets
from vergence.models.head_joints import RADIANS
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.models.toml_table import Rule, Table
from vergence.vision.objects.targets import GazeTarget, parse_gaze_target
from vergence.vision.targets import AprilTag, Target, parse_target

__all__ = [
    "BusConfig",
    "CameraConfig",
    "HardwareConfig",
    "ServoConfig",
    "actuator_slots",
    "load_hardware",
    "refuse_other_head",
]

KINDS: Final[dict[str, type[Servos]]] = {"dynamixel": DynamixelServos}
"""Kinds of buses by their name in `[bus]`; `module:class` is somebody's own."""


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """The bus of the servos."""

    kind: str = "dynamixel"
    """One of `KINDS`, or `module:class` of a `vergence.hardware.servos.Servos`."""
    port: str = ""
    """Device file of a serial line."""
    baud_rate: int = 1_000_000
    """Its baud rate, bit/s."""
    watchdog_s: float = 0.2
    """Watchdog time: without a packet for so long the servos stop by themselves, s."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """All other keys, for a bus of somebody's own."""
    servos_type: type[Servos] = DynamixelServos
    """The class of the bus."""

    def make(
        self, servos: Sequence[ServoConfig], head: HeadModel, clock: Callable[[], float]
    ) -> Servos:
        """Make the servos of a head, still closed."""
        if self.kind in KINDS:
            wire = {"port": self.port, "baud_rate": self.baud_rate, "watchdog_s": self.watchdog_s}
            return self.servos_type(servos, head, clock, **wire)
        try:
            return guard(self.servos_type(servos, head, clock, **self.options))
        except Exception as error:
            raise ConfigurationError(
                f"bus.kind {self.kind}: cannot be made: {user_error_with_place(error)}"
            ) from error


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """One eye's camera."""

    eye: int
    """0 for left, 1 for right."""
    source: str
    """Camera number, device file or URL, as for `vergence detect --live`."""
    pixel_format: str
    """Requested pixel format, four letters such as MJPG; empty for the camera's default."""
    latency_s: float
    """Latency from exposure to receipt, s."""
    exposure_s: float | None = None
    """Fixed exposure time of a camera of this machine, s; None leaves its setting."""

    @property
    def name(self) -> str:
        """Name of the camera in messages."""
        return f"cameras.{EYE_NAMES[self.eye]}"


@dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """Loop timing and motor response from `vergence measure-delay`; replaces that of the head file.

    The latency of the encoder feedback itself is not included: commands and images are dated by
    the encoder readings, and only time differences from these can be measured.
    """

    measured: str  # date of the measurement
    command_latency_s: float
    """Latency from a command to the motors' response in the encoder readings, s."""
    lag_s: float
    """Time constant of the motors' response, as a head's `timing.lag_s`, s; an actuator with its
    own lag keeps its ratio to this one."""
    speed_gain: float  # steady-state speed per commanded speed
    computing_s: float  # computing time: image to detection plus reading to command, s
    backlash_rad: float | None = None
    """Backlash (play) between encoders and cameras, rad; None, like the values below, if not
    measured."""
    jitter_s: float | None = None  # greatest delay of an image beyond its camera's latency, s
    acceleration_ratio: float | None = None
    """Greatest acceleration as a ratio to the head file's; None if it was not reached."""
    sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations by the names of the values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredTarget:
    """A target at a measured point."""

    target: Target  # target that the cameras detect there
    point: FloatArray  # (3,) centre of the target in the frame N, m


def actuator_slots(head: HeadModel) -> dict[str, int]:
    """Neck joints and eye actuators that need a servo: index into the 7-element command by name."""
    slots = {name: slot for slot, name in enumerate(head.joints[NECK]) if name}
    return slots | {name: NECK.stop + i for i, name in enumerate(head.actuation.names)}


_MILLISECONDS: Final = "(is it in milliseconds?)"
_WATCHDOG_PERIODS: Final = 3
"""Least watchdog time, control periods: one late period must not trip it (chosen)."""
_ID: Final[Rule] = (lambda x: 0 <= x <= 252, "a servo's id, 0 to 252")
_BAUD: Final[Rule] = (lambda x: 9600 <= x <= 10_500_000, "a baud rate, 9600 to 10500000")
_ZERO_TICKS: Final[Rule] = (lambda x: 0 <= x <= 4095, "ticks of the servo's position, 0 to 4095")
_ZERO_RAD: Final[Rule] = (lambda x: abs(x) <= 100.0, "the shaft's angle, rad (is it in degrees?)")
_SIGN: Final[Rule] = (lambda x: x in (1, -1), "1 or -1")
_GEAR: Final[Rule] = (
    lambda x: 0.01 <= x <= 100.0,
    "turns of the servo per turn of the joint, 0.01 to 100",
)
_WATCHDOG: Final[Rule] = (
    lambda x: 0.02 <= x <= 2.54,
    f"seconds in steps of the servos' 20 ms, 0.02 to 2.54 {_MILLISECONDS}",
)
_LATENCY: Final[Rule] = (lambda x: 0.0 <= x < 2.0, f"seconds, 0 to 2 {_MILLISECONDS}")
_EXPOSURE: Final[Rule] = (
    lambda x: 1e-4 <= x <= 0.5,
    f"seconds in steps of a camera's 100 us, 0.0001 to 0.5 {_MILLISECONDS}",
)
_PAIRING: Final[Rule] = (lambda x: 0.0 < x < 1.0, f"seconds, 0 to 1 {_MILLISECONDS}")
_PAIRING_FRAME_FRACTION: Final = 0.75
"""Greatest time between the exposures of a pair, as a fraction of the frame period: a half, so that
images of unsynchronised cameras always find a partner, and a quarter for jitter (chosen)."""
_COORDINATE_MM: Final[Rule] = (lambda x: abs(x) <= 100_000.0, "mm, up to 100 m")
_LEAST_TARGET_DISTANCE_MM: Final = 20.0
"""Least distance of a target from the origin of the neck frame, mm (chosen)."""
_NEAREST_TEXT: Final = "mm, at least 20 mm from the neck frame's origin (is it in metres?)"
_PORT: Final = "the device file of the serial line, such as /dev/ttyUSB0"
_FORMAT: Final = "four letters, such as MJPG"
_CAMERA_NUMBERS: Final = 256
"""Number of cameras that Linux can number on one machine (physical: a limit of Linux)."""
_SIGMA: Final[Rule] = (lambda x: 0.0 <= x < 1e4, "a standard deviation, 0 or more")
_TARGET: Final = "a target, such as tag:36h11:5:120"
_SOURCE: Final = "a camera's number, its device file or a URL"
_ADDRESS: Final = "HOST:PORT of an emulated head"
_LOOP_VALUES: Final = ("command_latency_s", "lag_s", "speed_gain", "computing_s")
_LOOP_OPTIONAL: Final = ("backlash_rad", "jitter_s", "acceleration_ratio")
_DIGITS: Final = 4
"""Significant digits of the measured values in the file (chosen)."""


def _numbers(table: Table, rules: Mapping[str, Rule]) -> dict[str, float]:
    """Values of those keys that are there."""
    return {name: table.number(name, rule) for name, rule in rules.items() if table.has(name)}


@contextmanager
def _collect(mistakes: list[VergenceError]) -> Iterator[None]:
    """Add an error to the mistakes of a file, in their order; it ends the `with` block alone."""
    try:
        yield
    except VergenceError as error:
        mistakes.append(error)


def _read_bus(table: Table, head: HeadModel | None, path: str) -> BusConfig:
    kind = "dynamixel"
    if table.has("kind"):
        expected = f"{', '.join(KINDS)}, or module:class of your own bus"
        kind = table.text("kind", expected)
        table.expect(is_entry_point(kind) or kind in KINDS, "kind", kind, expected)
    if kind not in KINDS:
        return _own_bus(table, kind, path)
    port = table.text("port", _PORT)
    table.expect(port.isprintable(), "port", port, _PORT)
    rate = table.integer("baud_rate", _BAUD) if table.has("baud_rate") else BusConfig.baud_rate
    watchdog_s = BusConfig.watchdog_s
    if table.has("watchdog_s"):
        watchdog_s = table.number("watchdog_s", _WATCHDOG)
        least_s = 0.0 if head is None else _WATCHDOG_PERIODS * head.timing.period_s
        named = "" if head is None else f" of {head.name}"
        asked = f"at least {_WATCHDOG_PERIODS} control periods{named}, {least_s:.3g} s"
        table.expect(watchdog_s >= least_s, "watchdog_s", watchdog_s, asked)
    table.close()
    return BusConfig(kind=kind, port=port, baud_rate=rate, watchdog_s=watchdog_s)


def _own_bus(table: Table, kind: str, path: str) -> BusConfig:
    entry = EntryPoint.of(kind, "bus.kind")
    folder = Path(path).parent.absolute()
    beside = (entry.module, f"{entry.module.replace('.', '/')}.py")
    if any((folder / one).is_file() for one in beside):  # as a head file may be
        entry = replace(entry, folder=folder)
    found = entry.load()
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing or not (isinstance(found, type) and issubclass(found, Servos)):
        got = f"one without {', '.join(missing)}" if missing else f"{found!r:.80}"
        raise ConfigurationError(
            f"bus.kind {kind}: expected a class that derives from vergence.hardware.servos.Servos "
            f"and has all of its methods, got {got}"
        )
    unit_rad: Any = found.unit_rad
    if not (isinstance(unit_rad, int | float) and unit_rad > 0.0):
        raise ConfigurationError(
            f"bus.kind {kind}: expected unit_rad above 0, got {unit_rad!r:.40}"
        )
    options = {name: table.take(name, "") for name in table.names()}
    known = accepted_arguments(found)
    if known is not None:
        own = sorted(known - {"servos", "head", "clock"})
        refuse_unknown("bus", options, own or ["(none)"])
    return BusConfig(kind=kind, options=options, servos_type=found)


def _read_servos(
    tables: Sequence[Table],
    head: HeadModel | None,
    unit_rad: float | None,
    mistakes: list[VergenceError],
) -> tuple[ServoConfig, ...]:
    """Read the servos, in the order of their slots; those with mistakes are left out."""
    slots = {} if head is None else actuator_slots(head)
    servos: list[ServoConfig] = []
    names: list[str] = []
    ids: dict[int, str] = {}
    for table in tables:
        with _collect(mistakes):
            if head is None:
                name = table.text("name", "the name of a joint or actuator of the head")
            else:
                name = table.choice("name", list(slots))
            table.expect(name not in names, "name", name, "each joint once")
            names.append(name)
            ident = table.integer("id", _ID)
            table.expect(ident not in ids, "id", ident, f"another id than that of {ids.get(ident)}")
            ids[ident] = name
            servos.append(_servo(table, name, ident, slots.get(name, 0), head, unit_rad))
    # the mistakes of unreadable tables are reported already
    if head is not None and set(names) < set(slots) and len(slots) > len(tables):
        asked = f"a servo for each of {', '.join(slots)} of {head.name}"
        mistakes.append(HeadFileError("servos", names, asked))
    return tuple(sorted(servos, key=lambda servo: servo.slot))


def _servo(
    table: Table, name: str, ident: int, slot: int, head: HeadModel | None, unit_rad: float | None
) -> ServoConfig:
    zero = 0.0
    if unit_rad is None:  # a bus with a mistake
        unit_rad = 1.0
        for key in {"zero_ticks", "zero_rad"} & set(table.names()):
            table.take(key, "")
    elif unit_rad != 1.0:
        zero = table.integer("zero_ticks", _ZERO_TICKS)
    elif table.has("zero_rad"):
        zero = table.number("zero_rad", _ZERO_RAD)
    sign = table.integer("sign", _SIGN)
    gear_ratio = table.number("gear_ratio", _GEAR) if table.has("gear_ratio") else 1.0
    lower, upper = -np.pi, np.pi
    if head is not None:
        lower, upper = float(head.actuation.lower[slot]), float(head.actuation.upper[slot])
    limits = {"lower_rad": lower, "upper_rad": upper}
    for key, value in _numbers(table, dict.fromkeys(limits, RADIANS)).items():
        asked = f"an angle within the head's limits, {lower:g} to {upper:g} rad"
        table.expect(head is None or lower <= value <= upper, key, value, asked)
        limits[key] = value
    lower, upper = limits.values()
    table.expect(lower < upper, "upper_rad", upper, f"more than {lower:g} rad")
    turns = gear_ratio * (upper - lower) / (2.0 * np.pi)
    asked = (
        "a range of at most one turn of the servo, which knows its angle within a turn alone "
        f"when it is switched on (this one makes {turns:.2f})"
    )
    table.expect(head is None or turns <= 1.0, "gear_ratio", gear_ratio, asked)
    table.close()
    return ServoConfig(
        name=name,
        slot=slot,
        id=ident,
        zero=zero,
        sign=sign,
        gear_ratio=gear_ratio,
        unit_rad=unit_rad,
        **limits,
    )


def _read_camera(table: Table, eye: int, head: HeadModel | None) -> CameraConfig:
    """Read the table of one eye's camera."""
    source = table.take("source", _SOURCE)
    table.expect(_is_source(source), "source", source, _SOURCE)
    pixel_format = table.text("pixel_format", _FORMAT) if table.has("pixel_format") else ""
    fits = re.fullmatch(r"([ -~]{4})?", pixel_format)
    table.expect(fits, "pixel_format", pixel_format, _FORMAT)
    values = {"latency_s": 0.0 if head is None else head.timing.latency_s}
    values |= _numbers(table, {"latency_s": _LATENCY, "exposure_s": _EXPOSURE})
    if head is not None:
        exposure_s, frame_s = values.get("exposure_s", 0.0), head.timing.frame_s
        asked = f"at most the time between two frames of {head.name}, {frame_s:.3g} s"
        table.expect(exposure_s <= frame_s, "exposure_s", exposure_s, asked)
    table.close()
    return CameraConfig(eye=eye, source=str(source), pixel_format=pixel_format, **values)


def _is_source(value: object) -> bool:
    """True if a value is the number of a camera, or text that may name one."""
    if type(value) is int or (isinstance(value, str) and value.isdecimal()):
        return len(str(value)) <= 3 and 0 <= int(value) < _CAMERA_NUMBERS
    return isinstance(value, str) and bool(value.strip()) and value.isprintable()


def _read_loop(table: Table) -> LoopConfig:
    """Read the `loop` table: the measured loop."""
    values = {name: table.number(name, _loop_rule(name)) for name in _LOOP_VALUES}
    values |= _numbers(table, {name: _loop_rule(name) for name in _LOOP_OPTIONAL})
    measured = table.text("measured", "the day of the measurement")
    sigma = {}
    if table.has("sigma"):
        part = table.table("sigma")
        names = (*_LOOP_VALUES, *_LOOP_OPTIONAL, "latency_s")
        sigma = _numbers(part, dict.fromkeys(names, _SIGMA))
        part.close()
    table.close()
    return LoopConfig(measured=measured, sigma=sigma, **values)


def _loop_rule(name: str) -> Rule:
    """Rule of a measured value: the range of the simulated one, see `imperfections`."""
    if name not in IMPERFECTIONS:  # a time that simulation does not have
        return _LATENCY
    return (lambda x: is_valid_range(name, x, x), valid_range_text(name))


def _read_places(tables: Sequence[Table], mistakes: list[VergenceError]) -> dict[str, Any]:
    """Read the targets at measured points; those with mistakes are left out."""
    targets: list[MeasuredTarget] = []
    key_of_target: dict[str, str] = {}
    for table in tables:
        with _collect(mistakes):
            text = table.text("target", _TARGET)
            try:
                target = parse_target(text)
            except ConfigurationError as error:
                asked = f"{_TARGET} ({error})"
                raise HeadFileError(table.key("target"), text, asked) from error
            # the size of a tag does not distinguish it from others
            seen = str((target.family, target.id) if isinstance(target, AprilTag) else target)
            asked = f"another target than {key_of_target.get(seen)}"
            table.expect(seen not in key_of_target, "target", text, asked)
            key_of_target[seen] = table.key("target")
            point = table.numbers("point_mm", (3,), _COORDINATE_MM)
            far = np.linalg.norm(point) >= _LEAST_TARGET_DISTANCE_MM
            table.expect(far, "point_mm", point.tolist(), _NEAREST_TEXT)
            table.close()
            targets.append(MeasuredTarget(target=target, point=point / 1000.0))
    if len(tables) == 1:
        asked = "two or more, between which the eyes turn"
        mistakes.append(HeadFileError("places", 1, asked))
    return {"measured_targets": tuple(targets)}


def _safety(table: Table, head: HeadModel | None) -> dict[str, Any]:
    # its forbidden postures name joints of the head
    return {} if head is None else {"safety": parse_safety(table, actuator_slots(head))}


def _read_emulator(table: Table) -> dict[str, Any]:
    address = table.text("address", _ADDRESS)
    host_port = re.fullmatch(r"[^:\s]+:([0-9]{1,5})", address)
    fits = host_port is not None and 1 <= int(host_port[1]) <= 65535
    table.expect(fits, "address", address, _ADDRESS)
    places_targets = not table.has("places_targets") or table.boolean("places_targets")
    table.close()
    return {"emulator_address": address, "places_targets": places_targets}


@dataclass(frozen=True, kw_only=True, eq=False)
class HardwareConfig:
    """A real head: the model that controllers use, and its hardware."""

    path: str
    """Path of the configuration file."""
    head: HeadModel
    """Model of the head."""
    target: GazeTarget
    """Target that the cameras detect."""
    bus: BusConfig
    """The serial line."""
    servos: tuple[ServoConfig, ...]
    """Servos in the order of the slots of a command."""
    cameras: tuple[CameraConfig, CameraConfig]
    """Left and right camera."""
    pairing_tolerance_s: float
    """Greatest time between the exposures of two images of a pair, s."""
    emulator_address: str = ""
    """HOST:PORT of the emulated head behind this hardware; empty for a robot."""
    places_targets: bool = False
    """True if trials place their targets: for an emulated head, unless its board is fixed. Before a
    robot targets stand in the real world."""
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    """Safety bounds in addition to the limits of the head file."""
    loop: LoopConfig | None = None
    """Measured latencies and responses of the loop; None for the values of the head file."""
    measured_targets: tuple[MeasuredTarget, ...] = ()
    """Further targets at measured points, between which trials switch."""
    text: str = ""
    """Content of the file."""

    @property
    def slots(self) -> dict[str, int]:
        """Indices into the 7-element command by name, for joints and actuators with a servo."""
        return {servo.name: servo.slot for servo in self.servos}

    def make_servos(self, clock: Callable[[], float]) -> Servos:
        """Make the servos, still closed; see `BusConfig.make`."""
        return self.bus.make(self.servos, self.head, clock)


def load_hardware(source: str | os.PathLike[str]) -> HardwareConfig:
    """Read the hardware of a real head from a TOML file, see the module's description.

    Args:
        source: the path of the file.

    Raises:
        UnreadableFileError: the file is missing, or is no TOML.
        HeadFileError: a key of it is missing, unknown or impossible; the message names the file,
            the key, the value and what was expected. Several mistakes are raised as one
            `MistakesError`.
        ConfigurationError: the target is not a valid one, and nothing else is wrong.
    """
    if not isinstance(source, str | os.PathLike):
        raise ConfigurationError(f"config: expected the path of a TOML file, got {source!r:.80}")
    path = os.fspath(source)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not text in UTF-8"
        raise UnreadableFileError(
            path, reason, "the TOML file of a robot's configuration"
        ) from error
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # nested too deeply, or a number too long
        raise UnreadableFileError(path, f"no TOML ({error})", "a TOML file") from error
    return replace(_parse(Table(document, ""), path), text=text)


def refuse_other_head(config: HardwareConfig, head: HeadModel) -> None:
    """Raise a `ConfigurationError` if a head is not that of the hardware configuration."""
    if head.digest != config.head.digest:
        raise ConfigurationError(
            f"head: expected the head of {config.path}, {config.head.name} with the digest "
            f"{config.head.digest[:12]}, got {head.name} with {head.digest[:12]}"
        )


def _parse(table: Table, path: str) -> HardwareConfig:
    mistakes: list[VergenceError] = []
    head: HeadModel | None = None
    with _collect(mistakes):
        head = _head(table, path)
    with _collect(mistakes):
        if table.has("head_digest"):
            expected = "the digest of the head, which `vergence info --head` tells"
            asked = table.text("head_digest", expected)
            if head is not None:
                fits = len(asked) >= 8 and head.digest.startswith(asked.lower())
                expected = f"that of {head.name}, {head.digest[:16]}"
                table.expect(fits, "head_digest", asked, expected)
    with _collect(mistakes):
        target = _target(table, path)
    named = table.peek("bus")
    own = isinstance(named, Mapping) and named.get("kind", "dynamixel") not in KINDS
    unit_rad = None if own else DynamixelServos.unit_rad  # while the bus is not known
    with _collect(mistakes):
        bus = _read_bus(table.table("bus"), head, path)
        unit_rad = bus.servos_type.unit_rad
    with _collect(mistakes):
        servos = _read_servos(table.tables("servos"), head, unit_rad, mistakes)
    with _collect(mistakes):
        cameras, tolerance_s = _cameras(table.table("cameras"), head, mistakes)
    more: dict[str, Any] = {}
    readers: dict[str, Callable[[], dict[str, Any]]] = {
        "emulator": lambda: _read_emulator(table.table("emulator")),
        "safety": lambda: _safety(table.table("safety"), head),
        "loop": lambda: {"loop": _read_loop(table.table("loop"))},
        "places": lambda: _read_places(table.tables("places"), mistakes),
    }
    for name, read in readers.items():
        with _collect(mistakes):
            if table.has(name):
                more |= read()
    with _collect(mistakes):
        table.close()
    if mistakes or head is None:
        found = [
            HeadFileError(one.key, one.value, one.expected, path)
            if isinstance(one, HeadFileError) and not one.file
            else one
            for one in mistakes
        ]
        raise found[0] if len(found) == 1 else MistakesError(path, found)
    left, right = cameras
    return HardwareConfig(
        path=path,
        head=head,
        target=target,
        bus=bus,
        servos=servos,
        cameras=(left, right),
        pairing_tolerance_s=tolerance_s,
        **more,
    )


def _cameras(
    table: Table, head: HeadModel | None, mistakes: list[VergenceError]
) -> tuple[list[CameraConfig], float]:
    """Read the cameras, left one first, and the pairing tolerance, s; mistakes are left out."""
    tolerance_s = 0.0 if head is None else _PAIRING_FRAME_FRACTION * head.timing.frame_s
    with _collect(mistakes):
        found = _numbers(table, {"pairing_tolerance_s": _PAIRING})
        tolerance_s = found.get("pairing_tolerance_s", tolerance_s)
    cameras = []
    for eye, name in enumerate(EYE_NAMES):
        with _collect(mistakes):
            cameras.append(_read_camera(table.table(name), eye, head))
    table.close()
    if len({camera.source for camera in cameras}) < len(cameras):
        raise HeadFileError(
            "cameras.right.source", cameras[1].source, "another camera than the left one"
        )
    return cameras, tolerance_s


def _head(table: Table, path: str) -> HeadModel:
    expected = f"one of {', '.join(presets())}, or the path of a head file"
    name = table.text("head", expected)
    if name in presets():
        return load_head(name)
    place = Path(path).parent.absolute() / name
    table.expect(name.isprintable(), "head", name, expected)
    # reading a pipe or some devices never ends
    fits = not os.path.exists(place) or os.path.isfile(place)
    table.expect(fits, "head", name, f"{expected} ({place!s:.200}: no regular file)")
    try:
        return load_head(place)
    except UnreadableFileError as error:
        asked = f"{expected} ({error.path:.200}: {error.reason})"
        raise HeadFileError("head", name, asked) from error


def _target(table: Table, path: str) -> GazeTarget:
    if not table.has("target"):
        return parse_gaze_target("tag:36h11:0")
    text = table.text("target", "a target, such as tag:36h11:0:150")
    try:
        return parse_gaze_target(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def write_servos(path: str | os.PathLike[str], servos: Iterable[ServoConfig]) -> None:
    """Write signs and zeros of some servos, by name, into their file; all else in it stays."""

    def change(document: Any) -> None:
        tables = {table["name"]: table for table in document["servos"]}
        for servo in servos:
            table = tables[servo.name]
            for key, value in (("sign", servo.sign), (servo.zero_key, servo.zero)):
                if table.get(key, 0.0) != value:  # correct values keep their spelling
                    table[key] = value

    _edit(path, change, "a TOML file with these servos")


def write_loop(
    path: str | os.PathLike[str], loop: LoopConfig, latencies_s: Mapping[str, float]
) -> None:
    """Write the measured loop, and the cameras' latencies, s, by `left` and `right`."""

    def change(document: Any) -> None:
        import tomlkit

        for name, latency_s in latencies_s.items():
            document["cameras"][name]["latency_s"] = _rounded(latency_s)
        values = {
            name: _rounded(value) if isinstance(value, float) else value
            for name, value in dataclasses.asdict(loop).items()
            if value is not None and name != "sigma"
        }
        table = tomlkit.table()
        table.update(values)
        table["sigma"] = {name: _rounded(value) for name, value in loop.sigma.items()}
        document["loop"] = table

    _edit(path, change, "a TOML file with both cameras")


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _edit(path: str | os.PathLike[str], change: Callable[[Any], None], expected: str) -> None:
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    place = Path(path).resolve()  # a symbolic link stays one
    content = place.read_bytes()
    try:
        document = tomlkit.parse(content.decode("utf-8-sig"))
        change(document)
    except (TOMLKitError, KeyError, TypeError, ValueError) as error:
        raise UnreadableFileError(str(path), f"changed meanwhile ({error})", expected) from error
    mark = b"\xef\xbb\xbf" if content.startswith(b"\xef\xbb\xbf") else b""
    write_atomic(place, mark + tomlkit.dumps(document).encode())


def loop_variation(config: HardwareConfig) -> Variation:
    """Make the variation of simulated trials whose loop is that of a robot.

    It has the mean latency of the cameras, a random phase of exposure, and all measured values of
    the loop; the other values are those of the head.
    """
    latency_s, loop = float(np.mean([camera.latency_s for camera in config.cameras])), config.loop
    values: dict[str, float | None] = {"latency_s": latency_s}
    if loop is not None:
        measured = [one for one in (*_LOOP_VALUES, *_LOOP_OPTIONAL) if one in IMPERFECTIONS]
        values = {name: getattr(loop, name) for name in measured}
        # in simulation detection and computing a command take no time
        values["latency_s"] = latency_s + loop.computing_s
        # the encoder readings date everything else, so they have no latency themselves
        values["feedback_latency_s"] = 0.0
    ranges = {name: (value, value) for name, value in values.items() if value is not None}
    found = make_variation({"frame_phase": (0.0, 1.0), **ranges})
    assert found is not None
    return found
