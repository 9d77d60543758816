"""Eyes that do not come to rest about their goals: sustained oscillation, and static friction.

In a loop with unmodelled properties (a servo unlike the model, a wrong delay, lost commands) any
fast law can oscillate for ever. A half swing is the motion of an eye joint from one reversal to the
next; it counts if it is about as long as the one before and much longer than the goal's motion in
that time. The first reversal towards a new goal does not count.

With static friction, a servo's inner loop integrates a command too small to move its joint, until
static friction breaks and the joint jumps, often past the goal: a law that corrects every small
error jumps to and fro for ever. Commands that should have moved a joint by more than its encoder
can miss, and have not, show that something holds it. From then on an actuator that comes to rest
near its goal is held: the law sees no error until the error is clear. Backlash may show the same,
and is none the worse for it.

If much more motion is absent, it is friction, and a clear error is corrected in a step, which ends
when the joint has moved, and whose result is seen in images before the next one. In a step the law
sees twice the error, so that the integral turns round sooner, and the reverse of it once the joint
has broken away, which brakes the jump. Without such commands nothing changes.
"""

from math import exp2, pi, sqrt
from typing import Annotated, Final

from vergence.controllers.prediction.parameters import PredictorParameters
from vergence.kernels import inlined
from vergence.models.parts import FloatArray

_MIN_HALF_SWING_RAD: Final = 0.003
"""Least length of a half swing before quantisation and detection noise are added, rad (chosen)."""
_HALF_SWING_STEPS: Final = 2.0  # encoder resolutions added to that length (chosen)
_HALF_SWING_SIGMAS: Final = 4.0
"""Standard deviations of a detection added to that length (chosen: 4 sigma)."""
_MAX_HALF_SWING_S: Final = 0.6  # duration above which a half swing does not count, s (chosen)
_MIN_SWING_SPEED: Final = 0.2
"""Least peak-to-peak speed of the sinusoid like a half swing that counts, rad/s (chosen)."""
_MIN_GOAL_RATIO: Final = 2.0
"""Least ratio of a half swing to the goal's motion in that time (chosen)."""
_SUSTAINED_RATIOS: Final = (0.3, 0.7)
"""Ratios of a half swing to the one before between which it counts from 0 to 1 (chosen)."""
COUNT_KEPT_AT_JUMP: Final = 0.5
"""Factor that remains of the count after a jump of the target (chosen)."""
OSCILLATING_HALF_SWINGS: Final = 2.0
"""Count of half swings above which a law has to be calm (chosen)."""
MAX_HALF_SWINGS: Final = 6.0
"""Upper bound of the count (chosen)."""
_MIN_REDUCED_RATE: Final = 1.0  # lower bound of a calmed law's rate, 1/s (chosen)
INITIAL_DECAY_TIME_S: Final = 1.0
"""Initial time constant with which the count decays, s (chosen)."""


class OscillationState:
    """State of the detection of oscillation; arrays (2, 2) are by eye and joint."""

    direction: Annotated[FloatArray, 2, 2]  # of its present motion: 1, -1, or 0 before any
    reversal_angle: Annotated[FloatArray, 2, 2]  # angle at the last reversal, rad
    extreme_angle: Annotated[FloatArray, 2, 2]  # farthest angle in that direction since then, rad
    goal_at_reversal: Annotated[FloatArray, 2, 2]  # goal when the reversal was detected, rad
    goal_moved: Annotated[FloatArray, 2, 2, 2]  # the goal's way since then and before, rad
    last_half_swing: Annotated[FloatArray, 2, 2]  # length of the half swing before, rad; 0 for none
    periods_since_reversal: Annotated[FloatArray, 2, 2]  # periods since that reversal was detected
    half_swing_count: float  # decayed count of half swings, at most `MAX_HALF_SWINGS`
    decay_time_s: float  # time constant of the count's decay, doubled by each new oscillation


@inlined
def oscillation_reduced_rate(rate: float, half_swings: float) -> float:
    """Rate of a linear law, 1/s, halved for each half swing beyond `OSCILLATING_HALF_SWINGS`."""
    reduced = rate * exp2(-max(half_swings - OSCILLATING_HALF_SWINGS, 0.0))
    return max(reduced, min(rate, _MIN_REDUCED_RATE))


@inlined
def decay_count(oscillation: OscillationState, period_s: float) -> None:
    """Let the count decay over a period."""
    share = min(period_s / oscillation.decay_time_s, 1.0)
    oscillation.half_swing_count -= oscillation.half_swing_count * share


@inlined
def reset_oscillation(oscillation: OscillationState, eye: int, joint: int, angle: float) -> None:
    """Initialise a joint at rest at an angle, rad."""
    oscillation.reversal_angle[eye, joint] = oscillation.extreme_angle[eye, joint] = angle


@inlined
def update_oscillation(
    oscillation: OscillationState, params: PredictorParameters, eye: int, joint: int,
    angle: float, goal: float, detection_variance: float,
) -> None:  # fmt: skip
    """Update the detection of oscillation with one eye joint's angle and goal, rad."""
    at, moved = (eye, joint), oscillation.goal_moved[eye, joint]
    least = _MIN_HALF_SWING_RAD + _HALF_SWING_STEPS * params.joint_step[at]
    least += _HALF_SWING_SIGMAS * sqrt(detection_variance)
    side, farthest = oscillation.direction[at], oscillation.extreme_angle[at]
    oscillation.periods_since_reversal[at] += 1.0
    time_s = oscillation.periods_since_reversal[at] * params.period_s
    moved[0] = max(moved[0], abs(goal - oscillation.goal_at_reversal[at]))
    if time_s > _MAX_HALF_SWING_S:
        oscillation.last_half_swing[at] = 0.0
    if side == 0.0:
        off = angle - oscillation.reversal_angle[at]
        if abs(off) > least:
            oscillation.direction[at] = 1.0 if off > 0.0 else -1.0
            oscillation.extreme_angle[at], oscillation.goal_at_reversal[at] = angle, goal
            oscillation.periods_since_reversal[at] = 0.0
        return
    if side * (angle - farthest) >= 0.0:
        oscillation.extreme_angle[at] = angle
        return
    if side * (farthest - angle) < least:
        return
    half, before = abs(farthest - oscillation.reversal_angle[at]), oscillation.last_half_swing[at]
    goal_moved = max(moved[0], moved[1])
    moved[1], moved[0] = moved[0], 0.0
    fast = pi * half > _MIN_SWING_SPEED * time_s
    if before > 0.0 and fast and half > _MIN_GOAL_RATIO * goal_moved:
        low, high = _SUSTAINED_RATIOS
        share = (half / before - low) / (high - low)
        count = min(oscillation.half_swing_count + min(max(share, 0.0), 1.0), MAX_HALF_SWINGS)
        if oscillation.half_swing_count <= OSCILLATING_HALF_SWINGS < count:
            oscillation.decay_time_s *= 2.0
        oscillation.half_swing_count = count
    oscillation.last_half_swing[at], oscillation.goal_at_reversal[at] = half, goal
    oscillation.direction[at], oscillation.periods_since_reversal[at] = -side, 0.0
    oscillation.reversal_angle[at], oscillation.extreme_angle[at] = farthest, angle


_MIN_MOTION_RAD: Final = 2e-4
"""Least change of a reading that is motion, rad (chosen: with exact encoders)."""
_MIN_SPEED_RAD_S: Final = 0.005
"""Least velocity reading that is motion, rad/s (chosen: with exact readings)."""
_MAX_CREEP_RAD_S: Final = 0.1
"""Fastest command that may show friction, rad/s (chosen: late motors are no evidence)."""
_MIN_STUCK_RAD: Final = 1e-3
"""Commanded motion beyond the resolution that holds actuators by its absence, rad (chosen)."""
_MIN_FRICTION_RAD: Final = 7.5e-3
"""Such motion whose absence shows friction, rad (chosen: backlash hides less)."""
_HOLD_PX: Final = 0.6
"""Error up to which a held actuator stays held, px (chosen: two joints of an eye within 1 px)."""
_FAR_PX: Final = 3.0  # error above which an actuator is not stopped by its motion, px (chosen)
_LOOK_S: Final = 0.15
"""Time from a motion, beyond the delay of images, to a step, s (chosen: four images at 30 Hz)."""
_REACHED_RATIO: Final = 0.5  # ratio to that error below which a step is no longer due (chosen)
_PUSH_RATIO: Final = 2.0
"""Ratio of the error that a law sees in a step to the true one (chosen: turns integrals sooner)."""
_BRAKE_S: Final = 0.05  # longest time for which a step is braked, s (chosen)

_HELD: Final = 0.0  # mode of an actuator held near its goal (numerical)
_BRAKES: Final = 1.0  # mode of an actuator whose step is braked (numerical)
_STEPS: Final = 2.0  # mode of an actuator that makes a step (numerical)
_TURNS: Final = 3.0  # mode of an actuator that the law turns freely (numerical)


class FrictionState:
    """State of the hold; arrays of four are by actuator."""

    absent_rad: float  # largest commanded motion beyond the resolution that a joint has not made
    angle: Annotated[FloatArray, 4]  # measured angle after the last motion, rad
    motion_tick: Annotated[FloatArray, 4]  # period of the last motion
    push: Annotated[FloatArray, 4]  # commanded motion since then, rad
    mode: Annotated[FloatArray, 4]  # held, braking after a step, making a step, or turning freely
    step_tick: Annotated[FloatArray, 4]  # period in which the last step was seen
    step_error: Annotated[FloatArray, 4]  # angle to the goal before that step, rad


@inlined
def error_to_correct(
    friction: FrictionState, params: PredictorParameters, tick: float, j: int,
    measured_angle: float, measured_velocity: float, acting_velocity: float,
    angle_error: float, goal_moves: bool, image_delay_s: float,
) -> tuple[float, bool]:  # fmt: skip
    """Update an actuator with a period's reading; return its error to correct, and if it rests.

    `acting_velocity` is what the commands whose motion shows by now ask for, rad/s. The error is 0
    while the actuator is held, and backwards while it brakes.
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
