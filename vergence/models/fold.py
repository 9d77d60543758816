"""Radius at which a lens model folds the image back on itself; packing of a lens for kernels.

As a ray turns away from the optical axis, its image moves outwards until the radial part of the
model (see `lens`) stops rising. Beyond this fold a pixel would belong to several rays. The rational
model may also fold at a zero of its denominator.
"""

from typing import Final

import numpy as np

from vergence.models.cameras import BROWN_CONRADY
from vergence.models.lens import FISHEYE, PINHOLE, POLYNOMIAL, RATIONAL
from vergence.models.parts import FloatArray

LENS_NUMBERS: Final = 11
"""Length of the array that `pack_lens` returns (numerical)."""
_POLE_MARGIN_FACTOR: Final = 1.0 - 1e-9
"""Factor on the squared radius of a pole: the model has no value at the pole, only before it
(numerical)."""
_MAX_FOLD_ANGLE_RAD: Final = 0.5 * np.pi - 1e-9
"""Largest angle of a fisheye's fold from the optical axis, rad; its tangent is finite
(numerical)."""
_LEAST_RECIPROCAL: Final = 1e-12
"""Smallest reciprocal of a squared radius that counts as a root; smaller ones are rounding or
belong to rays within about 1e-6 of a right angle from the axis (numerical)."""


def pack_lens(lens: str, distortion: FloatArray) -> FloatArray:
    """(..., 11) k1, k2, p1, p2, k3-k6, model, squared radii: of the fold or inf, and safe."""
    numbers = np.zeros((*distortion.shape[:-1], LENS_NUMBERS))
    if lens == "fisheye":
        numbers[..., 0:2], numbers[..., 4:6] = distortion[..., 0:2], distortion[..., 2:4]
        numbers[..., 8] = FISHEYE
        angle = np.sqrt(_first_root(_odd_derivative(distortion[..., :4])))
        # a ray (X / Z, Y / Z) is less than a right angle from the axis
        numbers[..., 9] = np.tan(np.minimum(angle, _MAX_FOLD_ANGLE_RAD)) ** 2
        numbers[..., 10] = numbers[..., 9]
        return numbers
    count = distortion.shape[-1]
    numbers[..., :count] = distortion
    number = POLYNOMIAL if lens == BROWN_CONRADY else RATIONAL
    numbers[..., 8] = np.where(distortion.any(axis=-1), number, PINHOLE)
    above = numbers[..., [0, 1, 4]]
    if lens == BROWN_CONRADY:
        numbers[..., 9] = _first_root(_odd_derivative(above))
    else:
        numbers[..., 9] = _rational_fold(above, numbers[..., 5:8])
    numbers[..., 10] = _safe_radius_squared(lens, numbers)
    return numbers


def _safe_radius_squared(lens: str, numbers: FloatArray) -> FloatArray:
    """Squared radius of a positive definite derivative; the fold's without tangential terms."""
    fold = numbers[..., 9]
    tangential = np.hypot(numbers[..., 2], numbers[..., 3])
    if not tangential.any():
        return fold
    safe = np.zeros_like(fold)
    if lens == BROWN_CONRADY:
        # The least eigenvalue is at least 1 - sum of (2 i + 1) max(-k_i, 0) r^(2 i) - 6 |p| r:
        # above 0 where each of the four terms is below a quarter.
        down = np.maximum(-numbers[..., [0, 1, 4]], 0.0) * [3.0, 5.0, 7.0]
        terms = np.concatenate([down, 6.0 * tangential[..., None]], axis=-1)
        radii = np.full(terms.shape, np.inf)
        with np.errstate(over="ignore"):  # tiny terms overflow to inf: no limit
            np.divide(0.25, terms, out=radii, where=terms > 0.0)
            safe = (radii ** [1.0, 1.0 / 2.0, 1.0 / 3.0, 2.0]).min(axis=-1)
    return np.where(tangential > 0.0, np.minimum(safe, fold), fold)


def _odd_derivative(k: FloatArray) -> FloatArray:
    """Derivative of r (1 + k1 r^2 + k2 r^4 + ...) by r, in powers of r^2, highest power first."""
    powers = [np.ones_like(k[..., 0])]
    powers += [(2.0 * i + 3.0) * k[..., i] for i in range(k.shape[-1])]
    return np.stack(powers[::-1], axis=-1)


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
