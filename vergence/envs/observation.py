"""Observations and actions: their layout, and the encoding of each number.

An observation of a head with m eye actuators has 11 + 4 m numbers: eleven from the images, then
four groups of one number per actuator. Actuator angles and velocities are computed from the joint
readings. These were made from the actuators' encoders, so nothing is lost.
"""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.reading import BoolArray, Reading
from vergence.errors import ConfigurationError
from vergence.kernels import (
    inlined,
    kernel,
    make_row,
    record_view,
    row_layout,
    row_size,
    subroutine,
)
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead
from vergence.models.parts import EYES, NECK, SLOTS, FloatArray
from vergence.operands import as_operand

FINE_PX: Final = 16.0
"""Pixel error at which the fine channel saturates, px (chosen: resolution against range)."""
AGE_S: Final = 0.5
"""Image age at which its channel saturates, s (chosen: resolution against range)."""
ANGLE_MARGIN_RAD: Final = 0.05
"""Range of an angle channel beyond the actuator's limits, rad, as simulated stops give a little
(chosen: resolution against range)."""
SPEED_MARGIN: Final = 1.1
"""Full scale of a velocity channel as a ratio to the actuator's velocity limit (chosen: resolution
against range)."""

# first index of each field in an observation (numerical)
COARSE: Final = 0
FINE: Final = 4
VISIBLE: Final = 8
AGE: Final = 10
ACTUATORS: Final = 11
"""First index of the actuators' numbers."""


def observation_slices(actuators: int) -> dict[str, slice]:
    """Slice of each field in an observation, for a head with this many eye actuators."""
    groups = ("positions", "positions_at_exposure", "velocities", "last_action")
    starts = [ACTUATORS + actuators * i for i in range(len(groups) + 1)]
    return {
        "pixel_error": slice(COARSE, FINE),
        "pixel_error_fine": slice(FINE, VISIBLE),
        "visible": slice(VISIBLE, AGE),
        "image_age": slice(AGE, ACTUATORS),
        **{name: slice(starts[i], starts[i + 1]) for i, name in enumerate(groups)},
    }


FIELDS: Final = observation_slices(SLOTS)
"""The fields of a head whose eyes have four actuators."""


class Scaling:
    """Row of the scale factors of a head's observations; groups of four are by actuator slot."""

    width: float
    centre: Annotated[FloatArray, SLOTS]
    half_range: Annotated[FloatArray, SLOTS]
    speed: Annotated[FloatArray, SLOTS]
    limit: Annotated[FloatArray, SLOTS]
    resting_neck: Annotated[FloatArray, 3]
    right_width: float
    direct: float
    to_joints: Annotated[FloatArray, SLOTS, SLOTS]
    offset: Annotated[FloatArray, SLOTS]
    to_actuators: Annotated[FloatArray, SLOTS, SLOTS]


_SCALING: Final = row_layout(Scaling)
SCALING: Final = row_size(_SCALING)
"""Length of a row of `Scaling`."""
_UP_TO_RIGHT_WIDTH: Final = 21
"""Numbers of a row up to `right_width`, included (numerical)."""


def check_observation(observation: ArrayLike, size: int) -> NDArray[np.floating[Any]]:
    """Check that observations (..., size) are finite floating-point numbers, and return them."""
    try:
        array = np.asarray(observation)
    except ValueError as error:  # rows of different lengths
        raise ConfigurationError(
            f"observation: expected an array of shape (..., {size}), got {error}"
        ) from error
    if array.ndim == 0 or array.shape[-1] != size:
        raise ConfigurationError(f"observation: expected shape (..., {size}), got {array.shape}")
    if array.dtype.kind != "f":
        raise ConfigurationError(
            f"observation: expected floating-point numbers, got an array of {array.dtype}"
        )
    # the sum of squares is nan or inf if any number is: the cheapest test of all of them
    if not isfinite(np.vdot(array, array)):
        raise ConfigurationError("observation: expected finite numbers, got nan or inf")
    return array


@inlined
def _clip(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@inlined
def view_scaling(row: FloatArray) -> Scaling:
    """The scale factors of a row."""
    scaling: Scaling = record_view(row, _SCALING)
    return scaling


@inlined
def _width(scaling: Scaling, eye: int) -> float:
    return scaling.width if eye == 0 else scaling.right_width


@subroutine
def _actuators(scaling: Scaling, k: int, joints: FloatArray, offset: float) -> float:
    """Angle (offset 1.0) or velocity (offset 0.0) of actuator k, from that of the joints (7,)."""
    own = 0.0
    for j in range(SLOTS):
        own += scaling.to_actuators[k, j] * (joints[3 + j] - offset * scaling.offset[j])
    return own


@inlined
def encode_observation(
    out: NDArray[np.float32], scaling: Scaling, error: FloatArray, reading: Reading, n: int,
    action: FloatArray, coupled_head: PackedHead | None,
) -> None:  # fmt: skip
    """Write the observation of one environment."""
    for eye in range(2):
        seen = reading.visible[n, eye]
        out[VISIBLE + eye] = 1.0 if seen else 0.0
        for axis in range(2):
            value = error[eye, axis] if seen else 0.0
            out[COARSE + 2 * eye + axis] = _clip(value / _width(scaling, eye))
            out[FINE + 2 * eye + axis] = _clip(value / FINE_PX)
    age_s = reading.time_s[n] - reading.exposure_s[n]
    out[AGE] = 1.0 if age_s != age_s else min(age_s / AGE_S, 1.0)
    m = len(action)
    for k in range(m):
        if coupled_head is None:
            angle, rate = reading.positions[n, 3 + k], reading.velocities[n, 3 + k]
            at_exposure = reading.positions_at_exposure[n, 3 + k]
        else:
            angle = _actuators(scaling, k, reading.positions[n], 1.0)
            at_exposure = _actuators(scaling, k, reading.positions_at_exposure[n], 1.0)
            rate = _actuators(scaling, k, reading.velocities[n], 0.0)
        centre, half = scaling.centre[k], scaling.half_range[k]
        i = ACTUATORS + k
        out[i] = _clip((angle - centre) / half)
        out[i + m] = _clip((at_exposure - centre) / half)
        out[i + 2 * m] = _clip(rate / scaling.speed[k])
        out[i + 3 * m] = action[k]


_DIMENSION_DUMMIES: Final = (np.zeros(2), np.zeros(7), np.zeros(4))
"""Dummy operands: they name dimensions that `_decode` has only in its results (numerical)."""


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(o),({SCALING}),(2),(7),(4)->(2,2),(2),(),(7),(7),(7),(4)",
)
def _decode(
    obs: FloatArray, scaling_row: FloatArray, pair: FloatArray, seven: FloatArray, four: FloatArray,
    error: FloatArray, visible: BoolArray, age: FloatArray, positions: FloatArray,
    at_exposure: FloatArray, velocities: FloatArray, command: FloatArray,
) -> None:  # fmt: skip
    """Compute the fields of `Observation`; callers must have checked the observation's length."""
    scaling = view_scaling(scaling_row)
    for eye in range(2):
        seen = obs[VISIBLE + eye] > 0.5
        visible[eye] = seen
        for axis in range(2):
            i = 2 * eye + axis
            fine = obs[FINE + i]
            value = fine * FINE_PX if abs(fine) < 1.0 else obs[COARSE + i] * _width(scaling, eye)
            error[eye, axis] = value if seen else nan
    age[0] = obs[AGE] * AGE_S
    for j in range(3):
        positions[j] = at_exposure[j] = scaling.resting_neck[j]
        velocities[j] = 0.0
    direct = scaling.direct > 0.5
    for j in range(SLOTS):
        start = 0.0 if direct else scaling.offset[j]
        positions[3 + j] = at_exposure[3 + j] = start
        velocities[3 + j] = command[j] = 0.0
    m = min((len(obs) - ACTUATORS) // 4, SLOTS)
    for k in range(m):
        i, centre, half = ACTUATORS + k, scaling.centre[k], scaling.half_range[k]
        angle, then = centre + half * obs[i], centre + half * obs[i + m]
        rate = scaling.speed[k] * obs[i + 2 * m]
        command[k] = scaling.limit[k] * obs[i + 3 * m]
        if direct:
            positions[3 + k], at_exposure[3 + k], velocities[3 + k] = angle, then, rate
            continue
        for j in range(SLOTS):
            factor = scaling.to_joints[j, k]
            positions[3 + j] += factor * angle
            at_exposure[3 + j] += factor * then
            velocities[3 + j] += factor * rate


__all__ = ["AGE_S", "Observation", "ObservationLayout"]


class Observation(NamedTuple):
    """An observation in physical units."""

    pixel_error: FloatArray
    """(..., 2, 2) undistorted target pixel minus the principal point, px; nan if not visible."""
    visible: BoolArray
    """(..., 2) True if the eye saw the target in the newest image."""
    image_age_s: FloatArray
    """(...) age of the newest image, s: time since its exposure as dated by the reading."""
    positions: FloatArray
    """(..., 7) present joint angles, rad; the neck's are its rest angles, at which it is held."""
    positions_at_exposure: FloatArray
    """(..., 7) joint angles at the exposure of the newest image, rad."""
    velocities: FloatArray
    """(..., 7) present joint velocities, rad/s; the neck's are zero."""
    last_command: FloatArray
    """(..., 4) actuator velocities commanded last, rad/s; 0 in unused slots."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationLayout:
    """Meaning of each number of an observation and of an action, for one head.

    | index | field | what it is | 1.0 stands for | range |
    | --- | --- | --- | --- | --- |
    | 0:4 | `pixel_error` | the target less the principal point | the eye's width, px | -1 to 1 |
    | 4:8 | `pixel_error_fine` | the same, saturated | 16 px | -1 to 1 |
    | 8:10 | `visible` | whether each eye saw the target | true | 0 to 1 |
    | 10:11 | `image_age` | since the newest image's exposure, saturated | 0.5 s | 0 to 1 |
    | 11:15 | `positions` | angles from mid-range | half range + 0.05 rad | -1 to 1 |
    | 15:19 | `positions_at_exposure` | the same at exposure | half range + 0.05 rad | -1 to 1 |
    | 19:23 | `velocities` | velocities | 1.1 greatest commands, rad/s | -1 to 1 |
    | 23:27 | `last_action` | the action that holds | the greatest commands, rad/s | -1 to 1 |

    Pixels are undistorted, (u, v) of the left, then of the right eye. The errors of an eye that
    does not see the target are 0, and the age is 1 before the first image. Angles and velocities
    are those of the eye actuators: left tilt, left pan, right tilt, right pan if each eye joint has
    its own motor. The table is for four actuators; with m actuators, each of the last four fields
    has m numbers, and an observation 11 + 4 m.

    An action has one number per actuator: the ratio of its velocity to its limit, -1 to 1.
    """

    scaling: FloatArray
    """(SCALING,) packed scale factors, see `vergence.envs.observation`."""
    action_names: tuple[str, ...]
    """(m,) names of the actuators, in the order of an action."""
    latency_s: float
    """Nominal latency of an image, s."""
    period_s: float
    """Control period, s."""

    @classmethod
    def of(cls, head: HeadModel) -> "ObservationLayout":
        """The layout for a head, its neck held at rest."""
        own, (width, right_width) = head.actuation, head.cameras.size[:, 0]
        row = make_row(
            _SCALING, width=width, right_width=right_width, resting_neck=head.rest()[NECK],
            centre=0.5 * (own.lower + own.upper)[EYES],
            half_range=0.5 * (own.upper - own.lower)[EYES] + ANGLE_MARGIN_RAD,
            speed=SPEED_MARGIN * own.velocity[EYES], limit=own.velocity[EYES], direct=own.direct,
            to_joints=own.to_joints, offset=own.offset, to_actuators=own.to_actuators,
        )  # fmt: skip
        row.flags.writeable = False
        return cls(
            scaling=row, action_names=own.names, latency_s=head.timing.latency_s,
            period_s=head.timing.period_s,
        )  # fmt: skip

    def __eq__(self, other: object) -> bool:
        """True if observations and actions have the same meaning in both layouts."""
        if not isinstance(other, ObservationLayout):
            return NotImplemented
        return self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.scaling.tobytes(), self.action_names, self.latency_s, self.period_s))

    @property
    def count(self) -> int:
        """Length of an action: number of eye actuators."""
        return len(self.action_names)

    @property
    def size(self) -> int:
        """Length of an observation."""
        return ACTUATORS + 4 * self.count

    @property
    def fields(self) -> dict[str, slice]:
        """Slice of each field in an observation."""
        return observation_slices(self.count)

    @property
    def action_limits(self) -> FloatArray:
        """(4,) actuator velocities that an action of 1 commands, rad/s; 0 beyond the first m."""
        return view_scaling(self.scaling).limit

    def low(self) -> NDArray[np.float32]:
        """(size,) the least value of each number of an observation."""
        low = np.full(self.size, -1.0, dtype=np.float32)
        low[VISIBLE:ACTUATORS] = 0.0
        return low

    def high(self) -> NDArray[np.float32]:
        """(size,) the greatest value of each number of an observation."""
        return np.ones(self.size, dtype=np.float32)

    def decode(self, observation: ArrayLike) -> Observation:
        """Decode an observation to physical units.

        Args:
            observation: (..., size).

        Returns:
            The observation; errors of at most 16 px come from the fine channel.

        Raises:
            ConfigurationError: the array does not hold observations.
        """
        numbers = check_observation(observation, self.size).astype(np.float64, copy=False)
        return Observation(*_decode(numbers, self.scaling, *_DIMENSION_DUMMIES))

    def action(self, velocity: ArrayLike) -> NDArray[np.float32]:
        """Compute the action that commands given actuator velocities, limited to [-1, 1].

        Args:
            velocity: (..., 4) rad/s; only the first m are used.

        Returns:
            (..., m) actions.
        """
        m = self.count
        asked = as_operand("velocity", velocity, SLOTS)
        share = (asked if m == SLOTS else asked[..., :m]) / self.action_limits[:m]
        return np.clip(share, -1.0, 1.0).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """The layout as plain numbers and names, for a manifest.

        Entries that were added later are omitted if they carry no information: the right image's
        width if it equals the left's, and the joint coupling if each joint has its own motor.
        """
        own = view_scaling(self.scaling)
        numbers = _UP_TO_RIGHT_WIDTH - int(own.width == own.right_width)
        coupling = {
            "joints_per_actuator": own.to_joints.tolist(), "joint_offsets": own.offset.tolist(),
        }  # fmt: skip
        return {
            "fields": {name: [part.start, part.stop] for name, part in self.fields.items()},
            "actions": list(self.action_names), "scaling": self.scaling[:numbers].tolist(),
            "fine_px": FINE_PX, "age_s": AGE_S, "latency_s": self.latency_s,
            "period_s": self.period_s, **({} if own.direct else coupling),
        }  # fmt: skip
