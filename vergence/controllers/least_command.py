"""The least command that moves a motor whose speed is set in steps, for laws near their goal."""

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig


@device
def least_command(u: float, to_go: float, rig: Rig, gain: float) -> float:
    """A command, or where it is too small to move anything, a push of the least that does.

    Args:
        u: the command, rad/s.
        to_go: how far the actuator would come to rest from its goal under a command of zero, rad.
        rig: what is known of the head.
        gain: the actuator's speed by command.
    """
    step = rig.command_step
    if step == 0.0 or abs(u) >= 1.5 * step:
        return u
    push = 2.0 * step
    if abs(u) > 0.3 * step and abs(to_go) > 0.6 * push * gain * rig.period_s:
        return push if u > 0.0 else -push
    return 0.0
