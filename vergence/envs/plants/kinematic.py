"""The kinematic plant: motors follow their commands with an exactly solved lag, without masses."""

import numpy as np

from vergence._jit import compiled
from vergence.envs.plants.commands import Commands, hold_of
from vergence.envs.plants.conditions import BACKLASH, GAIN, PackedConditions, loop_of
from vergence.envs.plants.frames import SAME_S, Exposures, Frames, exposure_time
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    MotorParams,
    MotorState,
    MotorStates,
    driven_speed,
    moved,
    pushed,
    stop_at_joints,
    swung,
    tie,
)
from vergence.envs.plants.scene import Scene
from vergence.envs.plants.simulated import SimulatedPlant
from vergence.envs.streams import IntArray
from vergence.models.joint_response import lag_decay


class KinematicPlant(SimulatedPlant):
    """Heads without masses: each motor has the preset's lag and acceleration limit.

    The options are those of `SimulatedPlant`.
    """

    def _place(self, ids: IntArray) -> None:
        """Nothing to do: the motors' angles are the state."""

    def _move(self) -> None:
        own = self._bare
        drive(
            self.head.timing.period_s, own.drawn, own.scene, own.motors, self._tied, own.commands,
            own.frames, own.exposures,
        )  # fmt: skip


@compiled
def drive(
    period_s: float,
    drawn: PackedConditions,
    scene: Scene,
    motors: MotorStates,
    tied: ActuatorCoupling | None,
    commands: Commands,
    frames: Frames,
    exposures: Exposures,
) -> None:
    """Move all motors through a period, and record the joints at each exposure on the way.

    Args:
        period_s: the control period, s.
        drawn: `bare`, as are the following; conditions of the trials.
        scene: heads at the period's beginning; the joints are updated in place.
        motors: updated in place.
        tied: coupling of the eye joints; None if each has its own motor.
        commands: ring buffers with the commands of the period.
        frames: numbers of the next exposures.
        exposures: the result.
    """
    drawn, scene, motors = PackedConditions(*drawn), Scene(*scene), MotorStates(*motors)
    commands, frames, exposures = Commands(*commands), Frames(*frames), Exposures(*exposures)
    # unpacked once, as numba would count references at each access in the loop
    heads, _motions, _necks, steps, positions, velocities = scene
    angles, speeds, rates, driven, lower, upper, top, acceleration, lag_ratio = motors
    given, own, many = commands.given, drawn.own, np.uintp(heads.shape[0] > 1)
    following, (counts, times, then_q, then_v) = frames.next, exposures
    ring = given.shape[1]
    for place in range(steps.shape[0]):
        n = np.uintp(place)  # unsigned, so that no index is counted from the end
        step, frame, loop = steps[n], following[n], loop_of(drawn, n)
        begin_s = step * period_s
        hold = hold_of(loop.command_latency_s, step, ring, period_s)
        slot, done, count = hold.first, 0.0, np.uintp(0)
        due = exposure_time(loop, frame) - begin_s
        neck = 0.0  # motion of the neck; at rest it is skipped
        for k in range(3):
            neck += (
                abs(speeds[n, k])
                + abs(rates[n, k])
                + abs(given[n, hold.first, k])
                + abs(given[n, hold.then, k])
            )
        first = 3 if neck == 0.0 else 0
        while True:
            until = hold.change_s if done < hold.change_s else period_s
            exposed = due <= until + SAME_S
            until = min(due, until) if exposed else until
            time_s = until - done
            if time_s > 0.0:
                done, decay = until, lag_decay(time_s, loop.lag_s)
                for k in range(first, 7):
                    v, u = speeds[n, k], own[n, GAIN, k] * given[n, slot, k]
                    if v == 0.0 and u == 0.0 and rates[n, k] == 0.0:
                        continue
                    lag_s, left = loop.lag_s * lag_ratio[k], decay
                    if lag_ratio[k] != 1.0:
                        left = lag_decay(time_s, lag_s)
                    a, play = loop.acceleration_ratio * acceleration[k], own[n, BACKLASH, k]
                    fade = 0.0
                    if loop.torque_falloff > 0.0 and a < np.inf:
                        fade = loop.torque_falloff / (own[n, GAIN, k] * top[k])
                    motor = MotorState(angles[n, k], v, driven[n, k])
                    able = MotorParams(lag_s, a, fade, lower[k], upper[k], play)
                    if loop.overshoot > 0.0 and lag_s > 0.0:
                        motor, rates[n, k] = swung(
                            motor, rates[n, k], able, u, time_s, loop.overshoot
                        )
                    else:
                        motor = moved(motor, able, u, time_s, left)
                    angles[n, k], speeds[n, k] = motor.angle, motor.speed
                    driven[n, k] = motor.driven
                    if tied is None:
                        driven[n, k] = pushed(motor.driven, motor.angle, play)
                if tied is not None:
                    stop_at_joints(motors, tied, heads[n * many], n)
                    for k in range(7):
                        driven[n, k] = pushed(driven[n, k], angles[n, k], own[n, BACKLASH, k])
            if exposed:
                times[n, count] = begin_s + due
                for k in range(7):
                    motor = MotorState(angles[n, k], speeds[n, k], driven[n, k])
                    then_q[n, count, k] = motor.driven
                    then_v[n, count, k] = driven_speed(motor, own[n, BACKLASH, k])
                if tied is not None:
                    tie(tied.room, heads[n * many], then_q[n, count], then_v[n, count])
                count += np.uintp(1)
                due = exposure_time(loop, frame + np.int64(count)) - begin_s
            elif done >= period_s:
                break
            if done >= hold.change_s:
                slot = hold.then
        counts[n] = count
        for k in range(7):
            motor = MotorState(angles[n, k], speeds[n, k], driven[n, k])
            positions[n, k] = motor.driven
            velocities[n, k] = driven_speed(motor, own[n, BACKLASH, k])
        if tied is not None:
            tie(tied.room, heads[n * many], positions[n], velocities[n])
