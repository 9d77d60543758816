"""The lens: how it bends the image of a pinhole, and back. Lens models are added here.

A ray has the ideal coordinates x = X / Z, y = Y / Z of a pinhole, r^2 = x^2 + y^2. The models are
OpenCV's. `brown-conrady` (Brown and Conrady, 5 coefficients) and `rational` (8) are

    x_d = x c + 2 p1 x y + p2 (r^2 + 2 x^2)      c = 1 + k1 r^2 + k2 r^4 + k3 r^6
    y_d = y c + p1 (r^2 + 2 y^2) + 2 p2 x y

where c of the rational one is divided by 1 + k4 r^2 + k5 r^4 + k6 r^6. `fisheye` (Kannala and
Brandt, 4) bends by the angle t = atan(r) from the optical axis:

    (x_d, y_d) = (x, y) t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) / r

The derivative of each model is symmetric. A model means something as far as a ray that turns
outwards also moves outwards in the image: up to its fold (see `fold`), and where the derivative is
positive definite. Beyond it and where no ray leads, there is nan.

Another model needs its coefficients in `CameraRow`, its names in `parts.LENSES`, its fold in
`fold`, and its case here: no other module computes with coefficients.
"""

from math import atan, inf, isfinite, nan, sqrt, tan
from typing import Final, NamedTuple

from vergence._jit import device, subroutine

PINHOLE: Final = 0.0
"""What `CameraRow.lens` says of a lens that bends nothing."""
POLYNOMIAL: Final = 1.0
"""Of `brown-conrady`."""
RATIONAL: Final = 2.0
FISHEYE: Final = 3.0
_NEWTON_STEPS: Final = 25
_NEWTON_TOLERANCE: Final = 1e-15
_RESIDUAL: Final = 1e-13
"""Of an inverse: how far from the distorted coordinates it may be seen again."""


_FARTHEST: Final = 1e20
"""No image reaches as far, and powers of more would overflow."""


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
    lens: float
    """`PINHOLE`, `POLYNOMIAL`, `RATIONAL` or `FISHEYE`."""
    fold_radius_squared: float
    """Of the ideal radius at which the lens folds the image back on itself; inf if never."""
    safe_radius_squared: float
    """Of one before the fold within which the derivative is surely positive definite."""


class Bent(NamedTuple):
    """Distorted normalised coordinates and their derivatives by the ideal ones."""

    x: float
    y: float
    dxx: float
    dxy: float
    """Of x by y, which equals that of y by x."""
    dyy: float


@device
def is_distorted(camera: CameraRow) -> bool:
    """Whether the lens departs from the pinhole."""
    return camera.lens != PINHOLE


@device
def distort(camera: CameraRow, x: float, y: float) -> Bent:
    """What the lens makes of a ray's ideal normalised coordinates."""
    if camera.lens > POLYNOMIAL:
        return _distort_otherwise(camera, x, y)
    return _distort_by_polynomial(camera, x, y)


@device
def has_meaning(camera: CameraRow, x: float, y: float) -> bool:
    """Whether a ray lies where the model has an inverse."""
    r2 = x * x + y * y
    return r2 < camera.safe_radius_squared or _keeps_order(camera, x, y)


@subroutine
def _keeps_order(camera: CameraRow, x: float, y: float) -> bool:
    """`has_meaning` of a ray beyond the safe radius."""
    if not x * x + y * y < camera.fold_radius_squared:
        return False
    bent = distort(camera, x, y)
    return bent.dxx > 0.0 and bent.dxx * bent.dyy > bent.dxy * bent.dxy


@device
def undistort_ray(camera: CameraRow, xd: float, yd: float) -> tuple[float, float]:
    """The ideal coordinates of distorted ones; nan where the lens model has no ray."""
    if not isfinite(xd + yd):  # an eye that sees nothing: comparisons with nan would warn
        return nan, nan
    if camera.lens != POLYNOMIAL:
        return _undistort_outwards(camera, xd, yd)
    # lenses of moderate angles need no more than Newton's method from the distorted coordinates
    x, y = xd, yd
    converged = False
    for _ in range(_NEWTON_STEPS):
        bent = _distort_by_polynomial(camera, x, y)
        fx, fy = bent.x - xd, bent.y - yd
        det = bent.dxx * bent.dyy - bent.dxy * bent.dxy
        sx = (bent.dyy * fx - bent.dxy * fy) / det
        sy = (bent.dxx * fy - bent.dxy * fx) / det
        x -= sx
        y -= sy
        if abs(sx) + abs(sy) < _NEWTON_TOLERANCE * (1.0 + abs(x) + abs(y)):
            converged = True
            break
    if converged and x * x + y * y < camera.safe_radius_squared:
        return x, y
    return _judged(camera, xd, yd, x, y, converged)


@subroutine
def _judged(
    camera: CameraRow, xd: float, yd: float, x: float, y: float, converged: bool
) -> tuple[float, float]:
    """What Newton's method from the distorted coordinates led to, or what else leads to a ray."""
    if not has_meaning(camera, x, y):
        return _undistort_outwards(camera, xd, yd)
    if not converged:
        # the last digits may wander without settling: what counts is the residual
        bent = _distort_by_polynomial(camera, x, y)
        converged = abs(bent.x - xd) + abs(bent.y - yd) < _RESIDUAL
    if converged:
        return x, y
    if _in_image(camera, xd, yd):
        return _undistort_outwards(camera, xd, yd)
    return nan, nan  # too far aside for the steps


@device
def _distort_by_polynomial(camera: CameraRow, x: float, y: float) -> Bent:
    k1, k2, k3 = camera.k1, camera.k2, camera.k3
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    return _bend(camera, x, y, r2, radial, slope)


@device
def _bend(camera: CameraRow, x: float, y: float, r2: float, radial: float, slope: float) -> Bent:
    """Radial and tangential terms together; slope is the derivative of radial by r^2."""
    p1, p2 = camera.p1, camera.p2
    return Bent(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@subroutine
def _distort_otherwise(camera: CameraRow, x: float, y: float) -> Bent:
    """`distort` of the rational and the fisheye model."""
    r2 = x * x + y * y
    if camera.lens == FISHEYE:
        if r2 < 1e-24:
            return Bent(x, y, 1.0, 0.0, 1.0)
        r = sqrt(r2)
        bent, slope = _radial(camera, atan(r))
        ratio = bent / r
        # the derivative is the ratio across the radius, and slope / (1 + r^2) along it
        along = (slope / (1.0 + r2) - ratio) / r2
        return Bent(
            x * ratio, y * ratio, ratio + x * x * along, x * y * along, ratio + y * y * along
        )
    above = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    below = 1.0 + r2 * (camera.k4 + r2 * (camera.k5 + r2 * camera.k6))
    above_slope = camera.k1 + r2 * (2.0 * camera.k2 + 3.0 * r2 * camera.k3)
    below_slope = camera.k4 + r2 * (2.0 * camera.k5 + 3.0 * r2 * camera.k6)
    radial = above / below
    return _bend(camera, x, y, r2, radial, (above_slope - radial * below_slope) / below)


@subroutine
def _radial(camera: CameraRow, r: float) -> tuple[float, float]:
    """How far from the centre a ray appears but for tangential terms, and the derivative.

    r is the ideal radius, and for a fisheye the angle from the optical axis.
    """
    s = r * r
    k1, k2, k3, k4 = camera.k1, camera.k2, camera.k3, camera.k4
    if camera.lens == FISHEYE:
        return (
            r * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))),
            1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4))),
        )
    below = 1.0 + s * (k4 + s * (camera.k5 + s * camera.k6))
    below_slope = k4 + s * (2.0 * camera.k5 + 3.0 * s * camera.k6)
    radial = (1.0 + s * (k1 + s * (k2 + s * k3))) / below
    slope = (k1 + s * (2.0 * k2 + 3.0 * s * k3) - radial * below_slope) / below
    return r * radial, radial + 2.0 * s * slope


@device
def _in_image(camera: CameraRow, xd: float, yd: float) -> bool:
    u, v = camera.centre_u + camera.focal_u * xd, camera.centre_v + camera.focal_v * yd
    return (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)


@subroutine
def _undistort_outwards(camera: CameraRow, xd: float, yd: float) -> tuple[float, float]:
    """`undistort_ray` of any lens: the radius between the centre and the fold, then the rest."""
    if abs(xd) + abs(yd) > _FARTHEST:
        return nan, nan
    seen = sqrt(xd * xd + yd * yd)
    if seen == 0.0:
        return 0.0, 0.0
    fold = sqrt(camera.fold_radius_squared)
    if camera.lens == FISHEYE:
        r = tan(_inverse_radial(camera, seen, atan(fold)))
        return xd / seen * r, yd / seen * r
    r = _inverse_radial(camera, seen, fold)
    if camera.p1 != 0.0 or camera.p2 != 0.0:
        if r != r:  # tangential terms may bring it nearer
            r = fold
        return _newton_from(camera, xd, yd, xd / seen * r, yd / seen * r)
    return xd / seen * r, yd / seen * r


@subroutine
def _inverse_radial(camera: CameraRow, seen: float, fold: float) -> float:
    """Where `_radial` is a given value below the fold, by bisection and Newton's method."""
    low, high = 0.0, fold
    if fold == inf:
        high = seen
        for _ in range(64):
            if _radial(camera, high)[0] >= seen:
                break
            low, high = high, 2.0 * high
    if not _radial(camera, high)[0] >= seen:
        return nan
    r = seen if low < seen < high else 0.5 * (low + high)
    for _ in range(120):
        value, slope = _radial(camera, r)
        off = value - seen
        if off > 0.0:
            high = r
        else:
            low = r
        new = r - off / slope if slope > 0.0 else nan
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - r) <= 2.0 * _NEWTON_TOLERANCE * r:
            return new
        r = new
    return r


@subroutine
def _newton_from(
    camera: CameraRow, xd: float, yd: float, x: float, y: float
) -> tuple[float, float]:
    """Newton's method from a guess, with steps shortened until each brings it nearer.

    The lens is the gradient of a function that is convex where order is kept, so that there is
    one ray at most, and shorter steps lead to it. They also shorten the guess itself.
    """
    x0 = y0 = 0.0
    sx, sy, share, least = -x, -y, 1.0, inf
    for _ in range(100):
        bent = distort(camera, x, y)
        fx, fy = bent.x - xd, bent.y - yd
        off = abs(fx) + abs(fy)
        if off < least and has_meaning(camera, x, y):
            det = bent.dxx * bent.dyy - bent.dxy * bent.dxy
            sx = (bent.dyy * fx - bent.dxy * fy) / det
            sy = (bent.dxx * fy - bent.dxy * fx) / det
            x0, y0, share, least = x, y, 1.0, off
        else:
            share *= 0.5
        if least == 0.0 or share < 1e-6:
            break
        x, y = x0 - share * sx, y0 - share * sy
    if least < _RESIDUAL * (1.0 + abs(xd) + abs(yd)):
        return x0, y0
    return nan, nan
