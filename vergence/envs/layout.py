"""The layout of observations and actions, and the way back to physical units."""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence._jit import device, kernel
from vergence.envs.reading import BoolArray, Reading
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, JOINTS, NECK
from vergence.models.parts import FloatArray

FINE_PX: Final = 16.0
"""Pixel error at which the fine channel saturates."""
AGE_S: Final = 0.5
"""Image age at which its channel saturates."""
ANGLE_MARGIN_RAD: Final = 0.05
"""How far beyond a joint's limits its channel reaches: a simulated stop gives a little."""
SPEED_MARGIN: Final = 1.1
"""How far beyond a joint's greatest command its velocity channel reaches, as a factor."""

COARSE: Final = 0
FINE: Final = 4
VISIBLE: Final = 8
AGE: Final = 10
POSITIONS: Final = 11
AT_EXPOSURE: Final = 15
VELOCITIES: Final = 19
LAST_ACTION: Final = 23
SIZE: Final = 27

FIELDS: Final = {
    "pixel_error": slice(COARSE, FINE),
    "pixel_error_fine": slice(FINE, VISIBLE),
    "visible": slice(VISIBLE, AGE),
    "image_age": slice(AGE, POSITIONS),
    "positions": slice(POSITIONS, AT_EXPOSURE),
    "positions_at_exposure": slice(AT_EXPOSURE, VELOCITIES),
    "velocities": slice(VELOCITIES, LAST_ACTION),
    "last_action": slice(LAST_ACTION, SIZE),
}

# the scaling's row of numbers, in the order kernels read it
_WIDTH = 0
_CENTRE = 1
_HALF = 5
_SPEED = 9
_LIMIT = 13
_NECK = 17
_RIGHT_WIDTH = 20
SCALING: Final = 21
"""Length of a layout's row of scaling constants."""


class Observation(NamedTuple):
    """An observation in physical units."""

    pixel_error: FloatArray
    """(..., 2, 2) undistorted pixel of the target less the principal point, px; nan unseen."""
    visible: BoolArray
    """(..., 2) whether each eye saw the target in the newest image."""
    image_age_s: FloatArray
    """(...) age of the newest image: time since its exposure, as the reading dates it."""
    positions: FloatArray
    """(..., 7) present joint angles, rad; the neck's are those it is held at."""
    positions_at_exposure: FloatArray
    """(..., 7) joint angles at the exposure of the newest image, rad."""
    velocities: FloatArray
    """(..., 7) present joint velocities, rad/s; the neck's are zero."""
    last_command: FloatArray
    """(..., 4) the eyes' joint velocities commanded last, rad/s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationLayout:
    """What each number of an observation and an action means for one head.

    | index | field | what it is | 1.0 stands for | range |
    | --- | --- | --- | --- | --- |
    | 0:4 | `pixel_error` | the target less the principal point | the eye's width, px | -1 to 1 |
    | 4:8 | `pixel_error_fine` | the same, saturated | 16 px | -1 to 1 |
    | 8:10 | `visible` | whether each eye saw the target | true | 0 to 1 |
    | 10:11 | `image_age` | since the newest image's exposure, saturated | 0.5 s | 0 to 1 |
    | 11:15 | `positions` | angles from mid-range | half range + 0.05 rad | -1 to 1 |
    | 15:19 | `positions_at_exposure` | the same at exposure | half range + 0.05 rad | -1 to 1 |
    | 19:23 | `velocities` | joint velocities | 1.1 greatest commands, rad/s | -1 to 1 |
    | 23:27 | `last_action` | the action that holds | the greatest commands, rad/s | -1 to 1 |

    Pixels are undistorted, (u, v) of the left, then the right eye; an unseen target's errors are
    0, and the age is 1 before the first image. Joints are left tilt,
    left pan, right tilt, right pan.

    An action is the four eye joint velocities (left tilt, left pan, right tilt, right pan) by
    the joints' greatest commands, -1 to 1.
    """

    scaling: FloatArray
    """(SCALING,) left image's width, angles' centres and half ranges, velocity ranges, limits,
    neck, right image's width."""
    latency_s: float
    """The nominal latency of an image."""
    period_s: float
    """The control period."""

    @classmethod
    def of(cls, head: HeadModel) -> "ObservationLayout":
        """The layout for a head, its neck held at rest."""
        row = np.zeros(SCALING)
        limits = head.limits
        row[_WIDTH], row[_RIGHT_WIDTH] = head.cameras.size[:, 0]
        row[_CENTRE:_HALF] = 0.5 * (limits.lower + limits.upper)[EYES]
        row[_HALF:_SPEED] = 0.5 * (limits.upper - limits.lower)[EYES] + ANGLE_MARGIN_RAD
        row[_SPEED:_LIMIT] = SPEED_MARGIN * limits.velocity[EYES]
        row[_LIMIT:_NECK] = limits.velocity[EYES]
        row[_NECK:_RIGHT_WIDTH] = head.rest()[NECK]
        row.flags.writeable = False
        return cls(scaling=row, latency_s=head.timing.latency_s, period_s=head.timing.period_s)

    def __eq__(self, other: object) -> bool:
        """Whether observations and actions mean the same in both."""
        if not isinstance(other, ObservationLayout):
            return NotImplemented
        return self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.scaling.tobytes(), self.latency_s, self.period_s))

    @property
    def size(self) -> int:
        """Length of an observation."""
        return SIZE

    @property
    def fields(self) -> dict[str, slice]:
        """Where each field lies in an observation."""
        return dict(FIELDS)

    @property
    def action_names(self) -> tuple[str, ...]:
        """What each number of an action moves."""
        return tuple(JOINTS[EYES])

    @property
    def action_limits(self) -> FloatArray:
        """(4,) the joint velocity that an action of 1 commands, rad/s."""
        return self.scaling[_LIMIT:_NECK]

    def low(self) -> NDArray[np.float32]:
        """(size,) the least value of each number of an observation."""
        low = np.full(SIZE, -1.0, dtype=np.float32)
        low[VISIBLE:POSITIONS] = 0.0
        return low

    def high(self) -> NDArray[np.float32]:
        """(size,) the greatest value of each number of an observation."""
        return np.ones(SIZE, dtype=np.float32)

    def decode(self, observation: ArrayLike) -> Observation:
        """An observation in physical units.

        Args:
            observation: (..., size).

        Returns:
            The observation; errors of at most 16 px come from the fine channel.

        Raises:
            ConfigurationError: they are no observations.
        """
        error, visible, age, *joints, command = _decode(
            as_observation(observation).astype(np.float64, copy=False), self.scaling, *_SHAPES
        )
        return Observation(error, visible, age, joints[0], joints[1], joints[2], command)

    def action(self, joint_velocity: ArrayLike) -> NDArray[np.float32]:
        """The action that commands the eyes' joint velocities, limited to [-1, 1].

        Args:
            joint_velocity: (..., 4) rad/s.

        Returns:
            (..., 4) actions.
        """
        return np.clip(np.asarray(joint_velocity) / self.action_limits, -1.0, 1.0).astype(
            np.float32
        )

    def to_dict(self) -> dict[str, Any]:
        """The layout as plain numbers and names, for a manifest.

        The right image's width came later and is left out where it is the left's.
        """
        one_width = self.scaling[_WIDTH] == self.scaling[_RIGHT_WIDTH]
        return {
            "fields": {name: [part.start, part.stop] for name, part in FIELDS.items()},
            "actions": list(self.action_names),
            "scaling": self.scaling[: _RIGHT_WIDTH if one_width else SCALING].tolist(),
            "fine_px": FINE_PX,
            "age_s": AGE_S,
            "latency_s": self.latency_s,
            "period_s": self.period_s,
        }


def as_observation(observation: ArrayLike) -> NDArray[np.floating[Any]]:
    """Observations as an array.

    Args:
        observation: (..., size).

    Returns:
        The same numbers.

    Raises:
        ConfigurationError: they have another length, are no floating-point numbers, or not all
            of them are finite.
    """
    try:
        array = np.asarray(observation)
    except ValueError as error:  # rows of different lengths
        raise ConfigurationError(
            f"observation: expected an array of shape (..., {SIZE}), got {error}"
        ) from error
    if array.ndim == 0 or array.shape[-1] != SIZE:
        raise ConfigurationError(f"observation: expected shape (..., {SIZE}), got {array.shape}")
    if array.dtype.kind != "f":
        raise ConfigurationError(
            f"observation: expected floating-point numbers, got an array of {array.dtype}"
        )
    # a product with itself is nan or inf if one number is: the cheapest test of all of them
    if not isfinite(np.vdot(array, array)):
        raise ConfigurationError("observation: expected finite numbers, got nan or inf")
    return array


def fitting_layout(head: HeadModel, layout: "ObservationLayout | None") -> "ObservationLayout":
    """The layout with which a controller of a head is made.

    Args:
        head: the head that it is to control.
        layout: of the observations that it will see; None for the head's own.

    Returns:
        The layout.

    Raises:
        ConfigurationError: the layout is another head's, whose numbers mean something else.
    """
    own = ObservationLayout.of(head)
    if layout is None:
        return own
    if not isinstance(layout, ObservationLayout):
        raise ConfigurationError(f"layout: expected an ObservationLayout, got {layout!r:.80}")
    if layout == own:
        return layout
    ours, theirs = own.to_dict(), layout.to_dict()
    differing = ", ".join(name for name, value in ours.items() if theirs[name] != value)
    raise ConfigurationError(
        f"layout: expected that of the head {head.name!r}, got another head's, which differs in "
        f"{differing}"
    )


_SHAPES = (np.zeros(2), np.zeros(7), np.zeros(4))
"""They name dimensions that `_decode` has only in its results."""


@device
def _clip(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@device
def _width(scaling: FloatArray, eye: int) -> float:
    width: float = scaling[_WIDTH] if eye == 0 else scaling[_RIGHT_WIDTH]
    return width


@device
def encode(
    out: NDArray[np.float32],
    scaling: FloatArray,
    error: FloatArray,
    reading: Reading,
    n: int,
    action: FloatArray,
) -> None:
    """Write the observation of one place.

    Args:
        out: (SIZE,) result.
        scaling: (SCALING,) the layout's constants.
        error: (2, 2) measured pixel errors, px.
        reading: of the batch.
        n: the place.
        action: (4,) the action that holds.
    """
    for eye in range(2):
        seen = reading.visible[n, eye]
        out[VISIBLE + eye] = 1.0 if seen else 0.0
        for axis in range(2):
            value = error[eye, axis] if seen else 0.0
            out[COARSE + 2 * eye + axis] = _clip(value / _width(scaling, eye))
            out[FINE + 2 * eye + axis] = _clip(value / FINE_PX)
    age_s = reading.time_s[n] - reading.exposure_s[n]
    out[AGE] = 1.0 if age_s != age_s else min(age_s / AGE_S, 1.0)
    for j in range(4):
        centre, half = scaling[_CENTRE + j], scaling[_HALF + j]
        at_exposure = reading.positions_at_exposure[n, 3 + j]
        out[POSITIONS + j] = _clip((reading.positions[n, 3 + j] - centre) / half)
        out[AT_EXPOSURE + j] = _clip((at_exposure - centre) / half)
        out[VELOCITIES + j] = _clip(reading.velocities[n, 3 + j] / scaling[_SPEED + j])
        out[LAST_ACTION + j] = action[j]


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    "(o),(s),(e),(j),(a)->(e,e),(e),(),(j),(j),(j),(a)",
)
def _decode(
    obs: FloatArray,
    scaling: FloatArray,
    pair: FloatArray,
    seven: FloatArray,
    four: FloatArray,
    error: FloatArray,
    visible: BoolArray,
    age: FloatArray,
    positions: FloatArray,
    at_exposure: FloatArray,
    velocities: FloatArray,
    command: FloatArray,
) -> None:
    """The fields of `Observation`; the three after `scaling` are `_SHAPES`."""
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
        positions[j] = at_exposure[j] = scaling[_NECK + j]
        velocities[j] = 0.0
    for j in range(4):
        centre, half = scaling[_CENTRE + j], scaling[_HALF + j]
        positions[3 + j] = centre + half * obs[POSITIONS + j]
        at_exposure[3 + j] = centre + half * obs[AT_EXPOSURE + j]
        velocities[3 + j] = scaling[_SPEED + j] * obs[VELOCITIES + j]
        command[j] = scaling[_LIMIT + j] * obs[LAST_ACTION + j]
