r"""Rest near a goal for joints that static friction holds.

A servo's inner loop integrates a command too small to move its joint, until static friction breaks
and the joint jumps, often past the goal: a law that corrects every small error jumps to and fro for
ever. Commands that should have moved a joint by more than its encoder can miss, and have not, show
that something holds it. From then on an actuator that comes to rest near its goal is held: the law
sees no error until the error is clear. Backlash may show the same, and is none the worse for it.

If much more motion is absent, it is friction, and a clear error is corrected in a step, which ends
when the joint has moved, and whose result is seen in images before the next one. In a step the law
sees twice the error, so that the integral turns round sooner, and the reverse of it once the joint
has broken away, which brakes the jump. Without such commands nothing changes.
"""

from typing import Annotated, Final

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.kernels import inlined
from vergence.models.parts import FloatArray

_MIN_MOTION_RAD: Final = 2e-4
"""Least change of a reading that is motion, rad (chosen: with exact encoders)."""
_MIN_SPEED_RAD_S: Final = 0.005
"""Least velocity reading that is motion, rad/s (chosen: with exact readings)."""
_MAX_CREEP_RAD_S: Final = 0.1
"""Fastest command that may show friction, rad/s (chosen: late motors are no evidence)."""
_MIN_STUCK_RAD: Final = 1e-3
"""Commanded motion, beyond the encoder's resolution, that holds actuators by its absence, rad
(chosen)."""
_MIN_FRICTION_RAD: Final = 7.5e-3
"""Such motion whose absence shows friction, rad (chosen: backlash hides less)."""
_HOLD_PX: Final = 0.6
"""Error up to which a held actuator stays held, px (chosen: two joints of an eye within 1 px)."""
_FAR_PX: Final = 3.0
"""Error above which an actuator is not stopped by its motion, px (chosen)."""
_LOOK_S: Final = 0.15
"""Time after a motion, beyond the delay of images, until the next step, s (chosen: four images of
30 a second)."""
_REACHED_RATIO: Final = 0.5
"""Ratio to that error below which a step is no longer due (chosen)."""
_PUSH_RATIO: Final = 2.0
"""Ratio of the error that a law sees in a step to the true one (chosen: to turn the integral round
sooner; the same backwards brakes)."""
_BRAKE_S: Final = 0.05
"""Longest time for which a step is braked, s (chosen)."""

_HELD: Final = 0.0
"""Mode of an actuator held near its goal (numerical)."""
_BRAKES: Final = 1.0
"""Mode of an actuator whose step is braked (numerical)."""
_STEPS: Final = 2.0
"""Mode of an actuator that makes a step (numerical)."""
_TURNS: Final = 3.0
"""Mode of an actuator that the law turns freely (numerical)."""


class FrictionState:
    """State of the hold; arrays of four are by actuator."""

    absent_rad: float
    """Largest commanded motion, beyond the encoders' resolution, that a joint has not made, rad."""
    angle: Annotated[FloatArray, 4]
    """Measured angle after the last motion, rad."""
    motion_tick: Annotated[FloatArray, 4]
    """Period of the last motion."""
    push: Annotated[FloatArray, 4]
    """Commanded motion since then, rad."""
    mode: Annotated[FloatArray, 4]
    """Present mode: held, braking after a step, making a step, or turning freely."""
    step_tick: Annotated[FloatArray, 4]
    """Period in which the last step was seen."""
    step_error: Annotated[FloatArray, 4]
    """Angle to the goal before that step, rad."""


@inlined
def error_to_correct(
    friction: FrictionState,
    params: PredictorParameters,
    tick: float,
    j: int,
    measured_angle: float,
    measured_velocity: float,
    acting_velocity: float,
    angle_error: float,
    goal_moves: bool,
    image_delay_s: float,
) -> tuple[float, bool]:
    """Update an actuator with a period's reading; return its error, and whether it is at rest.

    Args:
        friction: changed in place.
        params: the head's parameters.
        tick: the period that has ended.
        j: index of the actuator.
        measured_angle: its measured angle, rad.
        measured_velocity: its measured velocity, rad/s.
        acting_velocity: velocity that the commands whose motion shows by now ask for, rad/s.
        angle_error: angle to its goal, rad.
        goal_moves: True if the goal moves.
        image_delay_s: delay of images behind readings, s.

    Returns:
        The angle that a law is to correct, rad: none of an actuator that is held, and backwards of
        one that brakes. True if the law is to take its velocity for zero.
    """
    step, period = params.angle_step[j], params.period_s
    moved = abs(measured_angle - friction.angle[j]) > max(0.5 * step, _MIN_MOTION_RAD)
    runs = abs(measured_velocity) > max(0.5 * params.speed_step[j], _MIN_SPEED_RAD_S)
    if moved or abs(acting_velocity) > _MAX_CREEP_RAD_S:
        friction.push[j] = 0.0
    else:
        friction.push[j] += acting_velocity * period
    if moved:
        friction.angle[j] = measured_angle
    if moved or runs:
        friction.motion_tick[j] = tick
    friction.absent_rad = max(friction.absent_rad, abs(friction.push[j]) - step)
    sticks = friction.absent_rad > _MIN_FRICTION_RAD
    error_px = abs(angle_error) * params.max_joint_per_actuator[j] / params.pixel_rad
    if friction.absent_rad < _MIN_STUCK_RAD or goal_moves or error_px > _FAR_PX:
        friction.mode[j] = _TURNS
    elif friction.mode[j] == _HELD:
        rested_s = (tick - friction.motion_tick[j]) * period
        if error_px > _HOLD_PX and rested_s > image_delay_s + _LOOK_S:
            friction.mode[j] = _STEPS if sticks else _TURNS
            friction.step_error[j] = angle_error
    elif friction.mode[j] == _TURNS:
        if error_px < _HOLD_PX and not runs:
            friction.mode[j] = _HELD
    elif friction.mode[j] == _STEPS:
        if moved or runs:
            friction.mode[j], friction.step_tick[j] = _BRAKES, tick
        elif error_px < _REACHED_RATIO * _HOLD_PX:
            friction.mode[j] = _HELD
    elif (
        not runs
        or measured_velocity * friction.step_error[j] < 0.0
        or (tick - friction.step_tick[j]) * period > _BRAKE_S
    ):
        friction.mode[j] = _HELD
    if friction.mode[j] == _TURNS:
        return angle_error, False
    if friction.mode[j] == _STEPS:
        return _PUSH_RATIO * angle_error, True
    return 0.0 if friction.mode[j] == _HELD else -_PUSH_RATIO * friction.step_error[j], True
