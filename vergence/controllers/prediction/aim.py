r"""Actuator angles that bring both images as near to their targets as possible.

The goals of an eye are the joint angles that would put its target on its optical axis. If every
joint has its own motor, the actuators reach the goals exactly. Where actuators couple joints, this
module finds the actuator angles with the least sum of squared pixel errors: Gauss-Newton steps,
starting from the linear solution. Each eye's target is a separate point on that eye's own ray, so
the residual is minimal in the images as seen, whatever the errors of the head's model.
"""

from typing import Final

import numpy as np

from vergence.kernels import inlined
from vergence.models.fixation import actuator_least_squares
from vergence.models.kinematics import (
    PackedHead,
    camera_of,
    eye_frames,
    eye_jacobian,
    eye_joint_angle,
    pixel_rate,
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
