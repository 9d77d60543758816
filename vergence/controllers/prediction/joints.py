r"""How a controller keeps track of the eyes' joints between two observations.

`track_joint` makes an angle finer than a step of the encoder. The encoder rounds, but the joint
moves as its lag says and the rounded reading bounds it: the model's angle, limited to the
interval of the reading, is several times finer. `learn_lag` estimates the lag from what a
period's command did to the velocity:

    u - v(T) = (u - v(0)) exp(-T / lag)

as long as the acceleration limit holds nothing back.
"""

from math import inf, log
from typing import Annotated, Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence.controllers.rows import make_row, row_layout
from vergence.models.head import HeadModel
from vergence.models.joint_response import follow_joint, share_left
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

LAG_RANGE_S: Final = (0.002, 0.2)
"""What a learned lag is limited to."""
_LAG_SIGMA_S: Final = 0.01
LAG_INFORMATION: Final = 1.0 / _LAG_SIGMA_S**2
"""Information on the lag before anything has moved, 1/s^2."""
_LEAST_GAP: Final = 0.1
_SPEED_SIGMA: Final = 0.01
_MOST_INFORMATION: Final = 3e7


class Rig:
    """What a controller knows of a head's timing, its sensors and the joints of its eyes.

    Arrays of four are in the order of the joints, left tilt and pan, right tilt and pan.
    """

    period_s: float
    """The control period."""
    delay: float
    """The nominal delay from an exposure to its reading, in periods."""
    lag_s: float
    """The nominal lag of the joints."""
    pixel_rad: float
    """Noise of a detection by the focal length."""
    angle_step_rad: float
    """Resolution of the encoders."""
    speed_step: float
    """Resolution of the velocity feedback, rad/s."""
    speed: Annotated[FloatArray, 4]
    """Greatest commands, rad/s."""
    acceleration: Annotated[FloatArray, 4]
    """Greatest accelerations, rad/s^2, inf for none."""
    lower: Annotated[FloatArray, 4]
    """Least angles, rad."""
    upper: Annotated[FloatArray, 4]
    """Greatest angles, rad."""


RIG: Final = row_layout(Rig)


def joint_rig(head: HeadModel) -> FloatArray:
    """The row of a head's `Rig`.

    Args:
        head: the model of the head.

    Returns:
        A row of the layout `RIG`.
    """
    timing, sensor, limits = head.timing, head.sensor, head.limits
    return make_row(
        RIG,
        period_s=timing.period_s,
        delay=timing.latency_frames,
        lag_s=timing.lag_s,
        pixel_rad=max(sensor.detection_noise_px, 1e-3) / float(np.mean(head.cameras.focal)),
        angle_step_rad=sensor.encoder_resolution_rad,
        speed_step=sensor.velocity_resolution_rad_s,
        speed=limits.velocity[EYES],
        acceleration=limits.acceleration[EYES],
        lower=limits.lower[EYES],
        upper=limits.upper[EYES],
    )


class JointReading(NamedTuple):
    """What one joint did in a period."""

    command: float
    """The velocity command that held, rad/s."""
    angle: float
    """The encoder's reading at the end, rad."""
    velocity: float
    """The velocity that is read at the end, rad/s."""


@device
def _within(value: float, reading: float, step: float) -> float:
    return min(max(value, reading - 0.5 * step), reading + 0.5 * step)


@device
def track_joint(
    rig: Rig, j: int, q: float, v: float, lag: float, read: JointReading
) -> tuple[float, float]:
    """Angle and velocity of one joint now, from those one period ago and the readings."""
    if rig.angle_step_rad == 0.0 and rig.speed_step == 0.0:
        return read.angle, read.velocity
    period = rig.period_s
    decay = share_left(period, lag)
    q, v = follow_joint(q, v, read.command, lag, rig.acceleration[j], period, decay)
    return _within(q, read.angle, rig.angle_step_rad), _within(v, read.velocity, rig.speed_step)


@device
def learn_lag(
    rig: Rig, j: int, v: float, lag: float, information: float, read: JointReading
) -> tuple[float, float]:
    """Estimate of the lag and its information after one joint's period, which began with v.

    A period in which the joint was held back by its acceleration limit only bounds the lag.
    """
    period, a = rig.period_s, rig.acceleration[j]
    before, after = read.command - v, read.command - read.velocity
    if abs(before) < _LEAST_GAP + 2.0 * rig.speed_step:
        return lag, information
    if a < inf and abs(read.velocity - v) > 0.995 * a * period:
        # the period's end may have been without the limit, and then 0.9 of it was left
        bound = abs(after) / (0.9 * a)
        return max(min(lag, bound), LAG_RANGE_S[0]), information
    ratio = after / before
    if not 0.02 < ratio < 0.98:
        return lag, information
    found = -period / log(ratio)
    if abs(before) > a * found or not LAG_RANGE_S[0] < found < LAG_RANGE_S[1]:
        return lag, information
    slope = abs(after) * period / (found * found)
    weight = (slope / (_SPEED_SIGMA + 0.5 * rig.speed_step)) ** 2
    information = min(information, _MOST_INFORMATION)
    lag += weight / (information + weight) * (found - lag)
    return lag, information + weight
