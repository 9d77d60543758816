r"""Quantised velocity commands, for actuators that do not move at one step or less.

A slow turn is made of pulses of two steps, with pauses. The rounding error of a command is carried
over to the next period, so that the mean velocity is the requested one (error feedback, the
first-order sigma-delta modulator). Otherwise a law proportional to the error would stop where its
command falls below one and a half steps: with a gain of 3 per second and a step of 0.024 rad/s, at
12 mrad, which are seven pixels at a focal length of 620 pixels.
"""

from typing import Final

import numpy as np

from vergence.kernels import kernel
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_ROUNDING: Final = 1e-9
"""Relative tolerance for rounding the limit to whole steps (numerical)."""


class CommandQuantiser:
    """Quantises a head's commands and carries the rounding errors over.

    Args:
        head: the model of the head.
        limits: (4,) largest speeds of the actuators, rad/s.
    """

    def __init__(self, head: HeadModel, limits: FloatArray) -> None:
        self.step_rad_s = head.sensor.command_resolution_rad_s
        self._limits = np.array(limits)

    def quantise(self, command: FloatArray, carried: FloatArray) -> FloatArray:
        """Compute the commands to send; without quantisation they are the requested ones.

        Args:
            command: (..., 4) requested velocities of the actuators, rad/s. A zero requests rest and
                discards the error carried over.
            carried: (..., 4) rounding errors carried over, rad/s, updated in place.

        Returns:
            (..., 4) rad/s, in whole steps, never a single one.
        """
        if not self.step_rad_s > 0.0:
            return command
        carried[...], quantised = quantise_command(carried, command, self.step_rad_s, self._limits)
        return np.asarray(quantised)


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"], "(4),(4),(),(4)->(4),(4)")
def quantise_command(
    carried_before: FloatArray,
    command: FloatArray,
    step: FloatArray,
    limits: FloatArray,
    carried_after: FloatArray,
    out: FloatArray,
) -> None:
    """Quantise commands to whole steps, never a single one, and carry the remainders over.

    Args:
        carried_before: (4,) remainders of the last period, rad/s.
        command: (4,) commands, rad/s.
        step: () resolution of the commands, rad/s.
        limits: (4,) largest commands, rad/s.
        carried_after: (4,) result: remainders, at most 1.5 steps; 0 where the command is 0.
        out: (4,) result: quantised commands, rad/s.
    """
    size = step[0]
    for k in range(4):
        carried_after[k] = out[k] = 0.0
        if command[k] == 0.0:
            continue
        wanted = command[k] + carried_before[k]
        most = np.floor(limits[k] / size * (1.0 + _ROUNDING))
        count = min(max(np.rint(wanted / size), -most), most)
        if abs(count) < 1.5:
            count = 0.0
        out[k] = size * count
        # an excess over 1.5 steps was cut off by the limits and is discarded
        carried_after[k] = min(max(wanted - out[k], -1.5 * size), 1.5 * size)
