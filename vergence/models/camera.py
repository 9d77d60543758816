"""Pinhole projection with lens distortion, both ways, as kernels over packed heads.

The distortion is the five-coefficient model of Brown and Conrady as OpenCV writes it:

    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

with pixel centres at integers, `u = u_0 + f_u x_d`.
"""

from math import nan
from typing import Any, Final

from vergence._jit import device, kernel
from vergence.models.kinematics import CAMERA_STRIDE, CAMERAS, point_in_eye

_NEWTON_STEPS: Final = 25
_NEWTON_TOLERANCE: Final = 1e-15


@device
def distort(p: Any, i: int, x: float, y: float) -> Any:
    """Distorted normalised coordinates and their derivatives by x and y.

    Returns:
        x_d, y_d, dx_d/dx, dx_d/dy (which equals dy_d/dx), dy_d/dy.
    """
    k1, k2, p1, p2, k3 = p[i + 4], p[i + 5], p[i + 6], p[i + 7], p[i + 8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    dxx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    dxy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    dyy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, dxx, dxy, dyy


@device
def is_distorted(p: Any, i: int) -> Any:
    """Whether any distortion coefficient is not zero."""
    return (
        p[i + 4] != 0.0 or p[i + 5] != 0.0 or p[i + 6] != 0.0 or p[i + 7] != 0.0 or p[i + 8] != 0.0
    )


@device
def point_to_pixel(p: Any, eye: int, x: float, y: float, z: float, distorted: bool) -> Any:
    """The pixel of a point of the camera frame, nan behind it or beyond the lens model."""
    i = CAMERAS + eye * CAMERA_STRIDE
    if not z > 0.0:
        return nan, nan
    xn, yn = x / z, y / z
    if distorted and is_distorted(p, i):
        if xn * xn + yn * yn >= p[i + 11]:
            return nan, nan
        xn, yn, _dxx, _dxy, _dyy = distort(p, i, xn, yn)
    return p[i + 2] + p[i] * xn, p[i + 3] + p[i + 1] * yn


@device
def undistort_pixel(p: Any, eye: int, u: float, v: float) -> Any:
    """The ideal pinhole's pixel, by Newton's method on the distortion; nan without a solution."""
    i = CAMERAS + eye * CAMERA_STRIDE
    if not is_distorted(p, i):
        return u, v
    xd, yd = (u - p[i + 2]) / p[i], (v - p[i + 3]) / p[i + 1]
    x, y = xd, yd
    converged = False
    for _ in range(_NEWTON_STEPS):
        fx, fy, dxx, dxy, dyy = distort(p, i, x, y)
        fx -= xd
        fy -= yd
        det = dxx * dyy - dxy * dxy
        sx = (dyy * fx - dxy * fy) / det
        sy = (dxx * fy - dxy * fx) / det
        x -= sx
        y -= sy
        if abs(sx) + abs(sy) < _NEWTON_TOLERANCE * (1.0 + abs(x) + abs(y)):
            converged = True
            break
    if not converged or not (x * x + y * y < p[i + 11]):
        # the last digits may wander without settling: what counts is the residual
        fx, fy, _dxx, _dxy, _dyy = distort(p, i, x, y)
        if not (abs(fx - xd) + abs(fy - yd) < 1e-13 and x * x + y * y < p[i + 11]):
            return nan, nan
    return p[i + 2] + p[i] * x, p[i + 3] + p[i + 1] * y


@device
def inside_image(p: Any, eye: int, u: float, v: float) -> Any:
    """Whether a raw pixel lies in the image, whose pixels' centres are at integers."""
    i = CAMERAS + eye * CAMERA_STRIDE
    # not `and`: a processor cannot foresee where each target of a batch is
    return (u >= -0.5) & (u <= p[i + 9] - 0.5) & (v >= -0.5) & (v <= p[i + 10] - 0.5)


@kernel(
    ["(f8[:],f8[:],b1[:],f8[:],f8[:],f8[:,:])"],
    "(j),(c),(),(p),(e)->(e,e)",
)
def project(q: Any, point: Any, distorted: Any, p: Any, pair: Any, out: Any) -> None:
    """Pixels of a point of N in both eyes."""
    for eye in range(2):
        tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
        x, y, z = point_in_eye(p, eye, tilt, pan, point[0], point[1], point[2])
        out[eye, 0], out[eye, 1] = point_to_pixel(p, eye, x, y, z, distorted[0])


@kernel(["(f8[:,:],f8[:],f8[:,:])"], "(e,e),(p)->(e,e)")
def undistort(pixels: Any, p: Any, out: Any) -> None:
    """Ideal pinhole pixels of raw pixels, both eyes."""
    for eye in range(2):
        out[eye, 0], out[eye, 1] = undistort_pixel(p, eye, pixels[eye, 0], pixels[eye, 1])
