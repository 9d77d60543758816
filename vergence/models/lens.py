"""Lens models: distortion of a pinhole's image, and its inverse. New models are added here.

A ray has the ideal coordinates x = X / Z, y = Y / Z of a pinhole, r^2 = x^2 + y^2. The models are
OpenCV's. `brown-conrady` (Brown and Conrady, 5 coefficients) and `rational` (8) are

    x_d = x c + 2 p1 x y + p2 (r^2 + 2 x^2)      c = 1 + k1 r^2 + k2 r^4 + k3 r^6
    y_d = y c + p1 (r^2 + 2 y^2) + 2 p2 x y

where `rational` divides c by 1 + k4 r^2 + k5 r^4 + k6 r^6. `fisheye` (Kannala and Brandt, 4)
distorts by the angle t = atan(r) from the optical axis:

    (x_d, y_d) = (x, y) t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) / r

The Jacobian of each model is symmetric. A model is valid as long as a ray that turns outwards also
moves outwards in the image, up to its fold, where the image turns back on itself, and while its
Jacobian is positive definite. Beyond that `is_invertible_at` is False and projections are nan, as
is `undistort_ray` for a pixel without a ray; `distort` does not check.

A new model needs here its coefficients in `CameraRow`, its names at the end of `LENSES` (heads'
digests count their places), a case in `distort` and its fold in `pack_camera`; a case with
derivatives by the coefficients in `vergence.calibration.adjustment`; and the names that calibration
files have for it in `vergence.models.stereo_files`. No other module computes with coefficients.
"""

from math import atan, inf, isfinite, nan, sqrt, tan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.kernels import inlined, make_tuple_reader, subroutine
from vergence.models.parts import FloatArray

BROWN_CONRADY: Final = "brown-conrady"
LENSES: Final[dict[str, tuple[str, ...]]] = {
    BROWN_CONRADY: ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""The lens models and their coefficients in OpenCV's order."""
PINHOLE: Final = 0.0
"""`CameraRow.lens` of a lens without distortion; of others, their place in `LENSES` from 1 on."""
POLYNOMIAL: Final = 1.0
"""`CameraRow.lens` of `brown-conrady` (numerical)."""
FISHEYE: Final = 3.0
"""`CameraRow.lens` of `fisheye` (numerical)."""
_NEWTON_STEPS: Final = 25  # iteration limit of Newton's method (numerical)
_NEWTON_TOLERANCE: Final = 1e-15  # relative convergence tolerance of a Newton step (numerical)
_MAX_RESIDUAL: Final = 1e-13
"""Largest distance of an inverse's distorted coordinates from the given ones, relative
(numerical)."""
_SEARCH_STEPS: Final = 200  # iteration limit of the damped search (numerical)
_LEAST_STEP_FRACTION: Final = 1e-6
"""Smallest fraction of a Newton step that the damped search tries (numerical)."""
_MAX_COORDINATE: Final = 1e20
"""Largest distorted coordinate that is inverted: far beyond any image; powers of larger
coordinates overflow (numerical)."""


class CameraRow(NamedTuple):
    """One camera inside a kernel: pinhole and image size in pixels, and the lens."""

    focal_u: float
    focal_v: float
    centre_u: float
    centre_v: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float
    k5: float
    k6: float
    width: float
    height: float
    lens: float  # `PINHOLE`, `POLYNOMIAL`, 2 for `rational`, or `FISHEYE`
    fold_radius_squared: float
    """Squared ideal radius of the fold, at which the image turns back on itself; inf if there is
    none."""
    safe_radius_squared: float
    """Squared ideal radius within which the Jacobian is guaranteed to be positive definite."""


class DistortedPoint(NamedTuple):
    """Distorted normalised coordinates and their derivatives by the ideal ones."""

    x: float
    y: float
    dxx: float
    dxy: float  # derivative of x by y, which equals that of y by x
    dyy: float


CAMERA_LENGTH: Final = 17
"""Length of a packed camera (numerical)."""
_camera_run = make_tuple_reader(CAMERA_LENGTH)


@inlined
def camera_at(row: FloatArray, i: int) -> CameraRow:
    """Read the camera that begins at index i of a row."""
    return CameraRow(*_camera_run(row, i))


@inlined
def is_distorted(camera: CameraRow) -> bool:
    """True if the lens differs from a pinhole."""
    return camera.lens != PINHOLE


@inlined
def distort(camera: CameraRow, x: float, y: float) -> DistortedPoint:
    """Distort a ray's ideal normalised coordinates."""
    if camera.lens > POLYNOMIAL:
        return _distort_rational_or_fisheye(camera, x, y)
    return _distort_by_polynomial(camera, x, y)


@inlined
def is_invertible_at(camera: CameraRow, x: float, y: float, distorted: DistortedPoint) -> bool:
    """True if the model is invertible at a ray: before the fold, Jacobian positive definite."""
    r2 = x * x + y * y
    return r2 < camera.safe_radius_squared or (
        r2 < camera.fold_radius_squared
        and distorted.dxx > 0.0
        and distorted.dxx * distorted.dyy > distorted.dxy * distorted.dxy
    )


@inlined
def undistort_ray(camera: CameraRow, xd: float, yd: float) -> tuple[float, float]:
    """Invert the distortion: the ideal coordinates; nan if the lens model has no ray there."""
    if not isfinite(xd + yd):  # no target visible: comparisons with nan would warn
        return nan, nan
    if camera.lens != POLYNOMIAL:
        return _search(camera, xd, yd, xd, yd)
    # for moderate angles, Newton's method from the distorted coordinates suffices
    x, y = xd, yd
    for _ in range(_NEWTON_STEPS):
        distorted = _distort_by_polynomial(camera, x, y)
        fx, fy = distorted.x - xd, distorted.y - yd
        det = distorted.dxx * distorted.dyy - distorted.dxy * distorted.dxy
        sx = (distorted.dyy * fx - distorted.dxy * fy) / det
        sy = (distorted.dxx * fy - distorted.dxy * fx) / det
        x -= sx
        y -= sy
        if abs(sx) + abs(sy) < _NEWTON_TOLERANCE * (1.0 + abs(x) + abs(y)):
            if x * x + y * y < camera.safe_radius_squared:
                return x, y
            return _search(camera, xd, yd, x, y)
    return _search(camera, xd, yd, xd, yd)


@inlined
def _distort_by_polynomial(camera: CameraRow, x: float, y: float) -> DistortedPoint:
    k1, k2, k3 = camera.k1, camera.k2, camera.k3
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    return _radial_and_tangential(camera, x, y, r2, radial, slope)


@inlined
def _radial_and_tangential(
    camera: CameraRow, x: float, y: float, r2: float, radial: float, slope: float
) -> DistortedPoint:
    """Combine the radial and tangential terms; slope is the derivative of radial by r^2."""
    p1, p2 = camera.p1, camera.p2
    return DistortedPoint(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@subroutine
def _distort_generic(camera: CameraRow, x: float, y: float) -> DistortedPoint:
    """Distort by any model; for the fisheye, a polynomial too, x and y are angles (x, y) t / r."""
    k1, k2, k3 = camera.k1, camera.k2, camera.k3
    k4, below_k1 = (camera.k4, 0.0) if camera.lens == FISHEYE else (0.0, camera.k4)
    r2 = x * x + y * y
    below = 1.0 + r2 * (below_k1 + r2 * (camera.k5 + r2 * camera.k6))
    below_slope = below_k1 + r2 * (2.0 * camera.k5 + 3.0 * r2 * camera.k6)
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))) / below
    slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + 4.0 * r2 * k4))
    return _radial_and_tangential(camera, x, y, r2, radial, (slope - radial * below_slope) / below)


@subroutine
def _distort_rational_or_fisheye(camera: CameraRow, x: float, y: float) -> DistortedPoint:
    """`distort` of the rational and the fisheye model."""
    r2 = x * x + y * y
    if camera.lens != FISHEYE or r2 < 1e-24:
        return _distort_generic(camera, x, y)
    r = sqrt(r2)
    ratio = atan(r) / r
    distorted = _distort_generic(camera, ratio * x, ratio * y)
    # derivative of the angles: the ratio across the radius, 1 / (1 + r^2) along it
    more = (1.0 / (1.0 + r2) - ratio) / r2
    axx, axy, ayy = ratio + x * x * more, x * y * more, ratio + y * y * more
    return DistortedPoint(
        distorted.x,
        distorted.y,
        distorted.dxx * axx + distorted.dxy * axy,
        distorted.dxx * axy + distorted.dxy * ayy,
        distorted.dxy * axy + distorted.dyy * ayy,
    )


@subroutine
def _search(camera: CameraRow, xd: float, yd: float, x: float, y: float) -> tuple[float, float]:
    """The ray of distorted coordinates by a damped Newton search; (x, y) is the initial guess.

    The search starts at the optical axis, and its first step goes to the guess. Each step is halved
    until it lowers the residual and stays where the model is invertible. In that region the
    distortion is the gradient of a convex function, so the residual has no other local minimum
    than the solution. For a fisheye, x and y are angles.
    """
    size = abs(xd) + abs(yd)
    if size > _MAX_COORDINATE:
        return nan, nan
    limit = camera.fold_radius_squared
    if camera.lens == FISHEYE:
        limit = atan(sqrt(limit)) ** 2
    step_x, step_y, fraction, least = -x, -y, 1.0, inf
    x = y = 0.0
    for _ in range(_SEARCH_STEPS):
        new_x, new_y = x - fraction * step_x, y - fraction * step_y
        distorted = _distort_generic(camera, new_x, new_y)
        fx, fy = distorted.x - xd, distorted.y - yd
        off, det = abs(fx) + abs(fy), distorted.dxx * distorted.dyy - distorted.dxy * distorted.dxy
        inside = new_x * new_x + new_y * new_y < limit and distorted.dxx > 0.0 and det > 0.0
        if inside and off < least:
            step_x = (distorted.dyy * fx - distorted.dxy * fy) / det
            step_y = (distorted.dxx * fy - distorted.dxy * fx) / det
            x, y, least, fraction = new_x, new_y, off, 1.0
            if abs(step_x) + abs(step_y) < 2.0 * _NEWTON_TOLERANCE * (1.0 + abs(x) + abs(y)):
                break
        else:
            fraction *= 0.5
            if fraction < _LEAST_STEP_FRACTION:
                break
    if not least < _MAX_RESIDUAL * (1.0 + size):
        return nan, nan
    if camera.lens == FISHEYE and least < size:  # from its angles to the ray
        angle = sqrt(x * x + y * y)
        return x * tan(angle) / angle, y * tan(angle) / angle
    return x, y


@inlined
def ray_to_pixel(camera: CameraRow, x: float, y: float) -> tuple[float, float]:
    """The pixel of a ray (X / Z, Y / Z), nan beyond the lens model's valid region."""
    if is_distorted(camera):
        distorted = distort(camera, x, y)
        if not is_invertible_at(camera, x, y, distorted):
            return nan, nan
        x, y = distorted.x, distorted.y
    return pinhole_pixel(camera, x, y)


@inlined
def pinhole_pixel(camera: CameraRow, x: float, y: float) -> tuple[float, float]:
    """The pixel of normalised coordinates, ideal or distorted."""
    return camera.centre_u + camera.focal_u * x, camera.centre_v + camera.focal_v * y


@inlined
def pinhole_ray(camera: CameraRow, u: float, v: float) -> tuple[float, float]:
    """The normalised coordinates of a pixel, the inverse of `pinhole_pixel`."""
    return (u - camera.centre_u) / camera.focal_u, (v - camera.centre_v) / camera.focal_v


_POLE_MARGIN_FACTOR: Final = 1.0 - 1e-9
"""Factor on the squared radius of a pole: the model has no value at the pole, only before it
(numerical)."""
_MAX_FOLD_ANGLE_RAD: Final = 0.5 * np.pi - 1e-9
"""Largest angle of a fisheye's fold from the optical axis, rad; its tangent is finite
(numerical)."""
_LEAST_RECIPROCAL: Final = 1e-12
"""Smallest reciprocal of a squared radius that counts as a root; smaller ones are rounding or
belong to rays within about 1e-6 of a right angle from the axis (numerical)."""


def pack_camera(
    size: ArrayLike, focal: FloatArray, principal: FloatArray, lens: str, distortion: ArrayLike
) -> FloatArray:
    """Pack cameras of one lens model into rows (..., 17) for `camera_at`; size and focal in px."""
    k = np.asarray(distortion)
    batch = np.broadcast_shapes(focal.shape[:-1], principal.shape[:-1], k.shape[:-1])
    rows = np.zeros((*batch, CAMERA_LENGTH))
    rows[..., 0:2], rows[..., 2:4], rows[..., 12:14] = focal, principal, size
    rows[..., [CameraRow._fields.index(name) for name in LENSES[lens]]] = k
    bends = k.any(axis=-1) | (lens == "fisheye")
    rows[..., 14] = np.where(bends, 1.0 + list(LENSES).index(lens), PINHOLE)
    if lens == "fisheye":
        angle = np.sqrt(_first_root(_odd_derivative(k)))
        # a ray (X / Z, Y / Z) is less than a right angle from the axis
        fold = np.tan(np.minimum(angle, _MAX_FOLD_ANGLE_RAD)) ** 2
    elif lens == BROWN_CONRADY:
        fold = _first_root(_odd_derivative(k[..., [0, 1, 4]]))
    else:
        fold = _rational_fold(k[..., [0, 1, 4]], k[..., 5:8])
    rows[..., 15] = fold
    rows[..., 16] = fold if lens == "fisheye" else _safe_radius_squared(lens, k, fold)
    return rows


def _safe_radius_squared(lens: str, k: FloatArray, fold: FloatArray) -> FloatArray:
    """Squared radius of a positive definite derivative; the fold's without tangential terms."""
    tangential = np.hypot(k[..., 2], k[..., 3])
    if not tangential.any():
        return fold
    safe = np.zeros_like(fold)
    if lens == BROWN_CONRADY:
        # The least eigenvalue is at least 1 - sum of (2 i + 1) max(-k_i, 0) r^(2 i) - 6 |p| r:
        # above 0 where each of the four terms is below a quarter.
        down = np.maximum(-k[..., [0, 1, 4]], 0.0) * [3.0, 5.0, 7.0]
        terms = np.concatenate([down, 6.0 * tangential[..., None]], axis=-1)
        radii = np.full(terms.shape, np.inf)
        with np.errstate(over="ignore"):  # tiny terms overflow to inf: no limit
            np.divide(0.25, terms, out=radii, where=terms > 0.0)
            safe = (radii ** [1.0, 1.0 / 2.0, 1.0 / 3.0, 2.0]).min(axis=-1)
    return np.where(tangential > 0.0, np.minimum(safe, fold), fold)


def _odd_derivative(k: FloatArray) -> FloatArray:
    """Derivative of r (1 + k1 r^2 + k2 r^4 + ...) by r, in powers of r^2, highest power first."""
    rising = (2.0 * np.arange(k.shape[-1]) + 3.0) * k
    return np.concatenate([rising[..., ::-1], np.ones_like(k[..., :1])], axis=-1)


def _rational_fold(above: FloatArray, below: FloatArray) -> FloatArray:
    """Squared radius at which r N / D stops rising or D vanishes; k1 to k3 in N, k4 to k6 in D."""
    one = np.ones_like(above[..., :1])
    N, D = (np.concatenate([k[..., ::-1], one], axis=-1) for k in (above, below))
    powers = np.arange(3.0, -1.0, -1.0)
    # the derivative is (N D + 2 s (N' D - N D')) / D^2 with s = r^2 and derivatives by s
    derivative = _product((1.0 + 2.0 * powers) * N, D) - _product(N, 2.0 * powers * D)
    return np.minimum(_first_root(derivative), _POLE_MARGIN_FACTOR * _first_root(D))


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Product of two polynomials of third degree."""
    out = np.zeros((*a.shape[:-1], 7))
    for i in range(4):
        out[..., i : i + 4] += a[..., i : i + 1] * b
    return out


def _first_root(powers: FloatArray) -> FloatArray:
    """Least positive root, or inf, of polynomials (..., n), highest power first, the last 1."""
    out = np.full(powers.shape[:-1], np.inf)
    used = powers.reshape(-1, powers.shape[-1]).any(axis=0)
    degree = powers.shape[-1] - 1 - int(np.argmax(used))
    if degree == 0:
        return out
    # The reciprocals of the roots are the roots of the polynomial with its coefficients reversed,
    # which begins with the 1. Its companion matrix needs no division, which a small highest
    # coefficient would make inexact.
    companion = np.zeros((*powers.shape[:-1], degree, degree))
    companion[..., range(1, degree), range(degree - 1)] = 1.0
    companion[..., 0, :] = -powers[..., -2 : -2 - degree : -1]
    reciprocals = np.linalg.eigvals(companion)
    fit = (reciprocals.imag == 0.0) & (reciprocals.real > _LEAST_RECIPROCAL)
    greatest = np.where(fit, reciprocals.real, 0.0).max(axis=-1)
    np.divide(1.0, greatest, out=out, where=greatest > 0.0)
    return out
