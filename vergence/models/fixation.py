"""Eye angles that put a point on both optical axes, or as near to them as the actuators allow.

For an eye with two motors of its own, Newton's method finds the angles. For coupled joints, of one
eye or of both, damped Gauss-Newton steps over the actuators minimise the sum of squared pixel
errors.
"""

from math import atan2, hypot, isfinite, isnan, nan, sqrt
from typing import Final

import numpy as np

from vergence.kernels import inlined, kernel, subroutine
from vergence.models.kinematics import (
    PACKED,
    PackedHead,
    camera_of,
    eye_frames,
    eye_joint_angle,
    joint_per_actuator,
    point_rate_in_camera,
    point_to_local,
)
from vergence.models.parts import SLOTS, FloatArray

_DAMPING: Final = 1e-11  # damping of the normal equations, as a fraction of their trace (numerical)


@subroutine
def cholesky_factorise(matrix: FloatArray, size: int, least_pivot: float) -> bool:
    """Replace a matrix by its lower Cholesky factor; False if a pivot is not above the least."""
    definite = True
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                definite &= total > least_pivot
                matrix[j, j] = sqrt(max(total, 1e-300))
            else:
                matrix[i, j] = total / matrix[j, j]
    return definite


@subroutine
def forward_substitute(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a lower triangular system, in place."""
    for i in range(size):
        for k in range(i):
            right_side[i] -= factor[i, k] * right_side[k]
        right_side[i] /= factor[i, i]


@subroutine
def cholesky_solve(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a system given the lower Cholesky factor of its matrix, in place."""
    forward_substitute(factor, right_side, size)
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right_side[i] -= factor[k, i] * right_side[k]
        right_side[i] /= factor[i, i]


@subroutine
def actuator_least_squares(
    p: PackedHead,
    jacobian: FloatArray,
    image_motions: FloatArray,
    use_left: bool,
    use_right: bool,
    out: FloatArray,
) -> None:
    """Motions (4,) of actuators that best give (2, 2) wanted motions of the images of used eyes."""
    rows = np.zeros((4, SLOTS))
    for eye in range(2):
        if not (use_right if eye else use_left):
            continue
        for axis in range(2):
            for k in range(SLOTS):
                first = joint_per_actuator(p, 2 * eye, k)
                second = joint_per_actuator(p, 2 * eye + 1, k)
                rows[2 * eye + axis, k] = (
                    jacobian[eye, axis, 0] * first + jacobian[eye, axis, 1] * second
                )
    normal = np.zeros((SLOTS, SLOTS))
    trace = 0.0
    for k in range(SLOTS):
        out[k] = 0.0
        for r in range(4):
            value = image_motions[r // 2, r % 2] if rows[r, k] != 0.0 else 0.0
            out[k] += rows[r, k] * value
            for i in range(k + 1):
                normal[k, i] += rows[r, k] * rows[r, i]
        trace += normal[k, k]
    if not trace > 0.0:
        return
    for k in range(SLOTS):
        normal[k, k] += _DAMPING * trace
    cholesky_factorise(normal, SLOTS, 0.0)
    cholesky_solve(normal, out, SLOTS)


@inlined
def image_rate(
    p: PackedHead, jacobian: FloatArray, eye: int, axis: int, actuators: FloatArray
) -> float:
    """Motion of one eye's image along one axis from the actuators' motions (4,)."""
    rate = 0.0
    for k in range(SLOTS):
        first, second = joint_per_actuator(p, 2 * eye, k), joint_per_actuator(p, 2 * eye + 1, k)
        rate += (jacobian[eye, axis, 0] * first + jacobian[eye, axis, 1] * second) * actuators[k]
    return rate


_MAX_ITERATIONS: Final = 60
"""Iteration limit of Newton's method, and half that of Gauss-Newton (numerical)."""
_MAX_STEP_RAD: Final = 0.5  # longest step of one iteration, rad (numerical)
_NEWTON_TOLERANCE_RAD: Final = 1e-15  # convergence tolerance of a Newton step, rad (numerical)
_PIXEL_PHASE_STEP_RAD: Final = 1e-4
"""Gauss-Newton step below which the errors change from bearings to pixels, rad (numerical)."""
_GN_TOLERANCE_RAD: Final = 1e-13  # convergence tolerance of a Gauss-Newton step, rad (numerical)
_ACCEPTED_STEP_RAD: Final = 1e-7
"""Last Gauss-Newton step that is accepted at the iteration limit, rad (numerical)."""


@inlined
def _aim(
    p: PackedHead, eye: int, q1: float, q2: float, x: float, y: float, z: float, bearings: bool
) -> tuple[float, float, float, float, float, float]:
    """Offset (a, b) of a point of N from an eye's axis, then a, and b, by each of its joints.

    With `bearings` it is (atan2(x, z), atan2(y, |x, z|)) in the camera, rad, else (x / z, y / z).
    All are nan for a point that has none. Unlike the pixel, the bearing stays smooth for a point
    behind the camera, so limited steps converge from any direction.
    """
    frames = eye_frames(p, eye, q1, q2)
    cx, cy, cz = point_to_local(frames.camera, x, y, z)
    r2 = cx * cx + cz * cz
    if not (r2 > 0.0 if bearings else cz > 0.0):
        return nan, nan, nan, nan, nan, nan
    t = point_rate_in_camera(frames.after_first_joint, frames.camera, x, y, z)
    s = point_rate_in_camera(frames.after_second_joint, frames.camera, x, y, z)
    if bearings:
        r, d2 = sqrt(r2), r2 + cy * cy
        a, b = atan2(cx, cz), atan2(cy, r)
        at, ap = (cz * t[0] - cx * t[2]) / r2, (cz * s[0] - cx * s[2]) / r2
        bt = (r * t[1] - cy * (cx * t[0] + cz * t[2]) / r) / d2
        bp = (r * s[1] - cy * (cx * s[0] + cz * s[2]) / r) / d2
    else:
        a, b = cx / cz, cy / cz
        at, ap = (t[0] - a * t[2]) / cz, (s[0] - a * s[2]) / cz
        bt, bp = (t[1] - b * t[2]) / cz, (s[1] - b * s[2]) / cz
    return a, b, at, ap, bt, bp


@inlined
def fixation_newton_step(
    p: PackedHead, eye: int, first_angle: float, second_angle: float, x: float, y: float, z: float
) -> tuple[float, float]:
    """Changes of an eye's joint angles in one Newton step towards a point of N, rad, or nan."""
    a, b, at, ap, bt, bp = _aim(p, eye, first_angle, second_angle, x, y, z, True)
    det = at * bp - ap * bt
    if isnan(a) or det == 0.0:
        return nan, nan
    return -(bp * a - ap * b) / det, -(at * b - bt * a) / det


@inlined
def fixate_eye(p: PackedHead, eye: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Newton's method on the bearing, from rest: the eye's two angles, rad; nan if none fixate."""
    tilt, pan = 0.0, 0.0
    for _ in range(_MAX_ITERATIONS):
        dt, dp = fixation_newton_step(p, eye, tilt, pan, x, y, z)
        step = hypot(dt, dp)
        if not isfinite(step):
            return nan, nan
        scale = _MAX_STEP_RAD / max(step, _MAX_STEP_RAD)
        tilt += scale * dt
        pan += scale * dp
        if step < _NEWTON_TOLERANCE_RAD:
            break
    cx, cy, cz = point_to_local(eye_frames(p, eye, tilt, pan).camera, x, y, z)
    # a tolerance two orders above rounding: a larger error means that there is no solution
    if cz > 0.0 and abs(cx) + abs(cy) < 1e-12 * (1.0 + cz):
        return tilt, pan
    return nan, nan


@subroutine
def fixate_coupled(p: PackedHead, x: float, y: float, z: float, joints: FloatArray) -> bool:
    """Write (4,) angles, rad or nan, of least squared pixel errors; True if there is a solution.

    The first steps take bearings times the focal lengths in place of pixels.
    """
    own, step = np.zeros(SLOTS), np.zeros(SLOTS)
    error, rate = np.zeros((2, 2)), np.zeros((2, 2, 2))
    bearings, found, size = True, False, 0.0
    for _ in range(2 * _MAX_ITERATIONS):
        for joint in range(SLOTS):
            joints[joint] = eye_joint_angle(p, joint, own)
        sees = True
        for eye in range(2):
            q1, q2, camera = joints[2 * eye], joints[2 * eye + 1], camera_of(p, eye)
            a, b, at, ap, bt, bp = _aim(p, eye, q1, q2, x, y, z, bearings)
            sees = sees and not isnan(a)
            error[eye, 0], error[eye, 1] = -camera.focal_u * a, -camera.focal_v * b
            rate[eye, 0, 0], rate[eye, 0, 1] = camera.focal_u * at, camera.focal_u * ap
            rate[eye, 1, 0], rate[eye, 1, 1] = camera.focal_v * bt, camera.focal_v * bp
        if not sees:
            break
        actuator_least_squares(p, rate, error, True, True, step)
        size = 0.0
        for k in range(SLOTS):
            size = max(size, abs(step[k]))
        if not isfinite(size):
            break
        scale = _MAX_STEP_RAD / max(size, _MAX_STEP_RAD)
        for k in range(SLOTS):
            own[k] += scale * step[k]
        if size < (_PIXEL_PHASE_STEP_RAD if bearings else _GN_TOLERANCE_RAD):
            found = not bearings
            if found:
                break
            bearings = False
    if not found and not bearings and size < _ACCEPTED_STEP_RAD:
        found = True  # Gauss-Newton converges slowly if a large error remains
    for joint in range(SLOTS):
        joints[joint] = eye_joint_angle(p, joint, own) if found else nan
    return found


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], f"(3),(3),(7),({PACKED})->(7)")
def fixate(
    points: FloatArray, neck: FloatArray, _seven: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Joint angles that fixate a point of N; nan for an eye without a solution."""
    for j in range(3):
        out[j] = neck[j]
    for eye in range(2):
        out[3 + 2 * eye], out[4 + 2 * eye] = fixate_eye(p, eye, points[0], points[1], points[2])


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], f"(3),(3),(7),({PACKED})->(7)")
def fixate_least_squares(
    points: FloatArray, neck: FloatArray, _seven: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """`fixate` for coupled joints: the least-squares solution; nan if there is none."""
    for j in range(3):
        out[j] = neck[j]
    fixate_coupled(p, points[0], points[1], points[2], out[3:])
