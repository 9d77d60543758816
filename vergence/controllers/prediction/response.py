r"""How the actuators answer their commands: latency, lag, acceleration and gain.

In the time in which joints are read, an actuator follows its commands by

    m l^2 dw/dt + l w + v = g u(t - L),   dv/dt = w,   dq/dt = v,   |w| <= a

L being the latency of the command and that of the reading together, l the lag and m its build-up,
g the actuator's speed gain and a a ratio of what the head's limits say. L, the ratio, the lag and
the build-up are those of the head, which the four actuators share; each has a gain of its own.

Two answers are found side by side, see `vergence.controllers.prediction.fitting`: the plain one
follows by a lag of first order, m = 0; the other one by a lag of second order, as a servo does
whose own loop swings. That is used once it explains the readings so much better that this is no
chance.
"""

from math import exp, log
from typing import Annotated, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig
from vergence.models.joint_pace import follow_pace, pace_of
from vergence.models.parts import FloatArray

COMMANDS: Final = 128
"""Commands of so many periods are remembered."""
SPEEDS: Final = 32
"""Velocities of so many periods are."""
LONGEST_S: Final = 0.12
"""The longest latency of command and reading together, unless the head's model says more."""
PLAIN: Final = 0
"""Place of the answer without a build-up."""
BUILDING: Final = 1
"""Place of the one with it."""
ANSWERS: Final = 2
_LATENCY_SD_S: Final = 0.012
"""How far a head's latency may be from what its model says, standard deviation."""
_MORE_S: Final = 0.01
"""How much longer it is than a model that counts none says, on average."""
_RATIO_SD: Final = 0.35
"""Standard deviation of the logarithm of the acceleration by the model's."""
_LAG_SD: Final = 0.45
"""That of the lag."""
_BUILD_UP: Final = 0.8
"""The build-up where there is one, on average: a servo that overshoots a step by 12 %."""
_BUILD_UP_SD: Final = 0.7
"""And its standard deviation."""
_LEAST_LAG_S: Final = 0.004


class Answer:
    """One answer to how the actuators follow their commands.

    (4,) are the latency, s, the logarithms of the acceleration ratio and of the lag, s, and the
    build-up; gains are by actuator.
    """

    found: Annotated[FloatArray, 4]
    variance: Annotated[FloatArray, 4]
    prior: Annotated[FloatArray, 4]
    """As it was known before the window."""
    information: Annotated[FloatArray, 4]
    """Inverse variances of that."""
    gain: Annotated[FloatArray, 4]
    """Logarithms of the actuators' speed gains."""
    gain_prior: Annotated[FloatArray, 4]
    accelerations: Annotated[FloatArray, 4]
    """The actuators' accelerations as the window begins, rad/s^2."""
    misfit: float
    """Mean squared residual of the last fit, by its variance."""
    residuals: float
    """The sum of these."""


class Response:
    """What is known of a head's response."""

    answers: Annotated[list[Answer], ANSWERS]
    chosen: float
    """Place of the one that is used."""
    evidence: float
    """By how much the answer with a build-up explained earlier windows better than the plain one,
    in squared residuals by their variance."""
    windows: float
    """How many windows have ended."""
    begun: float
    """The count of periods at which the window begins; negative for none."""
    ended: float
    """That at which the window before ended."""
    commands: Annotated[FloatArray, COMMANDS, 4]
    """The commands by period, rad/s, a ring in which period k has the place k modulo its length."""
    speeds: Annotated[FloatArray, SPEEDS, 4]
    """The actuators' velocities at the end of each period: as read where that is prompt, else as
    observed, rad/s."""
    accelerations: Annotated[FloatArray, 4]
    """Their accelerations now, as the commands let expect, rad/s^2."""
    prompt: float
    """Whether they are read without delay: 1 or 0."""
    means: Annotated[FloatArray, SPEEDS, 4]
    """Their mean velocities in each period by the angles that were read, rad/s."""
    angles: Annotated[FloatArray, 4]
    """The angles that were read last, rad."""


def first_answers(latency_s: float, lag_s: float, learn: bool) -> dict[str, object]:
    """What is known of a head's response before it has moved, by `ANSWERS`.

    Args:
        latency_s: the latency of commands and readings that its model says.
        lag_s: its lag.
        learn: whether it may be otherwise.
    """
    latency = latency_s if latency_s > 0.0 or not learn else _MORE_S
    plain = (latency, 0.0, log(max(lag_s, _LEAST_LAG_S)), 0.0)
    known = [plain, (*plain[:3], _BUILD_UP)]
    sds = np.array([_LATENCY_SD_S, _RATIO_SD, _LAG_SD, _BUILD_UP_SD])
    return {
        "found": known,
        "prior": known,
        "variance": sds**2 if learn else np.zeros(4),
        "information": 1.0 / sds**2,
        "misfit": 1.0,
    }


@device
def answer_of(response: Response) -> Answer:
    """The answer that is used."""
    return response.answers[np.intp(response.chosen)]


@device
def longest_latency(rig: Rig) -> float:
    """The longest latency of command and reading together that is in question, s.

    All commands are remembered that are so much older than a window.
    """
    return min(max(LONGEST_S, rig.response_s), rig.period_s * (COMMANDS - SPEEDS))


@device
def command_at(response: Response, tick: int, j: int) -> float:
    """The command of a period."""
    command: float = response.commands[np.uintp(tick & (COMMANDS - 1)), j]
    return command


@device
def speed_at(response: Response, tick: int, j: int) -> float:
    """The velocity at the end of a period."""
    speed: float = response.speeds[np.uintp(tick & (SPEEDS - 1)), j]
    return speed


@device
def mean_at(response: Response, tick: int, j: int) -> float:
    """The mean velocity in a period by the angles at its ends."""
    speed: float = response.means[np.uintp(tick & (SPEEDS - 1)), j]
    return speed


@device
def sent(rig: Rig, command: float) -> float:
    """What a command of the last period was for the motors, by its steps."""
    if rig.command_step == 0.0:
        return command
    count = np.rint(command / rig.command_step)
    return rig.command_step * count if abs(count) > 1.0 else 0.0


@device
def advance(
    response: Response,
    answer: Answer,
    rig: Rig,
    tick: int,
    j: int,
    q: float,
    v: float,
    w: float,
) -> tuple[float, float, float]:
    """One actuator a period of readings later, from the end of period `tick` on, by an answer."""
    latency, lag = answer.found[0], rig.lag_ratio[j] * exp(answer.found[2])
    a, gain = rig.acceleration[j] * exp(answer.found[1]), exp(answer.gain[j])
    whole = int(latency / rig.period_s + 1e-9)
    rest = latency - whole * rig.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, j)
        q, v, w = follow_pace(q, v, w, u, pace_of(lag, answer.found[3], a, rest))
    u, time = gain * command_at(response, tick - whole, j), rig.period_s - rest
    return follow_pace(q, v, w, u, pace_of(lag, answer.found[3], a, time))


@device
def when_next_acts(
    response: Response, rig: Rig, tick: int, j: int, q: float, v: float, latency: float
) -> tuple[float, float, float]:
    """Angle, velocity and acceleration, as they will be read, when the next command begins to act.

    Args:
        response: what is known.
        rig: what is known of the head.
        tick: the period that has ended.
        j: which actuator.
        q: its angle as it is read now, rad.
        v: its velocity, rad/s.
        latency: after which time that is, s.
    """
    answer = answer_of(response)
    lag, build_up = rig.lag_ratio[j] * exp(answer.found[2]), answer.found[3]
    a, gain = rig.acceleration[j] * exp(answer.found[1]), exp(answer.gain[j])
    w = response.accelerations[j]
    whole = int(latency / rig.period_s + 1e-9)
    rest = latency - whole * rig.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, j)
        q, v, w = follow_pace(q, v, w, u, pace_of(lag, build_up, a, rest))
    pace = pace_of(lag, build_up, a, rig.period_s)
    for i in range(whole):
        u = gain * command_at(response, tick - whole + i, j)
        q, v, w = follow_pace(q, v, w, u, pace)
    return q, v, w
