"""Start of trials in simulated plants: joints at rest, cameras that are already running."""

from math import floor, nan
from typing import Final

import numpy as np

from vergence.envs.plants.commands import LOOP_STATE, CommandBuffers
from vergence.envs.plants.conditions import (
    BACKLASH,
    PackedConditions,
    TrialConditions,
    unpack_conditions,
)
from vergence.envs.plants.feedback import JointFeedbackBuffers, quantise
from vergence.envs.plants.frames import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    draw_frame_faults,
    exposure_time,
    eye_skew_s,
    first_exposure_of_frame,
    frame_arrival_time,
    frame_exposure_time,
)
from vergence.envs.plants.motors import ActuatorCoupling, MotorStates, joints_from_actuators
from vergence.envs.plants.scene import (
    TrueHeadsAndTargets,
    distorted_eye_pixel,
    target_position_in_n,
    true_head_row,
)
from vergence.envs.reading import Reading
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamKeys,
    StreamPurpose,
    random_words,
    to_uniform,
)
from vergence.envs.targets.motion import is_shown, unpack_motion
from vergence.kernels import compiled, inlined
from vergence.models.kinematics import eye_actuator_angle, inside_image
from vergence.models.parts import SLOTS, FloatArray

_VARIATION: Final = int(StreamPurpose.VARIATION)
_MAX_SEARCH_S: Final = 10.0
"""Time without a sight after which a target counts as never seen, s (chosen: length of the search
against late sights)."""


@inlined
def first_frame_of_trial(conditions: TrialConditions) -> int:
    """First frame to be exposed in a trial, early enough to have arrived by time zero."""
    max_age_s = conditions.latency_s + conditions.jitter_s + eye_skew_s(conditions)
    return floor(-max_age_s / conditions.frame_s - conditions.frame_phase - TIME_TOLERANCE_S)


@compiled
def begin_trials(
    ids: IntArray,
    positions: FloatArray,
    motions: FloatArray,
    packed: PackedConditions,
    keys: StreamKeys,
    scene: TrueHeadsAndTargets,
    motors: MotorStates,
    coupling: ActuatorCoupling | None,
    commands: CommandBuffers,
    feedback: JointFeedbackBuffers,
    frames: Frames,
    reading: Reading,
) -> None:
    """Set starting trials to time zero, with joints at rest and empty ring buffers.

    The first frame to be exposed is early enough to have arrived by time zero.

    Args:
        ids: (m,) environment indices of the starting trials.
        positions: (m, 7) initial joint angles, rad.
        motions: (m, MOTION) motions of their targets.
        packed: `untyped_tuple`, as are the following; conditions of the trials.
        keys: keys of the trials' random streams.
        scene: result, as are the following.
        motors: the motors.
        coupling: coupling of the eye joints; None if each has its own motor.
        commands: set to none under way.
        feedback: the encoders.
        frames: ring buffers.
        reading: set to the reading of heads that have seen nothing yet.
    """
    packed, keys, scene = PackedConditions(*packed), StreamKeys(*keys), TrueHeadsAndTargets(*scene)
    motors, commands, feedback = (
        MotorStates(*motors),
        CommandBuffers(*commands),
        JointFeedbackBuffers(*feedback),
    )
    frames, reading = Frames(*frames), Reading(*reading)
    share = np.full(8, 0.5)
    for m in range(ids.shape[0]):
        n = ids[m]
        conditions = unpack_conditions(packed, n)
        for i in range(motions.shape[1]):
            scene.motions[n, i] = motions[m, i]
        scene.step[n] = 0
        for i in range(LOOP_STATE):
            feedback.control_loop_states[n, i] = 0
        for lane in range(2):
            words = random_words(keys.seeds[n], keys.trials[n], _VARIATION, 3, lane + 1)
            for i in range(4):
                share[4 * lane + i] = to_uniform(words[i])
        for k in range(7):
            motors.angles[n, k] = positions[m, k]
            motors.speeds[n, k] = motors.accelerations[n, k] = 0.0
        if coupling is not None:
            for k in range(SLOTS):
                motors.angles[n, 3 + k] = eye_actuator_angle(
                    coupling.nominal_head, k, positions[m, 3:]
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
            joints_from_actuators(
                coupling.scratch[n],
                true_head_row(scene, n),
                scene.positions[n],
                scene.velocities[n],
            )
            joints_from_actuators(
                coupling.scratch[n],
                coupling.nominal_head,
                reading.positions[n],
                reading.velocities[n],
            )
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
    ids: IntArray,
    packed: PackedConditions,
    scene: TrueHeadsAndTargets,
    frames: Frames,
    exposures: Exposures,
) -> bool:
    """Record exposures of resting heads before time zero, as many as the arrays hold.

    Call it until it returns False.

    Args:
        ids: (m,) environment indices of the starting trials.
        packed: `untyped_tuple`, as are the following.
        scene: their heads at rest.
        frames: ring buffers.
        exposures: the result.

    Returns:
        True if there are any.
    """
    packed, scene = PackedConditions(*packed), TrueHeadsAndTargets(*scene)
    frames, exposures = Frames(*frames), Exposures(*exposures)
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
    packed: PackedConditions,
    keys: StreamKeys,
    scene: TrueHeadsAndTargets,
    since_target_time_s: FloatArray,
    read_times_s: FloatArray,
) -> None:
    """Find the time at which the first image of the target exposed from some moment on is read.

    It is the first image in which either eye's detector finds the target, with the random faults of
    the frames; the eyes are assumed to rest until then.

    Args:
        packed: `untyped_tuple`, as are the following two; conditions of the trials.
        keys: keys of the trials' random streams.
        scene: trials at time zero.
        since_target_time_s: (n,) the moments, in the targets' own time, s.
        read_times_s: (n,) result, s since the trial's start; inf for never.
    """
    packed, keys, scene = PackedConditions(*packed), StreamKeys(*keys), TrueHeadsAndTargets(*scene)
    for n in range(len(read_times_s)):
        conditions, key = unpack_conditions(packed, n), StreamKey(keys.seeds[n], keys.trials[n])
        p, motion = true_head_row(scene, n), unpack_motion(scene.motions[n])
        q, neck = scene.positions[n], scene.necks[n]
        frame, latest_s = first_frame_of_trial(conditions), -np.inf
        read_times_s[n] = np.inf
        target_time_s = -np.inf
        while target_time_s < since_target_time_s[n] + _MAX_SEARCH_S:
            time_s, faults = (
                frame_exposure_time(conditions, frame),
                draw_frame_faults(conditions, key, frame),
            )
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
