r"""Predicted spread of the gap between two lines of sight: the length of their perpendicular.

The gap of a fix is a consistency check: it would be zero without errors. With the unit normal
`n = d_l x d_r / |d_l x d_r|` of both rays, the signed gap is `g = n . (o_r - o_l)`, which is
smooth, while its size is not. To first order, independent errors e_k of pixels and actuators with
standard deviations s_k give

    sigma_g^2 = sum_k (dg/de_k)^2 s_k^2

The derivatives are central differences. A gap far beyond sigma_g means errors that the noise does
not explain: a calibration that has moved, eyes exposed at different times, or two targets.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.operands import as_operand
from vergence.triangulation.fix import Noise

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
    noise = Noise.of(head) if noise is None else noise
    angles = head.actuation.actuators_of(as_operand("q", q, 7))
    points = as_operand("pixels", pixels, 2, 2)
    shape = np.broadcast_shapes(angles.shape[:-1], points.shape[:-2])
    variance = np.zeros(shape)
    joint_rad = np.broadcast_to(noise.joint_rad, (*shape, 7))
    for k in range(EYES.start, EYES.start + head.actuation.count):
        step = _STEP_RAD * np.eye(7)[k]
        rate = _difference(head, angles + step, angles - step, points, points) / _STEP_RAD
        variance = variance + (rate * joint_rad[..., k]) ** 2
    pixel_px = np.broadcast_to(noise.pixel_px, (*shape, 2, 2))
    for eye, axis in np.ndindex(2, 2):
        offset = np.zeros((2, 2))
        offset[eye, axis] = _STEP_PX
        rate = _difference(head, angles, angles, points + offset, points - offset) / _STEP_PX
        variance = variance + (rate * pixel_px[..., eye, axis]) ** 2
    return np.sqrt(variance)


def _difference(
    head: HeadModel, above: FloatArray, below: FloatArray, to: FloatArray, since: FloatArray
) -> FloatArray:
    """Half the change of the signed gap from one set of actuator angles and pixels to another."""
    return np.asarray(0.5 * (_signed_gap(head, above, to) - _signed_gap(head, below, since)))


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
