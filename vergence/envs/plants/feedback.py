"""Joint feedback: encoders on one side of the backlash, with latency, noise and quantisation."""

from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.commands import LAST_READ_STEP, LOOP_STATE, RESUME_PERIOD
from vergence.envs.plants.conditions import BACKLASH, PackedConditions, unpack_conditions
from vergence.envs.plants.frames import TIME_TOLERANCE_S, ring_size
from vergence.envs.plants.motors import (
    ActuatorCoupling,
    MotorState,
    MotorStates,
    joints_from_actuators,
    output_speed,
)
from vergence.envs.reading import Reading
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamKeys,
    StreamPurpose,
    random_words,
    to_normals,
)
from vergence.kernels import compiled, inlined
from vergence.models.head import HeadModel
from vergence.models.motion import lag_decay
from vergence.models.parts import FloatArray

_FEEDBACK: Final = int(StreamPurpose.FEEDBACK)


class JointFeedbackBuffers(NamedTuple):
    """Ring buffers of encoder measurements and joint readings, and the encoders' steps.

    In a ring buffer, step k lies at k modulo its length R or L.
    """

    measured: FloatArray
    """(n, R, 2, 7) angles, rad, and speeds, rad/s, on the encoders' side of the backlash."""
    reported_angles: FloatArray
    """(n, L, 7) joint angles as reported, rad."""
    control_loop_states: IntArray
    """(n, LOOP_STATE) states of the control loops, see `vergence.envs.plants.commands`."""
    speed_filter_states: FloatArray
    """(n, 2, 7) last outputs and last inputs of the servos' speed filters, rad/s."""
    angle_step: FloatArray
    """(7,) quantisation of the encoder angles, rad; 0 for exact."""
    speed_step: FloatArray
    """(7,) quantisation of the encoder speeds, rad/s; 0 for exact."""
    encoders_on_output: bool
    """True if the encoders sit on the output side of the backlash."""

    @classmethod
    def of(
        cls, head: HeadModel, num: int, max_latency_s: float, max_age_s: float
    ) -> "JointFeedbackBuffers":
        """Feedback of a batch of heads, with empty buffers.

        Args:
            head: head model with the encoders.
            num: number of heads.
            max_latency_s: the largest feedback latency, that of speeds included, s.
            max_age_s: the greatest age of angles that are looked up, s.
        """
        period_s, own = head.timing.period_s, head.actuation
        return cls(
            measured=np.zeros((num, ring_size(ceil(max_latency_s / period_s) + 2), 2, 7)),
            reported_angles=np.zeros((num, ring_size(ceil(max_age_s / period_s) + 3), 7)),
            control_loop_states=np.zeros((num, LOOP_STATE), dtype=np.int64),
            speed_filter_states=np.zeros((num, 2, 7)),
            angle_step=own.angle_step,
            speed_step=own.speed_step,
            encoders_on_output=head.sensor.encoder_side == "output",
        )


SAVED_FEEDBACK_FIELDS: Final = {
    "measured": "measured",
    "told": "reported_angles",
    "loops": "control_loop_states",
    "filtered": "speed_filter_states",
}
"""Fields of `JointFeedbackBuffers` that are part of a trial's state, by their names in a saved
state."""


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

    Args:
        q0: the angle at the first time, rad.
        v0: the velocity then, rad/s.
        q1: the angle at the second time, rad.
        v1: the velocity then, rad/s.
        share: fraction of the interval, from 0 to 1.
        interval_s: length of the interval, s.
    """
    s, r = share, 1.0 - share
    angle = r * r * ((1.0 + 2.0 * s) * q0 + s * interval_s * v0)
    angle += s * s * ((1.0 + 2.0 * r) * q1 - r * interval_s * v1)
    return angle, r * v0 + s * v1


@inlined
def eye_encoder_noise(
    key: StreamKey, step: int, word_lane: int, sigma: float
) -> tuple[float, float, float, float]:
    """White noise of the four eye actuators' encoders at a step, of standard deviation `sigma`."""
    words = random_words(key.seed, key.trial, _FEEDBACK, step, word_lane)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


class RingInterval(NamedTuple):
    """Ring positions of two neighbouring steps, and a fraction of the way between them."""

    first: np.uintp
    second: np.uintp
    share: float
    """Fraction of the way from `first` to `second`; 0 at `first`."""


@inlined
def ring_interval_by_age(age_periods: float, step: int, ring_length: int) -> RingInterval:
    """Find the measurements around a time before the newest one; `first` is the later of them.

    Args:
        age_periods: age in periods.
        step: step of the newest measurement.
        ring_length: length of the ring buffer.
    """
    whole, mask = int(age_periods + TIME_TOLERANCE_S), ring_length - 1
    rest = age_periods - whole
    share = rest if rest > TIME_TOLERANCE_S else 0.0
    return RingInterval(np.uintp((step - whole) & mask), np.uintp((step - whole - 1) & mask), share)


@inlined
def low_pass(
    output: float, last_input: float, present_input: float, decay: float, ramp_response: float
) -> float:
    """Advance a first-order low-pass filter by a period in which its input changes linearly.

    Args:
        output: the filter's output at the period's beginning.
        last_input: its input at the period's beginning.
        present_input: its input at the period's end.
        decay: fraction of the output that remains after the period, exp(-T/tau).
        ramp_response: its response to a ramp from 0 to 1, 1 - (1 - exp(-T/tau)) tau/T.
    """
    return (
        decay * output + (1.0 - decay - ramp_response) * last_input + ramp_response * present_input
    )


@inlined
def ring_interval_by_time(time_periods: float, step: int, ring_length: int) -> RingInterval:
    """Find the joint readings around a time, which is clamped to those in the ring buffer.

    Args:
        time_periods: the time in periods, on the clock that dates the readings.
        step: step of the newest reading.
        ring_length: length of the ring buffer.
    """
    at = min(max(time_periods, step - ring_length + 1.0), float(step))
    first = int(np.floor(at + TIME_TOLERANCE_S))
    share = at - first
    share = share if share > TIME_TOLERANCE_S else 0.0
    mask = ring_length - 1
    return RingInterval(np.uintp(first & mask), np.uintp((first + 1) & mask), share)


@compiled
def sense_joints(
    ids: IntArray,
    period_s: float,
    packed: PackedConditions,
    keys: StreamKeys,
    steps: IntArray,
    motors: MotorStates,
    coupling: ActuatorCoupling | None,
    feedback: JointFeedbackBuffers,
    reading: Reading,
) -> None:
    """Measure the joints of some environments, and read the measurement of one latency ago.

    Servos measure and filter even while the control loop stalls. Readings missed during a stall are
    interpolated linearly between the readings before and after it.

    Args:
        ids: (m,) environment indices.
        period_s: the control period, s.
        packed: conditions of the trials.
        keys: keys of the trials' random streams.
        steps: (n,) control periods since the trials' start.
        motors: the motors.
        coupling: coupling of the eye joints; None if each has its own motor.
        feedback: updated in place.
        reading: result: its positions and velocities.
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
                motor = MotorState(angles[n, k], speed, output[n, k])
                measured[n, slot, 0, k] = motor.output
                measured[n, slot, 1, k] = output_speed(motor, own[n, BACKLASH, k])
        late = conditions.feedback_latency_s * rate
        at = ring_interval_by_age(late, step, ring)
        sped = ring_interval_by_age(late + conditions.speed_latency_s * rate, step, ring)
        rest, new, old = at.share, at.first, at.second
        left = ramp = 0.0
        if conditions.speed_filter_s > 0.0:
            left = lag_decay(period_s, conditions.speed_filter_s)
            ramp = 1.0 - (1.0 - left) * conditions.speed_filter_s * rate
        noise = rates = (0.0, 0.0, 0.0, 0.0)
        if conditions.angle_noise_rad > 0.0 or conditions.speed_noise_rad_s > 0.0:
            key = StreamKey(keys.seeds[n], keys.trials[n])
            noise = eye_encoder_noise(key, step, 1, conditions.angle_noise_rad)
            rates = eye_encoder_noise(key, step, 2, conditions.speed_noise_rad_s)
        stalled = step < loop_states[n, RESUME_PERIOD]
        for k in range(7):
            q, v = measured[n, new, 0, k], measured[n, new, 1, k]
            if rest > 0.0 and not (v == 0.0 and measured[n, old, 1, k] == 0.0):
                q0, v0 = measured[n, old, 0, k], measured[n, old, 1, k]
                q, v = interpolate_joint(q0, v0, q, v, 1.0 - rest, period_s)
            if conditions.speed_latency_s > 0.0:
                v = measured[n, sped.first, 1, k]
                v += sped.share * (measured[n, sped.second, 1, k] - v)
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
