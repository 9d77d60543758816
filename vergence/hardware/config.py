"""A real head described in TOML: its servos, its cameras, and what it looks at.

    head = "turrets"                # a preset, or a head file beside this one
    target = "tag:36h11:0:150"      # as `vergence detect` takes it

    [bus]
    port = "/dev/ttyUSB0"
    baud_rate = 1_000_000

    [[servos]]                      # one for every joint of the neck and actuator of the eyes
    name = "left_pan"
    id = 1
    zero_ticks = 2048               # present position where the joint's angle is zero
    sign = 1                        # -1 where the servo turns against the joint

    [cameras.left]
    source = "/dev/v4l/by-id/usb-...-video-index0"

    [cameras.right]
    source = "http://192.168.1.20:8080/video"

The rates of control and of the frames, the latency and the limits are those of the head file.
"""

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError, UnreadableFileError
from vergence.hardware.dynamixel.control_table import TICKS_PER_TURN, WATCHDOG_MOST, WATCHDOG_S
from vergence.models.board_text import parse_target
from vergence.models.boards import Target
from vergence.models.files.head_file import load_head, presets
from vergence.models.files.head_rules import RADIANS
from vergence.models.files.toml_table import Rule, Table
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, NECK

_PAIRING: Final = 0.75
"""Greatest distance of the exposures of a pair by the time between two frames: half of it, so that
cameras that nothing synchronises always find a partner, and a quarter for jitter."""
_WATCHDOG_S: Final = 0.2
_WATCHDOG_PERIODS: Final = 3
"""Least watchdog: one late period is no reason to stop."""
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
_TOLERANCE: Final[Rule] = (lambda x: 0.0 < x < 1.0, "seconds, 0 to 1 (is it in milliseconds?)")
_LATENCY: Final[Rule] = (lambda x: 0.0 <= x < 2.0, "seconds, 0 to 2 (is it in milliseconds?)")


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """The serial line of the servos."""

    port: str
    """Its device file."""
    baud_rate: int = 1_000_000
    """Bits per second."""
    watchdog_s: float = _WATCHDOG_S
    """Time without a packet after which the servos stop by themselves, s."""


@dataclass(frozen=True, kw_only=True)
class ServoConfig:
    """One servo: the joint of the neck or actuator of the eyes that it moves, and how."""

    name: str
    """Of the neck's joint or the eyes' actuator."""
    slot: int
    """Its place in a command of seven, see `vergence.envs.plant.Plant.step`."""
    id: int
    """On the bus."""
    zero_ticks: int
    """Present position where the angle is zero, ticks."""
    sign: int
    """-1 where the servo turns against the angle."""
    gear_ratio: float
    """Turns of the servo per turn of the joint."""
    lower_rad: float
    """Least angle, rad."""
    upper_rad: float
    """Greatest angle, rad."""

    @property
    def ticks_per_rad(self) -> float:
        """Signed ticks of the servo's position per radian of the joint."""
        return self.sign * self.gear_ratio * TICKS_PER_TURN / (2.0 * np.pi)


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """One eye's camera."""

    eye: int
    """0 for left, 1 for right."""
    source: str
    """Number, device file or URL, as `vergence live` takes it."""
    pixel_format: str
    """Four letters of the pixel format that is asked for, such as MJPG; empty for the camera's."""
    latency_s: float
    """From exposure to receipt, s."""

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"cameras.{EYE_NAMES[self.eye]}"


@dataclass(frozen=True, kw_only=True, eq=False)
class HardwareConfig:
    """A real head: the model that controllers know, and the hardware that it stands for."""

    path: str
    """The file that says so."""
    head: HeadModel
    """The model."""
    target: Target
    """What the cameras look for."""
    bus: BusConfig
    """The serial line."""
    servos: tuple[ServoConfig, ...]
    """In the order of a command's slots."""
    cameras: tuple[CameraConfig, CameraConfig]
    """Left and right."""
    pairing_tolerance_s: float
    """Greatest time between the exposures of two images that are taken for one pair, s."""
    emulator: str
    """HOST:PORT of the emulated head behind all this, which places targets; empty for a robot."""


def load_hardware(source: str | os.PathLike[str]) -> HardwareConfig:
    """Read what a real head is made of from a TOML file, see the module's description.

    Args:
        source: the path of the file.

    Raises:
        HeadFileError: the file is missing, or a key of it is missing, unknown or impossible; the
            message names the file, the key, the value and what was expected.
        ConfigurationError: the target is none; the message says the same.
    """
    if not isinstance(source, str | os.PathLike):
        raise ConfigurationError(f"config: expected the path of a TOML file, got {source!r:.80}")
    path = os.fspath(source)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not text in UTF-8"
        raise UnreadableFileError(
            path, reason, "a TOML file that describes a robot head"
        ) from error
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # nested too deep, or a number too long
        raise UnreadableFileError(path, f"no TOML ({error})", "a TOML file") from error
    try:
        return _parse(Table(document, ""), path)
    except HeadFileError as error:
        if error.file or isinstance(error, UnreadableFileError):
            raise
        raise HeadFileError(error.key, error.value, error.expected, path) from error


def refuse_other_head(config: HardwareConfig, head: HeadModel) -> None:
    """Refuse a head that is not the one that the hardware is described with.

    Raises:
        ConfigurationError: their digests differ.
    """
    if head.digest != config.head.digest:
        raise ConfigurationError(
            f"head: expected the head of {config.path}, {config.head.name} with the digest "
            f"{config.head.digest[:12]}, got {head.name} with {head.digest[:12]}"
        )


def _parse(table: Table, path: str) -> HardwareConfig:
    head = _head(table, path)
    if table.has("head_digest"):
        asked = table.text("head_digest", "the digest of the head, see `vergence head`")
        if not (len(asked) >= 8 and head.digest.startswith(asked.lower())):
            raise HeadFileError("head_digest", asked, f"that of {head.name}, {head.digest[:16]}")
    target = _target(table, path)
    bus = _bus(table.table("bus"), head)
    servos = _servos(table.tables("servos"), head)
    cameras = table.table("cameras")
    tolerance_s = _PAIRING * head.timing.frame_s
    if cameras.has("pairing_tolerance_s"):
        tolerance_s = cameras.number("pairing_tolerance_s", _TOLERANCE)
    left, right = (_camera(cameras.table(name), eye, head) for eye, name in enumerate(EYE_NAMES))
    cameras.close()
    if left.source == right.source:
        raise HeadFileError(
            "cameras.right.source", right.source, "another camera than the left one"
        )
    emulator = ""
    if table.has("emulator"):
        part = table.table("emulator")
        emulator = part.text("address", "HOST:PORT of an emulated head")
        host_port = re.fullmatch(r"[^:\s]+:([0-9]{1,5})", emulator)
        if host_port is None or not 1 <= int(host_port[1]) <= 65535:
            raise HeadFileError("emulator.address", emulator, "HOST:PORT of an emulated head")
        part.close()
    table.close()
    return HardwareConfig(
        path=path,
        head=head,
        target=target,
        bus=bus,
        servos=servos,
        cameras=(left, right),
        pairing_tolerance_s=tolerance_s,
        emulator=emulator,
    )


def _head(table: Table, path: str) -> HeadModel:
    expected = f"one of {', '.join(presets())}, or the path of a head file"
    name = table.text("head", expected)
    if name in presets():
        return load_head(name)
    try:
        return load_head(Path(path).parent.absolute() / name)
    except UnreadableFileError as error:
        asked = f"{expected} ({error.key}: {error.value})"
        raise HeadFileError("head", name, asked, path) from error


def _target(table: Table, path: str) -> Target:
    if not table.has("target"):
        return parse_target("tag:36h11:0")
    text = table.text("target", "a target, such as tag:36h11:0:150")
    try:
        return parse_target(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def _bus(table: Table, head: HeadModel) -> BusConfig:
    port = table.text("port", "the device file of the serial line, such as /dev/ttyUSB0")
    baud_rate, watchdog_s = BusConfig.baud_rate, BusConfig.watchdog_s
    if table.has("baud_rate"):
        baud_rate = table.whole("baud_rate", _BAUD)
    if table.has("watchdog_s"):
        watchdog_s = table.number("watchdog_s", _WATCHDOG)
        least_s = _WATCHDOG_PERIODS * head.timing.period_s
        if watchdog_s < least_s:
            raise HeadFileError(
                table.key("watchdog_s"),
                watchdog_s,
                f"at least {_WATCHDOG_PERIODS} control periods of {head.name}, {least_s:.3g} s",
            )
    table.close()
    return BusConfig(port=port, baud_rate=baud_rate, watchdog_s=watchdog_s)


def actuator_slots(head: HeadModel) -> dict[str, int]:
    """What a robot needs a servo for, by name, and its place in a command of seven."""
    slots = {name: slot for slot, name in enumerate(head.joints[NECK]) if name}
    return slots | {name: NECK.stop + i for i, name in enumerate(head.actuation.names)}


def _servos(tables: Sequence[Table], head: HeadModel) -> tuple[ServoConfig, ...]:
    slots = actuator_slots(head)
    servos: dict[str, ServoConfig] = {}
    for table in tables:
        key = table.key("name")
        name = table.choice("name", list(slots))
        if name in servos:
            raise HeadFileError(key, name, "each joint once")
        servo = _servo(table, name, slots[name], head)
        same = next((one.name for one in servos.values() if one.id == servo.id), None)
        if same is not None:
            raise HeadFileError(table.key("id"), servo.id, f"another id than that of {same}")
        servos[name] = servo
    missing = [name for name in slots if name not in servos]
    if missing:
        raise HeadFileError(
            "servos", list(servos), f"a servo for each of {', '.join(slots)} of {head.name}"
        )
    return tuple(sorted(servos.values(), key=lambda servo: servo.slot))


def _servo(table: Table, name: str, slot: int, head: HeadModel) -> ServoConfig:
    ident = table.whole("id", _ID)
    zero_ticks = table.whole("zero_ticks", _ZERO)
    sign = table.whole("sign", _SIGN)
    gear_ratio = table.number("gear_ratio", _GEAR) if table.has("gear_ratio") else 1.0
    limits: dict[str, float] = {}
    for key, limit in (("lower_rad", head.actuation.lower), ("upper_rad", head.actuation.upper)):
        limits[key] = float(limit[slot])
        if table.has(key):
            given = table.number(key, RADIANS)
            if not head.actuation.lower[slot] <= given <= head.actuation.upper[slot]:
                raise HeadFileError(
                    table.key(key),
                    given,
                    f"an angle within the head's limits, {head.actuation.lower[slot]:g} to "
                    f"{head.actuation.upper[slot]:g} rad",
                )
            limits[key] = given
    if not limits["lower_rad"] < limits["upper_rad"]:
        raise HeadFileError(
            table.key("upper_rad"), limits["upper_rad"], f"more than {limits['lower_rad']:g} rad"
        )
    turns = gear_ratio * (limits["upper_rad"] - limits["lower_rad"]) / (2.0 * np.pi)
    if turns > 1.0:
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


def _camera(table: Table, eye: int, head: HeadModel) -> CameraConfig:
    source = table.take("source", "a camera's number, its device file or a URL")
    if isinstance(source, bool) or not isinstance(source, int | str) or not str(source).strip():
        raise HeadFileError(
            table.key("source"), source, "a camera's number, its device file or a URL"
        )
    pixel_format, latency_s = "", head.timing.latency_s
    if table.has("pixel_format"):
        pixel_format = table.text("pixel_format", "four letters, such as MJPG")
        if re.fullmatch(r"[ -~]{4}", pixel_format) is None:
            raise HeadFileError(
                table.key("pixel_format"), pixel_format, "four letters, such as MJPG"
            )
    if table.has("latency_s"):
        latency_s = table.number("latency_s", _LATENCY)
    table.close()
    return CameraConfig(eye=eye, source=str(source), pixel_format=pixel_format, latency_s=latency_s)
