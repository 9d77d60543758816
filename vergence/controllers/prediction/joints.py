r"""What a controller knows of the eyes' joints, and how it keeps track of them.

`JointRig` is the row of numbers that kernels read. `track_joints` follows the joints between
two observations: an encoder rounds, but the joint moves as its lag says and the rounded reading
bounds it, so the model's angle limited to the reading's interval is several times finer than a
step of the encoder. `learn_lag` estimates the lag from what a period's command did:

    u - v(T) = (u - v(0)) exp(-T / lag)

as long as the acceleration limit holds nothing back.
"""

from math import exp, inf, log
from typing import Any, Final

import numpy as np

from vergence._jit import device
from vergence.models.head import HeadModel
from vergence.models.joint_response import follow_joint
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

PERIOD: Final = 0
LATENCY: Final = 1
LAG: Final = 2
PIXEL_SIGMA: Final = 3
ANGLE_STEP: Final = 4
SPEED_STEP: Final = 5
NOMINAL_DELAY: Final = 6
SPEED: Final = 7
ACCELERATION: Final = 11
LOWER: Final = 15
UPPER: Final = 19
RIG: Final = 23
"""Length of the row."""

LAG_RANGE_S: Final = (0.002, 0.2)
"""What a learned lag is limited to."""
_LAG_SIGMA_S: Final = 0.01
_LEAST_GAP: Final = 0.1
_SPEED_SIGMA: Final = 0.01
_MOST_INFORMATION: Final = 3e7


def joint_rig(head: HeadModel) -> FloatArray:
    """The row of numbers for one head.

    Args:
        head: the model of the head.

    Returns:
        (RIG,) period and image latency, s; lag, s; detection noise by focal length, rad; steps
        of the encoders and of the velocity feedback, rad and rad/s; the latency in periods; and
        the eyes' greatest speeds, accelerations, least and greatest angles.
    """
    row = np.empty(RIG)
    timing, sensor, limits = head.timing, head.sensor, head.limits
    row[PERIOD], row[LATENCY], row[LAG] = timing.period_s, timing.latency_s, timing.lag_s
    row[PIXEL_SIGMA] = max(sensor.detection_noise_px, 1e-3) / float(np.mean(head.cameras.focal))
    row[ANGLE_STEP] = sensor.encoder_resolution_rad
    row[SPEED_STEP] = sensor.velocity_resolution_rad_s
    row[NOMINAL_DELAY] = timing.latency_frames
    row[SPEED:ACCELERATION] = limits.velocity[EYES]
    row[ACCELERATION:LOWER] = limits.acceleration[EYES]
    row[LOWER:UPPER] = limits.lower[EYES]
    row[UPPER:RIG] = limits.upper[EYES]
    return row


LAG_INFORMATION: Final = 1.0 / _LAG_SIGMA_S**2
"""Information on the lag before anything has moved, 1/s^2."""


@device
def _within(value: float, reading: float, step: float) -> float:
    return min(max(value, reading - 0.5 * step), reading + 0.5 * step)


@device
def track_joint(
    rig: Any, j: int, q: float, v: float, u: float, lag: float, q_read: float, v_read: float
) -> Any:
    """Angle and velocity of one joint now, from those one period ago and the readings."""
    angle_step, speed_step = rig[ANGLE_STEP], rig[SPEED_STEP]
    if angle_step == 0.0 and speed_step == 0.0:
        return q_read, v_read
    decay = exp(-rig[PERIOD] / lag) if lag > 0.0 else 0.0
    q, v = follow_joint(q, v, u, lag, rig[ACCELERATION + j], rig[PERIOD], decay)
    return _within(q, q_read, angle_step), _within(v, v_read, speed_step)


@device
def learn_lag(
    rig: Any, j: int, v: float, u: float, v_read: float, lag: float, information: float
) -> Any:
    """Estimate of the lag and its information after one joint's period.

    A period in which the joint was held back by its acceleration limit only bounds the lag.
    """
    period, a = rig[PERIOD], rig[ACCELERATION + j]
    before, after = u - v, u - v_read
    if abs(before) < _LEAST_GAP + 2.0 * rig[SPEED_STEP]:
        return lag, information
    if a < inf and abs(v_read - v) > 0.995 * a * period:
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
    weight = (slope / (_SPEED_SIGMA + 0.5 * rig[SPEED_STEP])) ** 2
    information = min(information, _MOST_INFORMATION)
    lag += weight / (information + weight) * (found - lag)
    return lag, information + weight
