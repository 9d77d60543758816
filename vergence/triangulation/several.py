r"""A point at rest, from several fixations whose angles differ: below the encoders' steps.

A reading says that an angle is within half a step h of it, no more and no less. The pixels of a
fixation tell each true angle by the point that is sought, `e(P) = e_0 + J (P - P_0)` from the
reading, with a deviation s; so that the likelihood of P is the product over fixations k and
actuators j of

    Phi((h_j - e_kj(P)) / s_kj) - Phi((-h_j - e_kj(P)) / s_kj) .

Where the eyes look a little elsewhere each time, the point lies where all these intervals overlap:
of n fixations the error falls as 1/n, where a mean's falls as 1/sqrt(n).
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray
from vergence.operands import as_operand
from vergence.triangulation.fix import Fix, Noise, triangulate_views

_STEP_RAD: Final = 1e-6
_STEP_M: Final = 1e-6
"""Steps of central differences: far above rounding, far below a head's own size."""
_WIDER: Final = (8.0, 4.0, 2.0, 1.0, 1.0)
"""Times their deviations at which the intervals' ends are taken, one after the other: a first fix
may lie outside of many intervals."""
_NEWTON_STEPS: Final = 20
_SMALL_M: Final = 1e-9
_LEAST_SHARE: Final = 1e-3
"""Of an interval: the least deviation of its ends, where pixels are exact."""


def triangulate_fixations(
    head: HeadModel, q: ArrayLike, pixels: ArrayLike, noise: Noise | None = None
) -> Fix:
    """Where a point at rest is that several fixations saw (see this module).

    The neck is at rest as well: the point is in N.

    Args:
        head: one head.
        q: (k, 7) joint angles as they were read, rad.
        pixels: (k, 2, 2) raw pixels of the point at the same instants.
        noise: standard deviations of pixels; those of angles are the head's steps and play. None
            for the head's detection noise.

    Returns:
        The fix. Its covariance is that of the intervals, and its gap the mean one of the fixations.

    Raises:
        ConfigurationError: this is a population, or no fixation saw the point with both eyes.
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
    half = 0.5 * (own.angle_step + own.backlash)[EYES]
    used = half > 0.0
    point = np.median(each.point[seen], axis=0)
    pixel_px = np.broadcast_to((Noise.of(head) if noise is None else noise).pixel_px, (2, 2))
    information = np.zeros((3, 3))
    for wider in _WIDER:
        by_angle, by_point, left = _linearised(head, q, pixels, point)
        scale = 1.0 / np.maximum(pixel_px.reshape(4), 1e-6)
        A = by_angle[..., used] * scale[:, None]
        B, r = by_point * scale[:, None], left * scale
        inner = np.linalg.inv(A.transpose(0, 2, 1) @ A) if used.any() else np.zeros((len(q), 0, 0))
        back = inner @ A.transpose(0, 2, 1)
        # errors of the readings by the point, and what no errors explain
        error, slope = (back @ r[..., None])[..., 0], -back @ B
        rest, rest_slope = r - (A @ error[..., None])[..., 0], -B - A @ slope
        deviation = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        ends = wider * np.maximum(deviation, _LEAST_SHARE * half[used])
        step = np.zeros(3)
        for _ in range(_NEWTON_STEPS):
            first, second = _log_interval(error + slope @ step, half[used], ends)
            gradient = np.einsum("kj,kji->i", first, slope)
            gradient -= np.einsum("kr,kri->i", rest + rest_slope @ step, rest_slope)
            information = np.einsum("kji,kj,kjl->il", slope, -second, slope)
            information += np.einsum("kri,krl->il", rest_slope, rest_slope)
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
    """(k, 4, 4) pixels by the actuators, (k, 4, 3) by the point, (k, 4) what is left, px."""
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

    left = pixels.reshape(len(q), 4) - seen(np.zeros(7), np.zeros(3))
    return slopes(4, _STEP_RAD, False), slopes(3, _STEP_M, True), left


def _log_interval(
    error: FloatArray, half: FloatArray, ends: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """First and second derivative by e of log(Phi((h - e) / s) - Phi((-h - e) / s)).

    Args:
        error: (k, j) e.
        half: (j,) h.
        ends: (k, j) s.
    """
    # it is even in e, and the difference is exact in the lower tail
    sign, e = np.sign(error), np.abs(error)
    upper, lower = (half - e) / ends, (-half - e) / ends
    log_upper, log_lower = log_ndtr(upper), log_ndtr(lower)
    log_mass = log_upper + np.log1p(-np.exp(log_lower - log_upper))
    at_upper, at_lower = (
        np.exp(-0.5 * x**2 - 0.5 * np.log(2.0 * np.pi) - log_mass) for x in (upper, lower)
    )
    first = -(at_upper - at_lower) / ends
    second = -(upper * at_upper - lower * at_lower) / ends**2 - first**2
    return sign * first, second
