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
from vergence.models.kinematics import EyeFrames, eye_frames
from vergence.models.packed import PackedHead, camera_of, is_direct, joint_at
from vergence.models.parts import FloatArray
from vergence.models.pose import into, point_rate
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


@device
def _bearing(
    frames: EyeFrames, x: float, y: float, z: float, error: FloatArray, rate: FloatArray
) -> bool:
    """A point's bearing (2,) from an optical axis, rad, and its rates (2, 2) by image axis, joint.

    Returns:
        False for a point in the camera's origin or straight above it.
    """
    cx, cy, cz = into(frames.camera, x, y, z)
    r2 = cx * cx + cz * cz
    d2 = r2 + cy * cy
    if not r2 > 0.0:
        return False
    r = sqrt(r2)
    error[0], error[1] = atan2(cx, cz), atan2(cy, r)
    for joint in range(2):
        axis = frames.first if joint == 0 else frames.second
        t = point_rate(axis, frames.camera, x, y, z)
        rate[0, joint] = (cz * t[0] - cx * t[2]) / r2
        rate[1, joint] = (r * t[1] - cy * (cx * t[0] + cz * t[2]) / r) / d2
    return True


@device
def _offset(
    frames: EyeFrames, x: float, y: float, z: float, error: FloatArray, rate: FloatArray
) -> bool:
    """As `_bearing`, of the normalised image coordinates; False for a point behind the camera."""
    cx, cy, cz = into(frames.camera, x, y, z)
    if not cz > 0.0:
        return False
    error[0], error[1] = cx / cz, cy / cz
    for joint in range(2):
        axis = frames.first if joint == 0 else frames.second
        t = point_rate(axis, frames.camera, x, y, z)
        rate[0, joint] = (t[0] - error[0] * t[2]) / cz
        rate[1, joint] = (t[1] - error[1] * t[2]) / cz
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
    # bearings find their way from any side, and pixels say what is least
    bearings, found, size = True, False, 0.0
    for _ in range(2 * _STEPS):
        for joint in range(SLOTS):
            joints[joint] = joint_at(p, joint, own)
        sees = True
        for eye in range(2):
            frames = eye_frames(p, eye, joints[2 * eye], joints[2 * eye + 1])
            if bearings:
                sees = sees and _bearing(frames, x, y, z, error[eye], rate[eye])
            else:
                sees = sees and _offset(frames, x, y, z, error[eye], rate[eye])
            camera = camera_of(p, eye)
            for axis in range(2):
                focal = camera.focal_v if axis else camera.focal_u
                error[eye, axis] *= -focal
                for joint in range(2):
                    rate[eye, axis, joint] *= focal
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


@device
def fixate_eyes(p: PackedHead, x: float, y: float, z: float, joints: FloatArray) -> None:
    """The angles (4,) of the eyes' joints that fixate a point of N, rad; nan for one that cannot.

    Where actuators tie joints, both eyes have an answer or neither has.
    """
    if not is_direct(p):
        fixate_tied(p, x, y, z, joints)
        return
    for eye in range(2):
        joints[2 * eye], joints[2 * eye + 1] = fixate_eye(p, eye, x, y, z)


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], "(c),(c),(j),(p)->(j)")
def fixate(
    point: FloatArray, neck: FloatArray, shape: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Joint angles that fixate a point of N; nan for an eye that cannot."""
    for j in range(3):
        out[j] = neck[j]
    fixate_eyes(p, point[0], point[1], point[2], out[3:])
