"""Smallest effective command of a motor with quantised speed, for laws near their goal."""

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.kernels import inlined


@inlined
def compensate_dead_zone(
    u: float, error_after_coasting: float, params: PredictorParameters, gain: float
) -> float:
    """Replace a command too small to move the motor by the smallest effective pulse, or by zero.

    Args:
        u: the command, rad/s.
        error_after_coasting: distance from the goal at which the actuator would come to rest under
            zero command, rad.
        params: the head's parameters.
        gain: ratio of the actuator's velocity to its command.
    """
    step = params.command_step
    if step == 0.0 or abs(u) >= 1.5 * step:
        return u
    push = 2.0 * step
    if abs(u) > 0.3 * step and abs(error_after_coasting) > 0.6 * push * gain * params.period_s:
        return push if u > 0.0 else -push
    return 0.0
