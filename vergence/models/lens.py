"""The lens: how it bends the image of a pinhole, and back. Lens models are added here.

The model is the five-coefficient one of Brown and Conrady as OpenCV writes it:

    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

in normalised coordinates x = X / Z, y = Y / Z. Another model (rational, fisheye) needs its
coefficients in `CameraRow`, and its case in each function of this module: no other computes
with coefficients.
"""

from math import isfinite, nan
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence.models.parts import FloatArray

_NEWTON_STEPS: Final = 25
_NEWTON_TOLERANCE: Final = 1e-15


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
    width: float
    height: float
    fold_radius_squared: float
    """Of the normalised radius at which the lens folds the image back on itself; inf if never."""


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
    """Whether any distortion coefficient is not zero."""
    return (
        camera.k1 != 0.0
        or camera.k2 != 0.0
        or camera.p1 != 0.0
        or camera.p2 != 0.0
        or camera.k3 != 0.0
    )


@device
def distort(camera: CameraRow, x: float, y: float) -> Bent:
    """What the lens makes of a ray's ideal normalised coordinates."""
    k1, k2, p1, p2, k3 = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    return Bent(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@device
def undistort_ray(camera: CameraRow, xd: float, yd: float) -> tuple[float, float]:
    """The ideal coordinates of distorted ones, by Newton's method; nan without a solution."""
    if not isfinite(xd + yd):  # an eye that sees nothing: comparisons with nan would warn
        return nan, nan
    x, y = xd, yd
    converged = False
    for _ in range(_NEWTON_STEPS):
        bent = distort(camera, x, y)
        fx, fy = bent.x - xd, bent.y - yd
        det = bent.dxx * bent.dyy - bent.dxy * bent.dxy
        sx = (bent.dyy * fx - bent.dxy * fy) / det
        sy = (bent.dxx * fy - bent.dxy * fx) / det
        x -= sx
        y -= sy
        if abs(sx) + abs(sy) < _NEWTON_TOLERANCE * (1.0 + abs(x) + abs(y)):
            converged = True
            break
    if not converged or not (x * x + y * y < camera.fold_radius_squared):
        # the last digits may wander without settling: what counts is the residual
        bent = distort(camera, x, y)
        off = abs(bent.x - xd) + abs(bent.y - yd)
        if not (off < 1e-13 and x * x + y * y < camera.fold_radius_squared):
            return nan, nan
    return x, y


def fold_radius_squared(distortion: FloatArray) -> FloatArray:
    """Squared normalised radius at which the radial distortion turns back on itself.

    Args:
        distortion: (..., 5) coefficients (k1, k2, p1, p2, k3).

    Returns:
        (...) squared radii, inf if it never does.
    """
    k1, k2, k3 = distortion[..., 0], distortion[..., 1], distortion[..., 4]
    # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6), as a polynomial in r^2 with its highest power first
    powers = np.stack([7.0 * k3, 5.0 * k2, 3.0 * k1, np.ones_like(k1)], axis=-1).reshape(-1, 4)
    degree = 3 - np.argmax(powers != 0.0, axis=-1)
    out = np.full(len(powers), np.inf)
    for d in range(1, 4):
        rows = np.flatnonzero(degree == d)
        if not rows.size:
            continue
        # the roots of a polynomial are the eigenvalues of its companion matrix
        companion = np.zeros((len(rows), d, d))
        companion[:, range(1, d), range(d - 1)] = 1.0
        companion[:, 0] = -powers[rows, 4 - d :] / powers[rows, 3 - d, None]
        roots = np.linalg.eigvals(companion)
        fit = (np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)
        out[rows] = np.where(fit, roots.real, np.inf).min(axis=-1)
    return out.reshape(k1.shape)
