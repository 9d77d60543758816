"""Actuators of a head, and how they move the four joints of the eyes.

A joint angle is a linear function of the actuators' angles, `joints = matrix actuators + offset`.
The matrix is the identity if each eye joint has its own motor; a tilt that both eyes share is one
column of it, a version and a vergence are two. Commands are indexed by actuator, measurements by
joint. Limits, lag, encoder quantisation and backlash belong to the actuator.

Kernels always take four actuators of the eyes. A head with fewer is padded with actuators that
move nothing, so arrays of the neck's three joints and then these four have the shape (7,) for
every head.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.parts import (
    EYES,
    NECK,
    FloatArray,
    FrozenArrays,
    JointLimits,
    LoopTiming,
    SensorModel,
)
from vergence.operands import as_operand

SLOTS: Final = 4
"""Number of eye actuators in the arrays of kernels (numerical); `vergence.kernels` compiles it."""
_DEFAULTS: Final = {
    **dict.fromkeys(("lag_s", "encoder_resolution_rad", "velocity_resolution_rad_s"), np.nan),
    "backlash_rad": 0.0,
}
"""Numbers of an actuator that stand for the head's own value, by field."""
_LIMITS: Final = ("lower", "upper", "velocity", "acceleration")


def _unset_array() -> FloatArray:
    return np.empty(0)


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
    lag_s: FloatArray = field(default_factory=_unset_array)
    """Time constants, s; nan (or empty) for that of the head's `timing`."""
    encoder_resolution_rad: FloatArray = field(default_factory=_unset_array)
    """Quantisation of the angle feedback, rad; nan (or empty) for that of the head's `sensor`."""
    velocity_resolution_rad_s: FloatArray = field(default_factory=_unset_array)
    """Quantisation of the velocity feedback, rad/s; nan (or empty) for that of the `sensor`."""
    backlash_rad: FloatArray = field(default_factory=_unset_array)
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


def assemble_actuation(
    joints: Sequence[str],
    limits: JointLimits,
    timing: LoopTiming,
    sensor: SensorModel,
    actuators: Actuators | None,
) -> Actuation:
    """Assemble the actuation of (7,) joints; timing and sensor supply what actuators leave out."""
    own = _own_motors(joints[EYES], limits) if actuators is None else actuators
    count = len(own.names)
    direct = actuators is None and count == SLOTS

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
