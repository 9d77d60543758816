"""Input channels of a network for each actuator of the eyes, and the kernels that compute them.

If each of the four eye joints has its own motor, an actuator is a joint.
"""

from math import log
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.networks.history import HISTORY_CHANNELS
from vergence.controllers.networks.resolutions import (
    COARSE_RAD,
    FINE_RAD,
    LOG_RAD,
    LOG_SPEED,
    MIDDLE_RAD,
    clip_to_unit,
    symlog_scaled,
)
from vergence.kernels import inlined, kernel
from vergence.models.parts import FloatArray

MAX_TO_GO_SHARE: Final = 2.0
"""Saturation of the ratio `to_go_share` (chosen)."""
MAX_LATENCY_S: Final = 0.1
"""Saturation of lags and latencies, s (chosen)."""
MAX_LATENCY_SD_S: Final = 0.02
"""Saturation of the latency's standard deviation, s (chosen)."""
MAX_ACCELERATION_RATIO: Final = 4.0
"""Saturation of the acceleration ratio, and of its inverse (chosen)."""
MAX_SPEED_GAIN: Final = 1.5
"""Saturation of the speed gain, and of its inverse (chosen)."""
MIN_REQUESTED_RAD: Final = 1e-5
"""Lower bound of the divisor in `to_go_share`, rad (numerical)."""


class _Error(NamedTuple):
    """Channels of one actuator from the newest image alone."""

    asked: float
    asked_log: float
    visible: float


class _Share(NamedTuple):
    """Channels that compare the remaining turn with the turn requested by the newest image."""

    asked: float
    asked_log: float
    to_go_share: float


class _Present(NamedTuple):
    """Channels of one actuator's present state."""

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
"""Channels of the kinds with values per actuator of the eyes.

| channel | meaning |
| --- | --- |
| `asked` | turn requested by the newest image's error / 1.5 rad; `_log` with x0 = 1 mrad |
| `visible` | 1 if an eye that it moves sees the target, otherwise 0 |
| `to_go` | remaining turn from the present angle / 1.5 rad; `_log` with x0 = 1 mrad |
| `to_go_middle`, `to_go_fine` | remaining turn / 0.1 and 0.01 rad, saturated |
| `to_go_share` | remaining turn / requested turn / 2, saturated |
| `to_rest_...` | turn that would remain after coming to rest under zero command |
| `velocity` | velocity / largest command; `_log` with x0 = 0.005 |
| `command` | present command / largest command |
| `lag` | estimated lag / 0.1 s |
| `acceleration` | log of the ratio of estimated to modelled acceleration limit / ln 4 |
| `acceleration_sd` | standard deviation of that logarithm |
| `gain` | log of the estimated ratio of velocity to command / ln 1.5 |
| `latency` | estimated latency of commands plus readings / 0.1 s |
| `latency_sd` | its standard deviation / 0.02 s |
| `rate` | growth rate of the remaining turn while it rests / largest command: a moving target |
| `later_rate` | this rate when a command given now takes effect |
| `known` | 1 if the target of an eye that it moves is known, otherwise 0 |

`error` has no memory except in the outlier gate: it depends only on the newest image that passes
the gate. `history` has no prediction, see `vergence.controllers.networks.history`. `error` and
`predicted` are for gain schedules: their angles and velocities are positive in the direction in
which the law turns the actuator, as the best gain does not depend on that direction.
"""

_ERROR_CHANNELS: Final = len(_Error._fields)
_PRESENT_CHANNELS: Final = len(_Present._fields)


@inlined
def _coasting(v: float, lag: float, a: float) -> float:
    """Signed angle that an actuator turns until it rests under zero command from now on, rad."""
    speed, least = abs(v), a * lag
    turn = speed * lag
    if speed > least:
        # constant deceleration a until the speed is a * lag, exponential decay afterwards
        turn = (speed * speed - least * least) / (2.0 * a) + least * lag
    return turn if v >= 0.0 else -turn


@inlined
def _present(
    to_go: float, v: float, u: float, limit: float, a: float, lag: float, rate: float,
    later_rate: float, gain: float, response_estimate: FloatArray, known: bool,
) -> _Present:  # fmt: skip
    rest, sees = to_go - _coasting(v, lag, response_estimate[0] * a), 1.0 if known else 0.0
    return _Present(
        to_go=clip_to_unit(to_go / COARSE_RAD),
        to_go_log=symlog_scaled(to_go, LOG_RAD, COARSE_RAD),
        to_go_middle=clip_to_unit(to_go / MIDDLE_RAD),
        to_go_fine=clip_to_unit(to_go / FINE_RAD),
        to_rest_log=symlog_scaled(rest, LOG_RAD, COARSE_RAD),
        to_rest_middle=clip_to_unit(rest / MIDDLE_RAD),
        to_rest_fine=clip_to_unit(rest / FINE_RAD),
        velocity=clip_to_unit(v / limit),
        velocity_log=symlog_scaled(v / limit, LOG_SPEED, 1.0),
        command=clip_to_unit(u / limit),
        lag=min(lag / MAX_LATENCY_S, 1.0),
        acceleration=clip_to_unit(log(response_estimate[0]) / log(MAX_ACCELERATION_RATIO)),
        acceleration_sd=min(response_estimate[1], 1.0),
        gain=clip_to_unit(log(gain) / log(MAX_SPEED_GAIN)),
        latency=clip_to_unit(response_estimate[2] / MAX_LATENCY_S),
        latency_sd=min(response_estimate[3] / MAX_LATENCY_SD_S, 1.0),
        rate=clip_to_unit(rate / limit),
        later_rate=clip_to_unit(later_rate / limit),
        known=sees,
    )


@kernel(
    ["(f8[:],b1[:],f8[:,:],f8[:,:])"],
    f"(4),(4),({_ERROR_CHANNELS},4)->({_ERROR_CHANNELS},4)",
)
def error_channels(
    requested_turn: FloatArray, visible: NDArray[np.bool_], shape_only: FloatArray, out: FloatArray
) -> None:
    """Compute the channels of `error`.

    Args:
        requested_turn: (..., 4) turns requested by the newest image, rad.
        visible: (..., 4) True if an eye that the actuator moves sees the target.
        shape_only: (channels, 4) array of any values; only its shape counts, which is that of the
            result.
        out: (..., channels, 4) result.
    """
    for j in range(4):
        turn = abs(requested_turn[j])
        error = _Error(
            asked=clip_to_unit(turn / COARSE_RAD),
            asked_log=symlog_scaled(turn, LOG_RAD, COARSE_RAD),
            visible=1.0 if visible[j] else 0.0,
        )
        for c in range(len(error)):
            out[c, j] = error[c]


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:,:],f8[:,:])"],
    "(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(4),(c,4)->(c,4)",
)
def present_channels(
    requested_turn: FloatArray, to_go: FloatArray, velocity: FloatArray, command: FloatArray,
    command_limits: FloatArray, acceleration_limit: FloatArray, lag: FloatArray,
    goal_rate: FloatArray,
    goal_rate_at_effect: FloatArray, speed_gain: FloatArray, response_estimate: FloatArray,
    known: NDArray[np.bool_], shape_only: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Compute the channels of `to_go` or `predicted`, selected by the length of `shape_only`.

    Args:
        requested_turn: (..., 4) turns requested by the newest image, rad.
        to_go: (..., 4) remaining turns, rad.
        velocity: (..., 4) present velocities, rad/s.
        command: (..., 4) present commands, rad/s.
        command_limits: (4,) largest commands, rad/s.
        acceleration_limit: (4,) acceleration limits of the model, rad/s^2.
        lag: (..., 4) lags, s.
        goal_rate: (..., 4) velocities of the goals, rad/s.
        goal_rate_at_effect: (..., 4) velocities of the goals when the command shows, rad/s.
        speed_gain: (..., 4) ratios of velocity to command.
        response_estimate: (..., 4) ratio of the accelerations to the model's, standard deviation of
            its logarithm, latency of commands plus readings, s, and its standard deviation, s.
        known: (..., 4) True if the target of an eye that the actuator moves is known.
        shape_only: (channels, 4) array of any values; only its shape counts, which is that of the
            result.
        out: (..., channels, 4) result.
    """
    # with the channels of `_Share`, signs are relative to the direction of the requested turn
    first = max(out.shape[0] - _PRESENT_CHANNELS, 0)
    for j in range(4):
        if not command_limits[j] > 0.0:  # no such actuator
            for c in range(out.shape[0]):
                out[c, j] = 0.0
            continue
        side = 1.0
        if first > 0:
            side = 1.0 if requested_turn[j] >= 0.0 else -1.0
            turn, left = side * requested_turn[j], side * to_go[j]
            share = _Share(
                asked=clip_to_unit(turn / COARSE_RAD),
                asked_log=symlog_scaled(turn, LOG_RAD, COARSE_RAD),
                to_go_share=clip_to_unit(left / max(turn, MIN_REQUESTED_RAD) / MAX_TO_GO_SHARE),
            )
            for c in range(min(len(share), first)):
                out[c, j] = share[c]
        present = _present(
            side * to_go[j], side * velocity[j], side * command[j], command_limits[j],
            acceleration_limit[j],
            lag[j], side * goal_rate[j], side * goal_rate_at_effect[j], speed_gain[j],
            response_estimate, known[j],
        )  # fmt: skip
        for c in range(min(len(present), out.shape[0])):
            out[first + c, j] = present[c]
