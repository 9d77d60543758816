r"""Angle and speed of each actuator as it is now: a Kalman filter on the angles that are read.

Between two readings an actuator goes as its commands let expect
(`vergence.controllers.prediction.response`), and its acceleration errs by a share of what the
commands under way ask for. An angle is exact but for the encoder's step: within it, a reading says
nothing against what is expected. The speed that a servo tells is a soft measurement. Servos filter
it, and drivers take differences of angles, so that it is older than the angle that comes with it.
Its delay D is found on line: after a motion has begun, what the angle is ahead of the sum of the
speeds is D times the speed,

    q(t) - q(t_0) - \int_{t_0}^{t} w dt' = D (w(t) - w(t_0)),

exactly so for a filter of first order with the time constant D, whatever the motion, and for any
other filter of that mean delay once the acceleration has been steady for a while. What a speed says
counts by how well D is known and by how fast speeds change; a head whose speeds are differences of
angles, or mean nothing, is one with a long D, or with a D that explains nothing.
"""

from math import exp, sqrt
from typing import Annotated, Final

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig, within
from vergence.controllers.prediction.response import (
    Response,
    answer_of,
    command_at,
    longest_latency,
)
from vergence.models.joint_response import share_left
from vergence.models.parts import FloatArray

_SHARE: Final = 0.1
"""Share of its acceleration by which an actuator of a known response errs."""
_PUSHED_RAD_S: Final = 0.005
"""How much a speed changes in a period without a command, standard deviation."""
_ANGLE: Final = 0.3
"""Standard deviation of an angle, as a share of the encoder's step, and beside that."""
_ANGLE_RAD: Final = 1e-5
_SPEED: Final = 0.3
"""Standard deviation of a speed, as a share of its step, beside that, and as a share of it."""
_SPEED_RAD_S: Final = 0.002
_SPEED_SHARE: Final = 0.01
_SHAPE: Final = 0.3
"""How far a filter of speeds may be from one of first order, as a share of its delay."""
_DELAY_SD_S: Final = 0.02
"""How late speeds may be before they have been compared with angles, standard deviation."""
_PROMPT_S: Final = 0.003
"""Delay of speeds below which they count as prompt."""
_EXPLAINED: Final = 10.0
"""And the misfit up to which a delay explains them."""
_OLDEST_S: Final = 0.2
"""The longest delay in question."""
_COMPARED_S: Final = 0.25
"""Over so long, at most, the angle is compared with the sum of speeds."""
_TELLS_RAD_S: Final = 0.1
"""Changes of speed below which nothing is learned of their delay."""
_TRAVEL: Final = 0.02
"""Share of the way by which the sum of speeds errs."""
_FORGET: Final = 0.995
"""What a reading leaves of what was known of the delay."""
_FASTEST: Final = 3.0
"""The greatest speed in question by the greatest command."""
_SETTLES: Final = 0.1
"""Share of the misfit that a reading makes new, itself at most `_MOST_MISFIT`."""
_MOST_MISFIT: Final = 100.0


class Observer:
    """What is known of how speeds are read, and how surely the actuators' state is known."""

    covariance: Annotated[FloatArray, 4, 3]
    """Of an actuator's angle and speed: that of the angle, of both, and of the speed."""
    told: Annotated[FloatArray, 4]
    """The speed that the servo is expected to tell, rad/s."""
    change: Annotated[FloatArray, 4]
    """How fast the speed has changed lately, rad/s^2."""
    read: Annotated[FloatArray, 4]
    """The last speed that was read, rad/s."""
    first_angle: Annotated[FloatArray, 4]
    """The angle with which the comparison began, rad."""
    first_speed: Annotated[FloatArray, 4]
    """The speed then, as it was read, rad/s."""
    summed: Annotated[FloatArray, 4]
    """The sum of the speeds since, rad."""
    compared: Annotated[FloatArray, 4]
    """Periods since."""
    information: float
    """Information on the delay of the speeds, 1/s^2."""
    moment: float
    """The same times the delay, 1/s."""
    delay_s: float
    """By how much speeds are older than angles."""
    misfit: float
    """Mean square of what the delay does not explain, by its variance."""


@device
def begin_comparison(observer: Observer, j: int, angle: float, rate: float) -> None:
    """Compare the angles and the speeds of an actuator from now on."""
    observer.first_angle[j], observer.first_speed[j] = angle, rate
    observer.summed[j] = observer.compared[j] = 0.0
    observer.read[j] = rate


@device
def _delay_sd(observer: Observer) -> float:
    return sqrt(1.0 / (observer.information + 1.0 / _DELAY_SD_S**2))


@device
def _compare(observer: Observer, rig: Rig, j: int, angle: float, rate: float) -> None:
    """What a reading tells of the delay of speeds."""
    period = rig.period_s
    observer.summed[j] += 0.5 * period * (rate + observer.read[j])
    observer.compared[j] += 1.0
    observer.read[j] = rate
    travel = angle - observer.first_angle[j]
    change = rate - observer.first_speed[j]
    ahead = travel - observer.summed[j]
    steps = 0.4 * rig.angle_step[j] + 0.3 * period * rig.speed_step[j] * sqrt(observer.compared[j])
    share = _TRAVEL * travel
    variance = steps * steps + share * share + _ANGLE_RAD * _ANGLE_RAD
    if abs(change) > _TELLS_RAD_S:
        weight = 0.25 / variance  # neighbours err alike
        observer.information = _FORGET * observer.information + weight * change * change
        observer.moment = _FORGET * observer.moment + weight * change * ahead
    if abs(travel) > 4.0 * (steps + _ANGLE_RAD):
        off = ahead - observer.delay_s * change
        square = min(off * off / variance, _MOST_MISFIT)
        observer.misfit += _SETTLES * (square - observer.misfit)
    delay_s = observer.moment * _delay_sd(observer) ** 2
    observer.delay_s = min(max(delay_s, 0.0), _OLDEST_S)
    rests = rate == 0.0 and abs(travel - observer.summed[j]) <= rig.angle_step[j]
    if rests or observer.compared[j] * period > _COMPARED_S:
        begin_comparison(observer, j, angle, rate)


@device
def is_prompt(observer: Observer) -> bool:
    """Whether nothing says that speeds are read with a delay."""
    return observer.delay_s < _PROMPT_S and observer.misfit < _EXPLAINED


@device
def _unsure(response: Response, period: float) -> float:
    """Share of its acceleration by which an actuator errs."""
    answer = answer_of(response)
    v = answer.variance
    square = _SHARE * _SHARE * max(answer.misfit, 1.0)
    square += max(v[0], 0.0) / (period * period) + max(v[1], 0.0) + max(v[2], 0.0)
    return min(sqrt(square), 1.0)


@device
def observe(
    observer: Observer,
    response: Response,
    rig: Rig,
    tick: int,
    j: int,
    before: float,
    q: float,
    v: float,
    angle: float,
    rate: float,
) -> tuple[float, float]:
    """Angle and speed of an actuator with what has just been read.

    Args:
        observer: changed in place.
        response: how the actuators answer their commands.
        rig: what is known of the head.
        tick: the period that has ended.
        j: which actuator.
        before: its speed at the period's beginning, rad/s.
        q: its angle as the commands let expect, rad.
        v: its speed, rad/s.
        angle: the angle that was read, rad.
        rate: the speed that was read, rad/s.

    Returns:
        The angle, within the reading's step, rad, and the speed, rad/s.
    """
    period, c, answer = rig.period_s, observer.covariance[j], answer_of(response)
    lag = rig.lag_ratio[j] * exp(answer.found[2])
    late_s = answer.found[0] + 2.0 * sqrt(max(answer.variance[0], 0.0))
    asked, gain = 0.0, exp(answer.gain[j])
    for i in range(int(min(late_s, longest_latency(rig)) / period) + 2):
        asked = max(asked, abs(gain * command_at(response, tick - i, j) - v))
    most = rig.acceleration[j] * exp(answer.found[1] + sqrt(max(answer.variance[1], 0.0)))
    sd = _unsure(response, period) * period * min(most, asked / lag)
    noise = sd * sd + _PUSHED_RAD_S * _PUSHED_RAD_S
    left = share_left(period, lag)
    c[0] += period * (2.0 * c[1] + period * (c[2] + noise / 3.0))
    c[1] = left * (c[1] + period * c[2]) + 0.5 * period * noise
    c[2] = left * left * c[2] + noise
    step = _ANGLE * rig.angle_step[j]
    spread = c[0] + step * step + _ANGLE_RAD * _ANGLE_RAD
    off = within(q, angle, rig.angle_step[j]) - q
    k, kv = c[0] / spread, c[1] / spread
    q, v = q + k * off, v + kv * off
    c[2] -= kv * c[1]
    c[1] *= 1.0 - k
    c[0] *= 1.0 - k
    _compare(observer, rig, j, angle, rate)
    # what the servo tells of it
    delay = observer.delay_s
    taken = 1.0 - share_left(period, delay)
    expected = observer.told[j] + taken * (v - observer.told[j])
    observer.change[j] = max(0.8 * observer.change[j], abs(v - before) / period)
    doubt = _delay_sd(observer) + _SHAPE * delay
    spread = _SPEED * rig.speed_step[j] + _SPEED_RAD_S + _SPEED_SHARE * abs(v)
    spread += observer.change[j] * doubt
    spread = c[2] + spread * spread * max(observer.misfit, 1.0)
    off = within(expected, rate, rig.speed_step[j]) - expected
    spread += off * off / 9.0  # as in Cauchy's law of errors
    k, kv = c[1] / spread, c[2] / spread
    q, v = q + k * off, v + kv * off
    c[0] -= k * c[1]
    c[1] *= 1.0 - kv
    c[2] *= 1.0 - kv
    observer.told[j] = expected + kv * off
    # whatever a damaged packet says, no actuator is faster
    fastest = _FASTEST * rig.speed[j]
    return within(q, angle, rig.angle_step[j]), min(max(v, -fastest), fastest)
