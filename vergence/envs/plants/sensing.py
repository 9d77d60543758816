r"""Sensor model of simulated plants: detections in each frame, and the time of their reading.

`simulate_detections` takes the frames of the last period, each with the joint angles at its own
exposure, and stores the detections in ring buffers. `read_sensors` reads the newest frame that has
become readable, and the joint feedback. While the control loop stalls nothing is read: a reading
then has the present time and is otherwise unchanged.

A reading dates its image by the camera's stamp if there is one, else by the receipt minus the
nominal latency, as does a robot that only knows when an image arrived. If the actual latency
differs, the angles "at exposure" are those at the date in the reading, and the controller has to
cope with the error.
"""

from math import hypot, nan
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.commands import (
    COMMAND_LOST,
    RESUME_PERIOD,
    is_command_lost,
    loop_resumes_at,
)
from vergence.envs.plants.conditions import PackedConditions, unpack_conditions
from vergence.envs.plants.feedback import JointFeedbackBuffers, ring_interval_by_time, sense_joints
from vergence.envs.plants.frames import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    draw_frame_faults,
    exposed_eyes,
    false_detection_offset,
    first_exposure_of_frame,
    frame_arrival_time,
    outlier_offset,
    pixel_noise,
)
from vergence.envs.plants.motors import ActuatorCoupling, MotorStates
from vergence.envs.plants.scene import (
    TrueHeadsAndTargets,
    distorted_eye_pixel,
    image_displacement,
    target_position_in_n,
)
from vergence.envs.reading import Reading
from vergence.envs.streams import IntArray, StreamKey, StreamKeys
from vergence.envs.targets.motion import is_shown, unpack_motion
from vergence.kernels import compiled
from vergence.models.head import HeadModel
from vergence.models.kinematics import inside_image

_NO_FRAME: Final = -(2**62)
"""Frame number that stands for no frame (numerical)."""


class SensorTiming(NamedTuple):
    """Clock and sensors common to all heads of a batch, by their model."""

    control_period_s: float
    """Control period, s."""
    nominal_latency_s: float
    """Nominal latency by which a reading dates its image, s."""
    nominal_feedback_latency_s: float
    """Nominal latency by which a reading dates the joints, s."""
    exposure_stamped: bool
    """True if the cameras stamp the exposure of a frame."""
    exposure_s: float
    """Exposure time, s."""
    max_smear_px: float
    """Image motion during an exposure above which the target is not detected, px."""

    @classmethod
    def of(cls, head: HeadModel) -> "SensorTiming":
        """The sensors of a head model."""
        timing = head.timing
        return cls(
            control_period_s=timing.period_s,
            nominal_latency_s=timing.latency_s,
            nominal_feedback_latency_s=timing.feedback_latency_s,
            exposure_stamped=bool(timing.exposure_stamps),
            exposure_s=timing.exposure_s,
            max_smear_px=head.sensor.max_smear_px,
        )


@compiled
def simulate_detections(
    ids: IntArray,
    timing: SensorTiming,
    packed: PackedConditions,
    keys: StreamKeys,
    scene: TrueHeadsAndTargets,
    exposures: Exposures,
    frames: Frames,
) -> None:
    """Simulate the detections in the last period's frames, and write them to the ring buffers.

    Args:
        ids: (m,) environment indices.
        timing: `untyped_tuple`, as are the following.
        packed: conditions of the trials.
        keys: keys of the trials' random streams.
        scene: the true heads and their targets.
        exposures: times of the exposures, and the joints at these times.
        frames: ring buffers, updated in place.
    """
    timing, packed, keys = SensorTiming(*timing), PackedConditions(*packed), StreamKeys(*keys)
    scene, exposures, frames = TrueHeadsAndTargets(*scene), Exposures(*exposures), Frames(*frames)
    # unpacked once, as numba would count references at each access in the loop
    heads, motions, necks, _steps, _positions, _velocities = scene
    counts, times, then_q, then_v = exposures
    pixels, visible, dropped, exposed_s, comes_s, following, _pending, latest_s = frames
    half_exposure_s = 0.5 * timing.exposure_s
    mask, many = dropped.shape[1] - 1, np.uintp(heads.shape[0] > 1)
    for env in ids:
        n = np.uintp(env)  # unsigned, so that no index is counted from the end
        if counts[n] == 0:
            continue
        conditions, key = unpack_conditions(packed, n), StreamKey(keys.seeds[n], keys.trials[n])
        p, motion = heads[n * many], unpack_motion(motions[n])
        for i in range(counts[n]):
            (f, first_eye, end_eye), time_s = exposed_eyes(conditions, following[n]), times[n, i]
            following[n] += 1
            slot, faults = np.uintp(f & mask), draw_frame_faults(conditions, key, f)
            if first_eye == 0:
                exposed_s[n, slot], dropped[n, slot] = time_s, faults.dropped
                visible[n, slot, 0] = visible[n, slot, 1] = False
            if faults.dropped:
                continue
            if first_eye == 0:
                comes_s[n, slot] = latest_s[n] = frame_arrival_time(
                    conditions, time_s, faults.extra_latency_s, latest_s[n]
                )
            # a frame at a jump shows the target after the jump
            target_time_s = time_s - conditions.onset_s + TIME_TOLERANCE_S
            if not is_shown(motion, target_time_s):
                continue
            q = then_q[n, i]
            point = target_position_in_n(p, motion, necks[n], q, target_time_s)
            noise = pixel_noise(conditions, key, f)
            for eye in range(first_eye, end_eye):
                u, v = distorted_eye_pixel(p, eye, q, point)
                missed = faults.missed_right if eye else faults.missed_left
                if missed or not inside_image(p, eye, u, v):
                    continue
                if half_exposure_s > 0.0:
                    smear = image_displacement(
                        p, motion, necks[n], eye, q, then_v[n, i], target_time_s, half_exposure_s
                    )
                    if not hypot(smear[0], smear[1]) <= timing.max_smear_px:
                        continue
                du, dv = outlier_offset(conditions, key, f, eye)
                false_u = false_v = 0.0
                if conditions.false_detection_probability > 0.0:
                    false_u, false_v = false_detection_offset(conditions, key, f, eye)
                visible[n, slot, eye] = True
                pixels[n, slot, eye, 0] = u + (noise[2] if eye else noise[0]) + du + false_u
                pixels[n, slot, eye, 1] = v + (noise[3] if eye else noise[1]) + dv + false_v


@compiled
def read_sensors(
    ids: IntArray,
    timing: SensorTiming,
    packed: PackedConditions,
    keys: StreamKeys,
    steps: IntArray,
    motors: MotorStates,
    coupling: ActuatorCoupling | None,
    feedback: JointFeedbackBuffers,
    frames: Frames,
    reading: Reading,
) -> None:
    """Read the newest available frames and the joint feedback of some environments.

    Args:
        ids: (m,) environment indices.
        timing: `untyped_tuple`, as are the following but for `steps` and `coupling`.
        packed: conditions of the trials.
        keys: keys of the trials' random streams.
        steps: (n,) control periods since the trials' start.
        motors: the motors.
        coupling: coupling of the eye joints; None if each has its own motor.
        feedback: the encoders and the states of the control loops, updated in place.
        frames: ring buffers.
        reading: the result; its image fields are unchanged if no new frame has arrived.
    """
    timing, packed, keys = SensorTiming(*timing), PackedConditions(*packed), StreamKeys(*keys)
    frames, reading = Frames(*frames), Reading(*reading)
    period_s, loop_states = (
        timing.control_period_s,
        JointFeedbackBuffers(*feedback).control_loop_states,
    )
    for env in ids:
        n = np.uintp(env)
        conditions, step = unpack_conditions(packed, n), steps[n]
        key = StreamKey(keys.seeds[n], keys.trials[n])
        loop_states[n, RESUME_PERIOD] = loop_resumes_at(
            conditions, key, step, period_s, loop_states[n, RESUME_PERIOD]
        )
        loop_states[n, COMMAND_LOST] = is_command_lost(conditions, key, step)
    sense_joints(
        ids, period_s, packed, keys, steps, MotorStates(*motors), coupling,
        JointFeedbackBuffers(*feedback),
        reading,
    )  # fmt: skip
    reported = JointFeedbackBuffers(*feedback).reported_angles
    # unpacked once, as numba would count references at each access in the loop
    pixels, visible, dropped, exposed_s, comes_s, following, pending, _latest_s = frames
    time_s, frame, read_pixels, read_visible = (
        reading.time_s,
        reading.frame,
        reading.pixels,
        reading.visible,
    )
    read_exposure_s, received_s, joints_s = reading.exposure_s, reading.received_s, reading.joints_s
    at_exposure = reading.positions_at_exposure
    mask, kept, rate = dropped.shape[1] - 1, reported.shape[1], 1.0 / period_s
    for env in ids:
        n = np.uintp(env)
        k = steps[n]
        now_s = k * period_s
        time_s[n] = now_s
        if k < loop_states[n, RESUME_PERIOD]:
            continue
        joints_s[n] = now_s - timing.nominal_feedback_latency_s
        newest, f, conditions = _NO_FRAME, pending[n], unpack_conditions(packed, n)
        # a frame whose right eye is still to be exposed has not arrived
        while first_exposure_of_frame(conditions, f) < following[n]:
            slot = np.uintp(f & mask)
            if not dropped[n, slot]:
                if comes_s[n, slot] > now_s + TIME_TOLERANCE_S:
                    break
                newest = f
                frame[n] += 1
            f += 1
        pending[n] = f
        if newest == _NO_FRAME:
            continue
        slot = np.uintp(newest & mask)
        received_s[n] = comes_s[n, slot]
        date_s = (
            exposed_s[n, slot]
            if timing.exposure_stamped
            else comes_s[n, slot] - timing.nominal_latency_s
        )
        read_exposure_s[n] = date_s
        at = ring_interval_by_time((date_s + timing.nominal_feedback_latency_s) * rate, k, kept)
        for j in range(7):
            old = reported[n, at.first, j]
            at_exposure[n, j] = old
            if at.share > 0.0:
                at_exposure[n, j] = old + at.share * (reported[n, at.second, j] - old)
        for eye in range(2):
            seen = visible[n, slot, eye]
            read_visible[n, eye] = seen
            read_pixels[n, eye, 0] = pixels[n, slot, eye, 0] if seen else nan
            read_pixels[n, eye, 1] = pixels[n, slot, eye, 1] if seen else nan
