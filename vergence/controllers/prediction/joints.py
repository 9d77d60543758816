r"""How a controller keeps track of the eyes' actuators between two observations.

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
from numpy.typing import NDArray

from vergence._jit import device
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.controllers.rows import make_row, row_layout
from vergence.models.head import HeadModel
from vergence.models.joint_response import follow_joint, share_left
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames
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
    """What a controller knows of a head's timing, its sensors and what moves its eyes.

    Arrays of four are by actuator of the eyes unless they say otherwise; where each of the four
    eye joints has its own motor, an actuator is a joint.
    """

    period_s: float
    """The control period."""
    delay: float
    """The nominal delay from an exposure to its reading, in periods."""
    lag_s: float
    """The nominal lag of the head's timing."""
    pixel_rad: float
    """Noise of a detection by the focal length."""
    lag_ratio: Annotated[FloatArray, 4]
    """Lags by that of the head's timing."""
    angle_step: Annotated[FloatArray, 4]
    """Resolution of the encoders, rad."""
    speed_step: Annotated[FloatArray, 4]
    """Resolution of the velocity feedback, rad/s."""
    speed: Annotated[FloatArray, 4]
    """Greatest commands, rad/s."""
    acceleration: Annotated[FloatArray, 4]
    """Greatest accelerations, rad/s^2, inf for none."""
    lower: Annotated[FloatArray, 4]
    """Least angles, rad."""
    upper: Annotated[FloatArray, 4]
    """Greatest angles, rad."""
    leverage: Annotated[FloatArray, 4]
    """The most that any eye joint turns per radian of an actuator; 1 for one that moves none."""
    moves: Annotated[FloatArray, 4, 2]
    """Whether each actuator turns each eye: 1 or 0."""
    joint_step: Annotated[FloatArray, 2, 2]
    """What the encoders' steps leave uncertain of each eye's joints, rad."""
    square: Annotated[FloatArray, 2]
    """Whether each eye's two joints and its optical axis at zero are at right angles: 1 or 0."""


RIG: Final = row_layout(Rig)
_SQUARE: Final = 0.1
"""Cosine up to which two axes count as at right angles."""


def joint_rig(head: HeadModel) -> FloatArray:
    """The row of a head's `Rig`.

    Args:
        head: the model of the head.

    Returns:
        A row of the layout `RIG`.
    """
    timing, sensor, actuation = head.timing, head.sensor, head.actuation
    leverage = np.abs(actuation.to_joints).max(axis=0)
    packed = two_joints_an_eye(head)
    return make_row(
        RIG,
        period_s=timing.period_s,
        delay=timing.latency_frames,
        lag_s=timing.lag_s,
        pixel_rad=max(sensor.detection_noise_px, 1e-3) / float(np.mean(head.cameras.focal)),
        lag_ratio=actuation.lag_ratio[EYES],
        angle_step=actuation.angle_step[EYES],
        speed_step=actuation.speed_step[EYES],
        speed=actuation.velocity[EYES],
        acceleration=actuation.acceleration[EYES],
        lower=actuation.lower[EYES],
        upper=actuation.upper[EYES],
        leverage=np.where(leverage > 0.0, leverage, 1.0),
        moves=eyes_moved(head),
        joint_step=joint_steps(head).reshape(2, 2),
        square=[_is_square(packed, eye) for eye in range(2)],
    )


def eyes_moved(head: HeadModel) -> NDArray[np.bool_]:
    """(4, 2) whether each actuator turns each eye."""
    turns = head.actuation.to_joints != 0.0
    return np.asarray(turns.reshape(2, 2, 4).any(axis=1).T)


def joint_steps(head: HeadModel) -> FloatArray:
    """(4,) what the encoders' steps leave uncertain of the eyes' joints, rad."""
    steps: FloatArray = (np.abs(head.actuation.to_joints) * head.actuation.angle_step[EYES]).sum(1)
    return steps


def _is_square(packed: FloatArray, eye: int) -> bool:
    frames = eye_frames(packed, eye, 0.0, 0.0)
    axes = np.array([[frame.xz, frame.yz, frame.zz] for frame in frames])
    return bool(np.abs((axes @ axes.T)[np.triu_indices(3, 1)]).max() < _SQUARE)


class JointReading(NamedTuple):
    """What one actuator did in a period."""

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
    """Angle and velocity of one actuator now, from those one period ago and the readings.

    Args:
        rig: what is known of the head.
        j: which actuator.
        q: its angle a period ago, rad.
        v: its velocity then, rad/s.
        lag: its own lag, s.
        read: the readings.
    """
    if rig.angle_step[j] == 0.0 and rig.speed_step[j] == 0.0:
        return read.angle, read.velocity
    period = rig.period_s
    decay = share_left(period, lag)
    q, v = follow_joint(q, v, read.command, lag, rig.acceleration[j], period, decay)
    return _within(q, read.angle, rig.angle_step[j]), _within(v, read.velocity, rig.speed_step[j])


@device
def learn_lag(
    rig: Rig, j: int, v: float, lag: float, information: float, read: JointReading
) -> tuple[float, float]:
    """Estimate of the lag and its information after one actuator's period, which began with v.

    The lag is that of the head's timing, of which an actuator has its own multiple. A period in
    which it was held back by its acceleration limit only bounds the lag.
    """
    period, a, own = rig.period_s, rig.acceleration[j], rig.lag_ratio[j]
    if own == 0.0:
        return lag, information
    before, after = read.command - v, read.command - read.velocity
    if abs(before) < _LEAST_GAP + 2.0 * rig.speed_step[j]:
        return lag, information
    if a < inf and abs(read.velocity - v) > 0.995 * a * period:
        # the period's end may have been without the limit, and then 0.9 of it was left
        bound = abs(after) / (0.9 * a) / own
        return max(min(lag, bound), LAG_RANGE_S[0]), information
    ratio = after / before
    if not 0.02 < ratio < 0.98:
        return lag, information
    found = -period / log(ratio)
    if abs(before) > a * found:
        return lag, information
    slope = own * (abs(after) * period / (found * found))
    found /= own
    if not LAG_RANGE_S[0] < found < LAG_RANGE_S[1]:
        return lag, information
    weight = (slope / (_SPEED_SIGMA + 0.5 * rig.speed_step[j])) ** 2
    information = min(information, _MOST_INFORMATION)
    lag += weight / (information + weight) * (found - lag)
    return lag, information + weight
