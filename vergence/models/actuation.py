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
from typing import Any, Final

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
_INHERITED_FIELDS: Final = ("lag_s", "encoder_resolution_rad", "velocity_resolution_rad_s")
"""Fields of an actuator that default to the head's own value; nan stands for the default."""


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
    """(4, m) rotation of each joint per rotation of each actuator: joints = matrix @ actuators +
    offset; rows in joint order."""
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
    """Time constants, s; nan (or empty) for the value in the head's `timing`."""
    encoder_resolution_rad: FloatArray = field(default_factory=_unset_array)
    """Quantisation of the angle feedback, rad; nan (or empty) for the value in the head's
    `sensor`."""
    velocity_resolution_rad_s: FloatArray = field(default_factory=_unset_array)
    """Quantisation of the velocity feedback, rad/s; nan (or empty) for the value in the head's
    `sensor`."""
    backlash_rad: FloatArray = field(default_factory=_unset_array)
    """Backlash between the motor and its load, whole width, rad; 0 (or empty) for the value in the
    head's `sensor`."""

    def __post_init__(self) -> None:
        count = len(self.names)
        for name in (*_INHERITED_FIELDS, "backlash_rad"):
            if not len(np.atleast_1d(getattr(self, name))):
                fill = 0.0 if name == "backlash_rad" else np.nan
                object.__setattr__(self, name, np.full(count, fill))
        super().__post_init__()
        if self.matrix.shape != (SLOTS, count) or np.linalg.matrix_rank(self.matrix) != count:
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
        """Convert angles of the neck and the eyes' actuators to joint angles of the whole head.

        Args:
            actuators: (..., 7) rad.

        Returns:
            (..., 7) rad.
        """
        out = as_operand("actuators", actuators, 7).copy()
        if not self.direct:
            out[..., EYES] = out[..., EYES] @ self.to_joints.T + self.offset
        return out

    def joint_velocities_of(self, actuators: ArrayLike) -> FloatArray:
        """Convert velocities of the neck and the eyes' actuators to joint velocities."""
        out = as_operand("actuators", actuators, 7).copy()
        if not self.direct:
            out[..., EYES] = out[..., EYES] @ self.to_joints.T
        return out

    def actuators_of(self, joints: ArrayLike) -> FloatArray:
        """Convert joint angles to angles of the neck and the eyes' actuators; inverts `joints_of`.

        Args:
            joints: (..., 7) rad; if no actuator angles give them, the least-squares solution is
                taken.

        Returns:
            (..., 7) rad.
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
    own = [(name, i) for i, name in enumerate(joints[EYES]) if name]
    names = tuple(dict.fromkeys(name for name, _ in own))
    seven: dict[str, FloatArray] = {}
    if actuators is None:
        direct = len(names) == SLOTS
        to_joints = np.zeros((SLOTS, SLOTS))
        for name, joint in own:
            to_joints[joint, names.index(name)] = 1.0
        first = [next(joint for name, joint in own if name == wanted) for wanted in names]
        offset = np.zeros(SLOTS)
        for name in ("lower", "upper", "velocity", "acceleration"):
            values = getattr(limits, name)
            seven[name] = _seven(values[NECK], values[EYES][first])
        given: dict[str, Any] = dict.fromkeys(
            (*_INHERITED_FIELDS, "backlash_rad"), np.full(len(names), np.nan)
        )
    else:
        direct = False
        names, offset = actuators.names, actuators.offset
        to_joints = np.zeros((SLOTS, SLOTS))
        to_joints[:, : len(names)] = actuators.matrix
        for name in ("lower", "upper", "velocity", "acceleration"):
            seven[name] = _seven(getattr(limits, name)[NECK], getattr(actuators, name))
        given = {name: getattr(actuators, name) for name in (*_INHERITED_FIELDS, "backlash_rad")}
    lag = np.where(np.isnan(given["lag_s"]), timing.lag_s, given["lag_s"])
    if timing.lag_s == 0.0 and lag.any():
        raise ConfigurationError(
            f"actuators.lag_s: expected 0 for a head whose timing.lag_s is 0, got {lag.tolist()}"
        )
    ratio = lag / timing.lag_s if timing.lag_s > 0.0 else np.ones(len(names))
    ones, steps = np.ones(3), {}
    for name, of_head in (
        ("encoder_resolution_rad", sensor.encoder_resolution_rad),
        ("velocity_resolution_rad_s", sensor.velocity_resolution_rad_s),
        ("backlash_rad", sensor.backlash_rad),
    ):
        unsaid = given[name] == 0.0 if name == "backlash_rad" else np.isnan(given[name])
        values = np.where(unsaid | np.isnan(given[name]), of_head, given[name])
        steps[name] = _seven((0.0 if name == "backlash_rad" else of_head) * ones, values)
    return Actuation(
        names=names,
        direct=direct,
        to_joints=to_joints,
        offset=offset,
        to_actuators=np.eye(SLOTS) if direct else np.round(np.linalg.pinv(to_joints), 15),
        lag_ratio=_seven(ones, ratio, 1.0),
        angle_step=steps["encoder_resolution_rad"],
        speed_step=steps["velocity_resolution_rad_s"],
        backlash=steps["backlash_rad"],
        **seven,
    )


def _seven(neck: FloatArray, eyes: FloatArray, fill: float = 0.0) -> FloatArray:
    """Join values of the neck's joints and of the eyes' actuators, padded to shape (7,)."""
    return np.concatenate([neck, eyes, np.full(SLOTS - len(eyes), fill)])
