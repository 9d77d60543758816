"""Parameters of the head that the predictor and its control laws use, as one packed row.

The predictor describes a target by the two joint angles that would put it on the eye's optical
axis. An eye with fewer joints, such as one that only pans, gets virtual ones, which never move.
"""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from vergence.kernels import inlined, make_row, row_layout, row_size
from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.kinematics import eye_frames, pack_constants
from vergence.models.parts import EYES, FloatArray

_MAX_PARALLEL_SQUARED_SINE: Final = 1e-3
"""Squared sine up to which a first axis is parallel to the optical axis (numerical)."""


def with_virtual_joints(head: HeadModel) -> FloatArray:
    """(PACKED,) row of a head with two joints in each eye; virtual ones at zero change no pose."""
    lacks = [not name for name in head.joints[EYES]]
    if not any(lacks):
        return head.packed
    poses = head.links.constant_poses()
    for eye in range(2):
        first, second = lacks[2 * eye : 2 * eye + 2]
        before, between, after = poses[4 + 3 * eye : 7 + 3 * eye]
        after = after @ head.head_eye[eye]
        if first:  # then the second is missing too: tilt and pan about the camera's own axes
            camera = before @ between @ after
            tilt, pan = _about(camera, camera[:3, 0]), _about(camera, camera[:3, 1])
            before, between, after = tilt, inverse_pose(tilt) @ pan, inverse_pose(pan) @ camera
        elif second:
            camera = between @ after
            axis = np.cross([0.0, 0.0, 1.0], camera[:3, 2])
            parallel = not axis @ axis > _MAX_PARALLEL_SQUARED_SINE
            across = _about(camera, camera[:3, 0] if parallel else axis)
            between, after = across, inverse_pose(across) @ camera
        poses[4 + 3 * eye : 7 + 3 * eye] = before, between, after
    return pack_constants(poses, head.cameras.rows, head.actuation)


def _about(camera: FloatArray, axis: FloatArray) -> FloatArray:
    """(4, 4) frame at a camera's origin with its z axis along `axis`, across the optical axis."""
    pose = np.eye(4)
    z = axis / np.linalg.norm(axis)
    x = camera[:3, 2] - (camera[:3, 2] @ z) * z
    x /= np.linalg.norm(x)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, np.cross(z, x), z
    pose[:3, 3] = camera[:3, 3]
    return pose


_MODEL_MISS_RATIO: Final = 0.008
"""Miss distance of two rays to one target per distance that model errors cause (chosen)."""
_NO_ACCELERATION_LIMIT: Final = 1e6
"""Acceleration limit used for an actuator that has none, rad/s^2 (numerical)."""

RING_LENGTH: Final = 64
"""Number of past joint angles in the ring buffer, a power of two (numerical)."""
_MIN_RING_S: Final = 0.45
"""Least time that the ring buffer covers, s (numerical: longer than every delay hypothesis)."""
_MAX_RESPONSE_LATENCY_S: Final = 0.12
"""Longest latency of commands plus readings that is considered, s (chosen)."""
_LATENCY_ROOM_S: Final = 0.06
"""Least room for it above the latency in the head's model, s (chosen: five prior deviations)."""
_RESPONSE_WINDOW_S: Final = 0.117
"""Window of readings to which the response is fitted, s (chosen: noise against adaptation)."""
_RING_MARGIN: Final = 4
"""Periods by which a ring buffer is longer than what it has to hold (numerical)."""
_LEAST_WINDOW: Final = 8  # shortest window, in periods (numerical)


class PredictorParameters:
    """Timing, sensors and actuators of a head, as its controller knows them.

    Arrays of four are by actuator of the eyes unless stated otherwise; where each of the four eye
    joints has its own motor, an actuator is a joint.
    """

    period_s: float
    """Control period, s."""
    nominal_delay_s: float
    """Nominal latency of images (0 for stamped exposures) minus that of joint readings, s."""
    image_latency_s: float
    """Nominal latency from exposure to arrival, s; 0 if the camera stamps exposures."""
    response_latency_s: float
    """Nominal latency of commands plus that of joint readings, s."""
    max_response_latency_s: float
    """Longest latency of commands plus readings that is considered, s."""
    response_window: float
    """Length of the window to which the response is fitted, in periods."""
    command_ring: float
    """Length of the ring buffer of commands, a power of two: a window and the latency before."""
    speed_ring: float
    """Length of the ring buffers of velocities, a power of two."""
    sample_periods: float
    """Number of periods between the joint angles that are stored for later images."""
    lag_s: float
    """Nominal lag in the head's timing, s."""
    pixel_rad: float
    """Angle of one pixel at the image centre, 1 / focal length, rad."""
    detection_noise_px: float
    """Detection noise, standard deviation, px."""
    command_step: float
    """Resolution of the commands, rad/s; 0 if not quantised."""
    frame_period_s: float
    """Nominal time between frames, s."""
    max_slip_rad_s: float
    """Largest eye-target angular rate before motion blur hides the target, rad/s."""
    targets_move: float
    """1 if targets may move, 0 if they rest except for jumps."""
    max_miss_ratio: float
    """Largest miss distance of both eyes' rays to one target, divided by its distance."""
    lag_ratio: Annotated[FloatArray, 4]
    """Ratio of each actuator's lag to the lag in the head's timing."""
    angle_step: Annotated[FloatArray, 4]
    """Resolution of the encoders, rad."""
    speed_step: Annotated[FloatArray, 4]
    """Resolution of the velocity feedback, rad/s."""
    speed_limit: Annotated[FloatArray, 4]
    """Largest commands, rad/s."""
    acceleration_limit: Annotated[FloatArray, 4]
    """Acceleration limits, rad/s^2; `_NO_ACCELERATION_LIMIT` for none."""
    lower: Annotated[FloatArray, 4]
    """Lower position limits, rad."""
    upper: Annotated[FloatArray, 4]
    """Upper position limits, rad."""
    max_joint_per_actuator: Annotated[FloatArray, 4]
    """Largest eye joint rotation per radian of an actuator; 1 for one that moves no eye."""
    moves_eye: Annotated[FloatArray, 4, 2]
    """1 if an actuator turns an eye, otherwise 0; by actuator and eye."""
    joint_step: Annotated[FloatArray, 2, 2]
    """Resolution of each eye's joint angles, from that of the encoders, rad."""
    orthogonal_axes: Annotated[FloatArray, 2]
    """1 for an eye whose joint axes and optical axis are at right angles at zero, otherwise 0."""


PREDICTOR_PARAMETERS: Final = row_layout(PredictorParameters)
PREDICTOR_PARAMETERS_SIZE: Final = row_size(PREDICTOR_PARAMETERS)
_MAX_ORTHOGONAL_COSINE: Final = 0.1
"""Largest cosine between two axes that count as at right angles (chosen)."""


def pack_predictor_parameters(head: HeadModel, targets_move: bool = True) -> FloatArray:
    """Pack the `PredictorParameters` of a head into a row; `targets_move` if they may move."""
    timing, sensor, actuation = head.timing, head.sensor, head.actuation
    leverage = np.abs(actuation.to_joints).max(axis=0)
    packed = with_virtual_joints(head)
    pixel_rad = 1.0 / float(np.mean(head.cameras.focal))
    # a finite number instead of infinity, which is slow; also where there is no actuator
    acceleration = np.minimum(actuation.acceleration[EYES], _NO_ACCELERATION_LIMIT)
    acceleration[~(actuation.velocity[EYES] > 0.0)] = _NO_ACCELERATION_LIMIT
    image_latency_s = 0.0 if timing.exposure_stamps else timing.latency_s
    response_latency_s = timing.command_latency_s + timing.feedback_latency_s
    longest_s = max(_MAX_RESPONSE_LATENCY_S, response_latency_s + _LATENCY_ROOM_S)
    window = max(int(_RESPONSE_WINDOW_S / timing.period_s + 0.5), _LEAST_WINDOW)
    return make_row(
        PREDICTOR_PARAMETERS,
        period_s=timing.period_s, frame_period_s=1.0 / timing.frame_rate_hz, lag_s=timing.lag_s,
        nominal_delay_s=image_latency_s - timing.feedback_latency_s,
        image_latency_s=image_latency_s,
        response_latency_s=response_latency_s, max_response_latency_s=longest_s,
        response_window=window, speed_ring=_ring_length(window),
        command_ring=_ring_length(window + longest_s / timing.period_s),
        sample_periods=np.ceil(_MIN_RING_S * timing.control_rate_hz / (RING_LENGTH - 4)),
        pixel_rad=pixel_rad, detection_noise_px=sensor.detection_noise_px,
        command_step=sensor.command_resolution_rad_s,
        max_slip_rad_s=min(sensor.max_smear_px * pixel_rad / max(timing.exposure_s, 1e-6), 1e6),
        targets_move=targets_move, max_miss_ratio=_MODEL_MISS_RATIO,
        lag_ratio=actuation.lag_ratio[EYES], angle_step=actuation.angle_step[EYES],
        speed_step=actuation.speed_step[EYES], speed_limit=actuation.velocity[EYES],
        acceleration_limit=acceleration,
        lower=actuation.lower[EYES], upper=actuation.upper[EYES],
        max_joint_per_actuator=np.where(leverage > 0.0, leverage, 1.0),
        moves_eye=actuator_moves_eye(head),
        joint_step=(np.abs(actuation.to_joints) * actuation.angle_step[EYES]).sum(1).reshape(2, 2),
        orthogonal_axes=[_is_orthogonal(packed, eye) for eye in range(2)],
    )  # fmt: skip


def _ring_length(periods: float) -> int:
    """Power of two that holds some periods, and the few about them."""
    return 1 << (int(periods) + _RING_MARGIN).bit_length()


def actuator_moves_eye(head: HeadModel) -> NDArray[np.bool_]:
    """(4, 2) True where an actuator turns an eye."""
    turns = head.actuation.to_joints != 0.0
    return np.asarray(turns.reshape(2, 2, 4).any(axis=1).T)


def _is_orthogonal(packed: FloatArray, eye: int) -> bool:
    frames = eye_frames(packed, eye, 0.0, 0.0)
    axes = np.array([[frame.xz, frame.yz, frame.zz] for frame in frames])
    return bool(np.abs((axes @ axes.T)[np.triu_indices(3, 1)]).max() < _MAX_ORTHOGONAL_COSINE)


@inlined
def clip_to_quantisation(value: float, reading: float, step: float) -> float:
    """Clip a value to the interval step / 2 about a quantised reading; step 0 gives the reading."""
    return min(max(value, reading - 0.5 * step), reading + 0.5 * step)
