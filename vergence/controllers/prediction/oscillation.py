"""Detection of sustained oscillation of the eyes about their goals.

In a loop with unmodelled properties (a servo unlike the model, a wrong delay, lost commands) any
fast law can oscillate for ever. Reversals of each eye joint are observed; a half swing is the
motion from one reversal to the next. A half swing is counted if it is about as long as the half
swing before and much longer than the goal's motion in that time. The first reversal towards a new
goal does not count.
"""

from math import exp2, pi, sqrt
from typing import Annotated, Final

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.kernels import inlined
from vergence.models.parts import FloatArray

_MIN_HALF_SWING_RAD: Final = 0.003
"""Least length of a half swing, rad, to which quantisation and detection noise are added
(chosen)."""
_HALF_SWING_STEPS: Final = 2.0
"""Encoder resolutions added to that length (chosen)."""
_HALF_SWING_SIGMAS: Final = 4.0
"""Standard deviations of a detection added to that length (chosen: 4 sigma)."""
_MAX_HALF_SWING_S: Final = 0.6
"""Duration above which a half swing does not count, s (chosen)."""
_MIN_SWING_SPEED: Final = 0.2
"""Peak-to-peak speed of the equivalent sinusoid below which a half swing does not count, rad/s
(chosen)."""
_MIN_GOAL_RATIO: Final = 2.0
"""Least ratio of a half swing to the goal's motion in that time (chosen)."""
_DYING_RATIO: Final = 0.3
"""Ratio of a half swing to the one before up to which an oscillation dies away: it counts 0
(chosen)."""
_SUSTAINED_RATIO: Final = 0.7
"""Ratio from which it is sustained: it counts 1, and proportionally in between (chosen)."""
_COUNT_KEPT_AT_JUMP: Final = 0.5
"""Factor that remains of the count after a jump of the target (chosen)."""
OSCILLATING_HALF_SWINGS: Final = 2.0
"""Count of half swings above which a law has to be calm (chosen)."""
MAX_HALF_SWINGS: Final = 6.0
"""Upper bound of the count (chosen)."""
_MIN_REDUCED_RATE: Final = 1.0
"""Lower bound of a calmed law's rate, 1/s (chosen)."""
INITIAL_DECAY_TIME_S: Final = 1.0
"""Initial time constant with which the count decays, s (chosen)."""


class OscillationState:
    """State of the detection of oscillation; arrays (2, 2) are by eye and joint."""

    direction: Annotated[FloatArray, 2, 2]
    """Direction of its present motion: 1, -1, or 0 before it has moved."""
    reversal_angle: Annotated[FloatArray, 2, 2]
    """Its angle at the last reversal, rad."""
    extreme_angle: Annotated[FloatArray, 2, 2]
    """Farthest angle in the present direction since then, rad."""
    goal_at_reversal: Annotated[FloatArray, 2, 2]
    """Its goal when that reversal was detected, rad."""
    goal_moved: Annotated[FloatArray, 2, 2, 2]
    """Largest distance of the goal from `goal_at_reversal` since then, and in the half swing
    before, rad."""
    last_half_swing: Annotated[FloatArray, 2, 2]
    """Length of the previous half swing, rad; 0 for none."""
    periods_since_reversal: Annotated[FloatArray, 2, 2]
    """Periods since that reversal was detected."""
    half_swing_count: float
    """Decayed count of half swings, at most `MAX_HALF_SWINGS`."""
    decay_time_s: float
    """Time constant with which the count decays, s; it doubles each time the count passes
    `OSCILLATING_HALF_SWINGS`."""


@inlined
def oscillation_reduced_rate(rate: float, half_swings: float) -> float:
    """Rate of a linear law, 1/s, halved for each half swing beyond `OSCILLATING_HALF_SWINGS`."""
    return max(
        rate * exp2(-max(half_swings - OSCILLATING_HALF_SWINGS, 0.0)), min(rate, _MIN_REDUCED_RATE)
    )


@inlined
def reduce_count_at_jump(oscillation: OscillationState) -> None:
    """Reduce the count, because the target has jumped."""
    oscillation.half_swing_count *= _COUNT_KEPT_AT_JUMP


@inlined
def decay_count(oscillation: OscillationState, period_s: float) -> None:
    """Let the count decay over a period."""
    oscillation.half_swing_count -= oscillation.half_swing_count * min(
        period_s / oscillation.decay_time_s, 1.0
    )


@inlined
def reset_oscillation(oscillation: OscillationState, eye: int, joint: int, angle: float) -> None:
    """Initialise a joint at rest at an angle, rad."""
    oscillation.reversal_angle[eye, joint] = oscillation.extreme_angle[eye, joint] = angle


@inlined
def update_oscillation(
    oscillation: OscillationState,
    params: PredictorParameters,
    eye: int,
    joint: int,
    angle: float,
    goal: float,
    detection_variance: float,
) -> None:
    """Update the detection of oscillation with one eye joint's angle and goal.

    Args:
        oscillation: changed in place.
        params: the head's parameters.
        eye: index of the eye.
        joint: index of its joint.
        angle: its present angle, rad.
        goal: its goal, rad.
        detection_variance: detection variance, rad^2.
    """
    least = (
        _MIN_HALF_SWING_RAD
        + _HALF_SWING_STEPS * params.joint_step[eye, joint]
        + _HALF_SWING_SIGMAS * sqrt(detection_variance)
    )
    side, farthest = oscillation.direction[eye, joint], oscillation.extreme_angle[eye, joint]
    oscillation.periods_since_reversal[eye, joint] += 1.0
    goal_moved = abs(goal - oscillation.goal_at_reversal[eye, joint])
    oscillation.goal_moved[eye, joint, 0] = max(oscillation.goal_moved[eye, joint, 0], goal_moved)
    if oscillation.periods_since_reversal[eye, joint] * params.period_s > _MAX_HALF_SWING_S:
        oscillation.last_half_swing[eye, joint] = 0.0
    if side == 0.0:
        off = angle - oscillation.reversal_angle[eye, joint]
        if abs(off) > least:
            oscillation.direction[eye, joint] = 1.0 if off > 0.0 else -1.0
            oscillation.extreme_angle[eye, joint] = angle
            (
                oscillation.periods_since_reversal[eye, joint],
                oscillation.goal_at_reversal[eye, joint],
            ) = 0.0, goal
        return
    if side * (angle - farthest) >= 0.0:
        oscillation.extreme_angle[eye, joint] = angle
        return
    if side * (farthest - angle) < least:
        return
    half = abs(farthest - oscillation.reversal_angle[eye, joint])
    goal_moved = max(oscillation.goal_moved[eye, joint, 0], oscillation.goal_moved[eye, joint, 1])
    oscillation.goal_moved[eye, joint, 1] = oscillation.goal_moved[eye, joint, 0]
    oscillation.goal_moved[eye, joint, 0] = 0.0
    before = oscillation.last_half_swing[eye, joint]
    time_s = (oscillation.periods_since_reversal[eye, joint]) * params.period_s
    fast = pi * half > _MIN_SWING_SPEED * time_s
    if before > 0.0 and fast and half > _MIN_GOAL_RATIO * goal_moved:
        share = (half / before - _DYING_RATIO) / (_SUSTAINED_RATIO - _DYING_RATIO)
        count = min(oscillation.half_swing_count + min(max(share, 0.0), 1.0), MAX_HALF_SWINGS)
        if oscillation.half_swing_count <= OSCILLATING_HALF_SWINGS < count:
            oscillation.decay_time_s *= 2.0
        oscillation.half_swing_count = count
    oscillation.last_half_swing[eye, joint], oscillation.goal_at_reversal[eye, joint] = half, goal
    oscillation.direction[eye, joint], oscillation.periods_since_reversal[eye, joint] = -side, 0.0
    oscillation.reversal_angle[eye, joint], oscillation.extreme_angle[eye, joint] = farthest, angle
