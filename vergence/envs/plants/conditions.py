"""Actual conditions of trials: by name for Python code, in packed arrays for kernels."""

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from vergence.envs.plants.imperfections import PER_ACTUATOR, PER_TRIAL, Imperfections
from vergence.kernels import inlined, make_tuple_reader
from vergence.models.parts import FloatArray

EnvIndex = int | np.unsignedinteger[Any]
"""Environment index; unsigned to spare kernels the check for a negative index."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions(Imperfections[FloatArray]):
    """Actual conditions of the trials of a batch, hidden from the controller.

    All fields but `heads` have the shape (n,), or (n, 7) for the neck's joints and the eye
    actuators.
    """

    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""

    def __iter__(self) -> Iterator[FloatArray]:
        return iter(vars(self).values())


class PackedConditions(NamedTuple):
    """`Conditions` packed into three arrays, the form kernels take."""

    loop: FloatArray
    """(n, TRIAL_CONDITIONS) one row of `TrialConditions` per trial."""
    own: FloatArray
    """(n, PER_ACTUATOR, 7) speed gains, and backlashes in rad, per actuator."""
    heads: FloatArray
    """(n or 1, PACKED) the true heads."""


if TYPE_CHECKING:

    class TrialConditions(Imperfections[float]):
        """The scalar conditions of one trial."""

        frame_s: float
        """Time from one frame to the next, s, from frame rate and clock drift."""

        def __init__(self, *numbers: float) -> None: ...

else:  # kernels take named tuples, but no dataclasses
    TrialConditions = namedtuple("TrialConditions", (*PER_TRIAL, "frame_s"))

TRIAL_CONDITIONS: Final = len(PER_TRIAL) + 1
"""Length of a row of `TrialConditions` (numerical)."""
_read_trial_conditions = make_tuple_reader(TRIAL_CONDITIONS)
GAIN: Final = PER_ACTUATOR.index("speed_gain")
BACKLASH: Final = PER_ACTUATOR.index("backlash_rad")


@inlined
def unpack_conditions(packed: PackedConditions, n: EnvIndex) -> TrialConditions:
    """Unpack the scalar conditions of one trial."""
    return TrialConditions(*_read_trial_conditions(packed.loop[n], 0))
