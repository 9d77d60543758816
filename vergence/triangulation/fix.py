"""Triangulation by gaze (the article's method) and by two views (ITPC-style, reconstructed)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
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
    noise = Noise.of(head) if noise is None else noise
    results: Any = triangulate(q, pixels, noise.pixel_px, noise.joint_rad, head.packed, _SHAPE_ONLY)
    return Fix(*results)
