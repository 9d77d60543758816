"""Configuration of an emulated head; also the options of `vergence emulate`."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from vergence.errors import ConfigurationError

_MAX_TIME_S: Final = 10.0
"""Greatest value of options that are times, s (chosen)."""
_DELAYS: Final = (
    "latency_s", "jitter_s", "right_late_s", "speed_filter_s", "lag_s", "command_latency_s",
    "feedback_latency_s", "answer_latency_s",
)  # fmt: skip
_RANGES: Final = {
    "lag_s": (1e-3, _MAX_TIME_S), "acceleration_rad_s2": (0.1, 1e4), "speed_gain": (0.01, 2.0),
    "backlash_rad": (0.0, 0.2), "friction": (0.0, 0.5), "gravity": (0.0, 0.5),
    "board_distance_m": (0.1, 20.0),
}  # fmt: skip
"""Least and greatest value of other options (chosen)."""


def _option(name: str) -> str:
    """Option of the command for a field."""
    return re.sub("_(s|rad|rad_s2|m)$", "", name).replace("_", "-")


@dataclass(frozen=True, kw_only=True)
class EmulatorConfig:
    """Configuration of an emulated head.

    Raises:
        ConfigurationError: a value is out of range.
    """

    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "turrets"
    """Head: a preset's name (see `vergence info`) or the path of a TOML file."""
    target_mm: Annotated[
        tuple[float, float, float], tyro.conf.arg(name="point", metavar="X Y Z")
    ] = (0.0, -100.0, 1000.0)
    """Position of the target until a trial places it, in mm, in the base frame N: x right, y down,
    z forward."""
    board: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TARGET")] = None
    """A board fixed in the world, in place of a tag that trials place, such as
    checkerboard:9x6:24 (inner corners, square in mm); none by default."""
    board_distance_m: Annotated[float, tyro.conf.arg(name="board-distance", metavar="METRES")] = 0.7
    """Distance of that board ahead of the head at rest."""
    scene: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="SCENE")] = None
    """A room with an object at the target's position, in place of a tag before plain grey:
    ball:#RRGGBB:MM, poster:MM, poster:FILE:MM or room (nothing); none by default."""
    wall: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """Photograph on that room's front wall."""
    servo: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="MODEL")] = None
    """Model of the servos, such as XL330: its model number, speed, acceleration and voltage; an
    XL430-W250 with the head's own speed and acceleration by default."""
    latency_s: Annotated[
        float | None, tyro.conf.arg(name="latency", help_behavior_hint="", metavar="SECONDS")
    ] = None
    """Latency from mid-exposure to the sending of the image; the head's by default."""
    jitter_s: Annotated[float, tyro.conf.arg(name="jitter", metavar="SECONDS")] = 0.0
    """Greatest random delay of an image beyond the latency."""
    right_late_s: Annotated[float, tyro.conf.arg(name="right-late", metavar="SECONDS")] = 0.0
    """Delay of the right camera's exposures after the left one's."""
    speed_filter_s: Annotated[float, tyro.conf.arg(name="speed-filter", metavar="SECONDS")] = 0.0
    """Time constant of the low-pass filter on the speeds that the servos report."""
    lag_s: Annotated[
        float | None, tyro.conf.arg(name="lag", help_behavior_hint="", metavar="SECONDS")
    ] = None
    """Time constant of the joints' response; the head's by default."""
    acceleration_rad_s2: Annotated[
        float | None, tyro.conf.arg(name="acceleration", help_behavior_hint="", metavar="RAD/S^2")
    ] = None
    """Greatest acceleration of the joints; the servo model's or the head's by default."""
    speed_gain: Annotated[float, tyro.conf.arg(metavar="RATIO")] = 1.0
    """Steady-state speed of the joints per commanded speed."""
    command_latency_s: Annotated[
        float, tyro.conf.arg(name="command-latency", metavar="SECONDS")
    ] = 0.0
    """Latency from a command's arrival to the servos' response."""
    backlash_rad: Annotated[float, tyro.conf.arg(name="backlash", metavar="RAD")] = 0.0
    """Backlash between the servos' encoders and the joints."""
    feedback_latency_s: Annotated[
        float, tyro.conf.arg(name="feedback-latency", metavar="SECONDS")
    ] = 0.0
    """Age of the angles and speeds that the servos report."""
    answer_latency_s: Annotated[float, tyro.conf.arg(name="answer-latency", metavar="SECONDS")] = (
        0.0
    )
    """Delay of every answer of the servos, as by an adapter's latency timer."""
    friction: Annotated[float, tyro.conf.arg(metavar="FRACTION")] = 0.0
    """Coulomb friction of the joints, of the greatest torque; static friction is 1.6 times that."""
    gravity: Annotated[float, tyro.conf.arg(metavar="FRACTION")] = 0.0
    """Torque of gravity about horizontal axes, of the greatest torque."""
    faults: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """A TOML file of faults: tables [[fault]] with what, at_s (since torque was switched on) and
    the fault's own keys; none by default."""
    port: int = 0
    """Port of the image streams, reachable from this machine only; 0 for any free port."""
    seed: int = 0
    """Random seed of image noise, jitter, faults and head errors."""

    def __post_init__(self) -> None:
        for name in _DELAYS:
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < _MAX_TIME_S:
                said = f"expected seconds, 0 to {_MAX_TIME_S:g}, got {value}"
                raise ConfigurationError(f"{_option(name)}: {said}")
        for name, (least, most) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                said = f"expected {least:g} to {most:g}, got {value}"
                raise ConfigurationError(f"{_option(name)}: {said}")
        if self.board is not None and (self.scene is not None or self.wall is not None):
            raise ConfigurationError("scene: expected no --board beside it, got both")
        if self.servo is not None:
            from vergence.hardware.dynamixel.control_table import model_number
            from vergence.models.ruler import find_servo_model

            model_number(find_servo_model(self.servo).name)
        if not 0 <= self.port <= 65535:
            raise ConfigurationError(f"port: expected 0 to 65535, got {self.port}")
        if self.seed < 0:
            raise ConfigurationError(f"seed: expected 0 or more, got {self.seed}")
        if not all(map(math.isfinite, self.target_mm)):
            raise ConfigurationError(f"point: expected three finite numbers, got {self.target_mm}")
