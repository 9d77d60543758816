r"""Commands of actuators that take speeds in steps and do not move at one step or less.

A slow turn is then made of pulses of two steps, with pauses: what rounding leaves of a command is
carried over to the next period, so that the mean speed is the one that was asked for (error
feedback, the first-order sigma-delta modulator). Without it a law proportional to the error stops
where its command falls below a step and a half, which at a gain of 3 per second and a step of
0.024 rad/s is at 12 mrad: seven pixels at a focal length of 620 pixels.
"""

from typing import Final

import numpy as np

from vergence._jit import kernel
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_ROUNDING: Final = 1e-9


class CommandSteps:
    """The steps of a head's commands, and what they leave.

    Args:
        head: the model of the head.
        limits: (4,) greatest speeds of the actuators, rad/s.
    """

    def __init__(self, head: HeadModel, limits: FloatArray) -> None:
        self.step_rad_s = head.sensor.command_resolution_rad_s
        self._limits = np.array(limits)

    def sent(self, command: FloatArray, carried: FloatArray) -> FloatArray:
        """The commands to send; without steps they are those that are asked for.

        Args:
            command: (..., 4) velocities of the actuators, rad/s. One that is zero asks for rest,
                and forgets what was carried.
            carried: (..., 4) what is carried over, rad/s, brought up to date in place.

        Returns:
            (..., 4) rad/s, in whole steps and never one alone.
        """
        if not self.step_rad_s > 0.0:
            return command
        carried[...], sent = in_steps(carried, command, self.step_rad_s, self._limits)
        return np.asarray(sent)


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"], "(4),(4),(),(4)->(4),(4)")
def in_steps(
    before: FloatArray,
    command: FloatArray,
    step: FloatArray,
    limits: FloatArray,
    after: FloatArray,
    out: FloatArray,
) -> None:
    """What is carried over, and the commands in steps."""
    size = step[0]
    for k in range(4):
        after[k] = out[k] = 0.0
        if command[k] == 0.0:
            continue
        wanted = command[k] + before[k]
        most = np.floor(limits[k] / size * (1.0 + _ROUNDING))
        count = min(max(np.rint(wanted / size), -most), most)
        if abs(count) < 1.5:
            count = 0.0
        out[k] = size * count
        # more than pauses leave is what the limits cut off, and that is lost
        after[k] = min(max(wanted - out[k], -1.5 * size), 1.5 * size)
