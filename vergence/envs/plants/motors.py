r"""The motors of heads whose eye joints do not each have one: what is commanded, and what it turns.

A motor follows its command by its own lag and acceleration limit and stops at its own limits. It
moves the joints through a play of width b, with friction: what it drives stays where it is while
the motor crosses the play, and is then pushed along,

    driven = clip(driven, motor - b / 2, motor + b / 2),   joints = A driven + offset

so a joint stands still for a moment whenever its motor turns round. The encoder sits on the
motor's side of the play: a reading says A times the motors' angles, each in its own steps. Where
a joint's stop is nearer than its motors' are, all motors that push against it stop, each giving
way by its share of the push.

Where each eye joint has its own motor, none of this is computed: the joints are the motors.
"""

from math import log
from typing import NamedTuple

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.plants.scene import Place, Scene, head_of
from vergence.models.actuation import SLOTS
from vergence.models.head import HeadModel
from vergence.models.joint_response import follow_joint, share_left
from vergence.models.joints import EYES
from vergence.models.packed import PackedHead, actuator_at, joint_at, joint_per_actuator, joint_rate
from vergence.models.parts import FloatArray

_CONTACT_RAD = 1e-12
"""What rounding may leave between a motor's flank and what it pushes."""
_PASSES = 4


class Motors(NamedTuple):
    """The motors of a batch of heads; (7,) are the neck's joints and four actuators of the eyes."""

    angles: FloatArray
    """(n, 7) rad."""
    speeds: FloatArray
    """(n, 7) rad/s."""
    driven: FloatArray
    """(n, 7) where what they move is, within half their play of them, rad."""
    lower: FloatArray
    """(7,) least angles, rad."""
    upper: FloatArray
    """(7,) greatest angles, rad."""
    acceleration: FloatArray
    """(7,) greatest accelerations, rad/s^2."""
    lag_ratio: FloatArray
    """(7,) lags by those of the conditions."""
    backlash: FloatArray
    """(7,) whole width of the play, rad."""
    angle_step: FloatArray
    """(7,) resolution of the encoders, rad."""
    speed_step: FloatArray
    """(7,) resolution of their velocities, rad/s."""
    joint_lower: FloatArray
    """(4,) least angles of the eyes' joints, rad."""
    joint_upper: FloatArray
    """(4,) greatest angles of the eyes' joints, rad."""
    head: PackedHead
    """(PACKED,) the head that the controller knows: by it, encoders' angles become joints'."""
    room: FloatArray
    """(4,) for numbers by actuator that kernels need for a moment."""

    @classmethod
    def of(cls, head: HeadModel, num: int) -> "Motors | None":
        """Those of heads; None where each eye joint has its own."""
        own = head.actuation
        if own.direct:
            return None
        rest = np.tile(own.actuators_of(head.rest()), (num, 1))
        return cls(
            angles=rest,
            speeds=np.zeros((num, 7)),
            driven=rest.copy(),
            lower=own.lower,
            upper=own.upper,
            acceleration=own.acceleration,
            lag_ratio=own.lag_ratio,
            backlash=own.backlash,
            angle_step=own.angle_step,
            speed_step=own.speed_step,
            joint_lower=head.limits.lower[EYES],
            joint_upper=head.limits.upper[EYES],
            head=head.packed,
            room=np.empty(SLOTS),
        )


@device
def quantise(value: float, step: float) -> float:
    """A value as a sensor of some resolution reports it; 0 for exact."""
    return step * np.rint(value / step) if step > 0.0 else value


@device
def feel_angles(motors: Motors, n: Place, out: FloatArray) -> None:
    """Joint angles (7,) as the encoders of one head tell them."""
    own = motors.room
    for k in range(3):
        out[k] = quantise(motors.angles[n, k], motors.angle_step[k])
    for k in range(SLOTS):
        own[k] = quantise(motors.angles[n, 3 + k], motors.angle_step[3 + k])
    for j in range(SLOTS):
        out[3 + j] = joint_at(motors.head, j, own)


@device
def feel_speeds(motors: Motors, n: Place, out: FloatArray) -> None:
    """Joint velocities (7,) as the encoders of one head tell them."""
    own = motors.room
    for k in range(3):
        out[k] = quantise(motors.speeds[n, k], motors.speed_step[k])
    for k in range(SLOTS):
        own[k] = quantise(motors.speeds[n, 3 + k], motors.speed_step[3 + k])
    for j in range(SLOTS):
        out[3 + j] = joint_rate(motors.head, j, own)


@device
def _push(motors: Motors, n: Place, k: int, angle: float) -> None:
    """Bring what a motor moves along, the motor being at an angle."""
    half = 0.5 * motors.backlash[k]
    motors.driven[n, k] = min(max(motors.driven[n, k], angle - half), angle + half)


@device
def _carry(motors: Motors, scene: Scene, n: Place) -> None:
    """Bring one head's joints up to date with its motors."""
    p, own = head_of(scene, n), motors.room
    for k in range(7):
        _push(motors, n, k, motors.angles[n, k])
    for k in range(3):
        scene.positions[n, k] = motors.driven[n, k]
        scene.velocities[n, k] = _driven_speed(motors, n, k)
    for k in range(SLOTS):
        own[k] = motors.driven[n, 3 + k]
    for j in range(SLOTS):
        scene.positions[n, 3 + j] = joint_at(p, j, own)
    for k in range(SLOTS):
        own[k] = _driven_speed(motors, n, 3 + k)
    for j in range(SLOTS):
        scene.velocities[n, 3 + j] = joint_rate(p, j, own)


@device
def _driven_speed(motors: Motors, n: Place, k: int) -> float:
    """The velocity of what a motor moves: the motor's while it pushes, else none."""
    speed, half = motors.speeds[n, k], 0.5 * motors.backlash[k]
    behind = motors.angles[n, k] - motors.driven[n, k]
    pushes = behind >= half - _CONTACT_RAD if speed > 0.0 else -behind >= half - _CONTACT_RAD
    return speed if pushes else 0.0


@device
def _time_to_turn(v: float, u: float, tau: float, a: float) -> float:
    """When a motor turns round whose velocity and command have opposite signs, s."""
    elapsed = 0.0
    if abs(u - v) > a * tau:
        if abs(u) >= a * tau:
            return abs(v) / a
        # the limit on acceleration ends before the motor stands still
        after = u + a * tau if v > 0.0 else u - a * tau
        elapsed = abs(v - after) / a
        v = after
    return elapsed + tau * log((u - v) / u)


@device
def _follow(
    motors: Motors, n: Place, k: int, command: float, lag_s: float, period_s: float
) -> None:
    """Move one motor through a period."""
    q, v = motors.angles[n, k], motors.speeds[n, k]
    if v == 0.0 and command == 0.0:
        return
    tau, a = lag_s * motors.lag_ratio[k], motors.acceleration[k]
    low, high = motors.lower[k], motors.upper[k]
    if motors.backlash[k] > 0.0 and v * command < 0.0:
        turn = _time_to_turn(v, command, tau, a)
        if turn < period_s:  # what is pushed stays at the turning point
            farthest, _rest = follow_joint(q, v, command, tau, a, turn, share_left(turn, tau))
            _push(motors, n, k, min(max(farthest, low), high))
    q, v = follow_joint(q, v, command, tau, a, period_s, share_left(period_s, tau))
    if q < low:
        q, v = low, max(v, 0.0)
    elif q > high:
        q, v = high, min(v, 0.0)
    motors.angles[n, k], motors.speeds[n, k] = q, v


@device
def _stop_at_joints(motors: Motors, p: PackedHead, n: Place) -> None:
    """Let motors give way where they push a joint against its own stop."""
    own = motors.room
    for _ in range(_PASSES):
        for j in range(SLOTS):
            square = rate = 0.0
            for k in range(SLOTS):
                own[k] = motors.angles[n, 3 + k]
                factor = joint_per_actuator(p, j, k)
                square += factor * factor
                rate += factor * motors.speeds[n, 3 + k]
            angle = joint_at(p, j, own)
            beyond = angle - min(max(angle, motors.joint_lower[j]), motors.joint_upper[j])
            if beyond == 0.0 or square == 0.0:
                continue
            rate = rate if rate * beyond > 0.0 else 0.0
            for k in range(SLOTS):
                share = joint_per_actuator(p, j, k) / square
                back = motors.angles[n, 3 + k] - share * beyond
                motors.angles[n, 3 + k] = min(max(back, motors.lower[3 + k]), motors.upper[3 + k])
                motors.speeds[n, 3 + k] -= share * rate


@compiled
def drive(
    motors: Motors, scene: Scene, command: FloatArray, lag_s: FloatArray, period_s: float
) -> None:
    """Move all motors through a period by their lags, and the joints with them.

    Args:
        motors: `bare`, brought up to date.
        scene: `bare`, its joints brought up to date.
        command: (n, 7) velocity commands within the limits, rad/s.
        lag_s: (n,) time constants of motors whose ratio is 1, s.
        period_s: the period.
    """
    motors, scene = Motors(*motors), Scene(*scene)
    for n in range(len(lag_s)):
        for k in range(7):
            _follow(motors, n, k, command[n, k], lag_s[n], period_s)
        _stop_at_joints(motors, head_of(scene, n), n)
        _carry(motors, scene, n)


@compiled
def carry(motors: Motors, scene: Scene) -> None:
    """Bring all joints up to date with motors that something else has moved.

    Args:
        motors: `bare`, what they push brought up to date.
        scene: `bare`, its joints brought up to date.
    """
    motors, scene = Motors(*motors), Scene(*scene)
    for n in range(len(motors.angles)):
        _carry(motors, scene, n)


@device
def place_motors(motors: Motors, scene: Scene, n: Place, positions: FloatArray) -> None:
    """Put one head's motors at rest where they give joint angles (7,), in the middle of play."""
    for k in range(3):
        motors.angles[n, k] = positions[k]
    for k in range(SLOTS):
        motors.angles[n, 3 + k] = actuator_at(motors.head, k, positions[3:])
    for k in range(7):
        motors.speeds[n, k] = 0.0
        motors.driven[n, k] = motors.angles[n, k]
    _carry(motors, scene, n)
