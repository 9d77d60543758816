r"""Least-squares motion of a head's actuators for wanted image motions, weighted by pixels.

For each eye e, the image Jacobian J_e (2, 2) of its two joints and a wanted motion w_e of the image
are given. With coupled joints the wanted motions of the two eyes may contradict each other. The
motion s of the actuators is

    s = argmin sum over eyes |J_e (A s)_e - w_e|^2

with A the joints' angles per actuator angle. A small multiple of |s|^2 is added as damping, so that
actuators without effect on any wanted motion do not move.
"""

from math import sqrt
from typing import Final

import numpy as np

from vergence._jit import inlined, subroutine
from vergence.models.actuation import SLOTS
from vergence.models.packed import PackedHead, joint_per_actuator
from vergence.models.parts import FloatArray

_DAMPING: Final = 1e-11
"""Damping of the normal equations, as a fraction of their trace (numerical)."""


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
    # Cholesky factor in place, then forward and back substitution
    for k in range(SLOTS):
        for i in range(k):
            total = normal[k, i]
            for r in range(i):
                total -= normal[k, r] * normal[i, r]
            normal[k, i] = total / normal[i, i]
        total = normal[k, k]
        for r in range(k):
            total -= normal[k, r] * normal[k, r]
        normal[k, k] = sqrt(max(total, 1e-300))
    for k in range(SLOTS):
        for r in range(k):
            out[k] -= normal[k, r] * out[r]
        out[k] /= normal[k, k]
    for k in range(SLOTS - 1, -1, -1):
        for r in range(k + 1, SLOTS):
            out[k] -= normal[r, k] * out[r]
        out[k] /= normal[k, k]


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
