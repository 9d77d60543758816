r"""Response of the actuators to their commands: latency, lag, acceleration limit and speed gain.

On the clock of the joint readings, an actuator follows its command u by

    m l^2 dw/dt + l w + v = g u(t - L),   dv/dt = w,   dq/dt = v,   |w| <= a

L is the latency of commands plus that of readings, l the lag, m its build-up and g the actuator's
speed gain; a is the acceleration limit, estimated as a ratio to the limit in the head's model. L,
the ratio, the lag and the build-up are common to the four actuators; each has its own gain.

Two models are fitted side by side, see `vergence.controllers.prediction.fitting`: a
plain one with a first-order lag, m = 0, and one with a second-order lag, for a servo with an
underdamped loop. The second one is used once it explains the readings better by more than chance.
"""

from math import exp, log
from typing import Annotated, Final

import numpy as np

from vergence.controllers.prediction.joints import PredictorParameters
from vergence.kernels import inlined
from vergence.models.motion import follow_held_command, prepare_held_response
from vergence.models.parts import FloatArray

COMMAND_RING_LENGTH: Final = 128
"""Number of past commands in the ring buffer, a power of two (numerical)."""
SPEED_RING_LENGTH: Final = 32
"""Number of past velocities in the ring buffer, a power of two (numerical)."""
MAX_RESPONSE_LATENCY_S: Final = 0.12
"""Longest latency of commands plus readings, s, unless the head's model has a longer one
(chosen)."""
FIRST_ORDER: Final = 0
"""Index of the model without build-up (numerical)."""
SECOND_ORDER: Final = 1
"""Index of the model with build-up (numerical)."""
RESPONSE_MODELS: Final = 2
"""Number of response models (numerical)."""
_LATENCY_SD_S: Final = 0.012
"""Prior standard deviation of the latency about its nominal value, s (chosen)."""
_FALLBACK_LATENCY_S: Final = 0.01
"""Prior mean of the latency if the head's model has none, s (chosen)."""
_LOG_ACCELERATION_SD: Final = 0.35
"""Prior standard deviation of the log acceleration ratio (chosen)."""
_LOG_LAG_SD: Final = 0.45
"""Prior standard deviation of the log lag (chosen)."""
_PRIOR_BUILD_UP: Final = 0.8
"""Prior mean of the build-up in the model that has one: a servo with 12 % overshoot (chosen)."""
_BUILD_UP_SD: Final = 0.7
"""Prior standard deviation of the build-up (chosen)."""
_MIN_PRIOR_LAG_S: Final = 0.004
"""Lower bound of the prior lag, s (chosen)."""


class ResponseModel:
    """One fitted model of the actuators' response.

    Arrays of four that hold parameters are: latency in s, log acceleration ratio, log lag (of s),
    and build-up. Gains and accelerations are by actuator.
    """

    parameters: Annotated[FloatArray, 4]
    """Estimated parameters."""
    variance: Annotated[FloatArray, 4]
    """Their variances."""
    prior: Annotated[FloatArray, 4]
    """Parameters before the present window."""
    information: Annotated[FloatArray, 4]
    """Inverse variances of `prior`."""
    log_gain: Annotated[FloatArray, 4]
    """Logarithms of the actuators' speed gains."""
    log_gain_prior: Annotated[FloatArray, 4]
    """These logarithms before the present window."""
    accelerations: Annotated[FloatArray, 4]
    """Actuator accelerations at the start of the window, rad/s^2."""
    misfit: float
    """Mean squared normalised residual of the last fit."""
    squared_residual_sum: float
    """Sum of the squared normalised residuals of the last fit."""


class ResponseIdentification:
    """State of the on-line identification of the actuators' response."""

    models: Annotated[list[ResponseModel], RESPONSE_MODELS]
    selected: float
    """Index of the model in use."""
    second_order_evidence: float
    """Decayed excess, over earlier windows, of the plain model's squared normalised residuals over
    those of the model with build-up."""
    windows: float
    """Number of windows that have ended."""
    window_begin: float
    """Period at which the present window begins; negative for none."""
    window_end: float
    """Period at which the previous window ended."""
    commands: Annotated[FloatArray, COMMAND_RING_LENGTH, 4]
    """Ring buffer of commands, rad/s; period k is at index k modulo its length."""
    speeds: Annotated[FloatArray, SPEED_RING_LENGTH, 4]
    """Ring buffer of actuator velocities at the end of each period, rad/s: measured if the readings
    are prompt, otherwise estimated by the observer."""
    accelerations: Annotated[FloatArray, 4]
    """Present accelerations predicted from the commands, rad/s^2."""
    prompt_velocities: float
    """1 if velocities are read without delay, otherwise 0."""
    mean_speeds: Annotated[FloatArray, SPEED_RING_LENGTH, 4]
    """Ring buffer of mean velocities in each period, from differences of measured angles, rad/s."""
    angles: Annotated[FloatArray, 4]
    """Last measured angles, rad."""


def initial_response_models(
    response_latency_s: float, lag_s: float, learn: bool
) -> dict[str, object]:
    """Initial fields of the `RESPONSE_MODELS`, before the head has moved.

    Args:
        response_latency_s: nominal latency of commands plus readings, s.
        lag_s: nominal lag, s.
        learn: True to identify the response; False gives the nominal values zero variance.
    """
    latency = response_latency_s if response_latency_s > 0.0 or not learn else _FALLBACK_LATENCY_S
    plain = (latency, 0.0, log(max(lag_s, _MIN_PRIOR_LAG_S)), 0.0)
    known = [plain, (*plain[:3], _PRIOR_BUILD_UP)]
    sds = np.array([_LATENCY_SD_S, _LOG_ACCELERATION_SD, _LOG_LAG_SD, _BUILD_UP_SD])
    return {
        "parameters": known,
        "prior": known,
        "variance": sds**2 if learn else np.zeros(4),
        "information": 1.0 / sds**2,
        "misfit": 1.0,
    }


@inlined
def selected_model(response: ResponseIdentification) -> ResponseModel:
    """Return the response model in use."""
    return response.models[np.intp(response.selected)]


@inlined
def max_response_latency(params: PredictorParameters) -> float:
    """Longest latency of commands plus readings that is considered, s.

    The ring buffer holds the commands of a window of readings and of this latency before it.
    """
    return min(
        max(MAX_RESPONSE_LATENCY_S, params.response_latency_s),
        params.period_s * (COMMAND_RING_LENGTH - SPEED_RING_LENGTH),
    )


@inlined
def command_at(response: ResponseIdentification, tick: int, j: int) -> float:
    """Return an actuator's command in a period, rad/s."""
    command: float = response.commands[np.uintp(tick & (COMMAND_RING_LENGTH - 1)), j]
    return command


@inlined
def speed_at(response: ResponseIdentification, tick: int, j: int) -> float:
    """Return an actuator's velocity at the end of a period, rad/s."""
    speed: float = response.speeds[np.uintp(tick & (SPEED_RING_LENGTH - 1)), j]
    return speed


@inlined
def mean_speed_at(response: ResponseIdentification, tick: int, j: int) -> float:
    """Return an actuator's mean velocity in a period, from measured angles, rad/s."""
    speed: float = response.mean_speeds[np.uintp(tick & (SPEED_RING_LENGTH - 1)), j]
    return speed


@inlined
def quantise_with_dead_zone(params: PredictorParameters, command: float) -> float:
    """Quantise a command to the motors' resolution; one single step counts as zero."""
    if params.command_step == 0.0:
        return command
    count = np.rint(command / params.command_step)
    return params.command_step * count if abs(count) > 1.0 else 0.0


@inlined
def simulate_period(
    response: ResponseIdentification,
    model: ResponseModel,
    params: PredictorParameters,
    tick: int,
    actuator: int,
    angle: float,
    velocity: float,
    acceleration: float,
) -> tuple[float, float, float]:
    """Simulate one actuator with a response model over one period, from the end of period `tick`.

    Return its angle, velocity and acceleration at the end.
    """
    latency, lag = model.parameters[0], params.lag_ratio[actuator] * exp(model.parameters[2])
    a, gain = (
        params.acceleration_limit[actuator] * exp(model.parameters[1]),
        exp(model.log_gain[actuator]),
    )
    whole = int(latency / params.period_s + 1e-9)
    rest = latency - whole * params.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, actuator)
        angle, velocity, acceleration = follow_held_command(
            angle,
            velocity,
            acceleration,
            u,
            prepare_held_response(lag, model.parameters[3], a, rest),
        )
    u, time = gain * command_at(response, tick - whole, actuator), params.period_s - rest
    return follow_held_command(
        angle, velocity, acceleration, u, prepare_held_response(lag, model.parameters[3], a, time)
    )


@inlined
def state_at_command_effect(
    response: ResponseIdentification,
    params: PredictorParameters,
    tick: int,
    j: int,
    q: float,
    v: float,
    latency: float,
) -> tuple[float, float, float]:
    """Predict an actuator's state at the time the next command begins to act.

    Returns angle, velocity and acceleration on the clock of the readings.

    Args:
        response: state of the identification.
        params: the head's parameters.
        tick: the period that has ended.
        j: index of the actuator.
        q: its present angle, rad.
        v: its present velocity, rad/s.
        latency: time until the command acts, s.
    """
    model = selected_model(response)
    lag, build_up = params.lag_ratio[j] * exp(model.parameters[2]), model.parameters[3]
    a, gain = params.acceleration_limit[j] * exp(model.parameters[1]), exp(model.log_gain[j])
    w = response.accelerations[j]
    whole = int(latency / params.period_s + 1e-9)
    rest = latency - whole * params.period_s
    if rest > 1e-9:
        u = gain * command_at(response, tick - whole - 1, j)
        q, v, w = follow_held_command(q, v, w, u, prepare_held_response(lag, build_up, a, rest))
    held = prepare_held_response(lag, build_up, a, params.period_s)
    for i in range(whole):
        u = gain * command_at(response, tick - whole + i, j)
        q, v, w = follow_held_command(q, v, w, u, held)
    return q, v, w
