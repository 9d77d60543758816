"""Readers of the tables of a robot's configuration file, and the rules of their keys.

All readers collect their mistakes, so that one reading of the file reports the mistakes of all
tables. If the head itself is wrong, the checks that depend on it are left out.
"""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from vergence.envs.plants.conditions import IMPERFECTIONS, is_valid_range, valid_range_text
from vergence.errors import ConfigurationError, HeadFileError, VergenceError
from vergence.hardware.config_parts import (
    BusConfig,
    CameraConfig,
    LoopConfig,
    MeasuredTarget,
    ServoConfig,
    actuator_slots,
)
from vergence.hardware.dynamixel.control_table import TICKS_PER_TURN, WATCHDOG_MOST, WATCHDOG_S
from vergence.models.head import HeadModel
from vergence.models.head_joints import RADIANS
from vergence.models.toml_table import Rule, Table
from vergence.vision.targets import AprilTag, parse_target

_WATCHDOG_PERIODS: Final = 3
"""Least watchdog time, control periods: one late period must not trip it (chosen)."""
_ID: Final[Rule] = (lambda x: 0 <= x <= 252, "a servo's id, 0 to 252")
_BAUD: Final[Rule] = (lambda x: 9600 <= x <= 10_500_000, "a baud rate, 9600 to 10500000")
_ZERO: Final[Rule] = (lambda x: 0 <= x < TICKS_PER_TURN, "ticks of the servo's position, 0 to 4095")
_SIGN: Final[Rule] = (lambda x: x in (1, -1), "1 or -1")
_GEAR: Final[Rule] = (
    lambda x: 0.01 <= x <= 100.0,
    "turns of the servo per turn of the joint, 0.01 to 100",
)
_WATCHDOG: Final[Rule] = (
    lambda x: WATCHDOG_S <= x <= WATCHDOG_MOST * WATCHDOG_S,
    "seconds in steps of the servos' 20 ms, 0.02 to 2.54 (is it in milliseconds?)",
)
_LATENCY: Final[Rule] = (lambda x: 0.0 <= x < 2.0, "seconds, 0 to 2 (is it in milliseconds?)")
_EXPOSURE: Final[Rule] = (
    lambda x: 1e-4 <= x <= 0.5,
    "seconds in steps of a camera's 100 us, 0.0001 to 0.5 (is it in milliseconds?)",
)
_COORDINATE_MM: Final[Rule] = (lambda x: abs(x) <= 100_000.0, "mm, up to 100 m")
_LEAST_TARGET_DISTANCE_MM: Final = 20.0
"""Least distance of a target from the origin of the neck frame, mm (chosen)."""
_NEAREST_TEXT: Final = "mm, at least 20 mm from the neck frame's origin (is it in metres?)"
_PORT: Final = "the device file of the serial line, such as /dev/ttyUSB0"
_CAMERA_NUMBERS: Final = 256
"""Number of cameras that Linux can number on one machine (physical: a limit of Linux)."""
_SIGMA: Final[Rule] = (lambda x: 0.0 <= x < 1e4, "a standard deviation, 0 or more")
_TARGET: Final = "a target, such as tag:36h11:5:120"
_SOURCE: Final = "a camera's number, its device file or a URL"
_ADDRESS: Final = "HOST:PORT of an emulated head"


class MistakeCollector:
    """Collects the mistakes of one file: an error ends its `with` block alone.

    Attributes:
        found: the errors, in the order in which they occurred.
    """

    def __init__(self) -> None:
        self.found: list[VergenceError] = []

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> bool:
        if not isinstance(error, VergenceError):
            return False
        self.found.append(error)
        return True


def read_bus(table: Table, head: HeadModel | None) -> BusConfig:
    """Read the `bus` table: the serial line.

    Raises:
        HeadFileError: a key is missing, unknown or impossible; the other readers raise it too.
    """
    port = table.text("port", _PORT)
    if not port.isprintable():
        raise HeadFileError(table.key("port"), port, _PORT)
    baud_rate, watchdog_s = BusConfig.baud_rate, BusConfig.watchdog_s
    if table.has("baud_rate"):
        baud_rate = table.integer("baud_rate", _BAUD)
    if table.has("watchdog_s"):
        watchdog_s = table.number("watchdog_s", _WATCHDOG)
        least_s = 0.0 if head is None else _WATCHDOG_PERIODS * head.timing.period_s
        if head is not None and watchdog_s < least_s:
            raise HeadFileError(
                table.key("watchdog_s"),
                watchdog_s,
                f"at least {_WATCHDOG_PERIODS} control periods of {head.name}, {least_s:.3g} s",
            )
    table.close()
    return BusConfig(port=port, baud_rate=baud_rate, watchdog_s=watchdog_s)


def read_servos(
    tables: Sequence[Table], head: HeadModel | None, mistakes: MistakeCollector
) -> tuple[ServoConfig, ...]:
    """Read the servos, in the order of their slots; those with mistakes are left out."""
    slots = None if head is None else actuator_slots(head)
    servos: list[ServoConfig] = []
    names: list[str] = []
    ids: dict[int, str] = {}
    for table in tables:
        with mistakes:
            name = (
                table.text("name", "the name of a joint or actuator of the head")
                if slots is None
                else table.choice("name", list(slots))
            )
            if name in names:
                raise HeadFileError(table.key("name"), name, "each joint once")
            names.append(name)
            ident = table.integer("id", _ID)
            if ident in ids:
                raise HeadFileError(table.key("id"), ident, f"another id than that of {ids[ident]}")
            ids[ident] = name
            servo = _servo(table, name, ident, 0 if slots is None else slots[name], head)
            servos.append(servo)
    if head is not None and slots is not None and set(names) < set(slots):
        unreadable = len(tables) - len(names)  # their own mistakes are reported already
        if len(slots) - len(names) > unreadable:
            mistakes.found.append(
                HeadFileError(
                    "servos", names, f"a servo for each of {', '.join(slots)} of {head.name}"
                )
            )
    return tuple(sorted(servos, key=lambda servo: servo.slot))


def _servo(table: Table, name: str, ident: int, slot: int, head: HeadModel | None) -> ServoConfig:
    zero_ticks = table.integer("zero_ticks", _ZERO)
    sign = table.integer("sign", _SIGN)
    gear_ratio = table.number("gear_ratio", _GEAR) if table.has("gear_ratio") else 1.0
    lower, upper = (-np.pi, np.pi) if head is None else _range_of(head, slot)
    limits = {"lower_rad": lower, "upper_rad": upper}
    for key in limits:
        if not table.has(key):
            continue
        limits[key] = table.number(key, RADIANS)
        if head is not None and not lower <= limits[key] <= upper:
            raise HeadFileError(
                table.key(key),
                limits[key],
                f"an angle within the head's limits, {lower:g} to {upper:g} rad",
            )
    if not limits["lower_rad"] < limits["upper_rad"]:
        raise HeadFileError(
            table.key("upper_rad"), limits["upper_rad"], f"more than {limits['lower_rad']:g} rad"
        )
    turns = gear_ratio * (limits["upper_rad"] - limits["lower_rad"]) / (2.0 * np.pi)
    if head is not None and turns > 1.0:
        raise HeadFileError(
            table.key("gear_ratio"),
            gear_ratio,
            "a range of at most one turn of the servo, which knows its angle within a turn alone "
            f"when it is switched on (this one makes {turns:.2f})",
        )
    table.close()
    return ServoConfig(
        name=name,
        slot=slot,
        id=ident,
        zero_ticks=zero_ticks,
        sign=sign,
        gear_ratio=gear_ratio,
        **limits,
    )


def _range_of(head: HeadModel, slot: int) -> tuple[float, float]:
    return float(head.actuation.lower[slot]), float(head.actuation.upper[slot])


def read_camera(table: Table, eye: int, head: HeadModel | None) -> CameraConfig:
    """Read the table of one eye's camera."""
    source = table.take("source", _SOURCE)
    if not _is_source(source):
        raise HeadFileError(table.key("source"), source, _SOURCE)
    pixel_format, exposure_s = "", None
    latency_s = 0.0 if head is None else head.timing.latency_s
    if table.has("pixel_format"):
        pixel_format = table.text("pixel_format", "four letters, such as MJPG")
        if re.fullmatch(r"[ -~]{4}", pixel_format) is None:
            raise HeadFileError(
                table.key("pixel_format"), pixel_format, "four letters, such as MJPG"
            )
    if table.has("latency_s"):
        latency_s = table.number("latency_s", _LATENCY)
    if table.has("exposure_s"):
        exposure_s = table.number("exposure_s", _EXPOSURE)
        if head is not None and exposure_s > head.timing.frame_s:
            raise HeadFileError(
                table.key("exposure_s"),
                exposure_s,
                f"at most the time between two frames of {head.name}, {head.timing.frame_s:.3g} s",
            )
    table.close()
    return CameraConfig(
        eye=eye,
        source=str(source),
        pixel_format=pixel_format,
        latency_s=latency_s,
        exposure_s=exposure_s,
    )


def _is_source(value: object) -> bool:
    """True if a value is the number of a camera, or text that may name one."""
    if isinstance(value, str) and not value.isdecimal():
        return bool(value.strip()) and value.isprintable()
    if isinstance(value, str) and len(value) > len(str(_CAMERA_NUMBERS)):
        return False
    return (
        isinstance(value, int | str)
        and not isinstance(value, bool)
        and (0 <= int(value) < _CAMERA_NUMBERS)
    )


_LOOP_VALUES: Final = (
    "command_latency_s",
    "lag_s",
    "speed_gain",
    "computing_s",
)
_LOOP_OPTIONAL: Final = ("backlash_rad", "jitter_s", "acceleration_ratio")


def read_loop(table: Table) -> LoopConfig:
    """Read the `loop` table: the measured loop."""
    values = {name: table.number(name, _loop_rule(name)) for name in _LOOP_VALUES}
    for name in _LOOP_OPTIONAL:
        if table.has(name):
            values[name] = table.number(name, _loop_rule(name))
    measured = table.text("measured", "the day of the measurement")
    sigma = {}
    if table.has("sigma"):
        part = table.table("sigma")
        names = (*_LOOP_VALUES, *_LOOP_OPTIONAL, "latency_s")
        sigma = {name: part.number(name, _SIGMA) for name in names if part.has(name)}
        part.close()
    table.close()
    return LoopConfig(measured=measured, sigma=sigma, **values)


def _loop_rule(name: str) -> Rule:
    """Rule of a measured value: the range of the simulated one, see `imperfections`."""
    if name not in IMPERFECTIONS:  # a time that simulation does not have
        return _LATENCY
    return (lambda x: is_valid_range(name, x, x), valid_range_text(name))


def read_measured_targets(
    tables: Sequence[Table], mistakes: MistakeCollector
) -> tuple[MeasuredTarget, ...]:
    """Read the targets at measured points; those with mistakes are left out."""
    targets: list[MeasuredTarget] = []
    key_of_target: dict[str, str] = {}
    for table in tables:
        with mistakes:
            text = table.text("target", _TARGET)
            try:
                target = parse_target(text)
            except ConfigurationError as error:
                asked = f"{_TARGET} ({error})"
                raise HeadFileError(table.key("target"), text, asked) from error
            # the size of a tag does not distinguish it from others
            seen = str((target.family, target.id) if isinstance(target, AprilTag) else target)
            if seen in key_of_target:
                raise HeadFileError(
                    table.key("target"), text, f"another target than {key_of_target[seen]}"
                )
            key_of_target[seen] = table.key("target")
            point = table.numbers("point_mm", (3,), _COORDINATE_MM)
            if np.linalg.norm(point) < _LEAST_TARGET_DISTANCE_MM:
                raise HeadFileError(table.key("point_mm"), point.tolist(), _NEAREST_TEXT)
            table.close()
            targets.append(MeasuredTarget(target=target, point=point / 1000.0))
    if len(tables) == 1:
        mistakes.found.append(
            HeadFileError("places", 1, "two or more, between which the eyes turn")
        )
    return tuple(targets)


def read_emulator(table: Table) -> tuple[str, bool]:
    """Read HOST:PORT of the emulated head, and the flag `places_targets`."""
    address = table.text("address", _ADDRESS)
    host_port = re.fullmatch(r"[^:\s]+:([0-9]{1,5})", address)
    if host_port is None or not 1 <= int(host_port[1]) <= 65535:
        raise HeadFileError(table.key("address"), address, _ADDRESS)
    places_targets = not table.has("places_targets") or table.boolean("places_targets")
    table.close()
    return address, places_targets
