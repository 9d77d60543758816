"""What a head model is made of: limits, timing, sensors, images."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, refuse_unknown
from vergence.operands import as_operand

T = TypeVar("T")
FloatArray = NDArray[np.float64]
ENCODER_SIDES: Final = ("motor", "output")


def frozen_array(values: ArrayLike) -> FloatArray:
    """A read-only float64 copy of the values."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def is_names(value: object) -> bool:
    """Whether a field holds names: a tuple of text."""
    return isinstance(value, tuple) and all(isinstance(one, str) for one in value)


def replaced(part: T, name: str, fields: Mapping[str, Any]) -> T:
    """A copy of a head, or of a part of one, with some fields changed.

    Args:
        part: what is copied.
        name: what a message calls it.
        fields: new values; a mapping for a field changes fields of that part in turn.

    Raises:
        ConfigurationError: a field is unknown, or a number is not one.
    """
    known: Any = part
    refuse_unknown(name, fields, [field.name for field in dataclasses.fields(known)])
    new = {}
    for key, value in fields.items():
        if isinstance(value, Mapping) and dataclasses.is_dataclass(getattr(part, key)):
            new[key] = replaced(getattr(part, key), key, value)
        else:
            new[key] = _checked(f"{name}.{key}", value, getattr(part, key))
    made: T = dataclasses.replace(known, **new)
    return made


def _checked(name: str, value: Any, now: Any) -> Any:
    """A new value in place of one of the same kind."""
    if isinstance(now, int | float | np.ndarray):
        try:
            numbers = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(f"{name}: expected numbers, got {value!r:.80}") from error
        if np.isnan(numbers).any() or (np.ndim(now) == 0) != (numbers.ndim == 0):
            what = "a number" if np.ndim(now) == 0 else "an array of numbers"
            raise ConfigurationError(f"{name}: expected {what}, got {value!r:.80}")
    elif name in ("cameras.lens", "cameras.response", "head.calibration"):
        pass  # one may stand for both eyes, which the cameras check; None for no record
    elif not isinstance(value, type(now)):
        raise ConfigurationError(f"{name}: expected a {type(now).__name__}, got {value!r:.80}")
    return value


class FrozenArrays:
    """Turns every field of a frozen dataclass that holds numbers in sequence into an array."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray | list | tuple) and not is_names(value):
                object.__setattr__(self, name, frozen_array(value))


class _NotNegative:
    """Refuses numbers of a frozen dataclass that are nan or below zero."""

    _above_zero: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, str):
                continue
            if not (value > 0.0 if name in self._above_zero else value >= 0.0):
                least = "above 0" if name in self._above_zero else "of at least 0"
                raise ConfigurationError(f"{name}: expected a number {least}, got {value!r}")


class Parameter(NamedTuple):
    """One of a part's numbers that a real head has otherwise than its model says."""

    name: str
    """Such as `left.tilt.alpha`."""
    unit: str
    """`m`, `rad`, `px`, or `1` for a ratio or a coefficient."""
    field: str
    """The part's field that holds it."""
    column: int
    """Its place in that field, the field's own dimensions taken as one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits(FrozenArrays):
    """What the joints can do; each field has the shape (7,)."""

    lower: FloatArray
    """Least angle, in radians."""
    upper: FloatArray
    """Greatest angle, in radians."""
    velocity: FloatArray
    """Greatest commanded speed, in rad/s."""
    acceleration: FloatArray
    """Greatest acceleration, in rad/s^2; inf where there is no limit."""

    def contains(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether all joints are at least `margin` rad inside their limits.

        Args:
            q: (..., 7) joint angles, rad.
            margin: the distance to keep, rad.

        Returns:
            (...) booleans; False where an angle is nan.
        """
        q = as_operand("q", q, 7)
        inside = (q >= self.lower + margin) & (q <= self.upper - margin)
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True, kw_only=True)
class LoopTiming(_NotNegative):
    """When images are taken and read, and how the joints follow their commands."""

    _above_zero = ("control_rate_hz", "frame_rate_hz")

    control_rate_hz: float
    """Commands per second; each is held for one period."""
    frame_rate_hz: float
    """Frames per second, by the camera's own clock."""
    latency_s: float
    """Seconds between the middle of an exposure and the image being readable."""
    exposure_s: float
    """Length of an exposure; it is centred on the frame's time."""
    lag_s: float
    """Time constant with which a joint's velocity follows its command; 0 for none."""
    command_latency_s: float = 0.0
    """Seconds between a command and the joints' response to it."""
    feedback_latency_s: float = 0.0
    """Seconds between a measurement of the joints and its being readable."""
    exposure_stamps: bool = False
    """Whether the cameras tell when a frame was exposed; else it is dated by its receipt."""

    @property
    def period_s(self) -> float:
        """The control period."""
        return 1.0 / self.control_rate_hz

    @property
    def frame_s(self) -> float:
        """The time from one frame to the next."""
        return 1.0 / self.frame_rate_hz

    @property
    def latency_frames(self) -> int:
        """The latency in control periods, rounded to whole ones."""
        return round(self.latency_s * self.control_rate_hz)


@dataclass(frozen=True, kw_only=True)
class SensorModel(_NotNegative):
    """What stands between the true state and a reading, and between a command and the motors."""

    detection_noise_px: float
    """Standard deviation of the detected target's pixel, each coordinate."""
    encoder_resolution_rad: float
    """Step of the joint angle feedback; 0 for exact."""
    velocity_resolution_rad_s: float
    """Step of the joint velocity feedback; 0 for exact."""
    dropped_frame_probability: float
    """Probability that a frame never arrives."""
    max_smear_px: float
    """Motion of the target in the image during an exposure beyond which it is not seen."""
    command_resolution_rad_s: float = 0.0
    """Step of the velocity commands; 0 for exact. A command of one step or less moves nothing."""
    backlash_rad: float = 0.0
    """Play between an actuator's motor and what it moves, whole width, where the actuator does not
    say otherwise."""
    encoder_side: Literal["motor", "output"] = "motor"
    """On which side of the play the encoders sit: `motor`, where the play shows in the images
    alone, or `output`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoder_side not in ENCODER_SIDES:
            raise ConfigurationError(
                f"encoder_side: expected {' or '.join(ENCODER_SIDES)}, got {self.encoder_side!r}"
            )


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """The grey-level model of one rig's images.

    An image is the supersampled target, blurred by the lens, brought to the rig's
    contrast, with white grey-level noise added, rounded to 8 bits.
    """

    blur_px: float
    """Standard deviation of the lens's Gaussian blur, in pixels."""
    noise_grey: float
    """Standard deviation of the white noise of one pixel, in grey levels of 255."""
    supersampling: int
    """Samples per pixel along each axis before blur."""
    black_grey: float
    """Grey level of the target's black, 0 to 255."""
    white_grey: float
    """Grey level of the target's white, 0 to 255."""
    background_grey: float
    """Grey level of what surrounds the target, 0 to 255."""
