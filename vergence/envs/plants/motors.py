r"""The motors of a batch of heads: how they follow commands, and the joints that they turn.

A motor follows its command by its own lag and acceleration limit and stops at its own limits. It
moves the joints through a play of width b, with friction: what it drives stays where it is while
the motor crosses the play, and is then pushed along,

    driven = clip(driven, motor - b / 2, motor + b / 2),   joints = A driven + offset

so a joint stands still for a moment whenever its motor turns round. The encoder sits on the
motor's side of the play, or on the output's. Where a joint's stop is nearer than its motors' are,
all motors that push against it stop, each giving way by its share of the push.

Where each eye joint has its own motor, A is the unit matrix: what a motor drives is its joint.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence._jit import device, subroutine
from vergence.envs.plants.conditions import Place
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.joint_response import (
    damping_ratio,
    follow_fading_joint,
    follow_joint,
    follow_swinging_joint,
    share_left,
    time_to_turn,
)
from vergence.models.joints import EYES
from vergence.models.packed import PackedHead, joint_at, joint_per_actuator, joint_rate
from vergence.models.parts import FloatArray

_CONTACT_RAD = 1e-12
"""What rounding may leave between a motor's flank and what it pushes."""
_PASSES = 4
_SHORT = 0.125
"""A step of a servo of second order by its time constant; within one, play and stops are not seen.
Numerical."""


class Motors(NamedTuple):
    """The motors of a batch of heads; (7,) are the neck's joints and four actuators of the eyes."""

    angles: FloatArray
    """(n, 7) rad."""
    speeds: FloatArray
    """(n, 7) rad/s."""
    accelerations: FloatArray
    """(n, 7) rad/s^2, of servos of second order; 0 for others."""
    driven: FloatArray
    """(n, 7) where what they move is, within half their play of them, rad; where each eye joint
    has its own motor, these are the joints."""
    lower: FloatArray
    """(7,) least angles, rad."""
    upper: FloatArray
    """(7,) greatest angles, rad."""
    velocity: FloatArray
    """(7,) greatest speeds, rad/s."""
    acceleration: FloatArray
    """(7,) greatest accelerations, rad/s^2."""
    lag_ratio: FloatArray
    """(7,) lags by those of the conditions."""

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel, num: int) -> "Motors":
        """Those of heads.

        Args:
            head: the model that a controller knows.
            true_head: whose limits the motors have.
            num: how many heads.
        """
        own = true_head.actuation
        rest = np.tile(own.actuators_of(head.rest()), (num, 1))
        return cls(
            angles=rest,
            speeds=np.zeros((num, 7)),
            accelerations=np.zeros((num, 7)),
            driven=rest.copy(),
            lower=own.lower,
            upper=own.upper,
            velocity=own.velocity,
            acceleration=own.acceleration,
            lag_ratio=own.lag_ratio,
        )


MOVING: Final = ("angles", "speeds", "accelerations", "driven")
"""The fields of `Motors` that a trial changes."""


class Tied(NamedTuple):
    """What else there is where motors move several joints."""

    joint_lower: FloatArray
    """(4,) least angles of the eyes' joints, rad."""
    joint_upper: FloatArray
    """(4,) greatest angles of the eyes' joints, rad."""
    head: PackedHead
    """(PACKED,) the head that the controller knows: by it, encoders' angles become joints'."""
    room: FloatArray
    """(4,) for numbers by actuator that kernels need for a moment."""

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel) -> "Tied | None":
        """That of a head; None where each eye joint has its own motor."""
        if head.actuation.direct:
            return None
        limits = true_head.limits
        return cls(limits.lower[EYES], limits.upper[EYES], head.packed, np.empty(SLOTS))


class Motor(NamedTuple):
    """How one motor stands."""

    angle: float
    speed: float
    driven: float
    """Where what it moves is."""


class Drive(NamedTuple):
    """What one motor can do in a trial."""

    lag_s: float
    acceleration: float
    fade: float
    """What its speed takes of the acceleration, per rad/s."""
    lower: float
    upper: float
    play: float
    """Whole width, rad."""


@device
def pushed(driven: float, angle: float, play: float) -> float:
    """Where what a motor moves is once the motor is at an angle."""
    return min(max(driven, angle - 0.5 * play), angle + 0.5 * play)


@device
def driven_speed(motor: Motor, play: float) -> float:
    """The velocity of what a motor moves: the motor's while it pushes, else none."""
    behind, half = motor.angle - motor.driven, 0.5 * play - _CONTACT_RAD
    pushes = behind >= half if motor.speed > 0.0 else -behind >= half
    return motor.speed if pushes else 0.0


@device
def moved(motor: Motor, drive: Drive, command: float, time_s: float, decay: float) -> Motor:
    """A motor a time later; what it moves has been brought to where the motor turned round.

    Args:
        motor: how it stands.
        drive: what it can do.
        command: what holds, rad/s, its speed gain included.
        time_s: how long, s.
        decay: `share_left(time_s, drive.lag_s)`.
    """
    q, v, driven = motor.angle, motor.speed, motor.driven
    tau, a = drive.lag_s, drive.acceleration
    if drive.play > 0.0 and v * command < 0.0:
        turn = time_to_turn(v, command, tau, a)
        if turn < time_s:  # what is pushed stays at the turning point
            farthest, _rest = follow_joint(q, v, command, tau, a, turn, share_left(turn, tau))
            driven = pushed(driven, min(max(farthest, drive.lower), drive.upper), drive.play)
    if drive.fade > 0.0:
        q, v = follow_fading_joint(q, v, command, tau, a, drive.fade, time_s)
    else:
        q, v = follow_joint(q, v, command, tau, a, time_s, decay)
    if q < drive.lower:
        q, v = drive.lower, max(v, 0.0)
    elif q > drive.upper:
        q, v = drive.upper, min(v, 0.0)
    return Motor(q, v, driven)


@subroutine
def swung(
    motor: Motor, acceleration: float, drive: Drive, command: float, time_s: float, overshoot: float
) -> tuple[Motor, float]:
    """A motor of second order a time later, and its acceleration; otherwise as `moved`.

    Args:
        motor: how it stands.
        acceleration: and what it accelerates by, rad/s^2.
        drive: what it can do; its lag is above 0.
        command: what holds, rad/s, its speed gain included.
        time_s: how long, s.
        overshoot: share by which its speed overshoots a step, above 0.
    """
    q, v, w, driven = motor.angle, motor.speed, acceleration, motor.driven
    zeta, steps = damping_ratio(overshoot), int(np.ceil(time_s / (_SHORT * drive.lag_s)))
    for _ in range(steps):
        driven = pushed(driven, q, drive.play)
        q, v, w = follow_swinging_joint(
            q, v, w, command, drive.lag_s, zeta, drive.acceleration, drive.fade, time_s / steps
        )
        if q < drive.lower:
            q, v, w = drive.lower, max(v, 0.0), max(w, 0.0)
        elif q > drive.upper:
            q, v, w = drive.upper, min(v, 0.0), min(w, 0.0)
    return Motor(q, v, driven), w


@subroutine
def stop_at_joints(motors: Motors, tied: Tied, p: PackedHead, n: Place) -> None:
    """Let one head's motors give way where they push a joint against its own stop.

    Args:
        motors: the angles and speeds, changed in place.
        tied: what they move.
        p: the true head.
        n: which head.
    """
    own = tied.room
    for _ in range(_PASSES):
        for j in range(SLOTS):
            square = rate = 0.0
            for k in range(SLOTS):
                own[k] = motors.angles[n, 3 + k]
                factor = joint_per_actuator(p, j, k)
                square += factor * factor
                rate += factor * motors.speeds[n, 3 + k]
            angle = joint_at(p, j, own)
            beyond = angle - min(max(angle, tied.joint_lower[j]), tied.joint_upper[j])
            if beyond == 0.0 or square == 0.0:
                continue
            rate = rate if rate * beyond > 0.0 else 0.0
            for k in range(SLOTS):
                share = joint_per_actuator(p, j, k) / square
                back = motors.angles[n, 3 + k] - share * beyond
                motors.angles[n, 3 + k] = min(max(back, motors.lower[3 + k]), motors.upper[3 + k])
                motors.speeds[n, 3 + k] -= share * rate


@subroutine
def tie(room: FloatArray, p: PackedHead, positions: FloatArray, velocities: FloatArray) -> None:
    """Turn angles and velocities (7,) of actuators into those of joints, in place.

    Args:
        room: (4,) for a moment.
        p: a packed head.
        positions: rad.
        velocities: rad/s.
    """
    for k in range(SLOTS):
        room[k] = positions[3 + k]
    for j in range(SLOTS):
        positions[3 + j] = joint_at(p, j, room)
    for k in range(SLOTS):
        room[k] = velocities[3 + k]
    for j in range(SLOTS):
        velocities[3 + j] = joint_rate(p, j, room)
