"""A control period of simulated heads in phases: start of a trial, sensors, and the step.

A step of a single head is mostly calls of compiled code, and their cost is that of their arguments.
So a plant makes a table of all arrays of a step, once, and calls a single function with it.

`simulate_detections` takes the frames of the last period, each with the joint angles at its own
exposure, and stores the detections in ring buffers. `read_sensors` reads the newest frame that has
become readable, and the joint feedback. While the control loop stalls nothing is read: a reading
then has the present time and is otherwise unchanged.

A reading dates its image by the camera's stamp if there is one, else by the receipt minus the
nominal latency, as does a robot that only knows when an image arrived. If the actual latency
differs, the angles "at exposure" are those at the date in the reading, and the controller has to
cope with the error.
"""

from math import floor, hypot, nan
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.envs.plants.cameras import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    TrueHeadsAndTargets,
    distorted_eye_pixel,
    draw_frame_faults,
    exposed_eyes,
    exposure_time,
    eye_skew_s,
    false_detection_offset,
    first_exposure_of_frame,
    frame_arrival_time,
    frame_exposure_time,
    image_displacement,
    outlier_offset,
    pixel_noise,
    target_position_in_n,
    true_head_row,
)
from vergence.envs.plants.conditions import (
    BACKLASH,
    PackedConditions,
    TrialConditions,
    unpack_conditions,
)
from vergence.envs.plants.motors import (
    COMMAND_LOST,
    LOOP_STATE,
    RESUME_PERIOD,
    ActuatorCoupling,
    CommandBuffers,
    JointFeedbackBuffers,
    MotorStates,
    is_command_lost,
    joints_from_actuators,
    loop_resumes_at,
    quantise,
    ring_interval_by_time,
    sense_joints,
    store_commands,
)
from vergence.envs.reading import Reading
from vergence.envs.reward import JUDGE, LIMIT, TaskArrays, judge_steps, limit_actions
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamKeys,
    StreamPurpose,
    random_words,
    to_uniform,
)
from vergence.envs.targets.motion import is_shown
from vergence.kernels import compiled, inlined, subroutine, unpack_table
from vergence.models.head import HeadModel
from vergence.models.kinematics import eye_actuator_angle, inside_image
from vergence.models.parts import SLOTS, FloatArray

_NO_FRAME: Final = -(2**62)
"""Frame number that stands for no frame (numerical)."""


class SensorTiming(NamedTuple):
    """Clock and sensors common to all heads of a batch, by their model."""

    control_period_s: float  # control period, s
    nominal_latency_s: float  # nominal latency by which a reading dates its image, s
    nominal_feedback_latency_s: float  # nominal latency by which a reading dates the joints, s
    exposure_stamped: bool  # True if the cameras stamp the exposure of a frame
    exposure_s: float  # exposure time, s
    max_smear_px: float
    """Image motion during an exposure above which the target is not detected, px."""

    @classmethod
    def of(cls, head: HeadModel) -> "SensorTiming":
        """The sensors of a head model."""
        timing = head.timing
        return cls(
            control_period_s=timing.period_s, nominal_latency_s=timing.latency_s,
            nominal_feedback_latency_s=timing.feedback_latency_s,
            exposure_stamped=bool(timing.exposure_stamps), exposure_s=timing.exposure_s,
            max_smear_px=head.sensor.max_smear_px,
        )  # fmt: skip


@subroutine
def simulate_detections(
    ids: IntArray, timing: SensorTiming, packed: PackedConditions, keys: StreamKeys,
    scene: TrueHeadsAndTargets, exposures: Exposures, frames: Frames,
) -> None:  # fmt: skip
    """Simulate the detections in the last period's frames, and write them to the ring buffers."""
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
        p, motion = heads[n * many], motions[n]
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


@subroutine
def read_sensors(
    ids: IntArray, timing: SensorTiming, packed: PackedConditions, keys: StreamKeys,
    steps: IntArray, motors: MotorStates, coupling: ActuatorCoupling | None,
    feedback: JointFeedbackBuffers, frames: Frames, reading: Reading,
) -> None:  # fmt: skip
    """Read the newest frames that have arrived, if any, and the joint feedback."""
    period_s, loop_states = timing.control_period_s, feedback.control_loop_states
    for env in ids:
        n = np.uintp(env)
        conditions, step = unpack_conditions(packed, n), steps[n]
        key = StreamKey(keys.seeds[n], keys.trials[n])
        resumes = loop_resumes_at(conditions, key, step, period_s, loop_states[n, RESUME_PERIOD])
        loop_states[n, RESUME_PERIOD] = resumes
        loop_states[n, COMMAND_LOST] = is_command_lost(conditions, key, step)
    sense_joints(ids, period_s, packed, keys, steps, motors, coupling, feedback, reading)
    reported = feedback.reported_angles
    # unpacked once, as numba would count references at each access in the loop
    pixels, visible, dropped, exposed_s, comes_s, following, pending, _latest_s = frames
    time_s, frame, read_pixels = reading.time_s, reading.frame, reading.pixels
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
        date_s = comes_s[n, slot] - timing.nominal_latency_s
        if timing.exposure_stamped:
            date_s = exposed_s[n, slot]
        read_exposure_s[n] = date_s
        first, second, share = ring_interval_by_time(
            (date_s + timing.nominal_feedback_latency_s) * rate, k, kept
        )
        for j in range(7):
            old = reported[n, first, j]
            at_exposure[n, j] = old
            if share > 0.0:
                at_exposure[n, j] = old + share * (reported[n, second, j] - old)
        for eye in range(2):
            seen = visible[n, slot, eye]
            reading.visible[n, eye] = seen
            read_pixels[n, eye, 0] = pixels[n, slot, eye, 0] if seen else nan
            read_pixels[n, eye, 1] = pixels[n, slot, eye, 1] if seen else nan


_VARIATION: Final = int(StreamPurpose.VARIATION)
_MAX_SEARCH_S: Final = 10.0
"""Time without a sight after which a target counts as never seen, s (chosen: length of the search
against late sights)."""


@inlined
def first_frame_of_trial(conditions: TrialConditions) -> int:
    """First frame to be exposed in a trial, early enough to have arrived by time zero."""
    max_age_s = conditions.latency_s + conditions.jitter_s + eye_skew_s(conditions)
    return floor(-max_age_s / conditions.frame_s - conditions.frame_phase - TIME_TOLERANCE_S)


@subroutine
def begin_trials(
    ids: IntArray, packed: PackedConditions, keys: StreamKeys, scene: TrueHeadsAndTargets,
    motors: MotorStates, coupling: ActuatorCoupling | None, commands: CommandBuffers,
    feedback: JointFeedbackBuffers, frames: Frames, reading: Reading,
) -> None:  # fmt: skip
    """Set trials to time zero: joints at rest at the scene's angles, and empty ring buffers."""
    share = np.full(8, 0.5)
    for n in ids:
        conditions = unpack_conditions(packed, n)
        scene.step[n] = 0
        for i in range(LOOP_STATE):
            feedback.control_loop_states[n, i] = 0
        for lane in range(2):
            words = random_words(keys.seeds[n], keys.trials[n], _VARIATION, 3, lane + 1)
            for i in range(4):
                share[4 * lane + i] = to_uniform(words[i])
        for k in range(7):
            motors.angles[n, k] = scene.positions[n, k]
            motors.speeds[n, k] = motors.accelerations[n, k] = 0.0
        if coupling is not None:
            for k in range(SLOTS):
                motors.angles[n, 3 + k] = eye_actuator_angle(
                    coupling.nominal_head, k, scene.positions[n, 3:]
                )
        for k in range(7):
            # the output is anywhere within the backlash
            offset = packed.own[n, BACKLASH, k] * (share[k] - 0.5)
            motors.output_angles[n, k] = scene.positions[n, k] = motors.angles[n, k] + offset
            scene.velocities[n, k] = reading.command[n, k] = 0.0
            for slot in range(commands.velocities.shape[1]):
                commands.velocities[n, slot, k] = 0.0
            feedback.speed_filter_states[n, 0, k] = feedback.speed_filter_states[n, 1, k] = 0.0
            angle = (
                motors.output_angles[n, k] if feedback.encoders_on_output else motors.angles[n, k]
            )
            for slot in range(feedback.measured.shape[1]):
                feedback.measured[n, slot, 0, k] = angle
                feedback.measured[n, slot, 1, k] = 0.0
            reading.positions[n, k] = quantise(angle, feedback.angle_step[k])
            reading.velocities[n, k] = 0.0
        if coupling is not None:
            scratch, true, own = coupling.scratch[n], true_head_row(scene, n), coupling.nominal_head
            joints_from_actuators(scratch, true, scene.positions[n], scene.velocities[n])
            joints_from_actuators(scratch, own, reading.positions[n], reading.velocities[n])
        for k in range(7):
            reading.positions_at_exposure[n, k] = reading.positions[n, k]
            for slot in range(feedback.reported_angles.shape[1]):
                feedback.reported_angles[n, slot, k] = reading.positions[n, k]
        for j in range(3):
            scene.necks[n, j] = scene.positions[n, j]
        frames.pending[n] = first_frame_of_trial(conditions)
        frames.next[n] = first_exposure_of_frame(conditions, frames.pending[n])
        frames.latest_s[n] = -np.inf
        reading.frame[n] = 0
        for eye in range(2):
            reading.visible[n, eye] = False
            reading.pixels[n, eye, 0] = reading.pixels[n, eye, 1] = nan
        reading.exposure_s[n] = reading.received_s[n] = nan


@compiled
def expose_frames_before_start(
    ids: IntArray, packed: PackedConditions, scene: TrueHeadsAndTargets, frames: Frames,
    exposures: Exposures,
) -> bool:  # fmt: skip
    """Record as many exposures of resting heads before time zero as fit; False if none is left."""
    some = False
    for n in ids:
        count, most, conditions = 0, exposures.time_s.shape[1], unpack_conditions(packed, n)
        while count < most:
            time_s = exposure_time(conditions, frames.next[n] + count)
            if time_s > TIME_TOLERANCE_S:
                break
            exposures.time_s[n, count] = time_s
            for j in range(7):
                exposures.positions[n, count, j] = scene.positions[n, j]
                exposures.velocities[n, count, j] = 0.0
            count += 1
        exposures.counts[n] = count
        some = some or count > 0
    return some


@compiled
def first_detection_times(
    packed: PackedConditions, keys: StreamKeys, scene: TrueHeadsAndTargets,
    since_target_time_s: FloatArray, read_times_s: FloatArray,
) -> None:  # fmt: skip
    """Find when the first image in which an eye, at rest, finds the target is read, s.

    Images count from a moment (n,) in the target's own time on. Never is inf, s since the start.
    """
    for n in range(len(read_times_s)):
        conditions, key = unpack_conditions(packed, n), StreamKey(keys.seeds[n], keys.trials[n])
        p, motion = true_head_row(scene, n), scene.motions[n]
        q, neck = scene.positions[n], scene.necks[n]
        frame, latest_s = first_frame_of_trial(conditions), -np.inf
        read_times_s[n] = np.inf
        target_time_s = -np.inf
        while target_time_s < since_target_time_s[n] + _MAX_SEARCH_S:
            time_s = frame_exposure_time(conditions, frame)
            faults = draw_frame_faults(conditions, key, frame)
            target_time_s = time_s - conditions.onset_s
            frame += 1
            if faults.dropped:
                continue
            latest_s = frame_arrival_time(conditions, time_s, faults.extra_latency_s, latest_s)
            found = False
            for eye in range(2):
                then_s = target_time_s + eye * eye_skew_s(conditions)
                if then_s < since_target_time_s[n] - TIME_TOLERANCE_S or not is_shown(
                    motion, then_s + TIME_TOLERANCE_S
                ):
                    continue
                point = target_position_in_n(p, motion, neck, q, then_s + TIME_TOLERANCE_S)
                u, v = distorted_eye_pixel(p, eye, q, point)
                missed = faults.missed_right if eye else faults.missed_left
                found = found or (inside_image(p, eye, u, v) and not missed)
            if found:
                read_times_s[n] = latest_s
                break


# further phases, one bit each, in their order between LIMIT and JUDGE (numerical)
STORE: Final = 4
"""Write the commands to the ring buffers (numerical)."""
MOVE: Final = 8
"""Move the joints through the period, and record them at its exposures (numerical)."""
EXPOSE: Final = 16
"""Take the period's frames (numerical)."""
REPORT: Final = 32
"""Read the sensors (numerical)."""
WARM_UP: Final = 64
"""Take the frames of starting trials from before time zero, in place of a period (numerical)."""
BEGIN: Final = 128
"""Set trials to their start (numerical)."""
ALL_PHASES: Final = LIMIT | STORE | MOVE | EXPOSE | REPORT | JUDGE


class StepArrays(NamedTuple):
    """All arrays of a step of simulated heads, of which tables are made."""

    timing: SensorTiming
    packed: PackedConditions
    keys: StreamKeys
    scene: TrueHeadsAndTargets
    motors: MotorStates
    coupling: ActuatorCoupling | None
    commands: CommandBuffers
    feedback: JointFeedbackBuffers
    frames: Frames
    exposures: Exposures
    reading: Reading
    task: TaskArrays
    motion: Any  # the plant's own arrays, for the phase in which it moves the joints


@subroutine
def begin_period(table: NDArray[np.void], ids: IntArray, phases: int) -> bool:
    """Run the phases before the joints move; False if an action or a command is nan."""
    own: StepArrays = unpack_table(table)
    if phases & BEGIN:
        begin_trials(
            ids, own.packed, own.keys, own.scene, own.motors, own.coupling, own.commands,
            own.feedback, own.frames, own.reading,
        )  # fmt: skip
    if phases & LIMIT and not limit_actions(ids, own.task):
        return False
    if phases & STORE:
        return store_commands(
            ids, own.task.command, own.commands, own.feedback.control_loop_states, own.scene.step,
            own.reading.command,
        )  # fmt: skip
    return True


@subroutine
def end_period(table: NDArray[np.void], ids: IntArray, phases: int) -> None:
    """Run the phases after the joints have moved; see `begin_period`."""
    own: StepArrays = unpack_table(table)
    if phases & MOVE:
        for n in ids:
            own.scene.step[n] += 1
    if phases & EXPOSE:
        simulate_detections(
            ids, own.timing, own.packed, own.keys, own.scene, own.exposures, own.frames
        )
    if phases & WARM_UP:
        while expose_frames_before_start(ids, own.packed, own.scene, own.frames, own.exposures):
            simulate_detections(
                ids, own.timing, own.packed, own.keys, own.scene, own.exposures, own.frames
            )
    if phases & REPORT:
        read_sensors(
            ids, own.timing, own.packed, own.keys, own.scene.step, own.motors, own.coupling,
            own.feedback, own.frames, own.reading,
        )  # fmt: skip
    if phases & JUDGE:
        judge_steps(ids, own.task, own.task.coupled_head, own.reading)
