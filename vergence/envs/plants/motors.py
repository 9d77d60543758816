"""The motors of a batch of heads: commands on their way to them, response, joint feedback.

A command holds for one period. For the motors, this period begins one command latency after the
command was given. A control period T is therefore split: until `latency modulo T` the earlier
command applies, then the next one.

If a command is lost or the loop stalls, the command of the period before stays in force.

A motor follows its command with its own lag and acceleration limit and stops at its own limits. It
drives the joints through backlash (play) of width b, with friction: its output stays in place while
the motor crosses the backlash, and is then pushed along,

    output = clip(output, motor - b / 2, motor + b / 2),   joints = A output + offset

so a joint stands still for a moment whenever its motor reverses. The encoder sits on the motor's
side of the backlash, or on the output's. If a joint reaches its own stop before its motors reach
theirs, all motors that push it stop, each giving way by its share of the push.

If each eye joint has its own motor, A is the unit matrix, and a motor's output is its joint.
"""

from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.cameras import TIME_TOLERANCE_S, ring_size
from vergence.envs.plants.conditions import (
    BACKLASH,
    EnvIndex,
    PackedConditions,
    TrialConditions,
    unpack_conditions,
)
from vergence.envs.reading import Reading
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamKeys,
    StreamPurpose,
    four_normals,
    random_words,
    to_uniform,
)
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

_ROUNDING: Final = 1e-9
"""Rounding tolerance, as a fraction of a limit or of a period (numerical)."""
_COMMAND: Final = int(StreamPurpose.COMMAND)


class CommandBuffers(NamedTuple):
    """Ring buffers of the last commands; the command of step k lies at k modulo C."""

    velocities: FloatArray
    """(n, C, 7) commands as they reach the motors, limited and quantised, rad/s; zero in the dead
    band of one quantisation step."""
    velocity_limits: FloatArray  # (7,) velocity limits, rad/s
    quantisation_step: float  # quantisation step of the commands, rad/s; 0 for exact

    @classmethod
    def empty(
        cls, num: int, velocity_limits: FloatArray, quantisation_step: float, max_latency_s: float,
        period_s: float,
    ) -> "CommandBuffers":  # fmt: skip
        """Buffers of zero commands, long enough for all commands that have not taken effect yet."""
        size = ring_size(ceil(max_latency_s / period_s) + 2)
        return cls(np.zeros((num, size, 7)), velocity_limits, quantisation_step)


RESUME_PERIOD: Final = 0
"""Column of a loop's state row: period in which the loop resumes after its last stall
(numerical)."""
COMMAND_LOST: Final = 1
"""Column: nonzero if the present period's command never reaches the motors (numerical)."""
LAST_READ_STEP: Final = 2
"""Column: step at which the joints were read last (numerical)."""
LOOP_STATE: Final = 3
"""Length of the state row of a control loop (numerical)."""


@inlined
def is_command_lost(conditions: TrialConditions, key: StreamKey, step: int) -> bool:
    """True if a period's command never reaches the motors."""
    chance = conditions.lost_command_probability
    if chance == 0.0:
        return False
    return to_uniform(random_words(key.seed, key.trial, _COMMAND, step, 1)[0]) < chance


@inlined
def loop_resumes_at(
    conditions: TrialConditions, key: StreamKey, step: int, period_s: float, last_resume_period: int
) -> int:
    """Number of the period from which the loop runs again; at most `step` while it runs.

    A loop that stalls at `step` returns a later period, drawn from the trial's random stream. It
    runs for at least one period between two stalls.
    """
    chance = conditions.stall_probability
    if chance == 0.0 or step == 0 or step <= last_resume_period:
        return last_resume_period
    words = random_words(key.seed, key.trial, _COMMAND, step, 1)
    if not to_uniform(words[1]) < chance:
        return last_resume_period
    return step + max(int(np.rint(to_uniform(words[2]) * conditions.stall_s / period_s)), 1)


@subroutine
def store_commands(
    ids: IntArray, command: FloatArray, commands: CommandBuffers, control_loop_states: IntArray,
    step: IntArray, sent: FloatArray,
) -> bool:  # fmt: skip
    """Limit and quantise the commands (n, 7) of a period, and write them to the ring buffers.

    In `sent`, a stalled loop keeps its last value. The result is False if any command is nan.
    """
    given, limits, size = commands.velocities, commands.velocity_limits, commands.quantisation_step
    numbers, mask = True, given.shape[1] - 1
    for n in ids:
        slot, before = np.uintp(step[n] & mask), np.uintp((step[n] - 1) & mask)
        stalled = step[n] < control_loop_states[n, RESUME_PERIOD]
        lost = control_loop_states[n, COMMAND_LOST] != 0
        for j in range(7):
            u, limit = command[n, j], limits[j]
            if u != u:
                numbers = False
            if stalled:
                given[n, slot, j] = given[n, before, j]
                continue
            u = min(max(u, -limit), limit)
            moving = u
            if size > 0.0:
                count = np.rint(u / size)
                if abs(count) * size > limit * (1.0 + _ROUNDING):
                    count -= np.sign(count)
                u = moving = size * count
                if abs(count) <= 1.0:
                    moving = 0.0
            sent[n, j] = u
            given[n, slot, j] = given[n, before, j] if lost else moving
    return numbers


@inlined
def held_commands(
    latency_s: float, step: int, ring_length: int, period_s: float
) -> tuple[np.uintp, np.uintp, float]:
    """Ring positions of a period's two commands, and the time of the change within it, s."""
    mask = ring_length - 1
    if latency_s == 0.0:
        now = np.uintp(step & mask)
        return now, now, 0.0
    whole = int(latency_s / period_s + _ROUNDING)
    rest = latency_s - whole * period_s
    then = np.uintp((step - whole) & mask)
    if rest < TIME_TOLERANCE_S:
        return then, then, 0.0
    return np.uintp((step - whole - 1) & mask), then, rest


_CONTACT_RAD: Final = 1e-12
"""Rounding tolerance of contact between a motor and its output, rad (numerical)."""
_JOINT_STOP_PASSES: Final = 4
"""Passes over the joints that move motors back from the joints' stops (numerical)."""
_MAX_STEP_RATIO: Final = 0.125
"""Largest step of a second-order servo as a fraction of its time constant; backlash and stops are
applied only between steps (numerical)."""


class MotorStates(NamedTuple):
    """The motors of a batch of heads; arrays of 7 hold the neck's joints and four eye actuators."""

    angles: FloatArray  # (n, 7) motor angles, rad
    speeds: FloatArray  # (n, 7) motor speeds, rad/s
    accelerations: FloatArray  # (n, 7) accelerations of second-order servos, rad/s^2; 0 for others
    output_angles: FloatArray
    """(n, 7) angles of the motors' outputs, within half the backlash of the motors, rad; if each
    eye joint has its own motor, these are the joint angles."""
    lower: FloatArray  # (7,) lower angle limits, rad
    upper: FloatArray  # (7,) upper angle limits, rad
    speed_limits: FloatArray  # (7,) speed limits, rad/s
    acceleration_limits: FloatArray  # (7,) acceleration limits, rad/s^2
    lag_ratios: FloatArray  # (7,) ratios of the motors' lags to the conditions' `lag_s`

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel, num: int) -> "MotorStates":
        """Motors of a batch of heads, at rest."""
        own = true_head.actuation
        rest = np.tile(own.actuators_of(head.rest()), (num, 1))
        return cls(
            angles=rest, speeds=np.zeros((num, 7)), accelerations=np.zeros((num, 7)),
            output_angles=rest.copy(), lower=own.lower, upper=own.upper, speed_limits=own.velocity,
            acceleration_limits=own.acceleration, lag_ratios=own.lag_ratio,
        )  # fmt: skip


class ActuatorCoupling(NamedTuple):
    """Coupling of the eye joints, for heads whose motors move several joints."""

    joint_lower: FloatArray  # (4,) lower angle limits of the eye joints, rad
    joint_upper: FloatArray  # (4,) upper angle limits of the eye joints, rad
    nominal_head: PackedHead
    """(PACKED,) the head that the controller knows; it converts encoder angles to joint angles."""
    scratch: FloatArray  # (n, 4) scratch arrays of kernels, one number per actuator

    @classmethod
    def of(cls, head: HeadModel, true_head: HeadModel, num: int) -> "ActuatorCoupling | None":
        """Coupling of a batch of heads; None if each eye joint has its own motor."""
        if head.actuation.direct:
            return None
        limits = true_head.limits
        return cls(limits.lower[EYES], limits.upper[EYES], head.packed, np.empty((num, SLOTS)))


class MotorParams(NamedTuple):
    """Parameters of one motor in a trial."""

    lag_s: float
    max_acceleration: float
    acceleration_falloff: float  # fraction of the acceleration that is lost per rad/s of speed
    lower: float
    upper: float
    backlash: float  # backlash, whole width, rad


@inlined
def output_angle(output: float, angle: float, backlash: float) -> float:
    """Angle of a motor's output once the motor has moved to `angle`."""
    return min(max(output, angle - 0.5 * backlash), angle + 0.5 * backlash)


@inlined
def output_speed(angle: float, speed: float, output: float, backlash: float) -> float:
    """Velocity of a motor's output: the motor's own while it pushes, else 0."""
    behind, half = angle - output, 0.5 * backlash - _CONTACT_RAD
    pushes = behind >= half if speed > 0.0 else -behind >= half
    return speed if pushes else 0.0


@inlined
def advance_first_order(
    q: float, v: float, output: float, params: MotorParams, command: float, time_s: float,
    decay: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Advance a motor's angle, speed and output angle by a time, with `decay` as its `lag_decay`.

    Its output moves only if the motor reverses within it. Callers push it on with `output_angle`.
    """
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
    return q, v, output


@subroutine
def advance_second_order(
    q: float, v: float, output: float, w: float, params: MotorParams, command: float, time_s: float,
    overshoot: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Advance a second-order servo and its acceleration by a time, see `advance_first_order`."""
    zeta, steps = damping_ratio(overshoot), int(np.ceil(time_s / (_MAX_STEP_RATIO * params.lag_s)))
    for _ in range(steps):
        output = output_angle(output, q, params.backlash)
        q, v, w = follow_second_order_joint(
            q, v, w, command, params.lag_s, zeta, params.max_acceleration,
            params.acceleration_falloff, time_s / steps,
        )  # fmt: skip
        if q < params.lower:
            q, v, w = params.lower, max(v, 0.0), max(w, 0.0)
        elif q > params.upper:
            q, v, w = params.upper, min(v, 0.0), min(w, 0.0)
    return q, v, output, w


@subroutine
def stop_motors_at_joint_stops(
    motors: MotorStates, coupling: ActuatorCoupling, p: PackedHead, n: EnvIndex
) -> None:
    """Move one head's motors back where they push a joint beyond its own stop."""
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
    """Convert angles and velocities (7,) of actuators to those of joints, in place."""
    for k in range(SLOTS):
        scratch[k] = positions[3 + k]
    for j in range(SLOTS):
        positions[3 + j] = eye_joint_angle(p, j, scratch)
    for k in range(SLOTS):
        scratch[k] = velocities[3 + k]
    for j in range(SLOTS):
        velocities[3 + j] = eye_joint_velocity(p, j, scratch)


_FEEDBACK: Final = int(StreamPurpose.FEEDBACK)


class JointFeedbackBuffers(NamedTuple):
    """Ring buffers of encoder measurements and joint readings, and the encoders' steps.

    In a ring buffer, step k lies at k modulo its length R or L.
    """

    measured: FloatArray
    """(n, R, 2, 7) angles, rad, and speeds, rad/s, on the encoders' side of the backlash."""
    reported_angles: FloatArray  # (n, L, 7) joint angles as reported, rad
    control_loop_states: IntArray
    """(n, LOOP_STATE) states of the control loops, see `vergence.envs.plants.motors`."""
    speed_filter_states: FloatArray
    """(n, 2, 7) last outputs and last inputs of the servos' speed filters, rad/s."""
    angle_step: FloatArray  # (7,) quantisation of the encoder angles, rad; 0 for exact
    speed_step: FloatArray  # (7,) quantisation of the encoder speeds, rad/s; 0 for exact
    encoders_on_output: bool  # True if the encoders sit on the output side of the backlash

    @classmethod
    def of(
        cls, head: HeadModel, num: int, max_latency_s: float, max_age_s: float
    ) -> "JointFeedbackBuffers":
        """Feedback of a batch of heads, with empty buffers."""
        period_s, own = head.timing.period_s, head.actuation
        return cls(
            measured=np.zeros((num, ring_size(ceil(max_latency_s / period_s) + 2), 2, 7)),
            reported_angles=np.zeros((num, ring_size(ceil(max_age_s / period_s) + 3), 7)),
            control_loop_states=np.zeros((num, LOOP_STATE), dtype=np.int64),
            speed_filter_states=np.zeros((num, 2, 7)), angle_step=own.angle_step,
            speed_step=own.speed_step, encoders_on_output=head.sensor.encoder_side == "output",
        )  # fmt: skip


@inlined
def quantise(value: float, step: float) -> float:
    """Round a value to a sensor's quantisation step; 0 for exact."""
    return step * np.rint(value / step) if step > 0.0 else value


@inlined
def interpolate_joint(
    q0: float, v0: float, q1: float, v1: float, share: float, interval_s: float
) -> tuple[float, float]:
    """Interpolate angle and velocity between two times.

    The angle follows the cubic through both angles and velocities. The velocity is linear: exact
    at both ends, and without the cubic's overshoot.
    """
    s, r = share, 1.0 - share
    angle = r * r * ((1.0 + 2.0 * s) * q0 + s * interval_s * v0)
    angle += s * s * ((1.0 + 2.0 * r) * q1 - r * interval_s * v1)
    return angle, r * v0 + s * v1


@inlined
def ring_interval_by_age(
    age_periods: float, step: int, ring_length: int
) -> tuple[np.uintp, np.uintp, float]:
    """Ring positions after and before a past time, and its fraction of the way between them."""
    whole, mask = int(age_periods + TIME_TOLERANCE_S), ring_length - 1
    rest = age_periods - whole
    share = rest if rest > TIME_TOLERANCE_S else 0.0
    return np.uintp((step - whole) & mask), np.uintp((step - whole - 1) & mask), share


@inlined
def low_pass(
    output: float, last_input: float, present_input: float, decay: float, ramp_response: float
) -> float:
    """Advance a first-order low-pass filter by a period in which its input changes linearly."""
    return (
        decay * output + (1.0 - decay - ramp_response) * last_input + ramp_response * present_input
    )


@inlined
def ring_interval_by_time(
    time_periods: float, step: int, ring_length: int
) -> tuple[np.uintp, np.uintp, float]:
    """Ring positions before and after a time, clamped to those there are, and its fraction."""
    at = min(max(time_periods, step - ring_length + 1.0), float(step))
    first = int(np.floor(at + TIME_TOLERANCE_S))
    share = at - first
    share = share if share > TIME_TOLERANCE_S else 0.0
    mask = ring_length - 1
    return np.uintp(first & mask), np.uintp((first + 1) & mask), share


@subroutine
def sense_joints(
    ids: IntArray, period_s: float, packed: PackedConditions, keys: StreamKeys, steps: IntArray,
    motors: MotorStates, coupling: ActuatorCoupling | None, feedback: JointFeedbackBuffers,
    reading: Reading,
) -> None:  # fmt: skip
    """Measure the joints of some environments, and read the measurement of one latency ago.

    Servos measure and filter even while the control loop stalls. Readings missed during a stall are
    interpolated linearly between the readings before and after it.
    """
    measured, reported, loop_states, filtered, angle_step, speed_step, on_output = feedback
    angles, speeds, output, own = motors.angles, motors.speeds, motors.output_angles, packed.own
    positions, velocities = reading.positions, reading.velocities
    ring, kept, rate = measured.shape[1], reported.shape[1] - 1, 1.0 / period_s
    for env in ids:
        n = np.uintp(env)
        step, conditions = steps[n], unpack_conditions(packed, n)
        slot = np.uintp(step & (ring - 1))
        for k in range(7):
            speed = speeds[n, k]
            measured[n, slot, 0, k], measured[n, slot, 1, k] = angles[n, k], speed
            if on_output:
                speed = output_speed(angles[n, k], speed, output[n, k], own[n, BACKLASH, k])
                measured[n, slot, 0, k], measured[n, slot, 1, k] = output[n, k], speed
        late = conditions.feedback_latency_s * rate
        new, old, rest = ring_interval_by_age(late, step, ring)
        late += conditions.speed_latency_s * rate
        speed_new, speed_old, speed_rest = ring_interval_by_age(late, step, ring)
        left = ramp = 0.0
        if conditions.speed_filter_s > 0.0:
            left = lag_decay(period_s, conditions.speed_filter_s)
            ramp = 1.0 - (1.0 - left) * conditions.speed_filter_s * rate
        noise = rates = (0.0, 0.0, 0.0, 0.0)
        if conditions.angle_noise_rad > 0.0 or conditions.speed_noise_rad_s > 0.0:
            words = random_words(keys.seeds[n], keys.trials[n], _FEEDBACK, step, 1)
            noise = four_normals(words, conditions.angle_noise_rad)
            words = random_words(keys.seeds[n], keys.trials[n], _FEEDBACK, step, 2)
            rates = four_normals(words, conditions.speed_noise_rad_s)
        stalled = step < loop_states[n, RESUME_PERIOD]
        for k in range(7):
            q, v = measured[n, new, 0, k], measured[n, new, 1, k]
            if rest > 0.0 and not (v == 0.0 and measured[n, old, 1, k] == 0.0):
                q0, v0 = measured[n, old, 0, k], measured[n, old, 1, k]
                q, v = interpolate_joint(q0, v0, q, v, 1.0 - rest, period_s)
            if conditions.speed_latency_s > 0.0:
                v = measured[n, speed_new, 1, k]
                v += speed_rest * (measured[n, speed_old, 1, k] - v)
            if conditions.speed_filter_s > 0.0:
                v0, filtered[n, 1, k] = filtered[n, 1, k], v
                v = filtered[n, 0, k] = low_pass(filtered[n, 0, k], v0, v, left, ramp)
            if stalled:
                continue
            if k >= 3:
                q, v = q + noise[k - 3], v + rates[k - 3]
            positions[n, k] = quantise(q, angle_step[k])
            velocities[n, k] = quantise(v, speed_step[k])
        if stalled:
            continue
        if coupling is not None:
            joints_from_actuators(
                coupling.scratch[n], coupling.nominal_head, positions[n], velocities[n]
            )
        since = step - loop_states[n, LAST_READ_STEP]
        for missed in range(1, since):
            share = missed / since
            then = np.uintp((step - missed) & kept)
            last = np.uintp(loop_states[n, LAST_READ_STEP] & kept)
            for k in range(7):
                q = positions[n, k]
                reported[n, then, k] = q + share * (reported[n, last, k] - q)
        loop_states[n, LAST_READ_STEP] = step
        span = int(np.rint(conditions.speed_span_s * rate))
        if span > 0:
            slot = np.uintp((step - span) & kept)
            for k in range(7):
                velocities[n, k] = (positions[n, k] - reported[n, slot, k]) * rate / span
        slot = np.uintp(step & kept)
        for k in range(7):
            reported[n, slot, k] = positions[n, k]
