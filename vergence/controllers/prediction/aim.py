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

_MAX_ITERATIONS: Final = 12  # iteration limit of Gauss-Newton (numerical)
_MAX_STEP_RAD: Final = 0.5
"""Largest step of one iteration, rad; longer steps are scaled down (numerical)."""
_CONVERGED_STEP_RAD: Final = 1e-6
"""Convergence tolerance: largest actuator step at which iteration stops, rad (numerical)."""


@inlined
def least_squares_actuators(
    p: PackedHead, goals: FloatArray, depth: FloatArray, known: FloatArray,
    present_angles: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Find the actuator angles (4,), rad, with the least squared pixel error about the known goals.

    `depth` (2,) is that of each target on the optical axis, m. Actuators that affect no goal keep
    their present angles (4,); joint limits are not regarded.
    """
    wanted, step, points = np.zeros((2, 2)), np.zeros(4), np.zeros((2, 3))
    jacobian = np.zeros((2, 2, 2))
    left, right = known[0] > 0.5, known[1] > 0.5
    for eye in range(2):
        if not known[eye] > 0.5:
            continue
        frames, camera = eye_frames(p, eye, goals[eye, 0], goals[eye, 1]), camera_of(p, eye)
        x, y, z = point_to_outer(frames.camera, 0.0, 0.0, depth[eye])
        points[eye, 0], points[eye, 1], points[eye, 2] = x, y, z
        u1, u2, v1, v2 = eye_jacobian(p, eye, frames, camera.centre_u, camera.centre_v, depth[eye])
        jacobian[eye, 0, 0], jacobian[eye, 0, 1] = u1, u2
        jacobian[eye, 1, 0], jacobian[eye, 1, 1] = v1, v2
        first = goals[eye, 0] - eye_joint_angle(p, 2 * eye, present_angles)
        second = goals[eye, 1] - eye_joint_angle(p, 2 * eye + 1, present_angles)
        wanted[eye, 0], wanted[eye, 1] = u1 * first + u2 * second, v1 * first + v2 * second
    actuator_least_squares(p, jacobian, wanted, left, right, step)
    for k in range(4):
        out[k] = present_angles[k] + step[k]
    for _ in range(_MAX_ITERATIONS):
        for eye in range(2):
            if not known[eye] > 0.5:
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
                jacobian[eye, 0, joint], jacobian[eye, 1, joint] = u, v
        actuator_least_squares(p, jacobian, wanted, left, right, step)
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
"""Share of `PredictorParameters.max_slip_rad_s` that an eye may slip (chosen: margin for blur)."""
_LATE_IMAGE_GRACE_S: Final = 0.03
"""Time by which an image may be late before an eye is slowed, s (chosen: tolerates late frames)."""


@inlined
def extrapolate_targets(
    state: PredictorState, params: PredictorParameters, lag_s: float, tick: float
) -> None:
    """Extrapolate the targets to a time in periods, see `EffectState`."""
    target, motion, effect = state.target, state.motion, state.effect
    for eye in range(2):
        for joint in range(2):
            effect.goals[eye, joint] = target.goals[eye, joint]
            effect.rates[eye, joint] = effect.later_rates[eye, joint] = 0.0
    if not (params.targets_move > 0.5 and motion.probabilities[0] < _REST_PROBABILITY):
        return
    time_s, effect_delay_s = (tick - motion.tick) * params.period_s, lag_s + 0.5 * params.period_s
    expected_s = state.delays.mean_s + params.frame_period_s
    expected_s += (tick - state.periods) * params.period_s
    expected_s += _LATE_IMAGE_GRACE_S
    for eye in range(2):
        if target.known[eye] < 0.5:
            continue
        models, probabilities = motion.models[eye], motion.probabilities
        slow = visible_speed_fraction(
            models, probabilities, _BLUR_SPEED_FRACTION * params.max_slip_rad_s
        )
        for joint in range(2):
            resting = target.goals[eye, joint]
            effect.goals[eye, joint], effect.rates[eye, joint] = extrapolate_goal(
                models, probabilities, resting, joint, time_s, expected_s, slow
            )
            effect.later_rates[eye, joint] = extrapolate_goal(
                models, probabilities, resting, joint, time_s + effect_delay_s,
                expected_s + effect_delay_s, slow,
            )[1]  # fmt: skip


@inlined
def predict_pixel_error(
    state: PredictorState, p: PackedHead, eye: int, first_angle: float, second_angle: float
) -> tuple[float, float]:
    """Undistorted error (u, v) of an eye at joint angles, px; nan if unknown or behind it."""
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
