"""Target angles at the time the next command acts, and the pixel errors at that time."""

from math import exp, nan
from typing import Final

from vergence._jit import inlined
from vergence.controllers.prediction.joints import PredictorModel
from vergence.controllers.prediction.memory import PredictorState
from vergence.controllers.prediction.moving import extrapolate, visible_speed_fraction
from vergence.controllers.prediction.response import selected_model
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, camera_of
from vergence.models.pose import point_to_outer

_SURE: Final = 0.9
"""Probability of rest above which a target is treated as resting (chosen)."""
_CLEARLY: Final = 0.5
"""Fraction of the motion-blur speed limit (`PredictorModel.max_slip_rad_s`) that an eye may reach
relative to its target (chosen: margin for exposure against speed of pursuit)."""
_GRACE_S: Final = 0.03
"""Time after the next image is due during which an eye keeps following the extrapolated motion, s
(chosen: tolerates late frames)."""


@inlined
def extrapolate_targets(memory: PredictorState, rig: PredictorModel, tick: float) -> None:
    """Extrapolate the targets to a time in periods: their angles `aims` and angular rates `rates`.

    `later_rates` are the rates when that command shows in the motion, a lag and half a period
    later.
    """
    moves = rig.targets_move > 0.5 and memory.mode_probabilities[0] < _SURE
    effect_delay_s = exp(selected_model(memory.response).parameters[2]) + 0.5 * rig.period_s
    expected_s = memory.delay_s + rig.frame_s + (tick - memory.periods) * rig.period_s + _GRACE_S
    slow = 1.0
    for eye in range(2):
        for joint in range(2):
            memory.aims[eye, joint], memory.rates[eye, joint] = memory.goals[eye, joint], 0.0
            memory.later_rates[eye, joint] = 0.0
            if moves and memory.known[eye] > 0.5:
                time_s = (tick - memory.moved_at) * rig.period_s
                motions, resting = memory.motions[eye], memory.goals[eye, joint]
                if joint == 0:
                    slow = visible_speed_fraction(
                        motions, memory.mode_probabilities, _CLEARLY * rig.max_slip_rad_s
                    )
                angle, rate = extrapolate(
                    motions, memory.mode_probabilities, resting, joint, time_s, expected_s, slow
                )
                memory.aims[eye, joint], memory.rates[eye, joint] = angle, rate
                time_s += effect_delay_s
                _, rate = extrapolate(
                    motions,
                    memory.mode_probabilities,
                    resting,
                    joint,
                    time_s,
                    expected_s + effect_delay_s,
                    slow,
                )
                memory.later_rates[eye, joint] = rate


@inlined
def present_error(
    memory: PredictorState, p: PackedHead, eye: int, first: float, second: float
) -> tuple[float, float]:
    """Predict the pixel error of one eye at given joint angles.

    Args:
        memory: the predictor's state.
        p: a packed head.
        eye: index of the eye.
        first: angle of its first joint, rad.
        second: angle of its second joint, rad.

    Returns:
        Undistorted error along u and v, px; nan if the target is not known or lies behind the
        camera.
    """
    if memory.known[eye] < 0.5:
        return nan, nan
    # the point on the optical axis once the eye has turned to its aim
    camera = eye_frames(p, eye, memory.aims[eye, 0], memory.aims[eye, 1]).camera
    px, py, pz = point_to_outer(camera, 0.0, 0.0, memory.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first, second, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z
