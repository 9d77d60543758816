"""The eye angles that put a point on both optical axes."""

from math import atan2, hypot, isfinite, nan, sqrt
from typing import Final

from vergence._jit import device, kernel
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray
from vergence.models.pose import into, point_rate

_STEPS: Final = 60
_MAX_STEP_RAD: Final = 0.5
_TOLERANCE_RAD: Final = 1e-15


@device
def fixate_step(
    p: PackedHead, eye: int, tilt: float, pan: float, x: float, y: float, z: float
) -> tuple[float, float]:
    """How far Newton's method turns an eye towards a point: tilt and pan, nan for no answer.

    The bearing (atan2(x, z), atan2(y, |x, z|)) stays smooth for a point behind the camera,
    where the pixel does not, so a limited step finds its way from any side.
    """
    frames = eye_frames(p, eye, tilt, pan)
    cx, cy, cz = into(frames.camera, x, y, z)
    r2 = cx * cx + cz * cz
    if not r2 > 0.0:
        return nan, nan
    r = sqrt(r2)
    d2 = r2 + cy * cy
    a, b = atan2(cx, cz), atan2(cy, r)
    t = point_rate(frames.tilted, frames.camera, x, y, z)
    s = point_rate(frames.panned, frames.camera, x, y, z)
    at, ap = (cz * t[0] - cx * t[2]) / r2, (cz * s[0] - cx * s[2]) / r2
    bt = (r * t[1] - cy * (cx * t[0] + cz * t[2]) / r) / d2
    bp = (r * s[1] - cy * (cx * s[0] + cz * s[2]) / r) / d2
    det = at * bp - ap * bt
    if det == 0.0:
        return nan, nan
    return -(bp * a - ap * b) / det, -(at * b - bt * a) / det


@device
def fixate_eye(p: PackedHead, eye: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Newton's method on the point's bearing from the optical axis, from the eye at rest."""
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


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:])"], "(c),(c),(j),(p)->(j)")
def fixate(
    point: FloatArray, neck: FloatArray, shape: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Joint angles that fixate a point of N; nan for an eye that cannot."""
    for j in range(3):
        out[j] = neck[j]
    for eye in range(2):
        tilt, pan = fixate_eye(p, eye, point[0], point[1], point[2])
        out[3 + 2 * eye], out[4 + 2 * eye] = tilt, pan
