"""Parts of a real head's configuration: serial line, servos, cameras, measured loop, targets."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vergence.hardware.dynamixel.control_table import TICKS_PER_TURN
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.vision.targets import Target


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """The serial line of the servos."""

    port: str
    """Device file of the line."""
    baud_rate: int = 1_000_000
    """Baud rate, bit/s."""
    watchdog_s: float = 0.2
    """Watchdog time: without a packet for so long the servos stop by themselves, s."""


@dataclass(frozen=True, kw_only=True)
class ServoConfig:
    """One servo and its coupling to the neck joint or eye actuator that it moves."""

    name: str
    """Name of the neck joint or eye actuator."""
    slot: int
    """Index into the 7-element command, see `vergence.envs.plant.Plant.step`."""
    id: int
    """Id on the bus."""
    zero_ticks: int
    """Servo position at the zero angle, ticks."""
    sign: int
    """1, or -1 if the servo turns against the joint."""
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

    measured: str
    """Date of the measurement."""
    command_latency_s: float
    """Latency from a command to the motors' response in the encoder readings, s."""
    lag_s: float
    """Time constant of the motors' response, as a head's `timing.lag_s`, s; an actuator with its
    own lag keeps its ratio to this one."""
    speed_gain: float
    """Steady-state speed per commanded speed."""
    computing_s: float
    """Computing time: image to detection plus reading to command, s."""
    backlash_rad: float | None = None
    """Backlash (play) between encoders and cameras, rad; None, like the values below, if not
    measured."""
    jitter_s: float | None = None
    """Greatest delay of an image beyond its camera's latency, s."""
    acceleration_ratio: float | None = None
    """Greatest acceleration as a ratio to the head file's; None if it was not reached."""
    sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations by the names of the values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredTarget:
    """A target at a measured point."""

    target: Target
    """Target that the cameras detect there."""
    point: FloatArray
    """(3,) centre of the target in the frame N, m."""


def actuator_slots(head: HeadModel) -> dict[str, int]:
    """Neck joints and eye actuators that need a servo: index into the 7-element command by name."""
    slots = {name: slot for slot, name in enumerate(head.joints[NECK]) if name}
    return slots | {name: NECK.stop + i for i, name in enumerate(head.actuation.names)}
