r"""The motors of a batch of heads: their response to commands, and the joints that they drive.

A motor follows its command with its own lag and acceleration limit and stops at its own limits. It
drives the joints through backlash (play) of width b, with friction: its output stays in place while
the motor crosses the backlash, and is then pushed along,

    output = clip(output, motor - b / 2, motor + b / 2),   joints = A output + offset

so a joint stands still for a moment whenever its motor reverses. The encoder sits on the motor's
side of the backlash, or on the output's. If a joint reaches its own stop before its motors reach
theirs, all motors that push it stop, each giving way by its share of the push.

If each eye joint has its own motor, A is the unit matrix, and a motor's output is its joint.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.conditions import EnvIndex
from vergence.kernels import inlined, subroutine
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PackedHead,
    eye_joint_angle,
    eye_joint_velocity,
    joint_per_actuator,
)
from vergence.models.motion import (
    damping_ratio,
    follow_joint,
    follow_second_order_joint,
    follow_torque_limited_joint,
    lag_decay,
    time_to_reversal,
)
from vergence.models.parts import EYES, SLOTS, FloatArray

_CONTACT_RAD: Final = 1e-12
"""Rounding tolerance of contact between a motor and its output, rad (numerical)."""
_JOINT_STOP_PASSES: Final = 4
"""Passes over the joints that move motors back from the joints' stops (numerical)."""
_MAX_STEP_RATIO: Final = 0.125
"""Largest step of a second-order servo as a fraction of its time constant; backlash and stops are
applied only between steps (numerical)."""


class MotorStates(NamedTuple):
    """The motors of a batch of heads; arrays of 7 hold the neck's joints and four eye actuators."""

    angles: FloatArray
    """(n, 7) motor angles, rad."""
    speeds: FloatArray
    """(n, 7) motor speeds, rad/s."""
    accelerations: FloatArray
    """(n, 7) accelerations of second-order servos, rad/s^2; 0 for others."""
    output_angles: FloatArray
    """(n, 7) angles of the motors' outputs, within half the backlash of the motors, rad; if each
    eye joint has its own motor, these are the joint angles."""
    lower: FloatArray
    """(7,) lower angle limits, rad."""
    upper: FloatArray
    """(7,) upper angle limits, rad."""
    speed_limits: FloatArray
    """(7,) speed limits, rad/s."""
    acceleration_limits: FloatArray
    """(7,) acceleration limits, rad/s^2."""
    lag_ratios: FloatArray
    """(7,) ratios of the motors' lags to the conditions' `lag_s`."""

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel, num: int) -> "MotorStates":
        """Motors of a batch of heads, at rest.

        Args:
            head: the model that a controller knows.
            true_head: the head that sets the motors' limits.
            num: number of heads.
        """
        own = true_head.actuation
        rest = np.tile(own.actuators_of(head.rest()), (num, 1))
        return cls(
            angles=rest,
            speeds=np.zeros((num, 7)),
            accelerations=np.zeros((num, 7)),
            output_angles=rest.copy(),
            lower=own.lower,
            upper=own.upper,
            speed_limits=own.velocity,
            acceleration_limits=own.acceleration,
            lag_ratios=own.lag_ratio,
        )


SAVED_MOTOR_FIELDS: Final = {
    "angles": "angles",
    "speeds": "speeds",
    "accelerations": "accelerations",
    "driven": "output_angles",
}
"""Fields of `MotorStates` that are part of a trial's state, by their names in a saved state."""


class ActuatorCoupling(NamedTuple):
    """Coupling of the eye joints, for heads whose motors move several joints."""

    joint_lower: FloatArray
    """(4,) lower angle limits of the eye joints, rad."""
    joint_upper: FloatArray
    """(4,) upper angle limits of the eye joints, rad."""
    nominal_head: PackedHead
    """(PACKED,) the head that the controller knows; it converts encoder angles to joint angles."""
    scratch: FloatArray
    """(n, 4) scratch arrays of kernels, one number per actuator."""

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel, num: int) -> "ActuatorCoupling | None":
        """Coupling of a batch of heads; None if each eye joint has its own motor."""
        if head.actuation.direct:
            return None
        limits = true_head.limits
        return cls(limits.lower[EYES], limits.upper[EYES], head.packed, np.empty((num, SLOTS)))


@inlined
def name_coupling(group: tuple[FloatArray, ...] | None) -> ActuatorCoupling | None:
    """Restore the names of a coupling from a table; None stays None."""
    return None if group is None else ActuatorCoupling(*group)


class MotorState(NamedTuple):
    """State of one motor."""

    angle: float
    speed: float
    output: float
    """Angle of its output, rad."""


class MotorParams(NamedTuple):
    """Parameters of one motor in a trial."""

    lag_s: float
    max_acceleration: float
    acceleration_falloff: float
    """Fraction of the acceleration that is lost per rad/s of speed."""
    lower: float
    upper: float
    backlash: float
    """Backlash, whole width, rad."""


@inlined
def output_angle(output: float, angle: float, backlash: float) -> float:
    """Angle of a motor's output once the motor has moved to `angle`."""
    return min(max(output, angle - 0.5 * backlash), angle + 0.5 * backlash)


@inlined
def output_speed(motor: MotorState, backlash: float) -> float:
    """Velocity of a motor's output: the motor's own while it pushes, else 0."""
    behind, half = motor.angle - motor.output, 0.5 * backlash - _CONTACT_RAD
    pushes = behind >= half if motor.speed > 0.0 else -behind >= half
    return motor.speed if pushes else 0.0


@inlined
def advance_first_order(
    motor: MotorState, params: MotorParams, command: float, time_s: float, decay: float
) -> MotorState:
    """Advance a motor with a first-order lag by a time.

    Its output moves only if the motor reverses within it.

    Callers push the output on with `output_angle`.

    Args:
        motor: its state.
        params: its parameters.
        command: velocity command, rad/s, with the speed gain applied.
        time_s: duration, s.
        decay: `lag_decay(time_s, params.lag_s)`.
    """
    q, v, output = motor.angle, motor.speed, motor.output
    tau, a = params.lag_s, params.max_acceleration
    if params.backlash > 0.0 and v * command < 0.0:
        turn = time_to_reversal(v, command, tau, a)
        if turn < time_s:  # the output stays at the turning point
            farthest, _rest = follow_joint(q, v, command, tau, a, turn, lag_decay(turn, tau))
            output = output_angle(
                output, min(max(farthest, params.lower), params.upper), params.backlash
            )
    if params.acceleration_falloff > 0.0:
        q, v = follow_torque_limited_joint(
            q, v, command, tau, a, params.acceleration_falloff, time_s
        )
    else:
        q, v = follow_joint(q, v, command, tau, a, time_s, decay)
    if q < params.lower:
        q, v = params.lower, max(v, 0.0)
    elif q > params.upper:
        q, v = params.upper, min(v, 0.0)
    return MotorState(q, v, output)


@subroutine
def advance_second_order(
    motor: MotorState,
    acceleration: float,
    params: MotorParams,
    command: float,
    time_s: float,
    overshoot: float,
) -> tuple[MotorState, float]:
    """Advance a second-order servo by a time, see `advance_first_order`.

    Args:
        motor: its state.
        acceleration: its acceleration, rad/s^2.
        params: its parameters; the lag is above 0.
        command: velocity command, rad/s, with the speed gain applied.
        time_s: duration, s.
        overshoot: fraction by which its speed overshoots a step of the command, above 0.

    Returns:
        Its state, and its acceleration, rad/s^2.
    """
    q, v, w, output = motor.angle, motor.speed, acceleration, motor.output
    zeta, steps = damping_ratio(overshoot), int(np.ceil(time_s / (_MAX_STEP_RATIO * params.lag_s)))
    for _ in range(steps):
        output = output_angle(output, q, params.backlash)
        q, v, w = follow_second_order_joint(
            q,
            v,
            w,
            command,
            params.lag_s,
            zeta,
            params.max_acceleration,
            params.acceleration_falloff,
            time_s / steps,
        )
        if q < params.lower:
            q, v, w = params.lower, max(v, 0.0), max(w, 0.0)
        elif q > params.upper:
            q, v, w = params.upper, min(v, 0.0), min(w, 0.0)
    return MotorState(q, v, output), w


@subroutine
def stop_motors_at_joint_stops(
    motors: MotorStates, coupling: ActuatorCoupling, p: PackedHead, n: EnvIndex
) -> None:
    """Move one head's motors back where they push a joint beyond its own stop.

    Args:
        motors: their angles and speeds are updated in place.
        coupling: coupling of the eye joints, with their limits.
        p: the true head.
        n: environment index.
    """
    own = coupling.scratch[n]
    for _ in range(_JOINT_STOP_PASSES):
        for j in range(SLOTS):
            square = rate = 0.0
            for k in range(SLOTS):
                own[k] = motors.angles[n, 3 + k]
                factor = joint_per_actuator(p, j, k)
                square += factor * factor
                rate += factor * motors.speeds[n, 3 + k]
            angle = eye_joint_angle(p, j, own)
            beyond = angle - min(max(angle, coupling.joint_lower[j]), coupling.joint_upper[j])
            if beyond == 0.0 or square == 0.0:
                continue
            rate = rate if rate * beyond > 0.0 else 0.0
            for k in range(SLOTS):
                share = joint_per_actuator(p, j, k) / square
                back = motors.angles[n, 3 + k] - share * beyond
                motors.angles[n, 3 + k] = min(max(back, motors.lower[3 + k]), motors.upper[3 + k])
                motors.speeds[n, 3 + k] -= share * rate


@subroutine
def joints_from_actuators(
    scratch: FloatArray, p: PackedHead, positions: FloatArray, velocities: FloatArray
) -> None:
    """Convert angles and velocities (7,) of actuators to those of joints, in place.

    Args:
        scratch: (4,) scratch array.
        p: a packed head.
        positions: (7,) angles, rad, changed in place.
        velocities: (7,) velocities, rad/s, changed in place.
    """
    for k in range(SLOTS):
        scratch[k] = positions[3 + k]
    for j in range(SLOTS):
        positions[3 + j] = eye_joint_angle(p, j, scratch)
    for k in range(SLOTS):
        scratch[k] = velocities[3 + k]
    for j in range(SLOTS):
        velocities[3 + j] = eye_joint_velocity(p, j, scratch)
