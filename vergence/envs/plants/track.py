"""Control periods in substeps, as commands change and frames are exposed within a period.

For each substep, a physics engine is given a mean command, and its state is read at the end. The
joint angles at the exposure of a frame are interpolated between both ends of its substep.
"""

from typing import NamedTuple

import numpy as np

from vergence.envs.plants.commands import CommandBuffers, held_commands
from vergence.envs.plants.conditions import BACKLASH, GAIN, PackedConditions, unpack_conditions
from vergence.envs.plants.feedback import interpolate_joint
from vergence.envs.plants.frames import TIME_TOLERANCE_S, Exposures, Frames, exposure_time
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    MotorState,
    MotorStates,
    joints_from_actuators,
    output_angle,
    output_speed,
)
from vergence.envs.plants.scene import TrueHeadsAndTargets, true_head_row
from vergence.envs.streams import IntArray
from vergence.kernels import compiled
from vergence.models.kinematics import PackedHead, eye_actuator_angle, eye_actuator_velocity
from vergence.models.motion import damping_ratio, follow_second_order_joint, lag_decay
from vergence.models.parts import FloatArray


class SubstepTrajectory(NamedTuple):
    """Joint states within a period: at its beginning and at the end of each substep."""

    positions: FloatArray
    """(n, substeps + 1, 7) rad."""
    velocities: FloatArray
    """(n, substeps + 1, 7) rad/s."""

    @classmethod
    def empty(cls, num: int, substeps: int) -> "SubstepTrajectory":
        """Arrays for `num` heads."""
        return cls(*np.zeros((2, num, substeps + 1, 7)))


@compiled
def start_trajectory(
    ids: IntArray, scene: TrueHeadsAndTargets, trajectory: SubstepTrajectory
) -> None:
    """Begin a period's track with the present joint states; both groups are `untyped_tuple`."""
    scene, trajectory = TrueHeadsAndTargets(*scene), SubstepTrajectory(*trajectory)
    for n in ids:
        for j in range(7):
            trajectory.positions[n, 0, j] = scene.positions[n, j]
            trajectory.velocities[n, 0, j] = scene.velocities[n, j]


@compiled
def mean_substep_controls(
    ids: IntArray,
    substep: int,
    substeps: int,
    period_s: float,
    packed: PackedConditions,
    steps: IntArray,
    commands: CommandBuffers,
    motors: MotorStates,
    servo_slots: IntArray,
    control: FloatArray,
) -> None:
    """Compute the servos' controls for a substep of a period: the mean of its commands.

    A second-order servo is simulated as a first-order one with another control: the control that
    leads to the speed of the second-order response at the substep's end.

    Args:
        ids: (m,) environment indices.
        substep: index of the substep.
        substeps: number of substeps per period.
        period_s: the control period, s.
        packed: `untyped_tuple`, conditions of the trials.
        steps: (n,) numbers of the periods.
        commands: `untyped_tuple`, ring buffers with the commands of the period.
        motors: `untyped_tuple`, their accelerations are updated in place.
        servo_slots: (nu,) indices of the servos in an array of the neck's joints and the actuators.
        control: (n, nu) result, rad/s.
    """
    packed, motors = PackedConditions(*packed), MotorStates(*motors)
    given, length = CommandBuffers(*commands).velocities, period_s / substeps
    for n in ids:
        conditions = unpack_conditions(packed, n)
        hold = held_commands(conditions.command_latency_s, steps[n], given.shape[1], period_s)
        before = min(max(hold.change_s - substep * length, 0.0), length) / length
        for i in range(servo_slots.shape[0]):
            k = servo_slots[i]
            u = (
                before * given[n, hold.position_before, k]
                + (1.0 - before) * given[n, hold.position_after, k]
            )
            control[n, i] = u = packed.own[n, GAIN, k] * u
            if conditions.overshoot == 0.0:
                continue
            v, lag_s = motors.speeds[n, k], conditions.lag_s * motors.lag_ratios[k]
            a = conditions.acceleration_ratio * motors.acceleration_limits[k]
            falloff = conditions.torque_falloff / (packed.own[n, GAIN, k] * motors.speed_limits[k])
            _way, then, w = follow_second_order_joint(
                0.0, v, motors.accelerations[n, k], u, lag_s, damping_ratio(conditions.overshoot),
                a, falloff, length,
            )  # fmt: skip
            motors.accelerations[n, k] = w
            control[n, i] = v + (then - v) / (1.0 - lag_decay(length, lag_s))


@compiled
def read_mujoco_joints(
    ids: IntArray,
    substep: int,
    qpos: FloatArray,
    qvel: FloatArray,
    half_step: float,
    addresses: IntArray,
    nominal_head: PackedHead,
    packed: PackedConditions,
    scene: TrueHeadsAndTargets,
    motors: MotorStates,
    coupling: ActuatorCoupling | None,
    trajectory: SubstepTrajectory,
) -> None:
    """Read angles and velocities of motors and joints at the end of a substep.

    Semi-implicit integration leaves the angle half a step ahead of the velocity; this is corrected.

    Args:
        ids: (m,) environment indices.
        substep: index of the substep that has ended.
        qpos: (n, nq) MuJoCo's angles.
        qvel: (n, nv) MuJoCo's velocities.
        half_step: half a time step of the simulation, s.
        addresses: (7,) indices of the joints in `qpos` and `qvel`; -1 for a joint that does not
            move.
        nominal_head: (PACKED,) the head that the controller knows.
        packed: `untyped_tuple`, as are the following; conditions of the trials.
        scene: its joints are updated in place.
        motors: updated in place, to the motor angles nearest to MuJoCo's joints.
        coupling: coupling of the eye joints; None if each has its own motor.
        trajectory: updated in place.
    """
    packed, scene = PackedConditions(*packed), TrueHeadsAndTargets(*scene)
    motors, trajectory = MotorStates(*motors), SubstepTrajectory(*trajectory)
    angles, rates = np.zeros(7), np.zeros(7)
    for n in ids:
        for j in range(7):
            i = addresses[j]
            # a joint that does not move keeps its angle
            rates[j] = qvel[n, i] if i >= 0 else 0.0
            angles[j] = qpos[n, i] - half_step * rates[j] if i >= 0 else motors.angles[n, j]
            if coupling is not None and i < 0:
                angles[j] = 0.0
        for k in range(7):
            q, v = angles[k], rates[k]
            if coupling is not None and k >= 3:
                q = eye_actuator_angle(nominal_head, k - 3, angles[3:])
                v = eye_actuator_velocity(nominal_head, k - 3, rates[3:])
            motors.angles[n, k], motors.speeds[n, k] = q, v
            backlash = packed.own[n, BACKLASH, k]
            output = output_angle(motors.output_angles[n, k], q, backlash)
            motors.output_angles[n, k] = scene.positions[n, k] = output
            scene.velocities[n, k] = output_speed(MotorState(q, v, output), backlash)
        if coupling is not None:
            joints_from_actuators(
                coupling.scratch[n],
                true_head_row(scene, n),
                scene.positions[n],
                scene.velocities[n],
            )
        for j in range(7):
            trajectory.positions[n, substep + 1, j] = scene.positions[n, j]
            trajectory.velocities[n, substep + 1, j] = scene.velocities[n, j]


@compiled
def expose_on_trajectory(
    ids: IntArray,
    period_s: float,
    packed: PackedConditions,
    steps: IntArray,
    frames: Frames,
    trajectory: SubstepTrajectory,
    exposures: Exposures,
) -> None:
    """Expose the frames of a period, with the joints interpolated within its substeps.

    Args:
        ids: (m,) environment indices.
        period_s: the control period, s.
        packed: `untyped_tuple`, conditions of the trials.
        steps: (n,) numbers of the periods.
        frames: `untyped_tuple`, with the numbers of the next exposures.
        trajectory: `untyped_tuple`, joint states within the period.
        exposures: `untyped_tuple`, the result.
    """
    packed, frames = PackedConditions(*packed), Frames(*frames)
    trajectory, exposures = SubstepTrajectory(*trajectory), Exposures(*exposures)
    substeps = trajectory.positions.shape[1] - 1
    length = period_s / substeps
    for n in ids:
        begin_s, count, conditions = steps[n] * period_s, 0, unpack_conditions(packed, n)
        while True:
            due = exposure_time(conditions, frames.next[n] + count) - begin_s
            if due > period_s + TIME_TOLERANCE_S:
                break
            substep = min(max(int(due / length), 0), substeps - 1)
            share = min(max(due / length - substep, 0.0), 1.0)
            last = share > 1.0 - TIME_TOLERANCE_S
            exposures.time_s[n, count] = begin_s + due
            for j in range(7):
                a, b = trajectory.positions[n, substep, j], trajectory.positions[n, substep + 1, j]
                va, vb = (
                    trajectory.velocities[n, substep, j],
                    trajectory.velocities[n, substep + 1, j],
                )
                q, v = interpolate_joint(a, va, b, vb, share, length)
                exposures.positions[n, count, j] = b if last else q
                exposures.velocities[n, count, j] = vb if last else v
            count += 1
        exposures.counts[n] = count
