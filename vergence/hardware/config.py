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

import os
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from vergence.errors import (
    ConfigurationError,
    HeadFileError,
    MistakesError,
    UnreadableFileError,
    VergenceError,
)
from vergence.hardware.config_parts import (
    BusConfig,
    CameraConfig,
    LoopConfig,
    MeasuredTarget,
    ServoConfig,
    actuator_slots,
)
from vergence.hardware.config_tables import (
    MistakeCollector,
    read_bus,
    read_camera,
    read_emulator,
    read_loop,
    read_measured_targets,
    read_servos,
)
from vergence.hardware.safety.config import SafetyConfig, parse_safety
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head, presets
from vergence.models.parts import EYE_NAMES
from vergence.models.toml_table import Rule, Table
from vergence.vision.objects.targets import GazeTarget, parse_gaze_target

__all__ = [
    "BusConfig",
    "CameraConfig",
    "HardwareConfig",
    "ServoConfig",
    "actuator_slots",
    "load_hardware",
    "refuse_other_head",
]

_PAIRING_FRAME_FRACTION: Final = 0.75
"""Greatest time between the exposures of a pair, as a fraction of the frame period: a half, so that
images of unsynchronised cameras always find a partner, and a quarter for jitter (chosen)."""
_TOLERANCE_RULE: Final[Rule] = (lambda x: 0.0 < x < 1.0, "seconds, 0 to 1 (is it in milliseconds?)")


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
    emulator_address: str
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
    """Raise an error if a head differs from that of the hardware configuration.

    Raises:
        ConfigurationError: their digests differ.
    """
    if head.digest != config.head.digest:
        raise ConfigurationError(
            f"head: expected the head of {config.path}, {config.head.name} with the digest "
            f"{config.head.digest[:12]}, got {head.name} with {head.digest[:12]}"
        )


def _parse(table: Table, path: str) -> HardwareConfig:
    mistakes = MistakeCollector()
    head: HeadModel | None = None
    with mistakes:
        head = _head(table, path)
    with mistakes:
        _refuse_other_digest(table, head)
    with mistakes:
        target = _target(table, path)
    with mistakes:
        bus = read_bus(table.table("bus"), head)
    with mistakes:
        servos = read_servos(table.tables("servos"), head, mistakes)
    with mistakes:
        cameras, tolerance_s = _cameras(table.table("cameras"), head, mistakes)
    emulator, places_targets = "", False
    with mistakes:
        if table.has("emulator"):
            emulator, places_targets = read_emulator(table.table("emulator"))
    safety = SafetyConfig()
    with mistakes:
        if table.has("safety"):
            part = table.table("safety")
            # its forbidden postures name joints of the head
            safety = safety if head is None else parse_safety(part, actuator_slots(head))
    loop: LoopConfig | None = None
    with mistakes:
        if table.has("loop"):
            loop = read_loop(table.table("loop"))
    measured_targets: tuple[MeasuredTarget, ...] = ()
    with mistakes:
        if table.has("places"):
            measured_targets = read_measured_targets(table.tables("places"), mistakes)
    with mistakes:
        table.close()
    if mistakes.found or head is None:
        raise _error(mistakes, path)
    left, right = cameras
    return HardwareConfig(
        path=path,
        head=head,
        target=target,
        bus=bus,
        servos=servos,
        cameras=(left, right),
        pairing_tolerance_s=tolerance_s,
        emulator_address=emulator,
        places_targets=places_targets,
        safety=safety,
        loop=loop,
        measured_targets=measured_targets,
    )


def _error(mistakes: MistakeCollector, path: str) -> VergenceError:
    """The error to raise for all mistakes, each with the name of the file."""
    found = [_in_file(mistake, path) for mistake in mistakes.found]
    return found[0] if len(found) == 1 else MistakesError(path, found)


def _in_file(error: VergenceError, path: str) -> VergenceError:
    if not isinstance(error, HeadFileError) or error.file:
        return error
    return HeadFileError(error.key, error.value, error.expected, path)


def _refuse_other_digest(table: Table, head: HeadModel | None) -> None:
    if not table.has("head_digest"):
        return
    asked = table.text("head_digest", "the digest of the head, which `vergence info --head` tells")
    if head is not None and not (len(asked) >= 8 and head.digest.startswith(asked.lower())):
        raise HeadFileError("head_digest", asked, f"that of {head.name}, {head.digest[:16]}")


def _cameras(
    table: Table, head: HeadModel | None, mistakes: MistakeCollector
) -> tuple[list[CameraConfig], float]:
    """Read the cameras, left one first, and the pairing tolerance, s; mistakes are left out."""
    tolerance_s = 0.0 if head is None else _PAIRING_FRAME_FRACTION * head.timing.frame_s
    with mistakes:
        if table.has("pairing_tolerance_s"):
            tolerance_s = table.number("pairing_tolerance_s", _TOLERANCE_RULE)
    cameras = []
    for eye, name in enumerate(EYE_NAMES):
        with mistakes:
            cameras.append(read_camera(table.table(name), eye, head))
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
    if not name.isprintable():
        raise HeadFileError("head", name, expected, path)
    # reading a pipe or some devices never ends
    if os.path.exists(place) and not os.path.isfile(place):
        raise HeadFileError("head", name, f"{expected} ({place!s:.200}: no regular file)", path)
    try:
        return load_head(place)
    except UnreadableFileError as error:
        asked = f"{expected} ({error.path:.200}: {error.reason})"
        raise HeadFileError("head", name, asked, path) from error


def _target(table: Table, path: str) -> GazeTarget:
    if not table.has("target"):
        return parse_gaze_target("tag:36h11:0")
    text = table.text("target", "a target, such as tag:36h11:0:150")
    try:
        return parse_gaze_target(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
