"""Target angles at the time the next command acts, and the pixel errors at that time."""

from math import exp, nan
from typing import Final

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.moving import extrapolate_goal, visible_speed_fraction
from vergence.controllers.prediction.predictor_state import PredictorState
from vergence.controllers.prediction.response import selected_model
from vergence.kernels import inlined
from vergence.models.kinematics import (
    PackedHead,
    camera_of,
    eye_frames,
    point_in_eye,
    point_to_outer,
)

_REST_PROBABILITY: Final = 0.9
"""Probability of rest above which a target is treated as resting (chosen)."""
_BLUR_SPEED_FRACTION: Final = 0.5
"""Fraction of the motion-blur speed limit (`PredictorParameters.max_slip_rad_s`) that an eye may
reach relative to its target (chosen: margin for exposure against speed of pursuit)."""
_LATE_IMAGE_GRACE_S: Final = 0.03
"""Time after the next image is due during which an eye keeps following the extrapolated motion, s
(chosen: tolerates late frames)."""


@inlined
def extrapolate_targets(state: PredictorState, params: PredictorParameters, tick: float) -> None:
    """Extrapolate the targets to a time in periods: `goals_at_effect` and `goal_rates`.

    `goal_rates_at_effect` are the rates when the command given now takes effect, a lag and half a
    period later.
    """
    moves = params.targets_move > 0.5 and state.mode_probabilities[0] < _REST_PROBABILITY
    effect_delay_s = exp(selected_model(state.response).parameters[2]) + 0.5 * params.period_s
    expected_s = (
        state.delay_s
        + params.frame_period_s
        + (tick - state.periods) * params.period_s
        + _LATE_IMAGE_GRACE_S
    )
    slow = 1.0
    for eye in range(2):
        for joint in range(2):
            state.goals_at_effect[eye, joint], state.goal_rates[eye, joint] = (
                state.goals[eye, joint],
                0.0,
            )
            state.goal_rates_at_effect[eye, joint] = 0.0
            if moves and state.known[eye] > 0.5:
                time_s = (tick - state.motion_tick) * params.period_s
                motions, resting = state.motions[eye], state.goals[eye, joint]
                if joint == 0:
                    slow = visible_speed_fraction(
                        motions,
                        state.mode_probabilities,
                        _BLUR_SPEED_FRACTION * params.max_slip_rad_s,
                    )
                angle, rate = extrapolate_goal(
                    motions, state.mode_probabilities, resting, joint, time_s, expected_s, slow
                )
                state.goals_at_effect[eye, joint], state.goal_rates[eye, joint] = angle, rate
                time_s += effect_delay_s
                _, rate = extrapolate_goal(
                    motions,
                    state.mode_probabilities,
                    resting,
                    joint,
                    time_s,
                    expected_s + effect_delay_s,
                    slow,
                )
                state.goal_rates_at_effect[eye, joint] = rate


@inlined
def predict_pixel_error(
    state: PredictorState, p: PackedHead, eye: int, first_angle: float, second_angle: float
) -> tuple[float, float]:
    """Predict the pixel error of one eye at given joint angles.

    Args:
        state: the predictor's state.
        p: a packed head.
        eye: index of the eye.
        first_angle: angle of its first joint, rad.
        second_angle: angle of its second joint, rad.

    Returns:
        Undistorted error along u and v, px; nan if the target is not known or lies behind the
        camera.
    """
    if state.known[eye] < 0.5:
        return nan, nan
    # the point on the optical axis once the eye has turned to its aim
    camera = eye_frames(p, eye, state.goals_at_effect[eye, 0], state.goals_at_effect[eye, 1]).camera
    px, py, pz = point_to_outer(camera, 0.0, 0.0, state.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first_angle, second_angle, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z
