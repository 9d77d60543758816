"""Parts of a head: joint order, limits, timing, sensors, rendering, actuators, calibration."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, refuse_unknown
from vergence.operands import as_operand

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


def replace_fields(part: Any, part_name: str, fields: Mapping[str, Any]) -> Any:
    """Copy a head or a part with some fields changed; a mapping changes fields of a part."""
    refuse_unknown(part_name, fields, part.__dataclass_fields__)
    new = dict(fields)
    for key, value in fields.items():
        now, name = getattr(part, key), f"{part_name}.{key}"
        if isinstance(value, Mapping) and dataclasses.is_dataclass(now):
            new[key] = replace_fields(now, key, value)
        elif isinstance(now, int | float | np.ndarray):
            try:
                numbers = np.asarray(value, dtype=np.float64)
            except (TypeError, ValueError, OverflowError) as error:
                raise ConfigurationError(f"{name}: expected numbers, got {value!r:.80}") from error
            if np.isnan(numbers).any() or (np.ndim(now) == 0) != (numbers.ndim == 0):
                what = "a number" if np.ndim(now) == 0 else "an array of numbers"
                raise ConfigurationError(f"{name}: expected {what}, got {value!r:.80}")
        elif not isinstance(value, type(now)) and name != "head.calibration":  # None for no record
            raise ConfigurationError(f"{name}: expected a {type(now).__name__}, got {value!r:.80}")
    return dataclasses.replace(part, **new)


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

    name: str  # name, such as `left.tilt.alpha`
    unit: str  # unit: `m`, `rad`, `px`, or `1` for a ratio or a coefficient
    field: str  # field of the part that holds the number
    column: int  # index of the number in that field, with the field's own dimensions flattened


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

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values in vars(self).items():
            if values.shape != (len(JOINTS),):
                raise ConfigurationError(f"limits.{name}: expected shape (7,), got {values.shape}")

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


SLOTS: Final = 4
"""Number of eye actuators in the arrays of kernels (numerical); `vergence.kernels` compiles it."""
_DEFAULTS: Final = {
    **dict.fromkeys(("lag_s", "encoder_resolution_rad", "velocity_resolution_rad_s"), np.nan),
    "backlash_rad": 0.0,
}
"""Numbers of an actuator that stand for the head's own value, by field."""
_LIMITS: Final = ("lower", "upper", "velocity", "acceleration")


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuators(FrozenArrays):
    """Actuators of eyes with coupled joints: not every joint has a motor of its own.

    All fields except `matrix` and `offset` have the shape (m,), m from 0 to 4.
    """

    names: tuple[str, ...]
    """(m,) names of the actuators."""
    matrix: FloatArray
    """(4, m) rotation of each joint, in order, per rotation of each actuator."""
    offset: FloatArray
    """(4,) joint angles with all actuators at zero, rad."""
    lower: FloatArray
    """Least angle, rad."""
    upper: FloatArray
    """Greatest angle, rad."""
    velocity: FloatArray
    """Greatest commanded speed, rad/s."""
    acceleration: FloatArray
    """Greatest acceleration, rad/s^2; inf for no limit."""
    lag_s: FloatArray = field(default_factory=lambda: np.empty(0))
    """Time constants, s; nan (or empty) for that of the head's `timing`."""
    encoder_resolution_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    """Quantisation of the angle feedback, rad; nan (or empty) for that of the head's `sensor`."""
    velocity_resolution_rad_s: FloatArray = field(default_factory=lambda: np.empty(0))
    """Quantisation of the velocity feedback, rad/s; nan (or empty) for that of the `sensor`."""
    backlash_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    """Backlash between motor and load, whole width, rad; 0 (or empty) for that of the `sensor`."""

    def __post_init__(self) -> None:
        count = len(self.names)
        for name, default in _DEFAULTS.items():
            if not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.full(count, default))
        super().__post_init__()
        shape = self.matrix.shape
        if shape != (SLOTS, count) or (count and np.linalg.matrix_rank(self.matrix) != count):
            raise ConfigurationError(
                f"actuators: expected a (4, {count}) matrix of independent columns, got "
                f"{self.matrix.tolist()}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuation(FrozenArrays):
    """A head's actuators as kernels, plants and controllers take them.

    Fields of shape (7,) hold the neck's three joints, then four actuators of the eyes.
    """

    names: tuple[str, ...]
    """(m,) names of the eyes' actuators."""
    direct: bool
    """True if each of the four eye joints has its own motor, in joint order."""
    to_joints: FloatArray
    """(4, 4) the eyes' joint angles per actuator angle; columns beyond m are zero."""
    offset: FloatArray
    """(4,) the eyes' joint angles with all actuators at zero, rad."""
    to_actuators: FloatArray
    """(4, 4) a left inverse of `to_joints`; rows beyond m are zero."""
    lower: FloatArray
    """(7,) least angles, rad."""
    upper: FloatArray
    """(7,) greatest angles, rad."""
    velocity: FloatArray
    """(7,) greatest commanded speeds, rad/s; 0 for one that does not exist."""
    acceleration: FloatArray
    """(7,) greatest accelerations, rad/s^2; inf for no limit."""
    lag_ratio: FloatArray
    """(7,) lags as ratios to the lag in the head's `timing`."""
    angle_step: FloatArray
    """(7,) quantisation of the angle feedback, rad; 0 for exact."""
    speed_step: FloatArray
    """(7,) quantisation of the velocity feedback, rad/s; 0 for exact."""
    backlash: FloatArray
    """(7,) backlash between motor and joint, whole width, rad; 0 for the neck."""

    @property
    def count(self) -> int:
        """Number of actuators of the eyes."""
        return len(self.names)

    def joints_of(self, actuators: ArrayLike) -> FloatArray:
        """(..., 7) joint angles of the whole head, rad.

        Args:
            actuators: (..., 7) angles of the neck and of the eyes' actuators, rad.
        """
        out = as_operand("actuators", actuators, 7).copy()
        if not self.direct:
            out[..., EYES] = out[..., EYES] @ self.to_joints.T + self.offset
        return out

    def joint_velocities_of(self, actuators: ArrayLike) -> FloatArray:
        """(..., 7) joint velocities, rad/s, by those of the neck and of the eyes' actuators."""
        out = as_operand("actuators", actuators, 7).copy()
        if not self.direct:
            out[..., EYES] = out[..., EYES] @ self.to_joints.T
        return out

    def actuators_of(self, joints: ArrayLike) -> FloatArray:
        """(..., 7) angles of the neck and of the eyes' actuators, rad: the inverse of `joints_of`.

        Args:
            joints: (..., 7) rad; those that no actuators give are met in the least-squares sense.
        """
        out = as_operand("joints", joints, 7).copy()
        if not self.direct:
            out[..., EYES] = (out[..., EYES] - self.offset) @ self.to_actuators.T
        return out


def assemble_actuation(head: Any) -> Actuation:
    """Assemble a head's actuation; its timing and sensor supply what actuators leave out."""
    limits, timing, sensor = head.limits, head.timing, head.sensor
    own = head.actuators or _own_motors(head.joints[EYES], limits)
    count = len(own.names)
    direct = head.actuators is None and count == SLOTS

    def seven(neck: FloatArray, eyes: FloatArray, fill: float = 0.0) -> FloatArray:
        return np.concatenate([neck, eyes, np.full(SLOTS - len(eyes), fill)])

    def given(name: str, of_head: float) -> FloatArray:
        values, unset = getattr(own, name), _DEFAULTS[name]
        return np.where(np.isnan(values) | (values == unset), of_head, values)

    lag = given("lag_s", timing.lag_s)
    if timing.lag_s == 0.0 and lag.any():
        raise ConfigurationError(
            f"actuators.lag_s: expected 0 for a head whose timing.lag_s is 0, got {lag.tolist()}"
        )
    to_joints, ones = np.zeros((SLOTS, SLOTS)), np.ones(NECK.stop)
    to_joints[:, :count] = own.matrix
    angle_step, speed_step = sensor.encoder_resolution_rad, sensor.velocity_resolution_rad_s
    return Actuation(
        names=own.names,
        direct=direct,
        to_joints=to_joints,
        offset=own.offset,
        to_actuators=np.eye(SLOTS) if direct else np.round(np.linalg.pinv(to_joints), 15),
        lag_ratio=seven(ones, lag / timing.lag_s if timing.lag_s > 0.0 else np.ones(count), 1.0),
        angle_step=seven(angle_step * ones, given("encoder_resolution_rad", angle_step)),
        speed_step=seven(speed_step * ones, given("velocity_resolution_rad_s", speed_step)),
        backlash=seven(0.0 * ones, given("backlash_rad", sensor.backlash_rad)),
        **{name: seven(getattr(limits, name)[NECK], getattr(own, name)) for name in _LIMITS},
    )


def _own_motors(eyes: Sequence[str], limits: JointLimits) -> Actuators:
    """One actuator for each joint of the eyes, by their (4,) names; shared ones occur twice."""
    names = tuple(dict.fromkeys(filter(None, eyes)))
    first = [EYES.start + eyes.index(name) for name in names]
    return Actuators(
        names=names,
        matrix=np.array([[float(joint == name) for name in names] for joint in eyes]),
        offset=np.zeros(SLOTS),
        **{name: getattr(limits, name)[first] for name in _LIMITS},
    )
