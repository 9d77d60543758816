"""Parts of a head model: joint order, limits, timing, sensors, rendering, calibration record."""

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


def readonly_array(values: ArrayLike) -> FloatArray:
    """A read-only float64 copy of the values."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def is_name_tuple(value: object) -> bool:
    """True for a tuple of strings, which a field of names holds."""
    return isinstance(value, tuple) and all(isinstance(one, str) for one in value)


def replace_fields(part: T, part_name: str, fields: Mapping[str, Any]) -> T:
    """Copy a head or a part with some fields changed; a mapping changes fields of a part."""
    known: Any = part
    refuse_unknown(part_name, fields, known.__dataclass_fields__)
    new = dict(fields)
    for key, value in fields.items():
        now = getattr(part, key)
        if isinstance(value, Mapping) and dataclasses.is_dataclass(now):
            new[key] = replace_fields(now, key, value)
        elif (part_name, key) != ("head", "calibration"):  # None for no record
            _check(f"{part_name}.{key}", value, now)
    made: T = dataclasses.replace(known, **new)
    return made


def _check(name: str, value: Any, now: Any) -> None:
    """Check that a new value has the type of the current one."""
    if isinstance(now, int | float | np.ndarray):
        try:
            numbers = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(f"{name}: expected numbers, got {value!r:.80}") from error
        if np.isnan(numbers).any() or (np.ndim(now) == 0) != (numbers.ndim == 0):
            what = "a number" if np.ndim(now) == 0 else "an array of numbers"
            raise ConfigurationError(f"{name}: expected {what}, got {value!r:.80}")
    elif not isinstance(value, type(now)):
        raise ConfigurationError(f"{name}: expected a {type(now).__name__}, got {value!r:.80}")


class FrozenArrays:
    """Converts every sequence of numbers in a frozen dataclass to a read-only array."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray | list | tuple) and not is_name_tuple(value):
                object.__setattr__(self, name, readonly_array(value))


class _NotNegative:
    """Rejects numbers of a frozen dataclass that are nan or negative."""

    _above_zero: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            above, text = name in self._above_zero, isinstance(value, str)
            if not (text or (value > 0.0 if above else value >= 0.0)):
                least = "above 0" if above else "of at least 0"
                raise ConfigurationError(f"{name}: expected a number {least}, got {value!r}")


class Parameter(NamedTuple):
    """One number of a part in which a real head may differ from its model."""

    name: str
    """Name, such as `left.tilt.alpha`."""
    unit: str
    """Unit: `m`, `rad`, `px`, or `1` for a ratio or a coefficient."""
    field: str
    """Field of the part that holds the number."""
    column: int
    """Index of the number in that field, with the field's own dimensions flattened."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits(FrozenArrays):
    """Limits of the joints; each field has the shape (7,)."""

    lower: FloatArray
    """Least angle, in radians."""
    upper: FloatArray
    """Greatest angle, in radians."""
    velocity: FloatArray
    """Greatest commanded speed, in rad/s."""
    acceleration: FloatArray
    """Greatest acceleration, in rad/s^2; inf for no limit."""

    def contains(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """(...) True if all joints are at least `margin` rad inside their limits; False for nan.

        Args:
            q: (..., 7) joint angles, rad.
            margin: the distance to keep, rad.
        """
        q = as_operand("q", q, 7)
        inside = (q >= self.lower + margin) & (q <= self.upper - margin)
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True, kw_only=True)
class LoopTiming(_NotNegative):
    """Rates, latencies and lag of the control loop, its cameras and its joints."""

    _above_zero = ("control_rate_hz", "frame_rate_hz")

    control_rate_hz: float
    """Control rate, Hz; each command is held for one period."""
    frame_rate_hz: float
    """Frame rate by the camera's own clock, Hz."""
    latency_s: float
    """Latency from the middle of an exposure until the image is readable, s."""
    exposure_s: float
    """Exposure time, s; the exposure is centred on the frame's time."""
    lag_s: float
    """Time constant of a joint's velocity after its command, s; 0 for no lag."""
    command_latency_s: float = 0.0
    """Dead time from a command to the joints' response, s."""
    feedback_latency_s: float = 0.0
    """Latency from a measurement of the joints until it is readable, s."""
    exposure_stamps: bool = False
    """True if the cameras stamp frames with the time of exposure; else receipt dates them."""

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
        """The latency of images in control periods, rounded to an integer."""
        return round(self.latency_s * self.control_rate_hz)


@dataclass(frozen=True, kw_only=True)
class SensorModel(_NotNegative):
    """Noise, quantisation, dropped frames and backlash of readings and commands."""

    detection_noise_px: float
    """Standard deviation of each coordinate of the detected target, px."""
    encoder_resolution_rad: float
    """Quantisation of the joint angle feedback, rad; 0 for exact."""
    velocity_resolution_rad_s: float
    """Quantisation of the joint velocity feedback, rad/s; 0 for exact."""
    dropped_frame_probability: float
    """Probability that a frame is dropped."""
    max_smear_px: float
    """Largest motion of the target in the image during an exposure before it is not visible, px."""
    command_resolution_rad_s: float = 0.0
    """Quantisation of the velocity commands, rad/s, up to which none moves; 0 for exact."""
    backlash_rad: float = 0.0
    """Backlash between motor and load, whole width, rad, unless an actuator has its own."""
    encoder_side: Literal["motor", "output"] = "motor"
    """Side of the backlash with the encoders: `motor`, where only images show it, or `output`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoder_side not in ENCODER_SIDES:
            raise ConfigurationError(
                f"encoder_side: expected {' or '.join(ENCODER_SIDES)}, got {self.encoder_side!r}"
            )


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """Grey levels of a rig's images: supersampled, blurred, scaled, with noise, in 8 bits."""

    blur_px: float
    """Standard deviation of the lens's Gaussian blur, px."""
    noise_grey: float
    """Standard deviation of a pixel's white noise, in grey levels of 255."""
    supersampling: int
    """Samples per pixel along each axis, before the blur."""
    black_grey: float
    """Grey level of the target's black, 0 to 255."""
    white_grey: float
    """Grey level of the target's white, 0 to 255."""
    background_grey: float
    """Grey level of the background around the target, 0 to 255."""


JOINTS: Final = (
    "neck_yaw", "neck_roll", "neck_pitch", "left_tilt", "left_pan", "right_tilt", "right_pan",
)  # fmt: skip
"""Joint order of every array of joint angles, velocities and limits."""

NECK: Final = slice(0, 3)
"""The neck's joints in an array of all joints (numerical)."""

EYES: Final = slice(3, 7)
"""The eyes' joints in an array of all joints: left tilt and pan, then right (numerical)."""

EYE_NAMES: Final = ("left", "right")
"""Eye order of every array of cameras, pixels and image Jacobians."""

LINKS: Final = (
    (1, 0, "neck_yaw"), (2, 1, "neck_roll"), (3, 2, "neck_pitch"),
    (4, 3, "left_tilt"), (5, 4, "left_pan"), (6, 5, ""),
    (7, 3, "right_tilt"), (8, 7, "right_pan"), (9, 8, ""),
)  # fmt: skip
"""The tree of frames, (frame, parent, joint); an empty joint is a fixed link (Table 1)."""


@dataclass(frozen=True, kw_only=True)
class CalibrationRecord:
    """Origin and uncertainty of calibrated cameras."""

    target: str
    """The board, see `vergence.vision.parse_target`."""
    views: int
    """Number of pairs of photographs used."""
    rms_px: float
    """Root mean square of the reprojection errors of these pairs, as lengths in pixels."""
    rms_heldout_px: float
    """Root mean square of the reprojection errors of held-out pairs (cross-validation), px."""
    corners_sha256: str
    """SHA-256 of the measured corners."""
    versions: str
    """Versions of the programs that measured and solved."""
    sigma: Mapping[str, float]
    """Standard deviations by the names of `HeadModel.parameters`, in their units; those of
    `right.head_eye` are of the right camera's pose in the left camera's frame."""
