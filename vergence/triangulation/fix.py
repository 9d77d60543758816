"""Triangulation by gaze (the article's) and by two views (ITPC-style, reconstructed)."""

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

_SHAPE = np.zeros(3)


class Fix(NamedTuple):
    """A triangulated point, in frame N."""

    point: FloatArray
    """(..., 3) metres; nan where not valid."""
    gap: FloatArray
    """(...) length of the common perpendicular of the two rays, metres: a free health signal."""
    covariance: FloatArray
    """(..., 3, 3) m^2, first order in the noise."""
    valid: NDArray[np.bool_]
    """(...) False for near-parallel rays, a point behind an eye, or an eye that sees nothing."""

    @property
    def sigma(self) -> FloatArray:
        """(..., 3) metres: the square roots of the covariance's diagonal."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Standard deviations of what a fix is computed from, all independent."""

    pixel_px: float | FloatArray = 0.0
    """Of each pixel coordinate: a scalar, or (..., 2, 2) by eye and coordinate."""
    joint_rad: float | FloatArray = 0.0
    """Of each actuator's angle: a scalar, or (..., 7) for the neck's joints and four actuators of
    the eyes, of which those that a head lacks count for nothing. Where each of the four eye joints
    has a motor of its own, these are the joints in their order; joints that are tied together share
    one error."""

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
        """The noise of a head's own sensors: its detector's, its encoders' steps, and its play.

        A step of r spreads evenly over r, so its standard deviation is r / sqrt(12). A play of b
        lets what is driven lean to either side of where the encoder says, by b / 2.
        """
        own = head.actuation
        return _noise_of(
            head.sensor.detection_noise_px, own.angle_step.tobytes(), own.backlash.tobytes()
        )


@lru_cache(maxsize=64)
def _noise_of(pixel_px: float, steps_rad: bytes, plays_rad: bytes) -> Noise:
    # without play to the last bit what the steps say
    sd = np.frombuffer(steps_rad) / np.sqrt(12.0)
    half = 0.5 * np.frombuffer(plays_rad)
    return Noise(pixel_px=pixel_px, joint_rad=np.where(half > 0.0, np.hypot(sd, half), sd))


def triangulate_gaze(head: HeadModel, q: ArrayLike, noise: Noise | None = None) -> Fix:
    """Where the two optical axes cross: the point that both eyes look at (Eqs. 18 to 24).

    Pixel noise reaches the point through the loop: it makes the eyes look beside the target,
    by the joint angles that move the image by as much. To first order the axis then passes
    the target as a ray through the noisy pixel of a still eye would, so the covariance is that
    of `triangulate_views` at the principal points. Equations 27 to 33, which take a pixel of
    noise as `1 / f` radians of tilt and of pan alike, are `Noise(joint_rad=pixel_px / f)`.

    Args:
        head: the head, or a population.
        q: (..., 7) joint angles, rad.
        noise: standard deviations of pixels and of the actuators' angles; None for
            `Noise.of(head)`.

    Returns:
        The fix.

    Raises:
        ConfigurationError: the head's eyes do not move, and so do not look at anything together.
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
    """Where the rays through two image points cross, with extrinsics from the joints.

    This is the comparison method, ITPC-style and reconstructed: image points undistorted,
    the stereo extrinsics on line from forward kinematics and head-eye transforms, the point
    by the midpoint of the common perpendicular. Pixels and joints must be of the same instant.

    Args:
        head: the head, or a population.
        q: (..., 7) joint angles at the exposure, rad.
        pixels: (..., 2, 2) raw pixels of the target; nan for an eye that does not see it.
        noise: standard deviations of pixels and joints; None for `Noise.of(head)`.

    Returns:
        The fix; its covariance propagates Eqs. 34 to 36 in full, and the joints' noise.
    """
    noise = Noise.of(head) if noise is None else noise
    results: Any = triangulate(q, pixels, noise.pixel_px, noise.joint_rad, head.packed, _SHAPE)
    return Fix(*results)
