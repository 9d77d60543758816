"""Position of a target from two or more lines of sight, its covariance, and the lines' gap."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.operands import as_operand
from vergence.triangulation.rays import triangulate

_SHAPE_ONLY = np.zeros(3)


class Fix(NamedTuple):
    """A triangulated point, in frame N.

    Examples:
        >>> import vergence
        >>> head = vergence.load_head("simulated")
        >>> fix = vergence.triangulate_gaze(head, head.fixate([0.1, -0.1, 1.5]))
        >>> bool(fix.valid), fix.point.round(3), fix.sigma.round(4)
        (True, array([ 0.1, -0.1,  1.5]), array([0.0001, 0.0001, 0.0011]))
    """

    point: FloatArray
    """(..., 3) position, metres; nan if not valid."""
    gap: FloatArray
    """(...) length of the common perpendicular of the two rays, metres: a consistency check."""
    covariance: FloatArray
    """(..., 3, 3) covariance of the point, m^2, to first order in the noise."""
    valid: NDArray[np.bool_]
    """(...) False for near-parallel rays, a point behind an eye, or a target not visible to an
    eye."""

    @property
    def sigma(self) -> FloatArray:
        """(..., 3) standard deviations, metres: the square roots of the covariance's diagonal."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Standard deviations of the inputs of a fix; the errors are independent.

    Examples:
        Depth at 1 m with a detector of 0.2 px and joints known to 0.5 mrad, 1 sigma in metres:

        >>> import vergence
        >>> head = vergence.load_head("simulated")
        >>> noise = vergence.Noise(pixel_px=0.2, joint_rad=0.0005)
        >>> vergence.triangulate_gaze(head, head.fixate([0.0, -0.1, 1.0]), noise).sigma.round(4)
        array([0.0004, 0.0008, 0.009 ])
    """

    pixel_px: float | FloatArray = 0.0
    """Standard deviation of pixel coordinates, px: a scalar, or (..., 2, 2) by eye and
    coordinate."""
    joint_rad: float | FloatArray = 0.0
    """Standard deviation of actuator angles, rad: a scalar, or (..., 7) for the neck's joints and
    four actuators of the eyes; entries of actuators that the head does not have are ignored. If
    each of the four eye joints has its own motor, the actuators are the joints in their order.
    Coupled joints share one error."""

    def __post_init__(self) -> None:
        for name, core in (("pixel_px", (2, 2)), ("joint_rad", (7,))):
            given = getattr(self, name)
            value = as_operand(f"Noise.{name}", given)
            if value.ndim and value.shape[-len(core) :] != core:
                raise ConfigurationError(
                    f"Noise.{name}: expected a scalar or shape (..., {', '.join(map(str, core))}), "
                    f"got {value.shape}"
                )
            if not (np.isfinite(value) & (value >= 0.0)).all():
                raise ConfigurationError(f"Noise.{name}: expected finite values >= 0, got {value}")
            full = np.broadcast_to(value, core) if value.ndim == 0 else value
            object.__setattr__(self, name, full)

    @staticmethod
    def of(head: HeadModel) -> "Noise":
        """Noise of a head's own sensors: detector, encoder quantisation, and backlash.

        A quantisation of r has a uniform error with the standard deviation r / sqrt(12). With a
        backlash of b, the load may lie b / 2 to either side of the encoder's angle, so b / 2 is
        added in quadrature.
        """
        own = head.actuation
        return _noise_of(
            head.sensor.detection_noise_px, own.angle_step.tobytes(), own.backlash.tobytes()
        )


@lru_cache(maxsize=64)
def _noise_of(pixel_px: float, resolutions_rad: bytes, backlashes_rad: bytes) -> Noise:
    # without backlash, bit for bit the standard deviation of the quantisation
    sd = np.frombuffer(resolutions_rad) / np.sqrt(12.0)
    half = 0.5 * np.frombuffer(backlashes_rad)
    return Noise(pixel_px=pixel_px, joint_rad=np.where(half > 0.0, np.hypot(sd, half), sd))


def triangulate_gaze(head: HeadModel, q: ArrayLike, noise: Noise | None = None) -> Fix:
    """Triangulate the point at which the two optical axes cross (Eqs. 18 to 24).

    Pixel noise reaches the point through the control loop: the eyes look past the target by the
    joint angles that move the image by the pixel error. To first order, the optical axis then
    misses the target like a ray through the noisy pixel of an eye at rest. The covariance therefore
    equals the result of `triangulate_views` at the principal points. Equations 27 to 33, which
    convert a pixel of noise to `1 / f` radians of both tilt and pan, correspond to
    `Noise(joint_rad=pixel_px / f)`.

    Args:
        head: the head, or a population.
        q: (..., 7) joint angles, rad.
        noise: standard deviations of pixels and of the actuators' angles; None for
            `Noise.of(head)`.

    Returns:
        The fix.

    Raises:
        ConfigurationError: the head's eyes do not move, so they cannot fixate.

    Examples:
        A thousand fixations in one call:

        >>> import numpy as np, vergence
        >>> head = vergence.load_head("simulated")
        >>> points = np.random.default_rng(0).uniform((-0.2, -0.2, 0.5), (0.2, 0.2, 2.0), (1000, 3))
        >>> fix = vergence.triangulate_gaze(head, head.fixate(points))
        >>> bool(fix.valid.all()), bool(np.allclose(fix.point, points))
        (True, True)
    """
    if not head.actuation.count:
        raise ConfigurationError(
            f"triangulate_gaze: expected a head whose eyes move, got {head.name!r}, a fixed pair: "
            "triangulate_views takes the pixels of both its images"
        )
    return triangulate_views(head, q, head.cameras.principal, noise)


def triangulate_views(
    head: HeadModel, q: ArrayLike, pixels: ArrayLike, noise: Noise | None = None
) -> Fix:
    """Triangulate the point at which the rays through two image points cross.

    This is the comparison method, ITPC-style and reconstructed. Image points are undistorted, the
    stereo extrinsics are computed from the joint angles by forward kinematics and head-eye
    transforms, and the point is the midpoint of the rays' common perpendicular. Pixels and joint
    angles must belong to the same instant.

    Args:
        head: the head, or a population.
        q: (..., 7) joint angles at the exposure, rad.
        pixels: (..., 2, 2) raw pixels of the target; nan for an eye in which it is not visible.
        noise: standard deviations of pixels and of the actuators' angles; None for
            `Noise.of(head)`.

    Returns:
        The fix; its covariance is the full propagation of Eqs. 34 to 36 and of the joints' noise.

    Examples:
        The target need not be at the centre of the images:

        >>> import vergence
        >>> head = vergence.load_head("simulated")
        >>> q = head.fixate([0.0, -0.1, 1.0])
        >>> pixels = head.project(q, [0.1, 0.05, 1.2])
        >>> vergence.triangulate_views(head, q, pixels).point.round(3)
        array([0.1 , 0.05, 1.2 ])
    """
    noise = noise or Noise.of(head)
    results: Any = triangulate(q, pixels, noise.pixel_px, noise.joint_rad, head.packed, _SHAPE_ONLY)
    return Fix(*results)


# steps of the central differences (numerical: far above rounding, far below curvature)
_STEP_RAD: Final = 1e-5
_STEP_PX: Final = 1e-2


def gap_sigma(
    head: HeadModel, q: ArrayLike, pixels: ArrayLike, noise: Noise | None = None
) -> FloatArray:
    """Standard deviation of the signed gap of `triangulate_views`.

    Args:
        head: one head, not a population.
        q: (..., 7) joint angles at the exposure, rad.
        pixels: (..., 2, 2) raw pixels of the target; nan for an eye in which it is not visible.
        noise: standard deviations of pixels and of the actuators' angles; None for
            `Noise.of(head)`.

    Returns:
        (...) metres; nan where a pixel is nan.

    Examples:
        Half a pixel of noise at 1 m, in metres:

        >>> import numpy as np, vergence
        >>> from vergence.triangulation import gap_sigma
        >>> head = vergence.load_head("simulated")
        >>> q = head.fixate([0.0, -0.1, 1.0])
        >>> noise = vergence.Noise(pixel_px=0.5)
        >>> gap_sigma(head, q, head.project(q, [0.0, -0.1, 1.0]), noise).round(5)
        np.float64(0.00113)
    """
    noise = noise or Noise.of(head)
    actuators = head.actuation.actuators_of(as_operand("q", q, 7))
    pixels = as_operand("pixels", pixels, 2, 2)
    shape = np.broadcast_shapes(actuators.shape[:-1], pixels.shape[:-2])
    sigma = np.concatenate(
        [
            np.broadcast_to(noise.joint_rad, (*shape, 7)),
            np.broadcast_to(noise.pixel_px, (*shape, 2, 2)).reshape(*shape, 4),
        ],
        axis=-1,
    )
    used = [*range(EYES.start, EYES.start + head.actuation.count), *range(7, 11)]
    rates = _slopes(
        lambda by: _signed_gap(head, actuators + by[:7], pixels + by[7:].reshape(2, 2)),
        np.diag([_STEP_RAD] * 7 + [_STEP_PX] * 4)[used],
    )
    return np.sqrt(sum(np.moveaxis((rates * sigma[..., used]) ** 2, -1, 0), np.zeros(shape)))


def _slopes(function: Callable[[FloatArray], FloatArray], steps: FloatArray) -> FloatArray:
    """(..., k) derivatives of a function of an offset, by central differences of (k, n) steps."""
    return np.stack([(function(by) - function(-by)) / (2.0 * by.max()) for by in steps], axis=-1)


def _signed_gap(head: HeadModel, actuators: FloatArray, pixels: FloatArray) -> FloatArray:
    """(...) signed gap of the rays through raw pixels, m."""
    poses = head.camera_poses(head.actuation.joints_of(actuators))
    slopes = (head.undistort(pixels) - head.cameras.principal) / head.cameras.focal
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    rays = np.einsum("...eij,...ej->...ei", poses[..., :3, :3], rays)
    normal = np.cross(rays[..., 0, :], rays[..., 1, :])
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    apart = poses[..., 1, :3, 3] - poses[..., 0, :3, 3]
    return np.asarray((normal * apart).sum(axis=-1))


_AXIS_STEP_RAD: Final = 1e-6
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
    noise = noise or Noise.of(head)
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
    pixel_px = np.broadcast_to(noise.pixel_px, (2, 2))
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
            null = residual_null + residual_null_slope @ step
            gradient = np.einsum("kj,kji->i", first, slope)
            gradient -= np.einsum("kr,kri->i", null, residual_null_slope)
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

    def seen(by: FloatArray) -> FloatArray:
        joints = head.actuation.joints_of(actuators + [0.0, 0.0, 0.0, *by[:4]])
        return head.project(joints, point + by[4:]).reshape(len(q), 4)

    slopes = _slopes(seen, np.diag([_AXIS_STEP_RAD] * 4 + [_STEP_M] * 3))
    return slopes[..., :4], slopes[..., 4:], pixels.reshape(len(q), 4) - seen(np.zeros(7))


def _log_interval(
    error: FloatArray, half_width: FloatArray, sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives by e of log(Phi((h - e) / s) - Phi((-h - e) / s)) of (k, j) errors e, rad."""
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
