r"""The eye angles that put a point on both optical axes, or as near to them as actuators can.

An eye with two motors of its own is turned by Newton's method. Where actuators tie joints, of one
eye or of both, the angles are those with the least sum of squared pixel errors, by damped
Gauss-Newton steps over the actuators.
"""

from math import atan2, hypot, isfinite, nan, sqrt
from typing import Final

import numpy as np

from vergence._jit import device, kernel, subroutine
from vergence.models.actuation import SLOTS
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PACKED, PackedHead, camera_of, joint_at
from vergence.models.parts import FloatArray
from vergence.models.pose import Vector, into, point_rate
from vergence.models.projection import share_of_actuators

_STEPS: Final = 60
_MAX_STEP_RAD: Final = 0.5
_TOLERANCE_RAD: Final = 1e-15
_NEAR_RAD: Final = 1e-4
_LEAST_STEP_RAD: Final = 1e-13
_SETTLED_RAD: Final = 1e-7


@device
def fixate_step(
    p: PackedHead, eye: int, q1: float, q2: float, x: float, y: float, z: float
) -> tuple[float, float]:
    """How far Newton's method turns an eye's two joints towards a point, nan for no answer.

    The bearing (atan2(x, z), atan2(y, |x, z|)) stays smooth for a point behind the camera,
    where the pixel does not, so a limited step finds its way from any side.
    """
    frames = eye_frames(p, eye, q1, q2)
    cx, cy, cz = into(frames.camera, x, y, z)
    r2 = cx * cx + cz * cz
    if not r2 > 0.0:
        return nan, nan
    r = sqrt(r2)
    d2 = r2 + cy * cy
    a, b = atan2(cx, cz), atan2(cy, r)
    t = point_rate(frames.first, frames.camera, x, y, z)
    s = point_rate(frames.second, frames.camera, x, y, z)
    at, ap = (cz * t[0] - cx * t[2]) / r2, (cz * s[0] - cx * s[2]) / r2
    bt = (r * t[1] - cy * (cx * t[0] + cz * t[2]) / r) / d2
    bp = (r * s[1] - cy * (cx * s[0] + cz * s[2]) / r) / d2
    det = at * bp - ap * bt
    if det == 0.0:
        return nan, nan
    return -(bp * a - ap * b) / det, -(at * b - bt * a) / det


@device
def fixate_eye(p: PackedHead, eye: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Newton's method on the point's bearing from the optical axis, from the eye at rest.

    Returns:
        The angles of the eye's two joints, rad; nan for an eye that cannot.
    """
    tilt, pan = 0.0, 0.0
    for _ in range(_STEPS):
        dt, dp = fixate_step(p, eye, tilt, pan, x, y, z)
        step = hypot(dt, dp)
        if not isfinite(step):
            return nan, nan
        scale = _MAX_STEP_RAD / max(step, _MAX_STEP_RAD)
        tilt += scale * dt
        pan += scale * dp
        if step < _TOLERANCE_RAD:
            break
    cx, cy, cz = into(eye_frames(p, eye, tilt, pan).camera, x, y, z)
    # a tolerance two orders above rounding: farther off, there is no such angle
    if cz > 0.0 and abs(cx) + abs(cy) < 1e-12 * (1.0 + cz):
        return tilt, pan
    return nan, nan


@subroutine
def _aim_error(
    p: PackedHead,
    eye: int,
    joints: FloatArray,
    point: Vector,
    bearings: bool,
    error: FloatArray,
    rate: FloatArray,
) -> bool:
    """What an image lacks of a point at its principal point, by bearings or by pixels.

    Args:
        p: a packed head.
        eye: which eye.
        joints: (4,) the eyes' joint angles, rad.
        point: in N, m.
        bearings: whether to take bearings from the optical axis times focal lengths in place of
            pixels: they find their way from any side, and pixels say what is least.
        error: (2, 2) result by eye and image axis, px: less of it is nearer.
        rate: (2, 2, 2) result by eye, image axis and joint of that eye, px/rad.

    Returns:
        False for a point in the camera's origin or straight above it, and by pixels behind it.
    """
    frames = eye_frames(p, eye, joints[2 * eye], joints[2 * eye + 1])
    cx, cy, cz = into(frames.camera, point[0], point[1], point[2])
    r2 = cx * cx + cz * cz
    if not (r2 > 0.0 if bearings else cz > 0.0):
        return False
    camera, r, d2 = camera_of(p, eye), sqrt(r2), r2 + cy * cy
    a, b = (atan2(cx, cz), atan2(cy, r)) if bearings else (cx / cz, cy / cz)
    error[eye, 0], error[eye, 1] = -camera.focal_u * a, -camera.focal_v * b
    for joint in range(2):
        axis = frames.first if joint == 0 else frames.second
        t = point_rate(axis, frames.camera, point[0], point[1], point[2])
        if bearings:
            across = (cz * t[0] - cx * t[2]) / r2
            along = (r * t[1] - cy * (cx * t[0] + cz * t[2]) / r) / d2
        else:
            across, along = (t[0] - a * t[2]) / cz, (t[1] - b * t[2]) / cz
        rate[eye, 0, joint], rate[eye, 1, joint] = camera.focal_u * across, camera.focal_v * along
    return True


@subroutine
def fixate_tied(p: PackedHead, x: float, y: float, z: float, joints: FloatArray) -> bool:
    """The eyes' joint angles with the least sum of squared pixel errors that actuators can give.

    Args:
        p: a packed head.
        x: of the point in N, m.
        y: of it.
        z: of it.
        joints: (4,) result, rad; nan where there are none.

    Returns:
        Whether there are such angles.
    """
    own, step = np.zeros(SLOTS), np.zeros(SLOTS)
    error, rate = np.zeros((2, 2)), np.zeros((2, 2, 2))
    bearings, found, size = True, False, 0.0
    for _ in range(2 * _STEPS):
        for joint in range(SLOTS):
            joints[joint] = joint_at(p, joint, own)
        sees = True
        for eye in range(2):
            sees = sees and _aim_error(p, eye, joints, (x, y, z), bearings, error, rate)
        if not sees:
            break
        share_of_actuators(p, rate, error, True, True, step)
        size = 0.0
        for k in range(SLOTS):
            size = max(size, abs(step[k]))
        if not isfinite(size):
            break
        scale = _MAX_STEP_RAD / max(size, _MAX_STEP_RAD)
        for k in range(SLOTS):
            own[k] += scale * step[k]
        if size < (_NEAR_RAD if bearings else _LEAST_STEP_RAD):
            found = not bearings
            if found:
                break
            bearings = False
    if not found and not bearings and size < _SETTLED_RAD:
        found = True  # Gauss-Newton creeps where much is left of the error
    for joint in range(SLOTS):
        joints[joint] = joint_at(p, joint, own) if found else nan
    return found


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], f"(3),(3),(7),({PACKED})->(7)")
def fixate(
    points: FloatArray, neck: FloatArray, shape: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Joint angles that fixate a point of N; nan for an eye that cannot."""
    for j in range(3):
        out[j] = neck[j]
    for eye in range(2):
        q1, q2 = fixate_eye(p, eye, points[0], points[1], points[2])
        out[3 + 2 * eye], out[4 + 2 * eye] = q1, q2


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], f"(3),(3),(7),({PACKED})->(7)")
def fixate_best(
    points: FloatArray, neck: FloatArray, shape: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """As `fixate`, where actuators tie the joints: what comes nearest; nan where nothing does."""
    for j in range(3):
        out[j] = neck[j]
    fixate_tied(p, points[0], points[1], points[2], out[3:])
