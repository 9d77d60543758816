r"""Where a target is and how it moves, per eye, by Kalman filters on the angles that fixate it.

An image gives, with the joint angles of its exposure and the depth from both eyes, the angles of
each eye's two joints that would have put the target on its optical axis. Per angle, the target is
modelled after Singer (`vergence.controllers.prediction.singer`), and observed through the pixel's
and the encoder's noise.

Angles are better than a point in space here: their noise is the same at any depth, and an eye
that alone sees the target goes on.

The filter lives at the exposure of the newest image. It goes on by a period each period, and is
corrected where a new image has come. A measurement that lies farther from the prediction than a
moving target can explain is another target, and the filter begins anew, at rest.
"""

from math import exp, isfinite
from typing import Annotated, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.joints import joint_steps
from vergence.controllers.prediction.singer import singer_noise, singer_transition
from vergence.controllers.rows import make_row, row_layout
from vergence.envs.fields import finite_above_zero
from vergence.errors import ConfigurationError
from vergence.models.fixation import fixate_step
from vergence.models.head import HeadModel
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray
from vergence.models.pose import Pose, out_of


class Covariance:
    """The covariance of (theta, w, a), which both joints have in common."""

    p11: float
    p12: float
    p13: float
    p22: float
    p23: float
    p33: float


class EyeFilter:
    """What is known of one eye's target at the exposure of the newest image."""

    angle: Annotated[FloatArray, 2]
    """theta: the angles of both joints that fixate it, rad."""
    rate: Annotated[FloatArray, 2]
    """w: their rates, rad/s."""
    acceleration: Annotated[FloatArray, 2]
    """a: their accelerations, rad/s^2."""
    covariance: Covariance
    known: float
    """Whether there is a target: 1 or 0; the rest is 0 then."""


class TargetModel:
    """The constants of the filter."""

    period_s: float
    acceleration_time_s: float
    """T_a."""
    angle_by_acceleration: float
    """What an acceleration adds to the angle in a period, s^2."""
    rate_by_acceleration: float
    """What it adds to the rate, s."""
    acceleration_left: float
    """What is left of it, a share."""
    noise: Covariance
    """What a period adds to the covariance."""
    measured: float
    """Variance of a measured angle, rad^2."""
    start_rate: float
    """Variance of the rate of a new target, (rad/s)^2."""
    start_acceleration: float
    """Variance of its acceleration, (rad/s^2)^2."""
    gate_rad: float
    """A measurement farther than this from the prediction, at least, is another target."""


TARGET_MODEL: Final = row_layout(TargetModel)


def target_model(
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
        A row of the layout `TARGET_MODEL`.

    Raises:
        ConfigurationError: a value cannot be.
    """
    finite_above_zero("acceleration_sd", acceleration_sd)
    finite_above_zero("acceleration_time_s", acceleration_time_s)
    finite_above_zero("start_velocity_sd", start_velocity_sd)
    finite_above_zero("gate_rad", gate_rad)
    measured = measured_variance(head, pixel_sd)
    period, t = head.timing.period_s, acceleration_time_s
    transition = singer_transition(period, t)
    noise = singer_noise(period, t, acceleration_sd)
    return make_row(
        TARGET_MODEL,
        period_s=period,
        acceleration_time_s=t,
        angle_by_acceleration=transition[0, 2],
        rate_by_acceleration=transition[1, 2],
        acceleration_left=transition[2, 2],
        noise=tuple(noise[np.triu_indices(3)]),
        measured=measured,
        start_rate=start_velocity_sd**2,
        start_acceleration=acceleration_sd**2,
        gate_rad=gate_rad,
    )


def measured_variance(head: HeadModel, pixel_sd: float | None) -> float:
    """The variance of a measured angle, rad^2, from a detection's noise and the encoders' steps.

    Args:
        head: the model of the head.
        pixel_sd: noise of a detection, px; None for the head's.

    Raises:
        ConfigurationError: the noise cannot be.
    """
    pixel = head.sensor.detection_noise_px if pixel_sd is None else pixel_sd
    if not (isfinite(pixel) and pixel >= 0.0):
        raise ConfigurationError(f"pixel_sd: expected px >= 0, got {pixel_sd!r}")
    # a floor of a thousandth of a pixel keeps the filter a filter where nothing is noisy
    sd = max(pixel, 1e-3) / float(head.cameras.focal.min())
    # readings are rounded to steps of the encoder: uniform noise
    return sd**2 + float(joint_steps(head).max()) ** 2 / 12.0


@device
def fixate_near(
    p: PackedHead, eye: int, q1: float, q2: float, x: float, y: float, z: float
) -> tuple[float, float]:
    """The angles that put a point of N on an eye's axis, by Newton's method from nearby ones."""
    for _ in range(8):
        d1, d2 = fixate_step(p, eye, q1, q2, x, y, z)
        size = max(abs(d1), abs(d2))
        if not isfinite(size):
            break
        scale = 0.5 / max(size, 0.5)
        q1, q2 = q1 + scale * d1, q2 + scale * d2
        # the step's square is what is left: far below a hundredth of a pixel
        if size < 1e-3:
            break
    return q1, q2


@device
def angles_of_image(
    p: PackedHead, eye: int, camera: Pose, q: FloatArray, error: FloatArray, depth: float
) -> tuple[float, float]:
    """The angles that would have put the target of an image on an eye's axis.

    Args:
        p: a packed head.
        eye: which one.
        camera: the frame of its camera at the exposure.
        q: (7,) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px.
        depth: of the target in this eye, m.

    Returns:
        Those of its first and its second joint, rad.
    """
    lens = camera_of(p, eye)
    u, v = depth * error[eye, 0] / lens.focal_u, depth * error[eye, 1] / lens.focal_v
    x, y, z = out_of(camera, u, v, depth)
    return fixate_near(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], x, y, z)


@device
def forget(s: EyeFilter) -> None:
    """Forget an eye's target."""
    for axis in range(2):
        s.angle[axis] = s.rate[axis] = s.acceleration[axis] = 0.0
    c = s.covariance
    c.p11 = c.p12 = c.p13 = c.p22 = c.p23 = c.p33 = s.known = 0.0


@device
def advance(s: EyeFilter, m: TargetModel) -> None:
    """Go on by a period."""
    t, f13, f23 = m.period_s, m.angle_by_acceleration, m.rate_by_acceleration
    f33 = m.acceleration_left
    for axis in range(2):
        s.angle[axis] += t * s.rate[axis] + f13 * s.acceleration[axis]
        s.rate[axis] += f23 * s.acceleration[axis]
        s.acceleration[axis] *= f33
    c, noise = s.covariance, m.noise
    p11, p12, p13, p22, p23, p33 = c.p11, c.p12, c.p13, c.p22, c.p23, c.p33
    # rows of F P, then F P F'
    a11, a12, a13 = p11 + t * p12 + f13 * p13, p12 + t * p22 + f13 * p23, p13 + t * p23 + f13 * p33
    a22, a23 = p22 + f23 * p23, p23 + f23 * p33
    c.p11 = a11 + t * a12 + f13 * a13 + noise.p11
    c.p12 = a12 + f23 * a13 + noise.p12
    c.p13 = f33 * a13 + noise.p13
    c.p22 = a22 + f23 * a23 + noise.p22
    c.p23 = f33 * a23 + noise.p23
    c.p33 = f33 * f33 * p33 + noise.p33


@device
def correct(s: EyeFilter, m: TargetModel, first: float, second: float) -> None:
    """Take in a measurement of both angles, or begin anew with it."""
    c = s.covariance
    spread = c.p11 + m.measured
    off = (first - s.angle[0], second - s.angle[1])
    far = max(m.gate_rad * m.gate_rad, 25.0 * spread)
    if not s.known > 0.5 or off[0] * off[0] + off[1] * off[1] > far:
        forget(s)
        s.angle[0], s.angle[1] = first, second
        c.p11, c.p22, c.p33 = m.measured, m.start_rate, m.start_acceleration
        s.known = 1.0
        return
    k1, k2, k3 = c.p11 / spread, c.p12 / spread, c.p13 / spread
    for axis in range(2):
        s.angle[axis] += k1 * off[axis]
        s.rate[axis] += k2 * off[axis]
        s.acceleration[axis] += k3 * off[axis]
    p11, p12, p13 = c.p11, c.p12, c.p13
    c.p11, c.p12, c.p13 = p11 - k1 * p11, p12 - k1 * p12, p13 - k1 * p13
    c.p22 -= k2 * p12
    c.p23 -= k2 * p13
    c.p33 -= k3 * p13


@device
def ahead(s: EyeFilter, axis: int, m: TargetModel, h: float) -> tuple[float, float]:
    """An angle and its rate a time h later."""
    t, w, a = m.acceleration_time_s, s.rate[axis], s.acceleration[axis]
    left = exp(-h / t)
    angle = s.angle[axis] + w * h + a * t * t * (h / t - 1.0 + left)
    return angle, w + a * t * (1.0 - left)
