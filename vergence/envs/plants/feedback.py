"""What a head says of its joints: encoders on one side of the play, late, noisy, in steps."""

from math import ceil
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.plants.commands import LOOP_STATE, READ, RESUMES
from vergence.envs.plants.conditions import BACKLASH, Drawn, loop_of
from vergence.envs.plants.frames import SAME_S, ring_size
from vergence.envs.plants.motors import Motor, Motors, Tied, driven_speed, tie
from vergence.envs.reading import Reading
from vergence.envs.streams import IntArray, Key, Keys, Purpose, random_words, to_normals
from vergence.models.head import HeadModel
from vergence.models.joint_response import share_left
from vergence.models.parts import FloatArray

_FEEDBACK: Final = int(Purpose.FEEDBACK)


class Feedback(NamedTuple):
    """The encoders, and what they measured and told in the last periods.

    Step k lies at k modulo the ring.
    """

    measured: FloatArray
    """(n, R, 2, 7) angles, rad, and speeds, rad/s, of what the encoders sit on."""
    told: FloatArray
    """(n, L, 7) joint angles as they were read, rad."""
    loops: IntArray
    """(n, LOOP_STATE) how the control loops stand, see `vergence.envs.plants.commands`."""
    filtered: FloatArray
    """(n, 2, 7) the speeds that servos' filters put out last, and those that went in, rad/s."""
    angle_step: FloatArray
    """(7,) resolution of the encoders, rad; 0 for exact."""
    speed_step: FloatArray
    """(7,) resolution of their speeds, rad/s."""
    on_output: bool
    """Whether the encoders sit on the output's side of the play."""

    @classmethod
    def of(cls, head: HeadModel, num: int, longest_s: float, oldest_s: float) -> "Feedback":
        """Those of heads.

        Args:
            head: whose encoders they are.
            num: how many heads.
            longest_s: the greatest latency of the feedback, speeds included, s.
            oldest_s: how far back angles are asked for, s.
        """
        period_s, own = head.timing.period_s, head.actuation
        return cls(
            measured=np.zeros((num, ring_size(ceil(longest_s / period_s) + 2), 2, 7)),
            told=np.zeros((num, ring_size(ceil(oldest_s / period_s) + 3), 7)),
            loops=np.zeros((num, LOOP_STATE), dtype=np.int64),
            filtered=np.zeros((num, 2, 7)),
            angle_step=own.angle_step,
            speed_step=own.speed_step,
            on_output=head.sensor.encoder_side == "output",
        )


STATE: Final = ("measured", "told", "loops", "filtered")
"""The fields of `Feedback` that a trial changes."""


@device
def quantise(value: float, step: float) -> float:
    """A value as a sensor of some resolution reports it; 0 for exact."""
    return step * np.rint(value / step) if step > 0.0 else value


@device
def between(
    q0: float, v0: float, q1: float, v1: float, share: float, time_s: float
) -> tuple[float, float]:
    """Angle and velocity between two times, by the cubic through both angles and velocities.

    The velocity is the straight line's: exact at both ends, and without the cubic's overshoot.

    Args:
        q0: the angle at the first time, rad.
        v0: the velocity then, rad/s.
        q1: the angle at the second time, rad.
        v1: the velocity then, rad/s.
        share: where between them, from 0 to 1.
        time_s: how far they lie apart, s.
    """
    s, r = share, 1.0 - share
    angle = r * r * ((1.0 + 2.0 * s) * q0 + s * time_s * v0)
    angle += s * s * ((1.0 + 2.0 * r) * q1 - r * time_s * v1)
    return angle, r * v0 + s * v1


@device
def noise_of(key: Key, step: int, lane: int, sigma: float) -> tuple[float, float, float, float]:
    """White noise of the encoders of the eyes' actuators at a step."""
    words = random_words(key.seed, key.trial, _FEEDBACK, step, lane)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


class Between(NamedTuple):
    """Where a time lies among steps that are kept."""

    first: np.uintp
    second: np.uintp
    share: float
    """How far from the first to the second; 0 for at the first."""


@device
def ago(periods: float, step: int, ring: int) -> Between:
    """Between which measurements a time before the newest one lies: the later one is the first.

    Args:
        periods: how long ago, in periods.
        step: that of the newest measurement.
        ring: how many are kept.
    """
    whole, mask = int(periods + SAME_S), ring - 1
    rest = periods - whole
    share = rest if rest > SAME_S else 0.0
    return Between(np.uintp((step - whole) & mask), np.uintp((step - whole - 1) & mask), share)


@device
def low_pass(out: float, before: float, now: float, left: float, ramp: float) -> float:
    """A period of a filter of first order whose input goes straight from one value to another.

    Args:
        out: the filter's output at the period's beginning.
        before: its input then.
        now: its input at the period's end.
        left: share of the output that is left then, exp(-T/tau).
        ramp: what it gives out of a ramp from 0 to 1, 1 - (1 - exp(-T/tau)) tau/T.
    """
    return left * out + (1.0 - left - ramp) * before + ramp * now


@device
def told_at(periods: float, step: int, ring: int) -> Between:
    """Between which readings of the joints a time lies: at most at the newest.

    Args:
        periods: the time in periods, by which the readings are dated.
        step: that of the newest reading.
        ring: how many are kept.
    """
    at = min(max(periods, step - ring + 1.0), float(step))
    first = int(np.floor(at + SAME_S))
    share = at - first
    share = share if share > SAME_S else 0.0
    mask = ring - 1
    return Between(np.uintp(first & mask), np.uintp((first + 1) & mask), share)


@compiled
def sense_joints(
    ids: IntArray,
    period_s: float,
    drawn: Drawn,
    keys: Keys,
    steps: IntArray,
    motors: Motors,
    tied: Tied | None,
    feedback: Feedback,
    reading: Reading,
) -> None:
    """Measure some places' joints, and read what was measured one latency ago.

    Servos measure and filter while the control loop stalls. What would have been read meanwhile is
    taken to lie on a straight line between the readings before and after.

    Args:
        ids: (m,) the places.
        period_s: the control period.
        drawn: what the trials run with.
        keys: those of the trials' random numbers.
        steps: (n,) control periods since the trials' start.
        motors: the motors.
        tied: what they move; None where each eye joint has its own.
        feedback: brought up to date.
        reading: its positions and velocities are the result.
    """
    measured, told, loops, filtered, angle_step, speed_step, on_output = feedback
    angles, speeds, driven, own = motors.angles, motors.speeds, motors.driven, drawn.own
    positions, velocities = reading.positions, reading.velocities
    ring, kept, rate = measured.shape[1], told.shape[1] - 1, 1.0 / period_s
    for place in ids:
        n = np.uintp(place)
        step, loop = steps[n], loop_of(drawn, n)
        slot = np.uintp(step & (ring - 1))
        for k in range(7):
            speed = speeds[n, k]
            measured[n, slot, 0, k], measured[n, slot, 1, k] = angles[n, k], speed
            if on_output:
                motor = Motor(angles[n, k], speed, driven[n, k])
                measured[n, slot, 0, k] = motor.driven
                measured[n, slot, 1, k] = driven_speed(motor, own[n, BACKLASH, k])
        late = loop.feedback_latency_s * rate
        at, sped = ago(late, step, ring), ago(late + loop.speed_latency_s * rate, step, ring)
        rest, new, old = at.share, at.first, at.second
        left = ramp = 0.0
        if loop.speed_filter_s > 0.0:
            left = share_left(period_s, loop.speed_filter_s)
            ramp = 1.0 - (1.0 - left) * loop.speed_filter_s * rate
        noise = rates = (0.0, 0.0, 0.0, 0.0)
        if loop.angle_noise_rad > 0.0 or loop.speed_noise_rad_s > 0.0:
            key = Key(keys.seeds[n], keys.trials[n])
            noise = noise_of(key, step, 1, loop.angle_noise_rad)
            rates = noise_of(key, step, 2, loop.speed_noise_rad_s)
        stalled = step < loops[n, RESUMES]
        for k in range(7):
            q, v = measured[n, new, 0, k], measured[n, new, 1, k]
            if rest > 0.0 and not (v == 0.0 and measured[n, old, 1, k] == 0.0):
                q0, v0 = measured[n, old, 0, k], measured[n, old, 1, k]
                q, v = between(q0, v0, q, v, 1.0 - rest, period_s)
            if loop.speed_latency_s > 0.0:
                v = measured[n, sped.first, 1, k]
                v += sped.share * (measured[n, sped.second, 1, k] - v)
            if loop.speed_filter_s > 0.0:
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
        if tied is not None:
            tie(tied.room, tied.head, positions[n], velocities[n])
        since = step - loops[n, READ]
        for missed in range(1, since):
            share = missed / since
            then = np.uintp((step - missed) & kept)
            last = np.uintp(loops[n, READ] & kept)
            for k in range(7):
                told[n, then, k] = positions[n, k] + share * (told[n, last, k] - positions[n, k])
        loops[n, READ] = step
        span = int(np.rint(loop.speed_span_s * rate))
        if span > 0:
            slot = np.uintp((step - span) & kept)
            for k in range(7):
                velocities[n, k] = (positions[n, k] - told[n, slot, k]) * rate / span
        slot = np.uintp(step & kept)
        for k in range(7):
            told[n, slot, k] = positions[n, k]
