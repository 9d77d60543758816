r"""How the actuators answer their commands: latency, lag, acceleration and gain, found on line.

In the time in which joints are read, an actuator follows its commands by

    dv/dt = clip((g u(t - L) - v) / lag, -a, a),   dq/dt = v

L being the latency of the command and that of the reading together, g the actuator's speed gain and
a a ratio of what the head's limits say. What is to be known of them is in the readings while
something moves: over a window of the last periods, the motion that the model gives is fitted to
them by one step of Gauss and Newton in each period, with the knowledge from before the window as a
prior. The readings are speeds where these are known to be prompt, see
`vergence.controllers.prediction.observer`, and else mean speeds from angle to angle: a filter of
speeds would count as lag. L, the ratio and the lag are those of the head, which the four actuators
share; each has a gain of its own, which is eliminated (Schur). As the response to a latency beyond
the window's first command has no slope, a few other answers are tried in each period while the fit
is bad, and the best one is gone on from.

What is left of a period's residuals widens the covariance: a head that moves otherwise than this
model is not one that is known well.
"""

from math import exp, isfinite, log
from typing import Annotated, Final

import numpy as np

from vergence._jit import device, subroutine
from vergence.controllers.prediction.joints import Rig
from vergence.models.joint_response import follow_joint, share_left
from vergence.models.parts import FloatArray

COMMANDS: Final = 64
"""Commands of so many periods are remembered."""
SPEEDS: Final = 32
"""Velocities of so many periods are."""
LONGEST_S: Final = 0.06
"""The longest latency of command and reading together."""
_WINDOW_S: Final = 0.117
_LEAST_WINDOW: Final = 8
_LATENCY_SD_S: Final = 0.012
"""How far a head's latency may be from what its model says, standard deviation."""
_MORE_S: Final = 0.01
"""How much longer it is than a model that counts none says, on average."""
_RATIO_SD: Final = 0.35
"""Standard deviation of the logarithm of the acceleration by the model's."""
_LAG_SD: Final = 0.45
"""That of the lag."""
_GAIN_SD: Final = 0.08
"""That of the gain."""
_LEAST_LAG_S: Final = 0.004
_LAGS_S: Final = (0.004, 0.12)
_RATIOS: Final = (0.15, 120.0)
_MOST_GAIN: Final = 0.3
_MOVING_RAD_S: Final = 0.05
_EXCITED_RAD_S: Final = 0.3
_SPEED_SD: Final = 0.03
"""What the model leaves in a velocity, rad/s, and as a share of it."""
_SURE_S: Final = 0.0015
_SURE_RATIO: Final = 0.06
_GOOD: Final = 2.0
"""Mean squared residual, by its variance, of a fit that needs no other answer."""
_SPACING_S: Final = 0.004
_TRIED: Final = 15
_FASTER: Final = (3.0, 9.0, 27.0, 81.0)
"""Accelerations by the model's that are tried too, with lags of these."""
_FASTER_LAGS_S: Final = (0.008, 0.016, 0.03, 0.06)
_BETTER: Final = 3.0
_FLOORS: Final = (0.0008, 0.03, 0.05)
"""Standard deviations below which no window brings the prior."""
_LIMITS: Final = (0.006, 0.25, 0.25)
"""The longest steps."""
_DIFFERENCES: Final = (0.5e-3, 0.02, 0.02, 0.02)


class Response:
    """What is known of a head's response.

    (3,) are its latency, s, and the logarithms of its acceleration ratio and of its lag, s.
    """

    found: Annotated[FloatArray, 3]
    variance: Annotated[FloatArray, 3]
    prior: Annotated[FloatArray, 3]
    """As it was known before the window."""
    information: Annotated[FloatArray, 3]
    """Inverse variances of that."""
    gain: Annotated[FloatArray, 4]
    """Logarithms of the actuators' speed gains."""
    gain_prior: Annotated[FloatArray, 4]
    misfit: float
    """Mean squared residual of the last fit, by its variance."""
    windows: float
    """How many windows have ended."""
    begun: float
    """The count of periods at which the window begins; negative for none."""
    commands: Annotated[FloatArray, COMMANDS, 4]
    """The commands by period, rad/s, a ring in which period k has the place k modulo its length."""
    speeds: Annotated[FloatArray, SPEEDS, 4]
    """The actuators' velocities at the end of each period: as read where that is prompt, else as
    observed, rad/s."""
    prompt: float
    """Whether they are read without delay: 1 or 0."""
    means: Annotated[FloatArray, SPEEDS, 4]
    """Their mean velocities in each period by the angles that were read, rad/s."""
    angles: Annotated[FloatArray, 4]
    """The angles that were read last, rad."""


def first_response(latency_s: float, lag_s: float, learn: bool) -> dict[str, object]:
    """What is known of a head's response before it has moved.

    Args:
        latency_s: the latency of commands and readings that its model says.
        lag_s: its lag.
        learn: whether it may be otherwise.
    """
    latency = latency_s if latency_s > 0.0 or not learn else _MORE_S
    known = (latency, 0.0, log(max(lag_s, _LEAST_LAG_S)))
    sds = np.array([_LATENCY_SD_S, _RATIO_SD, _LAG_SD])
    return {
        "found": known,
        "prior": known,
        "variance": sds**2 if learn else np.zeros(3),
        "information": 1.0 / sds**2,
        "begun": -1.0,
        "misfit": 1.0,
    }


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
def _mean_step(rig: Rig, j: int) -> float:
    """What the encoder's steps leave of a mean velocity, standard deviation, rad/s."""
    return 0.4 * float(rig.angle_step[j]) / rig.period_s


@device
def sent(rig: Rig, command: float) -> float:
    """What a command of the last period was for the motors, by its steps."""
    if rig.command_step == 0.0:
        return command
    count = np.rint(command / rig.command_step)
    return rig.command_step * count if abs(count) > 1.0 else 0.0


@device
def advance(
    response: Response, rig: Rig, tick: int, j: int, q: float, v: float
) -> tuple[float, float]:
    """One actuator a period of readings later, from the end of period `tick` on."""
    latency, lag = response.found[0], rig.lag_ratio[j] * exp(response.found[2])
    a, gain = rig.acceleration[j] * exp(response.found[1]), exp(response.gain[j])
    whole = int(latency / rig.period_s + 1e-9)
    rest = latency - whole * rig.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, j)
        q, v = follow_joint(q, v, u, lag, a, rest, share_left(rest, lag))
    u, time = gain * command_at(response, tick - whole, j), rig.period_s - rest
    return follow_joint(q, v, u, lag, a, time, share_left(time, lag))


@device
def when_next_acts(
    response: Response, rig: Rig, tick: int, j: int, q: float, v: float, latency: float
) -> tuple[float, float]:
    """Angle and velocity, as they will be read, when the next command begins to act.

    Args:
        response: what is known.
        rig: what is known of the head.
        tick: the period that has ended.
        j: which actuator.
        q: its angle as it is read now, rad.
        v: its velocity, rad/s.
        latency: after which time that is, s.
    """
    lag = rig.lag_ratio[j] * exp(response.found[2])
    a, gain = rig.acceleration[j] * exp(response.found[1]), exp(response.gain[j])
    whole = int(latency / rig.period_s + 1e-9)
    rest = latency - whole * rig.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, j)
        q, v = follow_joint(q, v, u, lag, a, rest, share_left(rest, lag))
    left = share_left(rig.period_s, lag)
    for i in range(whole):
        u = gain * command_at(response, tick - whole + i, j)
        q, v = follow_joint(q, v, u, lag, a, rig.period_s, left)
    return q, v


@device
def _is_moving(response: Response, tick: int) -> bool:
    """Whether anything moves, or has been told to lately."""
    for j in range(4):
        if abs(speed_at(response, tick, j)) > _MOVING_RAD_S:
            return True
        for i in range(8):
            if command_at(response, tick - 1 - i, j) != 0.0:
                return True
    return False


@device
def _is_excited(response: Response, first: int, tick: int, j: int) -> bool:
    """Whether an actuator's commands have changed enough to be learned from."""
    begin, most = speed_at(response, first, j), 0.0
    for i in range(first - 8, tick):
        most = max(most, abs(command_at(response, i, j) - begin))
    return most >= _EXCITED_RAD_S


@subroutine
def _misfit(
    response: Response, rig: Rig, tick: int, latency: float, ratio: float, lag_s: float
) -> float:
    """How badly an answer explains the window, as a logarithm of its likelihood."""
    first = int(response.begun)
    off = (
        latency - response.prior[0], ratio - response.prior[1], lag_s - response.prior[2]
    )  # fmt: skip
    total = 0.0
    for i in range(3):
        total += off[i] * off[i] * response.information[i]
    period, whole = rig.period_s, int(latency / rig.period_s + 1e-9)
    rest = latency - whole * period
    for j in range(4):
        v, gain = speed_at(response, first, j), exp(response.gain[j])
        lag, a = rig.lag_ratio[j] * exp(lag_s), rig.acceleration[j] * exp(ratio)
        before, after = share_left(rest, lag), share_left(period - rest, lag)
        mean_sd = _mean_step(rig, j)
        for i in range(first, tick):
            u = gain * command_at(response, i - whole - 1, j)
            q, v = follow_joint(0.0, v, u, lag, a, rest, before)
            u = gain * command_at(response, i - whole, j)
            q, v = follow_joint(q, v, u, lag, a, period - rest, after)
            read, told, step_sd = mean_at(response, i + 1, j), q / period, mean_sd
            if response.prompt > 0.5:
                read, told, step_sd = speed_at(response, i + 1, j), v, rig.speed_step[j]
            spread = step_sd * step_sd + 0.05**2 + 0.01 * read * read
            total += min((read - told) ** 2 / spread, 30.0)
    return total


@subroutine
def _try_others(response: Response, rig: Rig, tick: int, free: bool) -> None:
    """Go on from another answer where that explains the window better."""
    best = _misfit(response, rig, tick, response.found[0], response.found[1], response.found[2])
    best -= _BETTER
    for i in range(_TRIED if free else 0):
        found = _misfit(response, rig, tick, _SPACING_S * i, response.found[1], response.found[2])
        if found < best:
            best, response.found[0] = found, _SPACING_S * i
    for m in range(8):  # of 72, in nine periods
        i = (8 * tick + m) % 72
        latency, ratio = 0.008 * (i % 6), log(0.4) + 0.5 * (i // 6 % 3)
        lag = log(0.016) + 0.45 * (i // 18)
        found = _misfit(response, rig, tick, latency, ratio, lag)
        if found < best:
            best = found
            response.found[0], response.found[1], response.found[2] = latency, ratio, lag
    latency = response.found[0]
    for m in range(2):  # of 16, in eight periods: motors that a model knows nothing of
        i = (2 * tick + m) % 16
        ratio, lag = log(_FASTER[i % 4]), log(_FASTER_LAGS_S[i // 4])
        found = _misfit(response, rig, tick, latency, ratio, lag)
        if found < best:
            best, response.found[1], response.found[2] = found, ratio, lag


@device
def _solve(matrix: FloatArray, right: FloatArray, out: FloatArray) -> None:
    """Three equations with a positive definite matrix, by elimination."""
    m, y = matrix.copy(), right.copy()
    for i in range(3):
        for r in range(i + 1, 3):
            factor = m[r, i] / m[i, i]
            for c in range(i, 3):
                m[r, c] -= factor * m[i, c]
            y[r] -= factor * y[i]
    for i in range(2, -1, -1):
        rest = y[i]
        for c in range(i + 1, 3):
            rest -= m[i, c] * out[c]
        out[i] = rest / m[i, i]


@subroutine
def _fit(response: Response, rig: Rig, tick: int) -> None:
    """One step of Gauss and Newton on the window."""
    first, period = int(response.begun), rig.period_s
    normal, right = np.zeros((3, 3)), np.zeros(3)
    mixed, own, own_right = np.zeros((4, 3)), np.zeros(4), np.zeros(4)
    v, ways, decays, model = np.zeros(5), np.zeros(5), np.zeros((5, 2)), np.zeros((5, 4))
    holds, slope = np.zeros(5, dtype=np.int64), np.zeros(4)
    for i in range(3):
        normal[i, i] = response.information[i]
        right[i] = response.information[i] * (response.prior[i] - response.found[i])
    misfit = count = 0.0
    for j in range(4):
        own[j] = 1.0 / _GAIN_SD**2
        own_right[j] = own[j] * (response.gain_prior[j] - response.gain[j])
        if not (rig.speed[j] > 0.0 and _is_excited(response, first, tick, j)):
            continue
        for m in range(5):  # as it is, and with one of the four a little greater
            latency = response.found[0] + (_DIFFERENCES[0] if m == 1 else 0.0)
            ratio = response.found[1] + (_DIFFERENCES[1] if m == 2 else 0.0)
            lag = response.found[2] + (_DIFFERENCES[2] if m == 3 else 0.0)
            gain = response.gain[j] + (_DIFFERENCES[3] if m == 4 else 0.0)
            holds[m] = int(latency / period + 1e-9)
            rest, lag_s = latency - holds[m] * period, rig.lag_ratio[j] * exp(lag)
            model[m, 0], model[m, 1] = rest, lag_s
            model[m, 2], model[m, 3] = rig.acceleration[j] * exp(ratio), exp(gain)
            decays[m, 0], decays[m, 1] = share_left(rest, lag_s), share_left(period - rest, lag_s)
            v[m] = speed_at(response, first, j)
        for i in range(first, tick):
            for m in range(5):
                rest, lag_s, a, gain = model[m, 0], model[m, 1], model[m, 2], model[m, 3]
                u = gain * command_at(response, i - holds[m] - 1, j)
                way, speed = follow_joint(0.0, v[m], u, lag_s, a, rest, decays[m, 0])
                u = gain * command_at(response, i - holds[m], j)
                way, v[m] = follow_joint(way, speed, u, lag_s, a, period - rest, decays[m, 1])
                ways[m] = way / period
            read, step_sd, told = mean_at(response, i + 1, j), _mean_step(rig, j), ways
            if response.prompt > 0.5:
                read, step_sd, told = speed_at(response, i + 1, j), rig.speed_step[j], v
            off = read - told[0]
            spread = step_sd * step_sd + _SPEED_SD**2 * (1.0 + read * read)
            share = off * off / spread
            misfit, count = misfit + min(share, 100.0), count + 1.0
            # as in Cauchy's law of errors: what fits nothing counts for little
            weight = 1.0 / spread / (1.0 + share / 9.0)
            for m in range(4):
                slope[m] = (told[m + 1] - told[0]) / _DIFFERENCES[m]
            for r in range(3):
                right[r] += weight * slope[r] * off
                mixed[j, r] += weight * slope[r] * slope[3]
                for c in range(3):
                    normal[r, c] += weight * slope[r] * slope[c]
            own[j] += weight * slope[3] * slope[3]
            own_right[j] += weight * slope[3] * off
    for j in range(4):
        for r in range(3):
            right[r] -= mixed[j, r] * own_right[j] / own[j]
            for c in range(3):
                normal[r, c] -= mixed[j, r] * mixed[j, c] / own[j]
    step, unit, column = np.zeros(3), np.zeros(3), np.zeros(3)
    _solve(normal, right, step)
    if not isfinite(step[0] + step[1] + step[2]):  # what is so far off has no slope
        return
    least = (0.0, log(_RATIOS[0]), log(_LAGS_S[0]))
    most = (LONGEST_S, log(_RATIOS[1]), log(_LAGS_S[1]))
    response.misfit = misfit / max(count, 1.0)
    worse = max(1.0, response.misfit)
    for i in range(3):
        found = response.found[i] + min(max(step[i], -_LIMITS[i]), _LIMITS[i])
        response.found[i] = min(max(found, least[i]), most[i])
        for r in range(3):
            unit[r] = 1.0 if r == i else 0.0
        _solve(normal, unit, column)
        response.variance[i] = worse * column[i]
    for j in range(4):
        change = own_right[j]
        for r in range(3):
            change -= mixed[j, r] * step[r]
        gain = response.gain[j] + min(max(change / own[j], -0.1), 0.1)
        response.gain[j] = min(max(gain, -_MOST_GAIN), _MOST_GAIN)


@device
def learn_response(response: Response, rig: Rig, tick: int) -> None:
    """Bring what is known of the response up to date with the readings of a period.

    Args:
        response: changed in place.
        rig: what is known of the head.
        tick: the period that has ended; its commands and velocities are remembered.
    """
    moving = _is_moving(response, tick)
    if response.begun < 0.0:
        if not moving:
            return
        response.begun = tick - 1.0
    first = int(response.begun)
    window = min(max(int(_WINDOW_S / rig.period_s + 0.5), _LEAST_WINDOW), SPEEDS - 4)
    ends = tick - first >= window or not moving
    excited = False
    for j in range(4):
        excited = excited or (rig.speed[j] > 0.0 and _is_excited(response, first, tick, j))
    # what is well known is brought up to date once a window
    sure = response.variance[0] < _SURE_S**2 and response.misfit < _GOOD
    if excited and (ends or not sure or response.variance[1] > _SURE_RATIO**2):
        if not sure:
            _try_others(response, rig, tick, response.variance[0] > _SURE_S**2)
        _fit(response, rig, tick)
    if ends:
        for i in range(3):
            response.prior[i] = response.found[i]
            variance = max(1.2 * response.variance[i], _FLOORS[i] ** 2)
            response.information[i] = 1.0 / variance
        for j in range(4):
            response.gain_prior[j] = response.gain[j]
        response.begun = -1.0
        response.windows += 1.0
