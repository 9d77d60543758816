"""What a controller knows of the head that it controls, as one row of numbers."""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import device
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.controllers.rows import make_row, row_layout, row_size
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames
from vergence.models.parts import FloatArray

_GAP_RAD: Final = 0.008
"""What the head's model leaves between the rays of both eyes, by the target's distance."""
_NO_LIMIT: Final = 1e6
"""Acceleration of an actuator that has no limit of it, rad/s^2."""

RING: Final = 64
"""Angles of so many readings are kept."""
_KEPT_S: Final = 0.45
"""For so long at least."""


class Rig:
    """What a controller knows of a head's timing, its sensors and what moves its eyes.

    Arrays of four are by actuator of the eyes unless they say otherwise; where each of the four
    eye joints has its own motor, an actuator is a joint.
    """

    period_s: float
    """The control period."""
    latency_s: float
    """The nominal latency of an image less that of the readings of the joints."""
    dated_s: float
    """What to add to a date of an image for the time at which it came; 0 for stamps."""
    response_s: float
    """The nominal latency of a command and of a reading together."""
    keep_every: float
    """Every how many periods the joints' angles are kept for images to come."""
    lag_s: float
    """The nominal lag of the head's timing."""
    pixel_rad: float
    """A pixel by the focal length."""
    detection_px: float
    """Noise of a detection."""
    command_step: float
    """Step of the commands, rad/s; 0 for exact."""
    frame_s: float
    """Time from one frame to the next, nominally."""
    sees: float
    """Speed of an eye against its target up to which images show it, rad/s."""
    follows: float
    """Whether targets may move: 1, or 0 where they rest but for jumps."""
    gap_rad: float
    """How far the rays of both eyes' detections of one target may pass each other, by distance."""
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
RIG_SIZE: Final = row_size(RIG)
_SQUARE: Final = 0.1
"""Cosine up to which two axes count as at right angles."""


def joint_rig(head: HeadModel, moving: bool = True) -> FloatArray:
    """The row of a head's `Rig`.

    Args:
        head: the model of the head.
        moving: whether targets may move.

    Returns:
        A row of the layout `RIG`.
    """
    timing, sensor, actuation = head.timing, head.sensor, head.actuation
    leverage = np.abs(actuation.to_joints).max(axis=0)
    packed = two_joints_an_eye(head)
    pixel_rad = 1.0 / float(np.mean(head.cameras.focal))
    moves = actuation.velocity[EYES] > 0.0
    return make_row(
        RIG,
        period_s=timing.period_s,
        latency_s=(0.0 if timing.exposure_stamps else timing.latency_s) - timing.feedback_latency_s,
        dated_s=0.0 if timing.exposure_stamps else timing.latency_s,
        response_s=timing.command_latency_s + timing.feedback_latency_s,
        keep_every=np.ceil(_KEPT_S * timing.control_rate_hz / (RING - 4)),
        lag_s=timing.lag_s,
        pixel_rad=pixel_rad,
        detection_px=sensor.detection_noise_px,
        command_step=sensor.command_resolution_rad_s,
        frame_s=1.0 / timing.frame_rate_hz,
        sees=min(sensor.max_smear_px * pixel_rad / max(timing.exposure_s, 1e-6), 1e6),
        follows=moving,
        gap_rad=_GAP_RAD,
        lag_ratio=actuation.lag_ratio[EYES],
        angle_step=actuation.angle_step[EYES],
        speed_step=actuation.speed_step[EYES],
        speed=actuation.velocity[EYES],
        # a number in place of infinity, so that it takes no time; and where there is no actuator
        acceleration=np.where(
            moves, np.minimum(actuation.acceleration[EYES], _NO_LIMIT), _NO_LIMIT
        ),
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


@device
def within(value: float, reading: float, step: float) -> float:
    """A value that a reading of some resolution allows; the reading itself where that is exact."""
    return min(max(value, reading - 0.5 * step), reading + 0.5 * step)
