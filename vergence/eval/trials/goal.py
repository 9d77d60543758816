r"""Goal angles of the eyes: the least error that a true head's actuators can reach.

A controller sees the true head through its model: the error of an eye is the true head's pixel,
undistorted by the model's lens, less the model's principal point. An eye with one motor for each
joint can reach an error of zero; Newton's method finds its angles. With coupled joints, the
actuators' goal angles a* minimise the sum of squares over both eyes,

    a* = argmin sum over eyes |e_eye(a)|^2,

by Gauss-Newton steps, and the residual e* = e(a*) remains. Limits of joints and actuators are not
applied.
"""

from math import isfinite, nan
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plant import Simulation
from vergence.envs.task import GazeTask
from vergence.kernels import compiled, inlined
from vergence.models.fixation import actuator_least_squares, fixate_coupled, fixate_eye
from vergence.models.kinematics import (
    PackedHead,
    eye_actuator_angle,
    eye_joint_angle,
    pixel_error,
    point_in_eye,
    point_to_pixel,
)
from vergence.models.parts import SLOTS, FloatArray

_NEWTON_STEPS: Final = 30
"""Most Newton steps for an eye (numerical)."""
_GAUSS_NEWTON_STEPS: Final = 200
"""Most Gauss-Newton steps for coupled joints (numerical)."""
_FINITE_DIFFERENCE_RAD: Final = 1e-5
"""Half step of the central differences, rad (numerical)."""
_TOLERANCE_PX: Final = 1e-9
"""Error at which Newton's method has converged, px (numerical)."""
_CONVERGED_STEP_RAD: Final = 1e-10
"""Gauss-Newton step below which the iteration has converged, rad (numerical)."""
_ACCEPTED_LAST_STEP_RAD: Final = 1e-7
"""Size of the last allowed Gauss-Newton step that still counts as converged, rad (numerical)."""


def least_reachable_error(task: GazeTask, target: FloatArray) -> FloatArray:
    """Least pixel errors that the actuators can reach at the targets; 0 without coupled joints.

    Args:
        task: the trials; unless they are simulated, the model stands for the true heads.
        target: (n, 3) their targets in N, m.

    Returns:
        (n, 2, 2) by eye and image axis, px, as `Truth.pixel_error`; zero for a head with one motor
        for each eye joint, nan if no angles bring the target into view.
    """
    residual, plant = np.zeros((task.num, 2, 2)), task.plant
    if not task.head.actuation.direct:
        model = task.head.packed
        heads = plant.conditions.heads if isinstance(plant, Simulation) else model[None]
        _residuals(heads, model, target, residual)
    return residual


@compiled
def _residuals(
    heads: FloatArray, nominal: PackedHead, targets: FloatArray, residual: FloatArray
) -> None:
    """Write the least errors of heads with coupled joints.

    Args:
        heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        targets: (n, 3) in N, m.
        residual: (n, 2, 2) result, px.
    """
    actuators, jacobian = np.empty(SLOTS), np.empty((2, 2, 2))
    for n in range(targets.shape[0]):
        true = heads[n] if heads.shape[0] > 1 else heads[0]
        if not actuator_goal(true, nominal, targets[n], actuators, residual[n], jacobian):
            for eye in range(2):
                for axis in range(2):
                    residual[n, eye, axis] = nan


@inlined
def noiseless_pixel_error(
    true: PackedHead, nominal: PackedHead, eye: int, tilt: float, pan: float, point: FloatArray
) -> tuple[float, float]:
    """Pixel error (u, v) of the true head for the nominal model, without noise, px."""
    x, y, z = point_in_eye(true, eye, tilt, pan, point[0], point[1], point[2])
    u, v = point_to_pixel(true, eye, x, y, z, True)
    return pixel_error(nominal, eye, u, v)


class PixelErrorSlopes(NamedTuple):
    """An eye's error, px, and its derivatives by tilt and pan, px/rad, by central differences."""

    u: float
    v: float
    u_per_tilt: float
    u_per_pan: float
    v_per_tilt: float
    v_per_pan: float


@inlined
def pixel_error_slopes(
    true: PackedHead, nominal: PackedHead, eye: int, tilt: float, pan: float, point: FloatArray
) -> PixelErrorSlopes:
    """An eye's measured error and image Jacobian at given angles."""
    h = _FINITE_DIFFERENCE_RAD
    u, v = noiseless_pixel_error(true, nominal, eye, tilt, pan, point)
    ua, va = noiseless_pixel_error(true, nominal, eye, tilt + h, pan, point)
    ub, vb = noiseless_pixel_error(true, nominal, eye, tilt - h, pan, point)
    uc, vc = noiseless_pixel_error(true, nominal, eye, tilt, pan + h, point)
    ud, vd = noiseless_pixel_error(true, nominal, eye, tilt, pan - h, point)
    u_per_tilt, v_per_tilt = 0.5 * (ua - ub) / h, 0.5 * (va - vb) / h
    u_per_pan, v_per_pan = 0.5 * (uc - ud) / h, 0.5 * (vc - vd) / h
    return PixelErrorSlopes(u, v, u_per_tilt, u_per_pan, v_per_tilt, v_per_pan)


class EyeGoal(NamedTuple):
    """Angles at which an eye's error is zero, rad, and the image Jacobian there; nan if none."""

    tilt: float
    pan: float
    u_per_tilt: float
    u_per_pan: float
    v_per_tilt: float
    v_per_pan: float


@inlined
def eye_goal(true: PackedHead, nominal: PackedHead, eye: int, point: FloatArray) -> EyeGoal:
    """Goal angles of an eye with one motor for each joint."""
    tilt, pan = fixate_eye(true, eye, point[0], point[1], point[2])
    for _ in range(_NEWTON_STEPS):
        u, v, u_per_tilt, u_per_pan, v_per_tilt, v_per_pan = pixel_error_slopes(
            true, nominal, eye, tilt, pan, point
        )
        determinant = u_per_tilt * v_per_pan - u_per_pan * v_per_tilt
        if not isfinite(determinant) or determinant == 0.0:
            break
        if abs(u) + abs(v) < _TOLERANCE_PX:
            return EyeGoal(tilt, pan, u_per_tilt, u_per_pan, v_per_tilt, v_per_pan)
        tilt -= (v_per_pan * u - u_per_pan * v) / determinant
        pan -= (u_per_tilt * v - v_per_tilt * u) / determinant
    return EyeGoal(nan, nan, nan, nan, nan, nan)


@inlined
def actuator_goal(
    true: PackedHead,
    nominal: PackedHead,
    point: FloatArray,
    goal_angles: FloatArray,
    error: FloatArray,
    jacobian: FloatArray,
) -> bool:
    """Find the goal angles of the actuators of both eyes, for coupled joints.

    Args:
        true: the true head, packed.
        nominal: the head that the controller knows, packed.
        point: (3,) the target in N, m.
        goal_angles: (4,) result: the actuators' goal angles, rad.
        error: (2, 2) result: the residual there, by eye and image axis, px.
        jacobian: (2, 2, 2) result: derivatives of the errors by eye, image axis and joint of that
            eye, px/rad.

    Returns:
        True if there are such angles.
    """
    joints, wanted, step = np.empty(4), np.empty((2, 2)), np.empty(SLOTS)
    if not fixate_coupled(true, point[0], point[1], point[2], joints):
        return False
    for k in range(SLOTS):
        goal_angles[k] = eye_actuator_angle(true, k, joints)
    for attempt in range(_GAUSS_NEWTON_STEPS):
        for joint in range(4):
            joints[joint] = eye_joint_angle(true, joint, goal_angles)
        for eye in range(2):
            found = pixel_error_slopes(
                true, nominal, eye, joints[2 * eye], joints[2 * eye + 1], point
            )
            error[eye, 0], error[eye, 1] = found.u, found.v
            jacobian[eye, 0, 0], jacobian[eye, 0, 1] = found.u_per_tilt, found.u_per_pan
            jacobian[eye, 1, 0], jacobian[eye, 1, 1] = found.v_per_tilt, found.v_per_pan
            wanted[eye, 0], wanted[eye, 1] = -found.u, -found.v
        actuator_least_squares(true, jacobian, wanted, True, True, step)
        size = 0.0
        for k in range(SLOTS):
            size = max(size, abs(step[k]))
        if not isfinite(size) or not isfinite(error[0, 0] + error[1, 0]):
            return False
        last = attempt == _GAUSS_NEWTON_STEPS - 1
        # convergence is slow if the residual is large
        if size < (_ACCEPTED_LAST_STEP_RAD if last else _CONVERGED_STEP_RAD):
            return True
        for k in range(SLOTS):
            goal_angles[k] += step[k]
    return False
