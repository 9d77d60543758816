"""Encoding and decoding of observations in kernels: index and scale of each number.

An observation of a head with m eye actuators has 11 + 4 m numbers: eleven from the images, then
four groups of one number per actuator. Actuator angles and velocities are computed from the joint
readings. These were made from the actuators' encoders, so nothing is lost.
"""

from math import isfinite, nan
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.reading import BoolArray, Reading
from vergence.errors import ConfigurationError
from vergence.kernels import inlined, kernel, subroutine
from vergence.models.head import HeadModel
from vergence.models.kinematics import PackedHead
from vergence.models.parts import EYES, NECK, SLOTS, FloatArray

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

# packed indices of the scaling array of kernels (numerical); groups of four have one number per
# actuator slot
WIDTH: Final = 0
CENTRE: Final = 1
HALF_RANGE: Final = 5
SPEED: Final = 9
LIMIT: Final = 13
RESTING_NECK: Final = 17
RIGHT_WIDTH: Final = 20
DIRECT: Final = 21
TO_JOINTS: Final = 22
OFFSET: Final = 38
TO_ACTUATORS: Final = 42
SCALING: Final = 58
"""Length of the scaling array."""


def packed_observation_scaling(head: HeadModel) -> FloatArray:
    """(SCALING,) packed scale factors of a head's observations, with its neck held at rest."""
    row = np.zeros(SCALING)
    own = head.actuation
    row[WIDTH], row[RIGHT_WIDTH] = head.cameras.size[:, 0]
    row[CENTRE:HALF_RANGE] = 0.5 * (own.lower + own.upper)[EYES]
    row[HALF_RANGE:SPEED] = 0.5 * (own.upper - own.lower)[EYES] + ANGLE_MARGIN_RAD
    row[SPEED:LIMIT] = SPEED_MARGIN * own.velocity[EYES]
    row[LIMIT:RESTING_NECK] = own.velocity[EYES]
    row[RESTING_NECK:RIGHT_WIDTH] = head.rest()[NECK]
    row[DIRECT] = own.direct
    row[TO_JOINTS:OFFSET] = own.to_joints.ravel()
    row[OFFSET:TO_ACTUATORS] = own.offset
    row[TO_ACTUATORS:] = own.to_actuators.ravel()
    row.flags.writeable = False
    return row


def check_observation(observation: ArrayLike, size: int) -> NDArray[np.floating[Any]]:
    """Check observations and return them as an array.

    Args:
        observation: (..., size).
        size: length of one observation.

    Returns:
        Array of the observation's numbers.

    Raises:
        ConfigurationError: the length is wrong, or the numbers are not floating-point or not all
            finite.
    """
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
def _width(scaling: FloatArray, eye: int) -> float:
    width: float = scaling[WIDTH] if eye == 0 else scaling[RIGHT_WIDTH]
    return width


@subroutine
def _actuators(scaling: FloatArray, k: int, joints: FloatArray, offset: float) -> float:
    """Angle (offset 1.0) or velocity (offset 0.0) of actuator k, from that of the joints (7,)."""
    own = 0.0
    for j in range(SLOTS):
        beyond = joints[3 + j] - offset * scaling[OFFSET + j]
        own += scaling[TO_ACTUATORS + SLOTS * k + j] * beyond
    return own


@inlined
def encode_observation(
    out: NDArray[np.float32],
    scaling: FloatArray,
    error: FloatArray,
    reading: Reading,
    n: int,
    action: FloatArray,
    coupled_head: PackedHead | None,
) -> None:
    """Write the observation of one environment.

    Args:
        out: (11 + 4 m,) result.
        scaling: (SCALING,) see `packed_observation_scaling`.
        error: (2, 2) measured pixel errors, px.
        reading: readings of the batch.
        n: environment index.
        action: (m,) action of the present period.
        coupled_head: the packed head if its eye joints are coupled, else None.
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
    m = len(action)
    for k in range(m):
        if coupled_head is None:
            angle, rate = reading.positions[n, 3 + k], reading.velocities[n, 3 + k]
            at_exposure = reading.positions_at_exposure[n, 3 + k]
        else:
            angle = _actuators(scaling, k, reading.positions[n], 1.0)
            at_exposure = _actuators(scaling, k, reading.positions_at_exposure[n], 1.0)
            rate = _actuators(scaling, k, reading.velocities[n], 0.0)
        centre, half = scaling[CENTRE + k], scaling[HALF_RANGE + k]
        i = ACTUATORS + k
        out[i] = _clip((angle - centre) / half)
        out[i + m] = _clip((at_exposure - centre) / half)
        out[i + 2 * m] = _clip(rate / scaling[SPEED + k])
        out[i + 3 * m] = action[k]


_DIMENSION_DUMMIES: Final = (np.zeros(2), np.zeros(7), np.zeros(4))
"""Dummy operands: they name dimensions that `_decode` has only in its results (numerical)."""


def decode_observation(
    observation: ArrayLike, size: int, scaling: FloatArray
) -> tuple[NDArray[Any], ...]:
    """Decode observations to physical units.

    Args:
        observation: (..., size).
        size: length of one observation.
        scaling: (SCALING,) see `packed_observation_scaling`.

    Returns:
        The fields of `vergence.envs.layout.Observation`.

    Raises:
        ConfigurationError: the array does not hold observations.
    """
    numbers = check_observation(observation, size).astype(np.float64, copy=False)
    fields: tuple[NDArray[Any], ...] = _decode(numbers, scaling, *_DIMENSION_DUMMIES)
    return fields


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(o),({SCALING}),(2),(7),(4)->(2,2),(2),(),(7),(7),(7),(4)",
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
    """Compute the fields of `Observation`.

    The three arguments after `scaling` are `_DIMENSION_DUMMIES`, which only set sizes. At
    least `ACTUATORS` numbers are read, so callers must have checked the length.
    """
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
        positions[j] = at_exposure[j] = scaling[RESTING_NECK + j]
        velocities[j] = 0.0
    direct = scaling[DIRECT] > 0.5
    for j in range(SLOTS):
        start = 0.0 if direct else scaling[OFFSET + j]
        positions[3 + j] = at_exposure[3 + j] = start
        velocities[3 + j] = command[j] = 0.0
    m = min((len(obs) - ACTUATORS) // 4, SLOTS)
    for k in range(m):
        i, centre, half = ACTUATORS + k, scaling[CENTRE + k], scaling[HALF_RANGE + k]
        angle, then = centre + half * obs[i], centre + half * obs[i + m]
        rate = scaling[SPEED + k] * obs[i + 2 * m]
        command[k] = scaling[LIMIT + k] * obs[i + 3 * m]
        if direct:
            positions[3 + k], at_exposure[3 + k], velocities[3 + k] = angle, then, rate
            continue
        for j in range(SLOTS):
            factor = scaling[TO_JOINTS + SLOTS * j + k]
            positions[3 + j] += factor * angle
            at_exposure[3 + j] += factor * then
            velocities[3 + j] += factor * rate
