"""The layout of observations and actions, and their conversion to and from physical units."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.encoding import (
    ACTUATORS,
    AGE_S,
    DIRECT,
    FINE_PX,
    LIMIT,
    OFFSET,
    RESTING_NECK,
    RIGHT_WIDTH,
    TO_ACTUATORS,
    TO_JOINTS,
    VISIBLE,
    WIDTH,
    decode_observation,
    observation_slices,
    packed_observation_scaling,
)
from vergence.envs.reading import BoolArray
from vergence.models.head import HeadModel
from vergence.models.parts import SLOTS, FloatArray
from vergence.operands import as_operand

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
    """(SCALING,) packed scale factors, see `vergence.envs.encoding`."""
    action_names: tuple[str, ...]
    """(m,) names of the actuators, in the order of an action."""
    latency_s: float
    """Nominal latency of an image, s."""
    period_s: float
    """Control period, s."""

    @classmethod
    def of(cls, head: HeadModel) -> "ObservationLayout":
        """The layout for a head, its neck held at rest."""
        return cls(
            scaling=packed_observation_scaling(head),
            action_names=head.actuation.names,
            latency_s=head.timing.latency_s,
            period_s=head.timing.period_s,
        )

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
        return self.scaling[LIMIT:RESTING_NECK]

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
        return Observation(*decode_observation(observation, self.size, self.scaling))

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
        row = self.scaling
        one_width = row[WIDTH] == row[RIGHT_WIDTH]
        coupling = {
            "joints_per_actuator": row[TO_JOINTS:OFFSET].reshape(SLOTS, SLOTS).tolist(),
            "joint_offsets": row[OFFSET:TO_ACTUATORS].tolist(),
        }
        return {
            "fields": {name: [part.start, part.stop] for name, part in self.fields.items()},
            "actions": list(self.action_names),
            "scaling": row[: RIGHT_WIDTH if one_width else RIGHT_WIDTH + 1].tolist(),
            "fine_px": FINE_PX,
            "age_s": AGE_S,
            "latency_s": self.latency_s,
            "period_s": self.period_s,
            **({} if row[DIRECT] else coupling),
        }
