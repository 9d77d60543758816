"""What an emulated head is like; also the options of `vergence emulate`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from vergence.errors import ConfigurationError

_MOST_S: Final = 10.0


@dataclass(frozen=True, kw_only=True)
class EmulatorConfig:
    """What an emulated head is like.

    Raises:
        ConfigurationError: a number cannot be.
    """

    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "turrets"
    """Head: a preset's name (see `vergence info`) or the path of a TOML file."""
    target_mm: Annotated[
        tuple[float, float, float], tyro.conf.arg(name="target", metavar="X Y Z")
    ] = (0.0, -100.0, 1000.0)
    """Where the target stands until a trial places it, in mm, in the base frame N: x right, y down,
    z forward."""
    board: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TARGET")] = None
    """A board that stands still in the world in place of a tag that trials place, such as
    checkerboard:9x6:24 (inner corners, square in mm); none by default."""
    board_distance_m: Annotated[float, tyro.conf.arg(name="board-distance", metavar="METRES")] = 0.7
    """How far ahead of the head at rest that board stands."""
    latency_s: Annotated[
        float | None, tyro.conf.arg(name="latency", help_behavior_hint="", metavar="SECONDS")
    ] = None
    """From the middle of an exposure to its image being sent; the head's by default."""
    jitter_s: Annotated[float, tyro.conf.arg(name="jitter", metavar="SECONDS")] = 0.0
    """The most by which an image is sent later than that."""
    right_late_s: Annotated[float, tyro.conf.arg(name="right-late", metavar="SECONDS")] = 0.0
    """By how much the right camera exposes later than the left one."""
    speed_filter_s: Annotated[float, tyro.conf.arg(name="speed-filter", metavar="SECONDS")] = 0.0
    """Time constant of the filter through which the servos report their speeds."""
    lag_s: Annotated[
        float | None, tyro.conf.arg(name="lag", help_behavior_hint="", metavar="SECONDS")
    ] = None
    """Time constant of the joints' response; the head's by default."""
    acceleration_rad_s2: Annotated[
        float | None, tyro.conf.arg(name="acceleration", help_behavior_hint="", metavar="RAD/S^2")
    ] = None
    """Greatest acceleration of the joints; the head's by default."""
    speed_gain: Annotated[float, tyro.conf.arg(metavar="RATIO")] = 1.0
    """Speed of the joints by what they are told."""
    command_latency_s: Annotated[
        float, tyro.conf.arg(name="command-latency", metavar="SECONDS")
    ] = 0.0
    """From a command's arrival to the servos' response."""
    backlash_rad: Annotated[float, tyro.conf.arg(name="backlash", metavar="RAD")] = 0.0
    """Play between the servos' encoders and the joints."""
    feedback_latency_s: Annotated[
        float, tyro.conf.arg(name="feedback-latency", metavar="SECONDS")
    ] = 0.0
    """Age of the angles and speeds that the servos report."""
    faults: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """A TOML file of faults: tables [[fault]] with what, at_s (since torque was switched on) and
    the fault's own keys; none by default."""
    port: int = 0
    """Port of the streams, on this machine alone; 0 for any that is free."""
    seed: int = 0
    """Seed of the noise of the images, of the jitter, of the faults and of the head's errors."""

    def __post_init__(self) -> None:
        times = ("latency_s", "jitter_s", "right_late_s", "speed_filter_s", "lag_s")
        for name in (*times, "command_latency_s", "feedback_latency_s"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < _MOST_S:
                raise ConfigurationError(
                    f"{name.removesuffix('_s').replace('_', '-')}: expected seconds, 0 to "
                    f"{_MOST_S:g}, got {value}"
                )
        for name, least, most in (
            ("lag_s", 1e-3, _MOST_S),
            ("acceleration_rad_s2", 0.1, 1e4),
            ("speed_gain", 0.01, 2.0),
            ("backlash_rad", 0.0, 0.2),
            ("board_distance_m", 0.1, 20.0),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                option = name.removesuffix("_s").removesuffix("_rad").removesuffix("_rad_s2")
                option = option.removesuffix("_m")
                raise ConfigurationError(
                    f"{option.replace('_', '-')}: expected {least:g} to {most:g}, got {value}"
                )
        if not 0 <= self.port <= 65535:
            raise ConfigurationError(f"port: expected 0 to 65535, got {self.port}")
        if self.seed < 0:
            raise ConfigurationError(f"seed: expected 0 or more, got {self.seed}")
        if not all(map(math.isfinite, self.target_mm)):
            raise ConfigurationError(f"target: expected three finite numbers, got {self.target_mm}")
