r"""Largest deviation of each actuator from its goal with both eyes in the settling band.

It is the widest deviation that the eyes' error circles allow, whatever the other actuators do. For
an eye with one motor for each joint it is `band sqrt(((J^T J)^-1)_ii)`, J being the true image
Jacobian at the goal. For coupled joints, J_e A is the Jacobian of the image of eye e with respect
to the actuators, and the deviation is the greatest d_k with |J_e A d| <= band for both eyes,

    band min over w of sqrt(((w M_l + (1 - w) M_r)^-1)_kk),   M_e = (J_e A)^T J_e A,   0 < w < 1.

Each w gives an upper limit, because the intersection of both circles lies in the ellipsoid of their
weighted sum. The smallest limit is exact, because both sets are convex.
"""

from math import inf, nan, sqrt
from typing import Final

import numpy as np

from vergence.eval.trials.goal import actuator_goal, eye_goal
from vergence.kernels import compiled, inlined
from vergence.models.kinematics import PackedHead, camera_of, joint_per_actuator
from vergence.models.parts import SLOTS, FloatArray

_INVERSE_GOLDEN_RATIO: Final = 0.6180339887498949
"""Golden ratio less 1: the factor by which a section shrinks the bracket (numerical)."""
_SECTIONS: Final = 40
"""Sections of the golden-section search; the bracket shrinks to 4e-9 (numerical)."""
_WEIGHT_MARGIN: Final = 1e-6
"""Distance of the weight from 0 and 1, which keeps the weighted sum invertible (numerical)."""


@compiled
def eye_settling_bands(
    true_heads: FloatArray,
    nominal: PackedHead,
    targets: FloatArray,
    band_px: float,
    goal_angles: FloatArray,
    half_band: FloatArray,
) -> None:
    """Write the goals and bands of the joints of eyes with one motor for each joint.

    Args:
        true_heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        targets: (n, 3) in N, m.
        band_px: settling band of an eye's error, px.
        goal_angles: (n, 4) result, goal angles, rad; nan if no angles reach the target.
        half_band: (n, 4) result, largest deviations from the goals, rad.
    """
    for n in range(targets.shape[0]):
        true = true_heads[n] if true_heads.shape[0] > 1 else true_heads[0]
        for eye in range(2):
            found = eye_goal(true, nominal, eye, targets[n])
            u_per_tilt, u_per_pan, v_per_tilt, v_per_pan = (
                found.u_per_tilt,
                found.u_per_pan,
                found.v_per_tilt,
                found.v_per_pan,
            )
            # Diagonal of (J^T J)^-1, with det(J^T J) = det(J)^2. Within the band the image deviates
            # from its linearisation by less than the fraction band / focal length.
            bend = 1.0 + band_px / camera_of(nominal, eye).focal_u
            widest = band_px * bend / abs(u_per_tilt * v_per_pan - u_per_pan * v_per_tilt)
            goal_angles[n, 2 * eye], goal_angles[n, 2 * eye + 1] = found.tilt, found.pan
            half_band[n, 2 * eye] = widest * sqrt(u_per_pan * u_per_pan + v_per_pan * v_per_pan)
            half_band[n, 2 * eye + 1] = widest * sqrt(
                u_per_tilt * u_per_tilt + v_per_tilt * v_per_tilt
            )


@compiled
def actuator_settling_bands(
    true_heads: FloatArray,
    nominal: PackedHead,
    targets: FloatArray,
    band_px: float,
    goal_angles: FloatArray,
    half_band: FloatArray,
) -> None:
    """Write the goals and bands of the actuators of coupled joints, see `eye_settling_bands`."""
    error, jacobian = np.empty((2, 2)), np.empty((2, 2, 2))
    for n in range(targets.shape[0]):
        true = true_heads[n] if true_heads.shape[0] > 1 else true_heads[0]
        if not actuator_goal(true, nominal, targets[n], goal_angles[n], error, jacobian):
            for k in range(SLOTS):
                goal_angles[n, k] = nan
            continue
        squares = np.zeros((2, SLOTS, SLOTS))
        focal, off = inf, 0.0
        for eye in range(2):
            camera = camera_of(nominal, eye)
            focal = min(focal, camera.focal_u, camera.focal_v)
            for axis in range(2):
                off = max(off, abs(error[eye, axis]))
                for k in range(SLOTS):
                    for i in range(SLOTS):
                        squares[eye, k, i] += _rate(true, jacobian, eye, axis, k) * _rate(
                            true, jacobian, eye, axis, i
                        )
        # as for an eye alone; off the image's centre the nonlinearity grows with the distance
        bend = 1.0 + band_px / focal * (1.0 + 4.0 * off / focal)
        for k in range(SLOTS):
            half_band[n, k] = band_px * bend * _widest(squares, k)


@inlined
def _rate(p: PackedHead, jacobian: FloatArray, eye: int, axis: int, k: int) -> float:
    """Derivative of an eye's image along one axis with respect to one actuator, px/rad."""
    first, second = joint_per_actuator(p, 2 * eye, k), joint_per_actuator(p, 2 * eye + 1, k)
    rate: float = jacobian[eye, axis, 0] * first + jacobian[eye, axis, 1] * second
    return rate


@inlined
def _widest(squares: FloatArray, k: int) -> float:
    """Largest deviation of actuator k with both eyes within 1 px, rad; by golden section.

    The minimised diagonal element is convex in the weight: the inverse of a positive definite
    matrix is.

    Args:
        squares: (2, 4, 4) M_l and M_r, px^2/rad^2.
        k: index of the actuator.
    """
    low, high = _WEIGHT_MARGIN, 1.0 - _WEIGHT_MARGIN
    a, b = high - _INVERSE_GOLDEN_RATIO * (high - low), low + _INVERSE_GOLDEN_RATIO * (high - low)
    at_a, at_b = _reach_squared(squares, a, k), _reach_squared(squares, b, k)
    # an actuator that moves one eye only has its minimum at an end of the interval
    least = min(_reach_squared(squares, low, k), _reach_squared(squares, high, k))
    for _ in range(_SECTIONS):
        least = min(least, at_a, at_b)
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - _INVERSE_GOLDEN_RATIO * (high - low)
            at_a = _reach_squared(squares, a, k)
        else:
            low, a, at_a = a, b, at_b
            b = low + _INVERSE_GOLDEN_RATIO * (high - low)
            at_b = _reach_squared(squares, b, k)
    return sqrt(least)


@inlined
def _reach_squared(squares: FloatArray, weight: float, k: int) -> float:
    """((w M_l + (1 - w) M_r)^-1)_kk, rad^2/px^2; inf if no image constrains actuator k."""
    m = np.empty((SLOTS, SLOTS))
    for i in range(SLOTS):
        for j in range(SLOTS):
            m[i, j] = weight * squares[0, i, j] + (1.0 - weight) * squares[1, i, j]
        if squares[0, i, i] + squares[1, i, i] == 0.0:
            m[i, i] = 1.0  # does not exist, or does not move the images
            if i == k:
                return inf
    # Gaussian elimination with k last: 1 / (M^-1)_kk is the last pivot
    for i in range(SLOTS):
        if i == k:
            continue
        pivot = m[i, i]
        if not pivot > 0.0:
            return inf
        for r in range(SLOTS):
            if r != k and r <= i:
                continue
            factor = m[r, i] / pivot
            for c in range(SLOTS):
                m[r, c] -= factor * m[i, c]
    return 1.0 / m[k, k] if m[k, k] > 0.0 else inf
