"""What trials really run with: by name for people, in rows for kernels."""

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence._runs import run_of
from vergence.envs.plants.imperfections import OWN, SCALARS, Imperfections
from vergence.models.parts import FloatArray

Place = int | np.unsignedinteger[Any]
"""A place in the batch; unsigned where no index has to be counted from the end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions(Imperfections[FloatArray]):
    """What the trials of a batch of heads really run with, hidden from the controller.

    The fields but the last are (n,) each, or (n, 7) by the neck's joints and the eyes' actuators.
    """

    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""

    def __iter__(self) -> Iterator[FloatArray]:
        return iter(vars(self).values())


class Drawn(NamedTuple):
    """The same as kernels take it, for whom few arrays are quick to hand on."""

    loop: FloatArray
    """(n, LOOP) a row of `Loop` for each trial."""
    own: FloatArray
    """(n, OWN, 7) speed gains, and backlashes in rad."""
    heads: FloatArray
    """(n or 1, PACKED)."""


if TYPE_CHECKING:

    class Loop(Imperfections[float]):
        """The conditions of one trial of which it has one number each."""

        frame_s: float
        """From one exposure to the next, by the rate and the clock's drift."""

        def __init__(self, *numbers: float) -> None: ...

else:  # kernels know named tuples
    Loop = namedtuple("Loop", (*SCALARS, "frame_s"))

LOOP: Final = len(SCALARS) + 1
_loop_run = run_of(LOOP)
GAIN: Final = OWN.index("speed_gain")
BACKLASH: Final = OWN.index("backlash_rad")


@device
def loop_of(drawn: Drawn, n: Place) -> Loop:
    """The conditions of one trial."""
    return Loop(*_loop_run(drawn.loop[n], 0))
