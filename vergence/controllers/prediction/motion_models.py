"""Motion of a target: an interacting multiple model (IMM) estimator of rest and several motions.

Per eye and joint, the angle that fixates a moving target follows Singer's model, an acceleration
that decorrelates with the time constant T_a (R. A. Singer, Estimating optimal tracking filter
performance for manned maneuvering targets, 1970),

    d/dt (theta, w, a) = (w, a, -a / T_a) + white noise on a of variance 2 sigma_a^2 / T_a.

No single sigma_a suits both a slow circle and a thrown ball, so there are several models, from
gentle to wild, beside the model of a target at rest. All models predict each image. The mode
probabilities follow from the likelihoods and a Markov transition matrix, and each model starts the
next image from the mixture of the models that may have switched to it (H. A. P. Blom and Y.
Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching
coefficients, 1988). The predicted target angle is the mean over the models, weighted by their
probabilities.

The states are valid at the exposure of the newest image, on the clock of the joint readings; an
exposure may lie anywhere between two periods.
"""

from math import exp, hypot, log
from typing import Annotated, Any, Final, TypeAlias

import numpy as np

from vergence.kernels import inlined
from vergence.models.parts import FloatArray

MODELS: Final = 3
"""Number of motion models (numerical)."""
MODES: Final = MODELS + 1
"""Number of mode probabilities: rest, then the motion models (numerical)."""
ERRATIC: Final = MODELS - 1
"""Index of the model of a target that changes direction at random (numerical)."""
_ACCELERATION_SD: Final = (0.05, 4.0, 5.0)
"""sigma_a of each motion model, rad/s^2 (chosen: with 0.15 the first one's rate follows noise)."""
_ACCELERATION_TIME_S: Final = (1.0, 1.0, 0.05)  # T_a of each motion model, s (chosen)
_PRIOR_RATE_SD: Final = 0.5  # prior standard deviation of a new target's rate, rad/s (chosen)
_MAX_TARGET_RATE: Final = 2.5  # largest target rate, rad/s; estimates are clipped to it (chosen)
SWITCH_PROBABILITY: Final = 0.02
"""Probability that a target switches to another model between two images (chosen)."""
PRIOR_REST_PROBABILITY: Final = 0.98
"""Prior probability that a new target rests (chosen)."""
_REST_BONUSES: Final = (0.7, 0.2)
"""Log-likelihood in favour of rest, at rest and in motion (chosen: 0.7 disturbs slow motion)."""
_GATES: Final = (9.0, 36.0)
"""Gates on squared Mahalanobis distances for unlikely and other models (chosen: 3 and 6 sigma)."""
_MAX_SQUARED_INNOVATION: Final = 25.0
"""Bound of the squared normalised innovation in a log-likelihood (chosen)."""
MAX_EYE_LOG_RATIO: Final = 2.5
"""Largest log-likelihood ratio of one eye in one image (chosen: robust to outliers)."""
_INFERRED_SD_RAD: Final = 0.006
"""Standard deviation of a target angle inferred from the other eye, rad (chosen)."""
_WIDE_GATE_PROBABILITY: Final = 0.1
"""Mode probability above which a model has the wide gate (chosen)."""
_MAX_EXTRAPOLATION_S: Final = 0.4
"""Time after an image for which motion is extrapolated, s (chosen); then the aim returns."""
_ERRATIC_TIME_S: Final = 0.3
"""Mean time between changes of direction in the erratic model, s (chosen)."""
_MIN_SPEED_FRACTION: Final = 0.1  # lower bound of the fraction `visible_speed_fraction` (chosen)
_RETURN_TIME_S: Final = 0.15
"""Time constant of the return to where the target was last seen, s (chosen)."""


class TargetMotion:
    """State of one motion model for one eye's target; arrays are by joint."""

    angle: Annotated[FloatArray, 2]  # theta, rad
    rate: Annotated[FloatArray, 2]  # w, rad/s
    acceleration: Annotated[FloatArray, 2]  # a, rad/s^2
    covariance: Annotated[FloatArray, 6]  # of (theta, w, a), common to both joints: upper triangle


Motions: TypeAlias = Any
"""`TargetMotion` by model; by eye and model where stated."""


@inlined
def begin_motion(motions: Motions, goals: FloatArray, variance: float) -> None:
    """Initialise an eye's target at rest, at angles (2,) of one variance, rad^2."""
    for m in range(MODELS):
        motion: TargetMotion = motions[m]
        motion.angle[:] = goals
        motion.rate[:] = motion.acceleration[:] = 0.0
        c = motion.covariance
        c[0], c[3], c[5] = variance, _PRIOR_RATE_SD**2, _ACCELERATION_SD[m] * _ACCELERATION_SD[m]
        c[1] = c[2] = c[4] = 0.0


@inlined
def mix_models(motions: Motions, probabilities: FloatArray) -> None:
    """Start each model of an eye from the mixture of those that may have switched to it."""
    mixed, share, other = np.zeros((MODELS, 12)), np.zeros(MODELS), SWITCH_PROBABILITY / MODELS
    for m in range(MODELS):
        total = 1e-12
        for n in range(MODELS):
            share[n] = ((1.0 - SWITCH_PROBABILITY) if n == m else other) * probabilities[n + 1]
            total += share[n]
        for n in range(MODELS):
            share[n] /= total
            motion: TargetMotion = motions[n]
            for joint in range(2):
                mixed[m, joint] += share[n] * motion.angle[joint]
                mixed[m, 2 + joint] += share[n] * motion.rate[joint]
                mixed[m, 4 + joint] += share[n] * motion.acceleration[joint]
        for n in range(MODELS):
            motion = motions[n]
            for i in range(6):
                mixed[m, 6 + i] += share[n] * motion.covariance[i]
            for joint in range(2):
                q = motion.angle[joint] - mixed[m, joint]
                w = motion.rate[joint] - mixed[m, 2 + joint]
                a = motion.acceleration[joint] - mixed[m, 4 + joint]
                # the covariance is common to both joints: average their spreads of the means
                half = 0.5 * share[n]
                mixed[m, 6] += half * q * q
                mixed[m, 7] += half * q * w
                mixed[m, 8] += half * q * a
                mixed[m, 9] += half * w * w
                mixed[m, 10] += half * w * a
                mixed[m, 11] += half * a * a
    for m in range(MODELS):
        motion = motions[m]
        for joint in range(2):
            motion.angle[joint], motion.rate[joint] = mixed[m, joint], mixed[m, 2 + joint]
            motion.acceleration[joint] = mixed[m, 4 + joint]
        for i in range(6):
            motion.covariance[i] = mixed[m, 6 + i]


@inlined
def predict_motions(motions: Motions, time_s: float) -> None:
    """Predict the models by a time; process noise in the limit of times much shorter than T_a."""
    t = time_s
    t2, t3 = t * t, t * t * t
    for m in range(MODELS):
        motion: TargetMotion = motions[m]
        forgets = _ACCELERATION_TIME_S[m]
        left = exp(-t / forgets)
        f13 = forgets * forgets * (t / forgets - 1.0 + left)
        f23 = forgets * (1.0 - left)
        for joint in range(2):
            a = motion.acceleration[joint]
            motion.angle[joint] += t * motion.rate[joint] + f13 * a
            motion.rate[joint] += f23 * a
            motion.acceleration[joint] = left * a
        c, noise = motion.covariance, 2.0 * _ACCELERATION_SD[m] * _ACCELERATION_SD[m] / forgets
        p11, p12, p13, p22, p23, p33 = c[0], c[1], c[2], c[3], c[4], c[5]
        # rows of F P, then F P F'
        a11, a12 = p11 + t * p12 + f13 * p13, p12 + t * p22 + f13 * p23
        a13, a22, a23 = p13 + t * p23 + f13 * p33, p22 + f23 * p23, p23 + f23 * p33
        c[0] = a11 + t * a12 + f13 * a13 + noise * t2 * t3 / 20.0
        c[1] = a12 + f23 * a13 + noise * t2 * t2 / 8.0
        c[2] = left * a13 + noise * t3 / 6.0
        c[3] = a22 + f23 * a23 + noise * t3 / 3.0
        c[4] = left * a23 + noise * t2 / 2.0
        c[5] = left * left * p33 + noise * t


@inlined
def passes_any_gate(
    motions: Motions, probabilities: FloatArray, goals: FloatArray, variance: FloatArray
) -> bool:
    """True if measured angles (2,) of given variances pass the gate of a model."""
    for m in range(MODELS):
        motion: TargetMotion = motions[m]
        gate = _GATES[1] if probabilities[m + 1] > _WIDE_GATE_PROBABILITY else _GATES[0]
        inside = True
        for joint in range(2):
            innovation, known = goals[joint] - motion.angle[joint], motion.covariance[0]
            inside = inside and innovation * innovation < gate * (known + variance[joint])
        if inside:
            return True
    return False


@inlined
def kalman_update(motion: TargetMotion, goals: FloatArray, variance: float) -> None:
    """Kalman update of one model with measured angles (2,) of one variance, rad^2."""
    c = motion.covariance
    innovation_variance = c[0] + variance
    k1, k2, k3 = c[0] / innovation_variance, c[1] / innovation_variance, c[2] / innovation_variance
    for joint in range(2):
        innovation = goals[joint] - motion.angle[joint]
        motion.angle[joint] += k1 * innovation
        rate = motion.rate[joint] + k2 * innovation
        motion.rate[joint] = min(max(rate, -_MAX_TARGET_RATE), _MAX_TARGET_RATE)
        motion.acceleration[joint] += k3 * innovation
    p11, p12, p13 = c[0], c[1], c[2]
    c[0], c[1], c[2] = p11 - k1 * p11, p12 - k1 * p12, p13 - k1 * p13
    c[3] -= k2 * p12
    c[4] -= k2 * p13
    c[5] -= k3 * p13


@inlined
def update_models(
    motions: Motions, goals: FloatArray, variance: FloatArray,
    model_error_variance: FloatArray, nll: FloatArray,
) -> None:  # fmt: skip
    """Update an eye's models with measured angles (2,); add their negative log-likelihoods."""
    own = 0.5 * (variance[0] + variance[1])
    for m in range(MODELS):
        motion: TargetMotion = motions[m]
        for joint in range(2):
            innovation = goals[joint] - motion.angle[joint]
            known = motion.covariance[0] + variance[joint] + model_error_variance[joint]
            square = min(innovation * innovation / known, _MAX_SQUARED_INNOVATION)
            nll[m + 1] += 0.5 * (square + log(known))
        kalman_update(motion, goals, own)


@inlined
def update_from_other_eye(motions: Motions, goals: FloatArray, variance: FloatArray) -> None:
    """Update an eye's models with angles (2,) inferred from the other eye; `variance` is (2,)."""
    own = 0.5 * (variance[0] + variance[1]) + _INFERRED_SD_RAD * _INFERRED_SD_RAD
    for m in range(MODELS):
        kalman_update(motions[m], goals, own)


@inlined
def update_modes(probabilities: FloatArray, nll: FloatArray) -> None:
    """Update the mode probabilities with the negative log-likelihoods of an image."""
    rest = _REST_BONUSES[0] if probabilities[0] > 0.5 else _REST_BONUSES[1]
    least, total = min(nll[0] - rest, nll[1:].min()), 0.0
    for m in range(MODES):
        more = nll[m] - (rest if m == 0 else 0.0) - least
        probabilities[m] = max(probabilities[m] * exp(-min(more, 50.0)), 1e-12)
        total += probabilities[m]
    for m in range(MODES):
        probabilities[m] /= total


@inlined
def mean_rate(motions: Motions, probabilities: FloatArray, joint: int) -> float:
    """Mean rate of an eye's target over the motion models, rad/s."""
    total, rate = 1e-12, 0.0
    for m in range(MODELS):
        total += probabilities[m + 1]
        rate += probabilities[m + 1] * motions[m].rate[joint]
    return rate / total


@inlined
def visible_speed_fraction(
    motions: Motions, probabilities: FloatArray, max_slip_rad_s: float
) -> float:
    """Fraction of the target's speed at which an eye still sees it even if it has reversed."""
    speed = hypot(mean_rate(motions, probabilities, 0), mean_rate(motions, probabilities, 1))
    return min(max((max_slip_rad_s - speed) / max(speed, 1e-6), _MIN_SPEED_FRACTION), 1.0)


@inlined
def extrapolate_goal(
    motions: Motions, probabilities: FloatArray, resting_goal: float, joint: int,
    time_s: float, next_image_due_s: float, visible_speed_fraction: float,
) -> tuple[float, float]:  # fmt: skip
    """Mean target angle and rate over all models, a time after the exposure of the newest image.

    After the next image is due, only `visible_speed_fraction` of the speed is followed.
    """
    left = exp(-max(time_s - _MAX_EXTRAPOLATION_S, 0.0) / _RETURN_TIME_S)
    slow = visible_speed_fraction * max(min(time_s, _MAX_EXTRAPOLATION_S) - next_image_due_s, 0.0)
    slower = left * (visible_speed_fraction if time_s > next_image_due_s else 1.0)
    time_s = min(time_s, _MAX_EXTRAPOLATION_S, next_image_due_s)
    offset = rate = 0.0
    for m in range(MODELS):
        motion: TargetMotion = motions[m]
        forgets, w, a = _ACCELERATION_TIME_S[m], motion.rate[joint], motion.acceleration[joint]
        kept = exp(-time_s / forgets)
        now = w + a * forgets * (1.0 - kept)
        turn = w * time_s + a * forgets * forgets * (time_s / forgets - 1.0 + kept)
        share = 1.0
        if m == ERRATIC:  # it may have changed direction by then
            share, lasts = visible_speed_fraction, exp(-time_s / _ERRATIC_TIME_S)
            now, turn = lasts * now, turn * _ERRATIC_TIME_S * (1.0 - lasts) / max(time_s, 1e-9)
        off = motion.angle[joint] - resting_goal + share * (turn + slow * now)
        offset += probabilities[m + 1] * off
        rate += probabilities[m + 1] * share * slower * now
    return resting_goal + left * offset, rate
