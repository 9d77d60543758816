r"""A point at rest from several fixations at different angles: finer than encoder quantisation.

An encoder reading constrains an angle to an interval of half width h around it, and no further.
For a point P, the pixels of a fixation determine the angle's error against the reading,
`e(P) = e_0 + J (P - P_0)`, with a standard deviation s. The likelihood of P is therefore the
product over fixations k and actuators j of

    Phi((h_j - e_kj(P)) / s_kj) - Phi((-h_j - e_kj(P)) / s_kj) .

If the eyes look in a slightly different direction each time, the point lies in the overlap of all
these intervals. With n fixations its error falls as 1/n; the error of a mean falls as 1/sqrt(n).
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.operands import as_operand
from vergence.triangulation.fix import Fix, Noise, triangulate_views

_STEP_RAD: Final = 1e-6
"""Step of central differences by angles, rad (numerical)."""
_STEP_M: Final = 1e-6
"""Step of central differences by the point, m: far above rounding, far below a head's size
(numerical)."""
_SOFTENING: Final = (8.0, 4.0, 2.0, 1.0, 1.0)
"""Factors on s in successive solutions: a first fix may lie outside many intervals, so their ends
start soft (numerical)."""
_NEWTON_STEPS: Final = 20
"""Iteration limit of Newton's method (numerical)."""
_SMALL_M: Final = 1e-9
"""Convergence tolerance of a Newton step, m (numerical)."""
_LEAST_SHARE: Final = 1e-3
"""Least s as a fraction of the half width h, for exact pixels (numerical)."""


def triangulate_fixations(
    head: HeadModel, q: ArrayLike, pixels: ArrayLike, noise: Noise | None = None
) -> Fix:
    """Triangulate a point at rest from several fixations (see this module).

    The neck must be at rest too, as the point is in N.

    Args:
        head: one head.
        q: (k, 7) joint angles as read by the encoders, rad.
        pixels: (k, 2, 2) raw pixels of the point at the same instants; nan if not visible.
        noise: standard deviations of pixels; None for the head's detection noise. Its angles are
            not used: the intervals follow from the head's encoder quantisation and backlash.

    Returns:
        The fix. Its covariance is the inverse of the information in the likelihood; its gap is the
        mean gap of the fixations.

    Raises:
        ConfigurationError: the head is a population, or the point is not visible to both eyes in
            any fixation.

    Examples:
        Twenty fixations near a point, joint angles rounded to 4,096 steps a turn. The depth error
        of a single one is up to 5.7 mm; all together know it to 0.6 mm (1 sigma):

        >>> import numpy as np, vergence
        >>> head = vergence.load_head("turrets")
        >>> point, rng = np.array([0.05, 0.02, 0.8]), np.random.default_rng(0)
        >>> q = head.fixate(point + 0.02 * rng.standard_normal((20, 3)))
        >>> read = np.round(q / (2 * np.pi / 4096)) * (2 * np.pi / 4096)
        >>> pixels = head.project(q, point)
        >>> errors = vergence.triangulate_views(head, read, pixels).point - point
        >>> (1000 * np.abs(errors[:, 2]).max()).round(1)
        np.float64(5.7)
        >>> fix = vergence.triangulate_fixations(head, read, pixels)
        >>> (1000 * fix.sigma[2]).round(1), bool(abs(fix.point - point)[2] < 2 * fix.sigma[2])
        (np.float64(0.6), True)
    """
    if head.batch_shape:
        raise ConfigurationError(
            f"triangulate_fixations: expected one head, got a population of {head.batch_shape}"
        )
    q, pixels = as_operand("q", q, 7), as_operand("pixels", pixels, 2, 2)
    each = triangulate_views(head, q, pixels, noise)
    seen = np.isfinite(pixels).all(axis=(-2, -1)) & np.asarray(each.valid)
    if not seen.any():
        raise ConfigurationError(
            "triangulate_fixations: expected fixations in which both eyes see the point, got none "
            f"in {len(q)}"
        )
    q, pixels = q[seen], pixels[seen]
    own = head.actuation
    half_width = 0.5 * (own.angle_step + own.backlash)[EYES]
    used = half_width > 0.0
    point = np.median(each.point[seen], axis=0)
    pixel_px = np.broadcast_to((Noise.of(head) if noise is None else noise).pixel_px, (2, 2))
    information = np.zeros((3, 3))
    for softening in _SOFTENING:
        by_angle, by_point, residual = _linearised(head, q, pixels, point)
        scale = 1.0 / np.maximum(pixel_px.reshape(4), 1e-6)
        A = by_angle[..., used] * scale[:, None]
        B, r = by_point * scale[:, None], residual * scale
        inner = np.linalg.inv(A.transpose(0, 2, 1) @ A) if used.any() else np.zeros((len(q), 0, 0))
        back = inner @ A.transpose(0, 2, 1)
        # errors of the readings as functions of the point, and residuals that they do not explain
        error, slope = (back @ r[..., None])[..., 0], -back @ B
        residual_null, residual_null_slope = r - (A @ error[..., None])[..., 0], -B - A @ slope
        deviation = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        sd = softening * np.maximum(deviation, _LEAST_SHARE * half_width[used])
        step = np.zeros(3)
        for _ in range(_NEWTON_STEPS):
            first, second = _log_interval(error + slope @ step, half_width[used], sd)
            gradient = np.einsum("kj,kji->i", first, slope)
            gradient -= np.einsum(
                "kr,kri->i", residual_null + residual_null_slope @ step, residual_null_slope
            )
            information = np.einsum("kji,kj,kjl->il", slope, -second, slope)
            information += np.einsum("kri,krl->il", residual_null_slope, residual_null_slope)
            change = np.linalg.solve(information, gradient)
            step = step + change
            if np.abs(change).max() < _SMALL_M:
                break
        point = point + step
    return Fix(
        point,
        np.asarray(np.mean(np.asarray(each.gap)[seen])),
        np.asarray(np.linalg.inv(information), np.float64),
        np.ones((), dtype=np.bool_),
    )


def _linearised(
    head: HeadModel, q: FloatArray, pixels: FloatArray, point: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixel derivatives by actuators (k, 4, 4) and by the point (k, 4, 3); residuals (k, 4), px."""
    actuators = head.actuation.actuators_of(q)

    def seen(step: FloatArray, moved: FloatArray) -> FloatArray:
        joints = head.actuation.joints_of(actuators + step)
        return head.project(joints, point + moved).reshape(len(q), 4)

    def slopes(size: int, length: float, of_point: bool) -> FloatArray:
        columns = []
        for row in length * np.eye(size):
            step = np.zeros(7) if of_point else np.concatenate([np.zeros(3), row])
            moved = row if of_point else np.zeros(3)
            columns.append((seen(step, moved) - seen(-step, -moved)) / (2.0 * length))
        return np.stack(columns, axis=-1)

    residual = pixels.reshape(len(q), 4) - seen(np.zeros(7), np.zeros(3))
    return slopes(4, _STEP_RAD, False), slopes(3, _STEP_M, True), residual


def _log_interval(
    error: FloatArray, half_width: FloatArray, sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """First and second derivatives by e of log(Phi((h - e) / s) - Phi((-h - e) / s)).

    Args:
        error: (k, j) errors of the readings e, rad.
        half_width: (j,) half widths of the intervals h, rad.
        sd: (k, j) standard deviations s, rad.
    """
    from scipy.special import log_ndtr

    # the function is even in e, and the difference is exact in the lower tail
    sign, e = np.sign(error), np.abs(error)
    upper, lower = (half_width - e) / sd, (-half_width - e) / sd
    log_upper, log_lower = log_ndtr(upper), log_ndtr(lower)
    log_mass = log_upper + np.log1p(-np.exp(log_lower - log_upper))
    at_upper, at_lower = (
        np.exp(-0.5 * x**2 - 0.5 * np.log(2.0 * np.pi) - log_mass) for x in (upper, lower)
    )
    first = -(at_upper - at_lower) / sd
    second = -(upper * at_upper - lower * at_lower) / sd**2 - first**2
    return sign * first, second
