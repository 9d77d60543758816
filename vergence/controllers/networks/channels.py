"""What a network sees of each actuator of the eyes, and the kernels that compute it.

Where each of the four eye joints has a motor of its own, an actuator is a joint.
"""

from math import log
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import device, kernel
from vergence.controllers.networks.history import HISTORY_CHANNELS
from vergence.controllers.networks.resolutions import (
    COARSE_RAD,
    FINE_RAD,
    LOG_RAD,
    LOG_SPEED,
    MIDDLE_RAD,
    clip,
    log_scaled,
)
from vergence.models.parts import FloatArray

MOST_SHARE: Final = 2.0
LONGEST_S: Final = 0.1
"""Of lags and of latencies."""
MOST_LATENCY_SD_S: Final = 0.02
MOST_RATIO: Final = 4.0
MOST_GAIN: Final = 1.5
LEAST_ASKED_RAD: Final = 1e-5


class _Error(NamedTuple):
    """What the newest image says of one actuator."""

    asked: float
    asked_log: float
    visible: float


class _Share(NamedTuple):
    """How the turn that is left compares with the one that the newest image asks for."""

    asked: float
    asked_log: float
    to_go_share: float


class _Present(NamedTuple):
    """Where one actuator stands now."""

    to_go: float
    to_go_log: float
    to_go_middle: float
    to_go_fine: float
    to_rest_log: float
    to_rest_middle: float
    to_rest_fine: float
    velocity: float
    velocity_log: float
    command: float
    lag: float
    acceleration: float
    acceleration_sd: float
    gain: float
    latency: float
    latency_sd: float
    rate: float
    later_rate: float
    known: float


CHANNELS: Final = {
    "error": _Error._fields,
    "predicted": (*_Share._fields, *_Present._fields),
    "to_go": _Present._fields,
    "history": HISTORY_CHANNELS,
}
"""The channels of the kinds that speak of actuators; each exists for every one of the eyes'.

| channel | what it is |
| --- | --- |
| `asked` | the turn that the newest image's error asks for, by 1.5 rad; `_log` from 1 mrad |
| `visible` | whether an eye that it moves sees the target: 1 or 0 |
| `to_go` | the turn that is left from the present angle, by 1.5 rad; `_log` from 1 mrad |
| `to_go_middle`, `to_go_fine` | the same by 0.1 and 0.01 rad, saturated |
| `to_go_share` | the turn that is left by the turn asked for, by 2, saturated |
| `to_rest_...` | the turn that were left if it came to rest under a command of zero |
| `velocity` | its velocity by its greatest command; `_log` from 0.005 of it |
| `command` | the command that holds, by the greatest |
| `lag` | its lag, as estimated, by 0.1 s |
| `acceleration` | logarithm of its greatest acceleration by the model's, as estimated, by ln 4 |
| `acceleration_sd` | the standard deviation of that logarithm |
| `gain` | logarithm of its speed by command, as estimated, by ln 1.5 |
| `latency` | the latency of command and reading together, as estimated, by 0.1 s |
| `latency_sd` | its standard deviation by 0.02 s |
| `rate` | how fast the turn that is left grows while it rests, by its greatest command: that of a \
target that moves |
| `later_rate` | the same when a command that is given now shows |
| `known` | whether it is known where the target of an eye that it moves is: 1 or 0 |

`error` is without memory but for the outlier gate's: it knows the newest image that the gate lets
through, and nothing else. `history` is without any prediction, see
`vergence.controllers.networks.history`. In `error` and `predicted`,
which are for gain schedules, all angles and velocities count in the direction in which the law
turns the actuator: the best gain does not depend on it.
"""

_ERROR_CHANNELS: Final = len(_Error._fields)
_PRESENT_CHANNELS: Final = len(_Present._fields)


@device
def _coasting(v: float, lag: float, a: float) -> float:
    """How far an actuator turns until it rests if its command is zero from now on."""
    speed, least = abs(v), a * lag
    turn = speed * lag
    if speed > least:
        # the limit holds the deceleration until the speed is a lag
        turn = (speed * speed - least * least) / (2.0 * a) + least * lag
    return turn if v >= 0.0 else -turn


@device
def _present(
    to_go: float, v: float, u: float, limit: float, a: float, lag: float, rate: float,
    later_rate: float, gain: float, sure: FloatArray, known: bool,
) -> _Present:  # fmt: skip
    rest, sees = to_go - _coasting(v, lag, sure[0] * a), 1.0 if known else 0.0
    return _Present(
        to_go=clip(to_go / COARSE_RAD),
        to_go_log=log_scaled(to_go, LOG_RAD, COARSE_RAD),
        to_go_middle=clip(to_go / MIDDLE_RAD),
        to_go_fine=clip(to_go / FINE_RAD),
        to_rest_log=log_scaled(rest, LOG_RAD, COARSE_RAD),
        to_rest_middle=clip(rest / MIDDLE_RAD),
        to_rest_fine=clip(rest / FINE_RAD),
        velocity=clip(v / limit),
        velocity_log=log_scaled(v / limit, LOG_SPEED, 1.0),
        command=clip(u / limit),
        lag=min(lag / LONGEST_S, 1.0),
        acceleration=clip(log(sure[0]) / log(MOST_RATIO)),
        acceleration_sd=min(sure[1], 1.0),
        gain=clip(log(gain) / log(MOST_GAIN)),
        latency=clip(sure[2] / LONGEST_S),
        latency_sd=min(sure[3] / MOST_LATENCY_SD_S, 1.0),
        rate=clip(rate / limit),
        later_rate=clip(later_rate / limit),
        known=sees,
    )


@kernel(
    ["(f8[:],b1[:],f8[:,:],f8[:,:])"],
    f"(4),(4),({_ERROR_CHANNELS},4)->({_ERROR_CHANNELS},4)",
)
def see_error(
    asked: FloatArray, visible: NDArray[np.bool_], shape: FloatArray, out: FloatArray
) -> None:
    """The channels of `error`.

    Args:
        asked: (..., 4) turns that the newest image asks for, rad.
        visible: (..., 4) whether an eye that each actuator moves sees the target.
        shape: (channels, 4) any numbers; its shape is that of the result.
        out: (..., channels, 4), the result.
    """
    for j in range(4):
        turn = abs(asked[j])
        error = _Error(
            asked=clip(turn / COARSE_RAD),
            asked_log=log_scaled(turn, LOG_RAD, COARSE_RAD),
            visible=1.0 if visible[j] else 0.0,
        )
        for c in range(len(error)):
            out[c, j] = error[c]


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:,:],f8[:,:])"],
    "(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(c,4)->(c,4)",
)
def see_present(
    asked: FloatArray, to_go: FloatArray, velocity: FloatArray, command: FloatArray,
    limits: FloatArray, acceleration: FloatArray, lag: FloatArray, rate: FloatArray,
    later_rate: FloatArray, gain: FloatArray, sure: FloatArray, known: NDArray[np.bool_],
    shape: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """The channels of `to_go` or of `predicted`, by the length of `shape`.

    Args:
        asked: (..., 4) turns that the newest image asks for, rad.
        to_go: (..., 4) turns that are left now, rad.
        velocity: (..., 4) present velocities, rad/s.
        command: (..., 4) commands that hold, rad/s.
        limits: (4,) greatest commands, rad/s.
        acceleration: (4,) greatest accelerations by the model, rad/s^2.
        lag: (..., 4) lags, s.
        rate: (..., 4) velocities of the goals, rad/s.
        later_rate: (..., 4) the same when the command shows, rad/s.
        gain: (..., 4) speeds by commands.
        sure: (..., 4) accelerations by the model's, the standard deviation of their logarithm,
            the latency of command and reading and its standard deviation, s.
        known: (..., 4) whether it is known where the target of an eye is that each moves.
        shape: (channels, 4) any numbers; its shape is that of the result.
        out: (..., channels, 4), the result.
    """
    # with the channels of what is asked for, all counts in the direction in which it is asked
    first = max(out.shape[0] - _PRESENT_CHANNELS, 0)
    for j in range(4):
        if not limits[j] > 0.0:  # no such actuator
            for c in range(out.shape[0]):
                out[c, j] = 0.0
            continue
        side = 1.0
        if first > 0:
            side = 1.0 if asked[j] >= 0.0 else -1.0
            turn, left = side * asked[j], side * to_go[j]
            share = _Share(
                asked=clip(turn / COARSE_RAD),
                asked_log=log_scaled(turn, LOG_RAD, COARSE_RAD),
                to_go_share=clip(left / max(turn, LEAST_ASKED_RAD) / MOST_SHARE),
            )
            for c in range(min(len(share), first)):
                out[c, j] = share[c]
        present = _present(
            side * to_go[j], side * velocity[j], side * command[j], limits[j], acceleration[j],
            lag[j], side * rate[j], side * later_rate[j], gain[j], sure, known[j],
        )  # fmt: skip
        for c in range(min(len(present), out.shape[0])):
            out[first + c, j] = present[c]
