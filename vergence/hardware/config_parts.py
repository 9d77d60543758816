"""The parts of a real head as its configuration describes them: line, servos, cameras."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vergence.hardware.dynamixel.control_table import TICKS_PER_TURN
from vergence.models.boards import Target
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, NECK
from vergence.models.parts import FloatArray


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """The serial line of the servos."""

    port: str
    """Its device file."""
    baud_rate: int = 1_000_000
    """Bits per second."""
    watchdog_s: float = 0.2
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
    exposure_s: float | None = None
    """Exposure time that a camera of this machine is locked to, s; None leaves it as it is."""

    @property
    def name(self) -> str:
        """As messages call it."""
        return f"cameras.{EYE_NAMES[self.eye]}"


@dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """A robot's loop as `vergence measure-delay` finds it, in place of what its head file says.

    The feedback's own latency stands in none of it: commands and images are dated by the encoders'
    readings, and only differences from these can be measured.
    """

    measured: str
    """Day of the measurement."""
    command_latency_s: float
    """From a command to the encoders' telling of the motors' response, s."""
    lag_s: float
    """Time constant of the motors' response, as a head's `timing.lag_s`, s; an actuator with a
    lag of its own keeps its ratio."""
    speed_gain: float
    """Speed at rest by command."""
    computing_s: float
    """From an image's receipt to its target being found, and from a reading to its command, s."""
    backlash_rad: float | None = None
    """Play between encoders and cameras, rad; None where no image told it, as the following."""
    jitter_s: float | None = None
    """The most by which an image comes later than its camera's latency, s."""
    acceleration_ratio: float | None = None
    """Greatest accelerations by those of the head file; None where they were not reached."""
    sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations by name of the values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """A target at a measured place."""

    target: Target
    """What the cameras look for there."""
    point: FloatArray
    """(3,) of its centre, in N, m."""


def actuator_slots(head: HeadModel) -> dict[str, int]:
    """What a robot needs a servo for, by name, and its place in a command of seven."""
    slots = {name: slot for slot, name in enumerate(head.joints[NECK]) if name}
    return slots | {name: NECK.stop + i for i, name in enumerate(head.actuation.names)}
