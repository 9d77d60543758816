"""Response of the actuators to their commands: latency, lag, acceleration limit and speed gain.

On the clock of the joint readings, an actuator follows its command u by

    m l^2 dw/dt + l w + v = g u(t - L),   dv/dt = w,   dq/dt = v,   |w| <= a

L is the latency of commands plus that of readings, l the lag, m its build-up and g the actuator's
speed gain; a is the acceleration limit, estimated as a ratio to the limit in the head's model. L,
the ratio, the lag and the build-up are common to the four actuators; each has its own gain.

Two models are fitted on line, side by side: a plain one with a first-order lag, m = 0, and one with
a second-order lag, for a servo with an underdamped loop. The second one is used once it explains
the readings better by more than chance. In each period in which something moves, one Gauss-Newton
step fits the motion simulated with the model parameters to the readings of a window of recent
periods; the posterior of earlier windows is the prior. The fitted readings are the velocities if
these are known to be prompt (`vergence.controllers.prediction.state`), otherwise mean velocities
from differences of angles, because a low-pass filter in the velocity feedback would be mistaken for
lag. The actuators' speed gains are eliminated by a Schur complement. The cost has no slope in a
latency that exceeds the age of the window's first command. Therefore a few other parameter values
are tried in each period while the fit is bad, and the fit continues from the best one. The
residuals widen the covariance: a head that does not move as the model says is not well known.
"""

from math import exp, isfinite, log
from typing import Annotated, Final, NamedTuple

import numpy as np

from vergence.controllers.prediction.parameters import PredictorParameters
from vergence.kernels import inlined, subroutine
from vergence.models.motion import HeldResponse, follow_held_command, prepare_held_response
from vergence.models.parts import FloatArray

FIRST_ORDER: Final = 0
"""Index of the model without build-up (numerical)."""
SECOND_ORDER: Final = 1
"""Index of the model with build-up (numerical)."""
RESPONSE_MODELS: Final = 2
"""Number of response models (numerical)."""
_PRIOR_SDS: Final = (0.012, 0.35, 0.45, 0.7)
"""Prior standard deviations of the parameters of a `ResponseModel` (chosen)."""
_FALLBACK_LATENCY_S: Final = 0.01
"""Prior mean of the latency if the head's model has none, s (chosen)."""
_PRIOR_BUILD_UP: Final = 0.8
"""Prior mean of the build-up in the model that has one: a servo with 12 % overshoot (chosen)."""
_MIN_PRIOR_LAG_S: Final = 0.004  # lower bound of the prior lag, s (chosen)


class ResponseModel:
    """One fitted model of the actuators' response.

    Arrays of four that hold parameters are: latency in s, log acceleration ratio, log lag (of s),
    and build-up. Gains and accelerations are by actuator.
    """

    parameters: Annotated[FloatArray, 4]  # estimated parameters
    variance: Annotated[FloatArray, 4]  # their variances
    prior: Annotated[FloatArray, 4]  # parameters before the present window
    information: Annotated[FloatArray, 4]  # inverse variances of `prior`
    log_gain: Annotated[FloatArray, 4]  # logarithms of the actuators' speed gains
    log_gain_prior: Annotated[FloatArray, 4]  # these logarithms before the present window
    accelerations: Annotated[FloatArray, 4]  # at the start of the window, rad/s^2
    misfit: float  # mean squared normalised residual of the last fit
    squared_residual_sum: float  # sum of the squared normalised residuals of the last fit


class ResponseIdentification:
    """State of the on-line identification of the actuators' response."""

    models: Annotated[list[ResponseModel], RESPONSE_MODELS]
    selected: float  # index of the model in use
    second_order_evidence: float  # decayed excess of the plain model's residuals in old windows
    windows: float  # number of windows that have ended
    window_begin: float  # period at which the present window begins; negative for none
    window_end: float  # period at which the previous window ended
    accelerations: Annotated[FloatArray, 4]  # present ones by the commands, rad/s^2
    prompt_velocities: float  # 1 if velocities are read without delay, otherwise 0
    angles: Annotated[FloatArray, 4]  # last measured angles, rad


class Rings(NamedTuple):
    """Ring buffers of a head: powers of two long; period k is at index k modulo the length."""

    commands: FloatArray  # (C, 4) commands, rad/s
    speeds: FloatArray  # (S, 4) velocities at the ends of periods, rad/s: estimated unless prompt
    mean_speeds: FloatArray  # (S, 4) mean velocities in periods, from measured angles, rad/s


def initial_response_models(
    response_latency_s: float, lag_s: float, learn: bool
) -> dict[str, object]:
    """Fields of the models before the head has moved; without variance if nothing is learned."""
    latency = response_latency_s if response_latency_s > 0.0 or not learn else _FALLBACK_LATENCY_S
    plain = (latency, 0.0, log(max(lag_s, _MIN_PRIOR_LAG_S)), 0.0)
    known = [plain, (*plain[:3], _PRIOR_BUILD_UP)]
    variance = np.array(_PRIOR_SDS) ** 2
    return {
        "parameters": known, "prior": known, "variance": variance if learn else np.zeros(4),
        "information": 1.0 / variance, "misfit": 1.0,
    }  # fmt: skip


@inlined
def selected_model(response: ResponseIdentification) -> ResponseModel:
    """Return the response model in use."""
    return response.models[np.intp(response.selected)]


@inlined
def ring_at(ring: FloatArray, tick: int, j: int) -> float:
    """Return an actuator's value of a period."""
    value: float = ring[np.uintp(tick & (len(ring) - 1)), j]
    return value


@inlined
def quantise_with_dead_zone(params: PredictorParameters, command: float) -> float:
    """Quantise a command to the motors' resolution; one single step counts as zero."""
    if params.command_step == 0.0:
        return command
    count = np.rint(command / params.command_step)
    return params.command_step * count if abs(count) > 1.0 else 0.0


class _Simulation(NamedTuple):
    """An actuator over a period, in which the command that acts changes once."""

    gain: float  # ratio of steady velocity to command
    whole: int  # whole periods of the latency
    rest_s: float  # rest of the latency, until the next command acts, s
    before: HeldResponse  # response to the command before, for the rest
    after: HeldResponse  # response to the command after it, until the end of the period


@inlined
def _prepare(
    params: PredictorParameters, j: int,
    latency: float, log_ratio: float, log_lag: float, build_up: float, log_gain: float,
) -> _Simulation:  # fmt: skip
    """Prepare the simulation of an actuator with parameter values of a `ResponseModel`."""
    lag, a = params.lag_ratio[j] * exp(log_lag), params.acceleration_limit[j] * exp(log_ratio)
    whole = int(latency / params.period_s + 1e-9)
    rest = latency - whole * params.period_s
    return _Simulation(
        exp(log_gain), whole, rest, prepare_held_response(lag, build_up, a, rest),
        prepare_held_response(lag, build_up, a, params.period_s - rest),
    )  # fmt: skip


@inlined
def _prepare_model(
    params: PredictorParameters, model: ResponseModel, j: int, latency: float
) -> _Simulation:
    """Prepare the simulation of an actuator with a model, but another latency, s."""
    known = model.parameters
    return _prepare(params, j, latency, known[1], known[2], known[3], model.log_gain[j])


@inlined
def _advance(
    simulation: _Simulation, commands: FloatArray, tick: int, j: int, q: float, v: float, w: float
) -> tuple[float, float, float]:
    """Angle, velocity and acceleration of an actuator a period after the end of period `tick`."""
    u = simulation.gain * ring_at(commands, tick - simulation.whole - 1, j)
    q, v, w = follow_held_command(q, v, w, u, simulation.before)
    u = simulation.gain * ring_at(commands, tick - simulation.whole, j)
    return follow_held_command(q, v, w, u, simulation.after)


@inlined
def simulate_period(
    rings: Rings, model: ResponseModel, params: PredictorParameters, tick: int, j: int,
    q: float, v: float, w: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Angle, velocity and acceleration of an actuator a period after the end of period `tick`."""
    simulation = _prepare_model(params, model, j, model.parameters[0])
    if simulation.rest_s > 1e-9:
        return _advance(simulation, rings.commands, tick, j, q, v, w)
    u = simulation.gain * ring_at(rings.commands, tick - simulation.whole, j)
    return follow_held_command(q, v, w, u, simulation.after)


@inlined
def state_at_command_effect(
    response: ResponseIdentification, rings: Rings, params: PredictorParameters, tick: int, j: int,
    q: float, v: float, latency: float,
) -> tuple[float, float, float]:  # fmt: skip
    """State of an actuator when the next command acts, a latency, s, after period `tick`."""
    model = selected_model(response)
    simulation, w = _prepare_model(params, model, j, latency), response.accelerations[j]
    whole, lag, a = simulation.whole, simulation.before.lag_s, simulation.before.max_acceleration
    if simulation.rest_s > 1e-9:
        u = simulation.gain * ring_at(rings.commands, tick - whole - 1, j)
        q, v, w = follow_held_command(q, v, w, u, simulation.before)
    held = prepare_held_response(lag, model.parameters[3], a, params.period_s)
    for i in range(whole):
        u = simulation.gain * ring_at(rings.commands, tick - whole + i, j)
        q, v, w = follow_held_command(q, v, w, u, held)
    return q, v, w


_GAIN_SD: Final = 0.08  # prior standard deviation of the logarithm of a speed gain (chosen)
_LAGS_S: Final = (0.004, 0.12)  # bounds of the lag, s (chosen: the range of known servos)
_RATIOS: Final = (0.15, 120.0)
"""Bounds of the acceleration limit, as a ratio to the model's (chosen)."""
_BUILD_UPS: Final = (0.03, 8.0)  # bounds of the build-up m (chosen)
_MAX_LOG_GAIN: Final = 0.3  # bound of the absolute logarithm of a speed gain (chosen)
_MOVING_RAD_S: Final = 0.05  # actuator speed above which a window starts, rad/s (chosen)
_EXCITED_RAD_S: Final = 0.3
"""Change of command from the speed at a window's start that excites an actuator, rad/s (chosen)."""
_SPEED_SD: Final = 0.03
"""Model error of a velocity, standard deviation, rad/s, and per rad/s of the velocity (chosen)."""
_KNOWN_SDS: Final = (0.0015, 0.06)
"""Deviations of latency, s, and log ratio below which these count as known (chosen)."""
_GOOD_FIT_MISFIT: Final = 2.0
"""Mean squared normalised residual below which a fit needs no other starting values (chosen)."""
_SPACING_S: Final = 0.004  # spacing of the latencies tried, s (numerical)
_TRIED_LATENCIES: Final = 30  # number of latencies tried (numerical)
_FAST_MOTOR_RATIOS: Final = (3.0, 9.0, 27.0, 81.0)
"""Acceleration ratios tried for motors unlike the model (chosen)."""
_FAST_MOTOR_LAGS_S: Final = (0.008, 0.016, 0.03, 0.06)  # lags tried with these ratios, s (chosen)
_MIN_COST_DECREASE: Final = 3.0
"""Decrease of the cost that restarts the fit elsewhere (chosen: no jumps between equal fits)."""
_MIN_PRIOR_SDS: Final = (0.0008, 0.03, 0.05, 0.05)
"""Least standard deviations of the parameters that a window leaves (chosen: keeps adapting)."""
_MAX_STEPS: Final = (0.006, 0.25, 0.25, 0.4)
"""Longest Gauss-Newton steps of the parameters (numerical)."""
_DIFFERENCES: Final = (0.5e-3, 0.02, 0.02, 0.02, 0.02)
"""Finite differences of the parameters and of the log gain for derivatives (numerical)."""
_MIN_SECOND_ORDER_EVIDENCE: Final = 15.0
"""Excess of the plain model's squared residuals that the build-up has to explain (chosen)."""
_INFORMATIVE_S: Final = 0.06
"""Shortest window with evidence on the build-up, s (chosen: at first both models fit)."""
_LEAST_BUILD_UP: Final = 0.25
"""Least build-up that is used (physical: critical damping; below it, nothing overshoots)."""
_EVIDENCE_DECAY: Final = 0.7  # factor that remains of the evidence of earlier windows (chosen)


@inlined
def _last_to_act(params: PredictorParameters) -> int:
    """Largest number of periods before a command acts."""
    return int(params.max_response_latency_s / params.period_s) + 1


@inlined
def _is_moving(rings: Rings, params: PredictorParameters, tick: int) -> bool:
    """True if any actuator moves, or a command that may still act is not zero."""
    for j in range(4):
        if abs(ring_at(rings.speeds, tick, j)) > _MOVING_RAD_S:
            return True
        for i in range(_last_to_act(params)):
            if ring_at(rings.commands, tick - 1 - i, j) != 0.0:
                return True
    return False


@inlined
def _is_excited(rings: Rings, params: PredictorParameters, first: int, tick: int, j: int) -> bool:
    """True if the commands of an actuator have changed enough to identify its response."""
    begin, most = ring_at(rings.speeds, first, j), 0.0
    for i in range(first - _last_to_act(params), tick):
        most = max(most, abs(ring_at(rings.commands, i, j) - begin))
    return params.speed_limit[j] > 0.0 and most >= _EXCITED_RAD_S


@inlined
def _reading(
    response: ResponseIdentification, rings: Rings, params: PredictorParameters, tick: int, j: int
) -> tuple[float, float]:
    """Velocity of a period that models are fitted to, and its quantisation error, rad/s."""
    if response.prompt_velocities > 0.5:
        return ring_at(rings.speeds, tick, j), params.speed_step[j]
    return ring_at(rings.mean_speeds, tick, j), 0.4 * float(params.angle_step[j]) / params.period_s


@subroutine
def _posterior_cost(
    response: ResponseIdentification, rings: Rings, model: ResponseModel,
    params: PredictorParameters, tick: int, latency: float, ratio: float, log_lag: float,
) -> float:  # fmt: skip
    """-2 log posterior of the window under other values, plus a constant; bounded residuals."""
    first, build_up = int(response.window_begin), model.parameters[3]
    deviation = (latency - model.prior[0], ratio - model.prior[1], log_lag - model.prior[2])
    total = 0.0
    for i in range(3):
        total += deviation[i] * deviation[i] * model.information[i]
    for j in range(4):
        simulation = _prepare(params, j, latency, ratio, log_lag, build_up, model.log_gain[j])
        v, w = ring_at(rings.speeds, first, j), model.accelerations[j]
        for i in range(first, tick):
            q, v, w = _advance(simulation, rings.commands, i, j, 0.0, v, w)
            measured, step_sd = _reading(response, rings, params, i + 1, j)
            simulated = v if response.prompt_velocities > 0.5 else q / params.period_s
            residual_variance = step_sd * step_sd + 0.05**2 + 0.01 * measured * measured
            total += min((measured - simulated) ** 2 / residual_variance, 30.0)
    return total


@subroutine
def _try_others(
    response: ResponseIdentification, rings: Rings, model: ResponseModel,
    params: PredictorParameters, tick: int,
) -> None:  # fmt: skip
    """Restart the fit at other parameter values where these explain the window better."""
    known, free = model.parameters, model.variance[0] > _KNOWN_SDS[0] ** 2
    best = _posterior_cost(response, rings, model, params, tick, known[0], known[1], known[2])
    best -= _MIN_COST_DECREASE
    # about the latency in the head's model if that is long, else from none on
    shortest = max(params.max_response_latency_s - _SPACING_S * _TRIED_LATENCIES, 0.0)
    for i in range(_TRIED_LATENCIES if free else 0):
        latency = min(shortest + _SPACING_S * i, params.max_response_latency_s)
        cost = _posterior_cost(response, rings, model, params, tick, latency, known[1], known[2])
        if cost < best:
            best, known[0] = cost, latency
    beside = max(params.response_latency_s - 0.016, 0.0)
    for m in range(8):  # 8 of 72 combinations per period, all in nine periods
        i = (8 * tick + m) % 72
        latency, ratio = beside + 0.008 * (i % 6), log(0.4) + 0.5 * (i // 6 % 3)
        log_lag = log(0.016) + 0.45 * (i // 18)
        cost = _posterior_cost(response, rings, model, params, tick, latency, ratio, log_lag)
        if cost < best:
            best, known[0], known[1], known[2] = cost, latency, ratio, log_lag
    for m in range(2):  # 2 of 16 per period, all in eight: motors very unlike the model
        i = (2 * tick + m) % 16
        ratio, log_lag = log(_FAST_MOTOR_RATIOS[i % 4]), log(_FAST_MOTOR_LAGS_S[i // 4])
        cost = _posterior_cost(response, rings, model, params, tick, known[0], ratio, log_lag)
        if cost < best:
            best, known[1], known[2] = cost, ratio, log_lag


@inlined
def _solve(matrix: FloatArray, right: FloatArray, out: FloatArray) -> None:
    """Solve linear equations with a positive definite matrix by Gaussian elimination."""
    m, y, size = matrix.copy(), right.copy(), right.size
    for i in range(size):
        for r in range(i + 1, size):
            factor = m[r, i] / m[i, i]
            for c in range(i, size):
                m[r, c] -= factor * m[i, c]
            y[r] -= factor * y[i]
    for i in range(size - 1, -1, -1):
        rest = y[i]
        for c in range(i + 1, size):
            rest -= m[i, c] * out[c]
        out[i] = rest / m[i, i]


@subroutine
def _fit(
    response: ResponseIdentification, rings: Rings, model: ResponseModel,
    params: PredictorParameters, tick: int,
) -> None:  # fmt: skip
    """Take one Gauss-Newton step on the window."""
    first, known = int(response.window_begin), model.parameters
    size = 4 if known[3] > 0.0 else 3
    normal, right = np.zeros((size, size)), np.zeros(size)
    mixed, own, own_right = np.zeros((4, size)), np.zeros(4), np.zeros(4)
    slope, v, w, mean_v = np.zeros(size), np.zeros(6), np.zeros(6), np.zeros(6)
    for i in range(size):
        normal[i, i] = model.information[i]
        right[i] = model.information[i] * (model.prior[i] - known[i])
    residuals = count = 0.0
    for j in range(4):
        own[j] = 1.0 / _GAIN_SD**2
        own_right[j] = own[j] * (model.log_gain_prior[j] - model.log_gain[j])
        if not _is_excited(rings, params, first, tick, j):
            continue
        simulations = [_prepare_model(params, model, j, known[0])] * 6
        for m in range(size + 2):  # nominal (0), gain (1) or a parameter perturbed
            simulations[m] = _prepare(
                params, j,
                known[0] + (_DIFFERENCES[0] if m == 2 else 0.0),
                known[1] + (_DIFFERENCES[1] if m == 3 else 0.0),
                known[2] + (_DIFFERENCES[2] if m == 4 else 0.0),
                known[3] + (_DIFFERENCES[3] if m == 5 else 0.0),
                model.log_gain[j] + (_DIFFERENCES[4] if m == 1 else 0.0),
            )  # fmt: skip
            v[m], w[m] = ring_at(rings.speeds, first, j), model.accelerations[j]
        for i in range(first, tick):
            for m in range(size + 2):
                q, v[m], w[m] = _advance(simulations[m], rings.commands, i, j, 0.0, v[m], w[m])
                mean_v[m] = q / params.period_s
            measured, step_sd = _reading(response, rings, params, i + 1, j)
            simulated = v if response.prompt_velocities > 0.5 else mean_v
            residual = measured - simulated[0]
            residual_variance = step_sd * step_sd + _SPEED_SD**2 * (1.0 + measured * measured)
            square = residual * residual / residual_variance
            residuals, count = residuals + min(square, 100.0), count + 1.0
            # Cauchy weight: outliers count for little
            weight = 1.0 / residual_variance / (1.0 + square / 9.0)
            gain_slope = (simulated[1] - simulated[0]) / _DIFFERENCES[4]
            for m in range(size):
                slope[m] = (simulated[m + 2] - simulated[0]) / _DIFFERENCES[m]
            for r in range(size):
                right[r] += weight * slope[r] * residual
                mixed[j, r] += weight * slope[r] * gain_slope
                for c in range(size):
                    normal[r, c] += weight * slope[r] * slope[c]
            own[j] += weight * gain_slope * gain_slope
            own_right[j] += weight * gain_slope * residual
    for j in range(4):
        for r in range(size):
            right[r] -= mixed[j, r] * own_right[j] / own[j]
            for c in range(size):
                normal[r, c] -= mixed[j, r] * mixed[j, c] / own[j]
    step, unit, column = np.zeros(size), np.zeros(size), np.zeros(size)
    _solve(normal, right, step)
    if not isfinite(step.sum()):  # no usable slope so far from the optimum
        return
    least = (0.0, log(_RATIOS[0]), log(_LAGS_S[0]), _BUILD_UPS[0])
    most = (params.max_response_latency_s, log(_RATIOS[1]), log(_LAGS_S[1]), _BUILD_UPS[1])
    model.squared_residual_sum, model.misfit = residuals, residuals / max(count, 1.0)
    worse = max(1.0, model.misfit)
    for i in range(size):
        updated = known[i] + min(max(step[i], -_MAX_STEPS[i]), _MAX_STEPS[i])
        known[i] = min(max(updated, least[i]), most[i])
        for r in range(size):
            unit[r] = 1.0 if r == i else 0.0
        _solve(normal, unit, column)
        model.variance[i] = worse * column[i]
    for j in range(4):
        change = own_right[j]
        for r in range(size):
            change -= mixed[j, r] * step[r]
        gain = model.log_gain[j] + min(max(change / own[j], -0.1), 0.1)
        model.log_gain[j] = min(max(gain, -_MAX_LOG_GAIN), _MAX_LOG_GAIN)


@inlined
def _select(response: ResponseIdentification, lasted_s: float, ends: bool) -> None:
    """Select the model that explains the windows better."""
    plain, second, excess = response.models[FIRST_ORDER], response.models[SECOND_ORDER], 0.0
    if lasted_s >= _INFORMATIVE_S:
        excess = plain.squared_residual_sum - second.squared_residual_sum
        excess /= max(second.misfit, 1.0)
    better = response.second_order_evidence + excess > _MIN_SECOND_ORDER_EVIDENCE
    overshoots = second.parameters[3] > _LEAST_BUILD_UP
    response.selected = SECOND_ORDER if better and overshoots else FIRST_ORDER
    if ends:
        response.second_order_evidence = _EVIDENCE_DECAY * (response.second_order_evidence + excess)


@subroutine
def _replay(
    response: ResponseIdentification, rings: Rings, model: ResponseModel,
    params: PredictorParameters, tick: int, out: FloatArray,
) -> None:  # fmt: skip
    """(4,) accelerations at the end of the window, simulated with a response model, rad/s^2."""
    first = int(response.window_begin)
    for j in range(4):
        v, out[j] = ring_at(rings.speeds, first, j), model.accelerations[j]
        for i in range(first, tick):
            _q, v, out[j] = simulate_period(rings, model, params, i, j, 0.0, v, out[j])


@inlined
def learn_response(
    response: ResponseIdentification, rings: Rings, params: PredictorParameters, tick: int
) -> None:
    """Update the response model with the readings of the period that has ended."""
    moving = _is_moving(rings, params, tick)
    if response.window_begin < 0.0:
        if not moving:
            return
        response.window_begin = tick - 1.0
        for i in range(RESPONSE_MODELS if response.window_end != response.window_begin else 0):
            response.models[i].accelerations[:] = 0.0
    first = int(response.window_begin)
    ends = tick - first >= int(params.response_window) or not moving
    excited = False
    for j in range(4):
        excited = excited or _is_excited(rings, params, first, tick, j)
    # a well-known response is updated only once a window
    model = selected_model(response)
    well_known = model.variance[0] < _KNOWN_SDS[0] ** 2 and model.misfit < _GOOD_FIT_MISFIT
    if excited and (ends or not well_known or model.variance[1] > _KNOWN_SDS[1] ** 2):
        for i in range(RESPONSE_MODELS):
            if not well_known:
                _try_others(response, rings, response.models[i], params, tick)
            _fit(response, rings, response.models[i], params, tick)
        _select(response, (tick - first) * params.period_s, ends)
        _replay(response, rings, selected_model(response), params, tick, response.accelerations)
    if ends:
        for i in range(RESPONSE_MODELS):
            model = response.models[i]
            _replay(response, rings, model, params, tick, model.accelerations)
            model.prior[:], model.log_gain_prior[:] = model.parameters, model.log_gain
            for n in range(4):
                model.information[n] = 1.0 / max(1.2 * model.variance[n], _MIN_PRIOR_SDS[n] ** 2)
        response.window_begin, response.window_end = -1.0, float(tick)
        response.windows += 1.0
