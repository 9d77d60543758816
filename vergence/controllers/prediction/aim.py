"""Where the actuators should turn: target angles when the next command acts, and the aim at them.

The goals of an eye are the joint angles that would put its target on its optical axis. If every
joint has its own motor, the actuators reach the goals exactly. Where actuators couple joints, this
module finds the actuator angles with the least sum of squared pixel errors: Gauss-Newton steps,
starting from the linear solution. Each eye's target is a separate point on that eye's own ray, so
the residual is minimal in the images as seen, whatever the errors of the head's model.
"""

from math import nan
from typing import Final

import numpy as np

from vergence.controllers.prediction.motion_models import extrapolate_goal, visible_speed_fraction
from vergence.controllers.prediction.parameters import PredictorParameters
from vergence.controllers.prediction.state import PredictorState
from vergence.kernels import inlined
from vergence.models.fixation import actuator_least_squares
from vergence.models.kinematics import (
    PackedHead,
    camera_of,
    eye_frames,
    eye_jacobian,
    eye_joint_angle,
    pixel_rate,
    point_in_eye,
    point_rate_in_camera,
    point_to_local,
    point_to_outer,
)
from vergence.models.parts import FloatArray

_MAX_ITERATIONS: Final = 12
"""Iteration limit of Gauss-Newton (numerical)."""
_MAX_STEP_RAD: Final = 0.5
"""Largest step of one iteration, rad; longer steps are scaled down (numerical)."""
_CONVERGED_STEP_RAD: Final = 1e-6
"""Convergence tolerance: largest actuator step at which iteration stops, rad (numerical)."""


@inlined
def least_squares_actuators(
    p: PackedHead,
    goals: FloatArray,
    depth_left: float,
    depth_right: float,
    left: bool,
    right: bool,
    present_actuators: FloatArray,
    jacobian_out: FloatArray,
    out: FloatArray,
) -> None:
    """Find the actuator angles with the least squared pixel error about both eyes' goals.

    Args:
        p: a packed head with two joints in each eye.
        goals: (2, 2) joint angles that fixate each eye's target, rad.
        depth_left: depth of the target in the left eye once it is on the optical axis, m.
        depth_right: depth of the target in the right eye likewise, m.
        left: True if the left eye has a goal.
        right: True if the right eye has a goal.
        present_actuators: (4,) present actuator angles, rad; actuators that affect no goal keep
            theirs.
        jacobian_out: (2, 2, 2) result: image Jacobians at the solution, by eye, image axis and
            joint, px/rad.
        out: (4,) result: actuator angles, rad, without joint limits.
    """
    wanted, step, points = np.zeros((2, 2)), np.zeros(4), np.zeros((2, 3))
    for eye in range(2):
        if not (right if eye else left):
            continue
        depth = depth_right if eye else depth_left
        frames, camera = eye_frames(p, eye, goals[eye, 0], goals[eye, 1]), camera_of(p, eye)
        points[eye, 0], points[eye, 1], points[eye, 2] = point_to_outer(
            frames.camera, 0.0, 0.0, depth
        )
        u1, u2, v1, v2 = eye_jacobian(p, eye, frames, camera.centre_u, camera.centre_v, depth)
        jacobian_out[eye, 0, 0], jacobian_out[eye, 0, 1] = u1, u2
        jacobian_out[eye, 1, 0], jacobian_out[eye, 1, 1] = v1, v2
        first = goals[eye, 0] - eye_joint_angle(p, 2 * eye, present_actuators)
        second = goals[eye, 1] - eye_joint_angle(p, 2 * eye + 1, present_actuators)
        wanted[eye, 0], wanted[eye, 1] = u1 * first + u2 * second, v1 * first + v2 * second
    actuator_least_squares(p, jacobian_out, wanted, left, right, step)
    for k in range(4):
        out[k] = present_actuators[k] + step[k]
    for _ in range(_MAX_ITERATIONS):
        for eye in range(2):
            if not (right if eye else left):
                continue
            q1, q2 = eye_joint_angle(p, 2 * eye, out), eye_joint_angle(p, 2 * eye + 1, out)
            frames, camera = eye_frames(p, eye, q1, q2), camera_of(p, eye)
            x, y, z = points[eye, 0], points[eye, 1], points[eye, 2]
            cx, cy, cz = point_to_local(frames.camera, x, y, z)
            if not cz > 0.0:
                return
            a, b = cx / cz, cy / cz
            wanted[eye, 0], wanted[eye, 1] = -camera.focal_u * a, -camera.focal_v * b
            for joint in range(2):
                axis = frames.after_first_joint if joint == 0 else frames.after_second_joint
                rate = point_rate_in_camera(axis, frames.camera, x, y, z)
                u, v = pixel_rate(camera, a, b, cz, rate)
                jacobian_out[eye, 0, joint], jacobian_out[eye, 1, joint] = u, v
        actuator_least_squares(p, jacobian_out, wanted, left, right, step)
        size = 0.0
        for k in range(4):
            size = max(size, abs(step[k]))
        scale = _MAX_STEP_RAD / max(size, _MAX_STEP_RAD)
        for k in range(4):
            out[k] += scale * step[k]
        if not size > _CONVERGED_STEP_RAD:
            return


_REST_PROBABILITY: Final = 0.9
"""Probability of rest above which a target is treated as resting (chosen)."""
_BLUR_SPEED_FRACTION: Final = 0.5
"""Fraction of the motion-blur speed limit (`PredictorParameters.max_slip_rad_s`) that an eye may
reach relative to its target (chosen: margin for exposure against speed of pursuit)."""
_LATE_IMAGE_GRACE_S: Final = 0.03
"""Time after the next image is due during which an eye keeps following the extrapolated motion, s
(chosen: tolerates late frames)."""


@inlined
def extrapolate_targets(
    state: PredictorState, params: PredictorParameters, lag_s: float, tick: float
) -> None:
    """Extrapolate the targets to a time in periods, see `EffectState`."""
    moves = params.targets_move > 0.5 and state.motion.probabilities[0] < _REST_PROBABILITY
    effect_delay_s = lag_s + 0.5 * params.period_s
    expected_s = (
        state.delays.mean_s
        + params.frame_period_s
        + (tick - state.periods) * params.period_s
        + _LATE_IMAGE_GRACE_S
    )
    slow = 1.0
    for eye in range(2):
        for joint in range(2):
            state.effect.goals[eye, joint], state.effect.rates[eye, joint] = (
                state.target.goals[eye, joint],
                0.0,
            )
            state.effect.later_rates[eye, joint] = 0.0
            if moves and state.target.known[eye] > 0.5:
                time_s = (tick - state.motion.tick) * params.period_s
                motions, resting = state.motion.models[eye], state.target.goals[eye, joint]
                if joint == 0:
                    slow = visible_speed_fraction(
                        motions,
                        state.motion.probabilities,
                        _BLUR_SPEED_FRACTION * params.max_slip_rad_s,
                    )
                angle, rate = extrapolate_goal(
                    motions, state.motion.probabilities, resting, joint, time_s, expected_s, slow
                )
                state.effect.goals[eye, joint], state.effect.rates[eye, joint] = angle, rate
                time_s += effect_delay_s
                _, rate = extrapolate_goal(
                    motions,
                    state.motion.probabilities,
                    resting,
                    joint,
                    time_s,
                    expected_s + effect_delay_s,
                    slow,
                )
                state.effect.later_rates[eye, joint] = rate


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
    if state.target.known[eye] < 0.5:
        return nan, nan
    # the point on the optical axis once the eye has turned to its aim
    camera = eye_frames(p, eye, state.effect.goals[eye, 0], state.effect.goals[eye, 1]).camera
    px, py, pz = point_to_outer(camera, 0.0, 0.0, state.target.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first_angle, second_angle, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z
