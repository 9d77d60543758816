r"""The point nearest to two rays of sight, and how it moves with pixels and joints.

The rays `o_l + s d_l` and `o_r + t d_r` in N come closest where the common perpendicular meets
them (Eqs. 18 to 23):

    [ d_l.d_l  -d_l.d_r ] [s]   [ -d_l.w ]
    [-d_l.d_r   d_r.d_r ] [t] = [  d_r.w ],   w = o_l - o_r

and the fix is the midpoint of the perpendicular (Eq. 24). Derivatives follow from those of the
2x2 system: a joint about the axis (z_i, o_i) moves a ray by `do = z_i x (o - o_i)` and
`dd = z_i x d`; a pixel turns its direction alone.
"""

from math import inf, isfinite, nan, sqrt
from typing import Any, Final

from vergence._jit import device, kernel
from vergence.models.camera import distort, is_distorted, undistort_pixel
from vergence.models.kinematics import CAMERA_STRIDE, CAMERAS, eye_frames

MIN_ANGLE_RAD: Final = 1e-4
"""Rays closer to parallel than this have no fix: 92 mm apart, they cross beyond 900 m."""


@device
def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


@device
def _cross(a: Any, b: Any) -> Any:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@device
def _turn(m: Any, x: float, y: float, z: float) -> Any:
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[4] * x + m[5] * y + m[6] * z,
        m[8] * x + m[9] * y + m[10] * z,
    )


@device
def _midpoint_rate(geometry: Any, eye: int, do: Any, dd: Any) -> Any:
    """Velocity of the midpoint when one eye's ray moves by do and turns by dd."""
    ol, dl, orr, dr, s, t = geometry
    w = (ol[0] - orr[0], ol[1] - orr[1], ol[2] - orr[2])
    a, b, c = _dot(dl, dl), _dot(dl, dr), _dot(dr, dr)
    if eye == 0:
        da, db, dc = 2.0 * _dot(dl, dd), _dot(dd, dr), 0.0
        r1 = -_dot(dd, w) - _dot(dl, do) - (da * s - db * t)
        r2 = _dot(dr, do) + db * s
    else:
        da, db, dc = 0.0, _dot(dl, dd), 2.0 * _dot(dr, dd)
        r1 = _dot(dl, do) + db * t
        r2 = _dot(dd, w) - _dot(dr, do) + db * s - dc * t
    det = a * c - b * b
    ds, dt = (c * r1 + b * r2) / det, (b * r1 + a * r2) / det
    if eye == 0:
        e = (do[0] + s * dd[0], do[1] + s * dd[1], do[2] + s * dd[2])
    else:
        e = (do[0] + t * dd[0], do[1] + t * dd[1], do[2] + t * dd[2])
    return (
        0.5 * (e[0] + ds * dl[0] + dt * dr[0]),
        0.5 * (e[1] + ds * dl[1] + dt * dr[1]),
        0.5 * (e[2] + ds * dl[2] + dt * dr[2]),
    )


@device
def ray(p: Any, eye: int, camera: Any, u: float, v: float) -> Any:
    """Direction in N of a raw pixel's ray with unit z in the camera; nan where undefined."""
    i = CAMERAS + eye * CAMERA_STRIDE
    u, v = undistort_pixel(p, eye, u, v)
    return _turn(camera, (u - p[i + 2]) / p[i], (v - p[i + 3]) / p[i + 1], 1.0)


@device
def nearest(ol: Any, dl: Any, orr: Any, dr: Any) -> Any:
    """Distances along two rays to their common perpendicular, and whether there is a fix."""
    w = (ol[0] - orr[0], ol[1] - orr[1], ol[2] - orr[2])
    a, b, c = _dot(dl, dl), _dot(dl, dr), _dot(dr, dr)
    det = a * c - b * b
    if not (isfinite(det) and det > MIN_ANGLE_RAD * MIN_ANGLE_RAD * a * c):
        return nan, nan, False
    r1, r2 = -_dot(dl, w), _dot(dr, w)
    s, t = (c * r1 + b * r2) / det, (b * r1 + a * r2) / det
    return s, t, 0.0 < s < inf and 0.0 < t < inf


@device
def _add_outer(covariance: Any, e: Any, sigma: float) -> None:
    for row in range(3):
        for column in range(3):
            covariance[row, column] += sigma * sigma * e[row] * e[column]


@device
def _add_pixel_noise(
    p: Any, eye: int, camera: Any, pixel: Any, sigma: Any, geometry: Any, covariance: Any
) -> None:
    i = CAMERAS + eye * CAMERA_STRIDE
    # normalised direction per raw pixel: the inverse of the distortion's derivative
    jxx, jxy, jyy = 1.0, 0.0, 1.0
    if is_distorted(p, i):
        u, v = undistort_pixel(p, eye, pixel[0], pixel[1])
        _xd, _yd, dxx, dxy, dyy = distort(p, i, (u - p[i + 2]) / p[i], (v - p[i + 3]) / p[i + 1])
        det = dxx * dyy - dxy * dxy
        jxx, jxy, jyy = dyy / det, -dxy / det, dxx / det
    still = (0.0, 0.0, 0.0)
    du = _turn(camera, jxx / p[i], jxy / p[i], 0.0)
    dv = _turn(camera, jxy / p[i + 1], jyy / p[i + 1], 0.0)
    _add_outer(covariance, _midpoint_rate(geometry, eye, still, du), sigma[0])
    _add_outer(covariance, _midpoint_rate(geometry, eye, still, dv), sigma[1])


@device
def _add_joint_noise(
    eye: int, frames: Any, origin: Any, direction: Any, tilt_sigma: float, pan_sigma: float,
    geometry: Any, covariance: Any,
) -> None:  # fmt: skip
    tilted, panned, _camera = frames
    for axis, sigma in ((tilted, tilt_sigma), (panned, pan_sigma)):
        z = (axis[2], axis[6], axis[10])
        arm = (origin[0] - axis[3], origin[1] - axis[7], origin[2] - axis[11])
        rate = _midpoint_rate(geometry, eye, _cross(z, arm), _cross(z, direction))
        _add_outer(covariance, rate, sigma)


@kernel(
    ["(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],b1[:])"],
    "(j),(e,e),(e,e),(j),(p),(c)->(c),(),(c,c),()",
)
def triangulate(
    q: Any, pixels: Any, pixel_sigma: Any, joint_sigma: Any, p: Any, shape: Any,
    point: Any, gap: Any, covariance: Any, valid: Any,
) -> None:  # fmt: skip
    """Fix, gap, covariance and validity from raw pixels and joint angles."""
    left, right = eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6])
    cl, cr = left[2], right[2]
    ol, orr = (cl[3], cl[7], cl[11]), (cr[3], cr[7], cr[11])
    dl = ray(p, 0, cl, pixels[0, 0], pixels[0, 1])
    dr = ray(p, 1, cr, pixels[1, 0], pixels[1, 1])
    s, t, found = nearest(ol, dl, orr, dr)
    valid[0] = found
    fill = 0.0 if found else nan
    for row in range(3):
        for column in range(3):
            covariance[row, column] = fill
    if not found:
        point[0] = point[1] = point[2] = gap[0] = nan
        return
    square = 0.0
    for k in range(3):
        near_left, near_right = ol[k] + s * dl[k], orr[k] + t * dr[k]
        point[k] = 0.5 * (near_left + near_right)
        square += (near_left - near_right) ** 2
    gap[0] = sqrt(square)
    geometry = (ol, dl, orr, dr, s, t)
    _add_pixel_noise(p, 0, cl, pixels[0], pixel_sigma[0], geometry, covariance)
    _add_pixel_noise(p, 1, cr, pixels[1], pixel_sigma[1], geometry, covariance)
    _add_joint_noise(0, left, ol, dl, joint_sigma[3], joint_sigma[4], geometry, covariance)
    _add_joint_noise(1, right, orr, dr, joint_sigma[5], joint_sigma[6], geometry, covariance)
