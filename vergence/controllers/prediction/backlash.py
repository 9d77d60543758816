r"""Effect of backlash between motors and eyes on the goals.

An encoder on the motor's side does not show which end of the backlash (play) the eye is at. When a
motor reverses and has crossed its backlash, the motor angles that fixate a resting target differ by
the backlash. An eye that turns to each new goal lags by the images' delay every time and never
comes to rest. Therefore goals get a larger variance when a motor reverses. Goals that jump to and
fro as their motors reverse reveal the backlash; a mean of both lies within it, and there the eye
keeps its direction.
"""

from typing import Final

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.moving import MODELS, Motions
from vergence.controllers.prediction.predictor_state import PredictorState
from vergence.kernels import inlined
from vergence.models.kinematics import PackedHead, joint_per_actuator
from vergence.models.parts import FloatArray

_CROSSING_SD_RAD: Final = 0.0006
"""Shift of a goal while a motor crosses its backlash, standard deviation, rad (chosen)."""
_MAX_BACKLASH_RAD: Final = 0.012
"""Largest shift that is taken for backlash, rad (chosen)."""
_MIN_BACKLASH_RAD: Final = 0.0012
"""Smallest shift that is taken for backlash, rad (chosen)."""
_MIN_SQUARED_SHIFT: Final = 16.0
"""Squared shift of a goal, relative to the detection variance, above which it is no noise (chosen:
4 sigma)."""
_MIN_REVERSING_COMMAND: Final = 0.01
"""Command below which a motor does not reverse, rad/s (chosen)."""
_RECENT_REVERSAL_S: Final = 0.25
"""Time after a reversal for which an eye may be at either end of the backlash, s (chosen)."""
_VARIANCE_DECAY: Final = 0.98
"""Per-image decay of the backlash variance that has been found (chosen)."""


@inlined
def inflate_variance_at_reversal(state: PredictorState, p: PackedHead, command: FloatArray) -> None:
    """Increase the variance of goals whose motors are about to reverse and cross their backlash.

    Args:
        state: changed in place.
        p: a packed head.
        command: (4,) commands of the actuators, rad/s.
    """
    for k in range(4):
        if abs(command[k]) < _MIN_REVERSING_COMMAND:
            continue
        side = 1.0 if command[k] > 0.0 else -1.0
        if state.last_direction[k] == side:
            continue
        state.last_direction[k] = side
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            if share == 0.0:
                continue
            eye, joint, backlash = j // 2, j % 2, _CROSSING_SD_RAD * share
            state.filter_variance[eye, joint] += backlash * backlash
            state.reversal_tick[eye, joint] = state.periods
            motions: Motions = state.motions[eye]
            for m in range(MODELS):  # half, as the covariance is common to both joints
                motions[m].covariance[0] += 0.5 * backlash * backlash


@inlined
def update_backlash_variance(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    eye: int,
    joint: int,
    measured_goal: float,
    at_rest: bool,
) -> float:
    """Update the backlash estimate with a measured goal; return its contribution to the variance.

    Args:
        state: the predictor's state; its backlash estimate is updated in place.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        eye: index of the eye.
        joint: index of its joint.
        measured_goal: the measured goal, rad.
        at_rest: True if the target is taken to rest.

    Returns:
        The variance, rad^2; 0 if the motor has not reversed recently.
    """
    state.backlash_variance[eye, joint] *= _VARIANCE_DECAY
    since_s = (exposure_tick - state.reversal_tick[eye, joint]) * params.period_s
    if since_s > _RECENT_REVERSAL_S:
        return 0.0
    off = measured_goal - state.goals[eye, joint]
    clear = off * off > max(
        _MIN_SQUARED_SHIFT * state.detection_variance, _MIN_BACKLASH_RAD * _MIN_BACKLASH_RAD
    )
    if at_rest and clear and abs(off) < _MAX_BACKLASH_RAD:
        half = 0.5 * off
        if state.jump_sign[eye, joint] * off < 0.0:
            state.backlash_variance[eye, joint] = max(
                state.backlash_variance[eye, joint], half * half
            )
        state.jump_sign[eye, joint] = 1.0 if off > 0.0 else -1.0
    found: float = state.backlash_variance[eye, joint]
    return found
