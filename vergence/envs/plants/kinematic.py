"""The kinematic plant: motors follow their commands with an exactly solved lag, without masses."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.envs.plants import advance_in_threads, bounds
from vergence.envs.plants.cameras import (
    TIME_TOLERANCE_S,
    Exposures,
    Frames,
    TrueHeadsAndTargets,
    exposure_time,
)
from vergence.envs.plants.conditions import BACKLASH, GAIN, PackedConditions, unpack_conditions
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    CommandBuffers,
    MotorParams,
    MotorStates,
    advance_first_order,
    advance_second_order,
    held_commands,
    joints_from_actuators,
    output_angle,
    output_speed,
    stop_motors_at_joint_stops,
)
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.plants.step import MOVE, StepArrays, begin_period, end_period
from vergence.envs.streams import IntArray
from vergence.kernels import compiled_for_threads, subroutine, unpack_table
from vergence.models.motion import lag_decay

_HEADS_PER_THREAD: Final = 192
"""Number of heads from which a thread is worth its start (measured: two threads against one)."""


class KinematicPlant(SimulatedPlant):
    """Heads without masses: each motor has the preset's lag and acceleration limit.

    The options are those of `SimulatedPlant`.
    """

    def _put_at_rest(self, ids: IntArray) -> None:
        """Nothing to do: the motors' angles are the state."""

    def _advance(self, ids: IntArray, phases: int) -> bool:
        at = bounds(len(ids), _HEADS_PER_THREAD)
        return advance_in_threads(advance_kinematic, self._table, ids, phases, at=at)


@subroutine
def move_motors(
    ids: IntArray, period_s: float, packed: PackedConditions, scene: TrueHeadsAndTargets,
    motors: MotorStates, coupling: ActuatorCoupling | None, commands: CommandBuffers,
    frames: Frames, exposures: Exposures,
) -> None:  # fmt: skip
    """Move all motors through a period, and record the joints at each exposure on the way."""
    # unpacked once, as numba would count references at each access in the loop
    heads, _motions, _necks, steps, positions, velocities = scene
    angles, speeds, rates, output, lower, upper, top, acceleration, lag_ratio = motors
    given, own, many = commands.velocities, packed.own, np.uintp(heads.shape[0] > 1)
    following, (counts, times, then_q, then_v) = frames.next, exposures
    ring = given.shape[1]
    for env in ids:
        n = np.uintp(env)  # unsigned, so that no index is counted from the end
        step, frame, conditions = steps[n], following[n], unpack_conditions(packed, n)
        begin_s = step * period_s
        before, after, change_s = held_commands(conditions.command_latency_s, step, ring, period_s)
        slot, done, count = before, 0.0, np.uintp(0)
        due = exposure_time(conditions, frame) - begin_s
        neck = 0.0  # motion of the neck; at rest it is skipped
        for k in range(3):
            neck += abs(speeds[n, k]) + abs(rates[n, k])
            neck += abs(given[n, before, k]) + abs(given[n, after, k])
        first = 3 if neck == 0.0 else 0
        while True:
            until = change_s if done < change_s else period_s
            exposed = due <= until + TIME_TOLERANCE_S
            until = min(due, until) if exposed else until
            time_s = until - done
            if time_s > 0.0:
                done, decay = until, lag_decay(time_s, conditions.lag_s)
                for k in range(first, 7):
                    v, u = speeds[n, k], own[n, GAIN, k] * given[n, slot, k]
                    if v == 0.0 and u == 0.0 and rates[n, k] == 0.0:
                        continue
                    lag_s, left = conditions.lag_s * lag_ratio[k], decay
                    if lag_ratio[k] != 1.0:
                        left = lag_decay(time_s, lag_s)
                    a = conditions.acceleration_ratio * acceleration[k]
                    backlash = own[n, BACKLASH, k]
                    falloff = 0.0
                    if conditions.torque_falloff > 0.0 and a < np.inf:
                        falloff = conditions.torque_falloff / (own[n, GAIN, k] * top[k])
                    q, out = angles[n, k], output[n, k]
                    params = MotorParams(lag_s, a, falloff, lower[k], upper[k], backlash)
                    if conditions.overshoot > 0.0 and lag_s > 0.0:
                        q, v, out, rates[n, k] = advance_second_order(
                            q, v, out, rates[n, k], params, u, time_s, conditions.overshoot
                        )
                    else:
                        q, v, out = advance_first_order(q, v, out, params, u, time_s, left)
                    angles[n, k], speeds[n, k] = q, v
                    output[n, k] = output_angle(out, q, backlash) if coupling is None else out
                if coupling is not None:
                    stop_motors_at_joint_stops(motors, coupling, heads[n * many], n)
                    for k in range(7):
                        output[n, k] = output_angle(output[n, k], angles[n, k], own[n, BACKLASH, k])
            if exposed:
                times[n, count] = begin_s + due
                for k in range(7):
                    then_q[n, count, k] = output[n, k]
                    then_v[n, count, k] = output_speed(
                        angles[n, k], speeds[n, k], output[n, k], own[n, BACKLASH, k]
                    )
                if coupling is not None:
                    joints_from_actuators(
                        coupling.scratch[n], heads[n * many], then_q[n, count], then_v[n, count]
                    )
                count += np.uintp(1)
                due = exposure_time(conditions, frame + np.int64(count)) - begin_s
            elif done >= period_s:
                break
            if done >= change_s:
                slot = after
        counts[n] = count
        for k in range(7):
            positions[n, k] = output[n, k]
            velocities[n, k] = output_speed(
                angles[n, k], speeds[n, k], output[n, k], own[n, BACKLASH, k]
            )
        if coupling is not None:
            joints_from_actuators(coupling.scratch[n], heads[n * many], positions[n], velocities[n])


@compiled_for_threads
def advance_kinematic(table: NDArray[np.void], ids: IntArray, phases: int) -> bool:
    """Run phases of a control period, see `vergence.envs.plants.step`; False for a nan."""
    if not begin_period(table, ids, phases):
        return False
    if phases & MOVE:
        own: StepArrays = unpack_table(table)
        move_motors(
            ids, own.timing.control_period_s, own.packed, own.scene, own.motors, own.coupling,
            own.commands, own.frames, own.exposures,
        )  # fmt: skip
    end_period(table, ids, phases)
    return True
