r"""Where a target is and how it moves, per eye, by Kalman filters on the angles that fixate it.

An image gives, with the joint angles of its exposure and the depth from both eyes, the tilt and
pan that would have put the target on each optical axis. Per angle, the target is modelled after
Singer: an acceleration that forgets itself with the time constant T_a,

    d/dt (theta, w, a) = (w, a, -a / T_a) + white noise on a of variance 2 sigma_a^2 / T_a,

observed through the pixel's and the encoder's noise. In this model the prediction over a time h
is linear (R. A. Singer, Estimating optimal tracking filter performance for manned maneuvering
targets, 1970):

    theta(h) = theta + w h + a T_a^2 (h / T_a - 1 + exp(-h / T_a))
    w(h)     = w + a T_a (1 - exp(-h / T_a)),   a(h) = a exp(-h / T_a)

Angles are better than a point in space here: their noise is the same at any depth, and an eye
that alone sees the target goes on.

The filter lives at the exposure of the newest image. It goes on by a period each period, and is
corrected where a new image has come. A measurement that lies farther from the prediction than a
moving target can explain is another target, and the filter begins anew, at rest.
"""

from math import exp, isfinite
from typing import Any, Final

import numpy as np

from vergence._jit import device
from vergence.errors import ConfigurationError
from vergence.models.fixation import fixate_step
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames
from vergence.models.packed import camera_of
from vergence.models.parts import FloatArray
from vergence.models.pose import out_of
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image

# a filter's state, per eye: (theta, w, a) of tilt and pan, their common covariance, whether known
THETA: Final = 0
COVARIANCE: Final = 6
KNOWN: Final = 12
EYE_FILTER: Final = 13
"""Length of one eye's filter in a controller's state."""

# the row of constants, in the order kernels read it
F_THETA_A: Final = 0
F_W_A: Final = 1
F_A: Final = 2
NOISE: Final = 3
R: Final = 9
START_W: Final = 10
START_A: Final = 11
GATE: Final = 12
PERIOD: Final = 13
T_A: Final = 14
MODEL: Final = 15
"""Length of a row of the filter's constants."""


def filter_constants(
    head: HeadModel,
    *,
    acceleration_sd: float,
    acceleration_time_s: float,
    start_velocity_sd: float,
    gate_rad: float,
    pixel_sd: float | None,
) -> FloatArray:
    """The filter's constants for a head.

    Args:
        head: the model of the head.
        acceleration_sd: sigma_a, rad/s^2.
        acceleration_time_s: T_a, s.
        start_velocity_sd: how fast a new target may be, rad/s.
        gate_rad: beyond this distance from the prediction, at least, it is another target.
        pixel_sd: noise of a detection, px; None for the head's.

    Returns:
        (MODEL,) a row for kernels.

    Raises:
        ConfigurationError: a value cannot be.
    """
    values = {
        "acceleration_sd": acceleration_sd,
        "acceleration_time_s": acceleration_time_s,
        "start_velocity_sd": start_velocity_sd,
        "gate_rad": gate_rad,
    }
    for name, value in values.items():
        if not (isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{name}: expected a finite number above 0, got {value!r}")
    pixel = head.sensor.detection_noise_px if pixel_sd is None else pixel_sd
    if not (isfinite(pixel) and pixel >= 0.0):
        raise ConfigurationError(f"pixel_sd: expected px >= 0, got {pixel_sd!r}")
    period, t = head.timing.period_s, acceleration_time_s
    transition = singer_transition(period, t)
    noise = _singer_noise(period, t, acceleration_sd)
    row = np.zeros(MODEL)
    row[F_THETA_A], row[F_W_A], row[F_A] = transition[0, 2], transition[1, 2], transition[2, 2]
    row[NOISE : NOISE + 6] = noise[np.triu_indices(3)]
    # a floor of a thousandth of a pixel keeps the filter a filter where nothing is noisy
    sd = max(pixel, 1e-3) / float(head.cameras.focal.min())
    # readings are rounded to steps of the encoder: uniform noise
    row[R] = sd**2 + head.sensor.encoder_resolution_rad**2 / 12.0
    row[START_W], row[START_A] = start_velocity_sd**2, acceleration_sd**2
    row[GATE], row[PERIOD], row[T_A] = gate_rad, period, t
    return row


def singer_transition(time_s: float, acceleration_time_s: float) -> FloatArray:
    """How (theta, w, a) goes on by itself.

    Args:
        time_s: h.
        acceleration_time_s: T_a.

    Returns:
        (3, 3) transition matrix.
    """
    t, left = acceleration_time_s, float(np.exp(-time_s / acceleration_time_s))
    return np.array(
        [
            [1.0, time_s, t * t * (time_s / t - 1.0 + left)],
            [0.0, 1.0, t * (1.0 - left)],
            [0.0, 0.0, left],
        ]
    )


def _singer_noise(period_s: float, t: float, sd: float) -> FloatArray:
    """Covariance that a period adds: its integral by Gauss-Legendre, exact to rounding."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    noise = np.zeros((3, 3))
    for node, weight in zip(nodes, weights, strict=True):
        column = singer_transition(0.5 * period_s * (1.0 + node), t)[:, 2]
        noise += 0.5 * period_s * weight * 2.0 * sd**2 / t * np.outer(column, column)
    return noise


def reach_of(head: HeadModel) -> FloatArray:
    """(8,) the eyes' joint limits, least and greatest angles, rad."""
    return np.concatenate([head.limits.lower[EYES], head.limits.upper[EYES]])


@device
def fixate_near(p: Any, eye: int, tilt: float, pan: float, x: float, y: float, z: float) -> Any:
    """The angles that put a point of N on an eye's axis, by Newton's method from nearby ones."""
    for _ in range(8):
        dt, dp = fixate_step(p, eye, tilt, pan, x, y, z)
        size = max(abs(dt), abs(dp))
        if not isfinite(size):
            break
        scale = 0.5 / max(size, 0.5)
        tilt, pan = tilt + scale * dt, pan + scale * dp
        # the step's square is what is left: far below a hundredth of a pixel
        if size < 1e-3:
            break
    return tilt, pan


@device
def image_depths(p: Any, q: Any, error: Any) -> Any:
    """Depths along both optical axes' rays by triangulating an image, or the default."""
    cl, cr = eye_frames(p, 0, q[3], q[4])[2], eye_frames(p, 1, q[5], q[6])[2]
    left, right = rays_of_image(p, cl, cr, error)
    depth_l, depth_r, _found = depths_on_rays(left, right)
    return cl, cr, depth_l, depth_r


@device
def angles_of_image(p: Any, eye: int, camera: Any, q: Any, error: Any, depth: float) -> Any:
    """The angles that would have put the target of an image on an eye's axis."""
    lens = camera_of(p, eye)
    u, v = depth * error[eye, 0] / lens.focal_u, depth * error[eye, 1] / lens.focal_v
    x, y, z = out_of(camera, u, v, depth)
    return fixate_near(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], x, y, z)


@device
def forget(s: Any, i: int) -> None:
    """Forget an eye's target; its filter begins at index i of the state."""
    for k in range(EYE_FILTER):
        s[i + k] = 0.0


@device
def advance(s: Any, i: int, m: Any) -> None:
    """Go on by a period."""
    t, f13, f23, f33 = m[PERIOD], m[F_THETA_A], m[F_W_A], m[F_A]
    for axis in range(2):
        k = i + 3 * axis
        s[k] += t * s[k + 1] + f13 * s[k + 2]
        s[k + 1] += f23 * s[k + 2]
        s[k + 2] *= f33
    c = i + COVARIANCE
    p11, p12, p13, p22, p23, p33 = s[c], s[c + 1], s[c + 2], s[c + 3], s[c + 4], s[c + 5]
    # rows of F P, then F P F'
    a11, a12, a13 = p11 + t * p12 + f13 * p13, p12 + t * p22 + f13 * p23, p13 + t * p23 + f13 * p33
    a22, a23 = p22 + f23 * p23, p23 + f23 * p33
    s[c] = a11 + t * a12 + f13 * a13 + m[NOISE]
    s[c + 1] = a12 + f23 * a13 + m[NOISE + 1]
    s[c + 2] = f33 * a13 + m[NOISE + 2]
    s[c + 3] = a22 + f23 * a23 + m[NOISE + 3]
    s[c + 4] = f33 * a23 + m[NOISE + 4]
    s[c + 5] = f33 * f33 * p33 + m[NOISE + 5]


@device
def correct(s: Any, i: int, m: Any, tilt: float, pan: float) -> None:
    """Take in a measurement of both angles, or begin anew with it."""
    c = i + COVARIANCE
    known = s[i + KNOWN] > 0.5
    spread = s[c] + m[R]
    off_tilt, off_pan = tilt - s[i], pan - s[i + 3]
    far = max(m[GATE] * m[GATE], 25.0 * spread)
    if not known or off_tilt * off_tilt + off_pan * off_pan > far:
        forget(s, i)
        s[i], s[i + 3] = tilt, pan
        s[c], s[c + 3], s[c + 5] = m[R], m[START_W], m[START_A]
        s[i + KNOWN] = 1.0
        return
    k1, k2, k3 = s[c] / spread, s[c + 1] / spread, s[c + 2] / spread
    for axis in range(2):
        k = i + 3 * axis
        off = off_tilt if axis == 0 else off_pan
        s[k] += k1 * off
        s[k + 1] += k2 * off
        s[k + 2] += k3 * off
    p11, p12, p13 = s[c], s[c + 1], s[c + 2]
    s[c], s[c + 1], s[c + 2] = p11 - k1 * p11, p12 - k1 * p12, p13 - k1 * p13
    s[c + 3] -= k2 * p12
    s[c + 4] -= k2 * p13
    s[c + 5] -= k3 * p13


@device
def ahead(s: Any, k: int, m: Any, h: float) -> Any:
    """An angle, its rate and acceleration a time h later."""
    t = m[T_A]
    left = exp(-h / t)
    return (
        s[k] + s[k + 1] * h + s[k + 2] * t * t * (h / t - 1.0 + left),
        s[k + 1] + s[k + 2] * t * (1.0 - left),
        s[k + 2] * left,
    )
