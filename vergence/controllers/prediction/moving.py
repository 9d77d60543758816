r"""Whether a target moves, and where it will be: interacting models beside that of rest.

Per eye and joint, the angle that fixates a moving target follows Singer's model: an acceleration
that forgets itself with the time T_a (R. A. Singer, Estimating optimal tracking filter performance
for manned maneuvering targets, 1970),

    d/dt (theta, w, a) = (w, a, -a / T_a) + white noise on a of variance 2 sigma_a^2 / T_a.

No one sigma_a suits a slow circle and a ball that is thrown. So there are several models, from
gentle to wild, and that of a target at rest. All predict each image; their probabilities follow
from the likelihoods and from how often targets change their ways, and each model begins the next
image from the mean of those that may have turned into it (H. A. P. Blom and Y. Bar-Shalom, The
interacting multiple model algorithm for systems with Markovian switching coefficients, 1988). Where
the target will be is the mean of what the models say.

They live at the exposure of the newest image, in the time in which joints are read; an image's date
may lie anywhere between two periods. An error of the date moves a measured angle with the eye, and
the target has moved as far meanwhile: what remains is the slip of the eye on the target, so eyes
that follow are not disturbed by it.
"""

from math import exp, hypot, log
from typing import Annotated, Any, Final, TypeAlias

from vergence._jit import device
from vergence.models.parts import FloatArray

MODELS: Final = 3
WEIGHTS: Final = MODELS + 1
"""The probabilities of rest and of the models, in this order."""
ERRATIC: Final = MODELS - 1
"""The model of a target that turns where it likes."""
_SD: Final = (0.05, 4.0, 5.0)
"""sigma_a by model, rad/s^2. The first is for what creeps: with 0.15 its rate follows noise."""
_FORGETS_S: Final = (1.0, 1.0, 0.05)
"""T_a by model."""
_START_RATE: Final = 0.5
"""How fast a new target may be, rad/s, standard deviation."""
_FASTEST: Final = 2.5
"""The greatest rate in question, rad/s."""
_SWITCHES: Final = 0.02
"""The probability that a target goes on by another model, from image to image."""
_RESTS: Final = 0.98
"""The probability that a new target rests."""
_REST: Final = 0.7
"""What an image says for rest in advance, as the logarithm of a likelihood."""
_STOPS: Final = 0.2
"""Prior for rest while the target moves, as `_REST`: a lower one keeps what creeps from resting by
turns. Measured on `simulated`: with 0.7 speeds swing half as wide again, with -0.3 a quarter."""
_GATE: Final = 36.0
"""Square of what a model errs by, by its variance, up to which a target is on its way."""
_NARROW: Final = 9.0
"""The same of a model that is not likely."""
_WORST: Final = 25.0
_DOUBT: Final = 2.5
"""The most that one eye says in one image against anything, as the logarithm of a likelihood."""
_INFERRED_RAD: Final = 0.006
"""How well one eye tells where the other's target is, standard deviation."""
_LIKELY: Final = 0.1
_UNSEEN_S: Final = 0.4
"""So long after an image a target goes on as it did; then it is sought where it was seen last."""
_LASTS_S: Final = 0.3
"""For how long one that turns where it likes goes on in one direction, on average."""
_LEAST_SHARE: Final = 0.1
_RETURNS_S: Final = 0.15


class EyeMotion:
    """What one model has of one eye's target; arrays are by joint."""

    angle: Annotated[FloatArray, 2]
    """theta, rad."""
    rate: Annotated[FloatArray, 2]
    """w, rad/s."""
    acceleration: Annotated[FloatArray, 2]
    """a, rad/s^2."""
    covariance: Annotated[FloatArray, 6]
    """Of (theta, w, a), which both joints have in common: its upper triangle by rows."""


Motions: TypeAlias = Any
"""`EyeMotion` by model, and by eye before that where it says so."""


@device
def begin_weights(weights: FloatArray) -> None:
    """What a new target does, in advance."""
    for m in range(WEIGHTS):
        weights[m] = _RESTS if m == 0 else (1.0 - _RESTS) / MODELS


@device
def begin_motion(motions: Motions, goals: FloatArray, variance: float) -> None:
    """Let an eye's target begin at rest at some angles (2,) of a variance, rad^2."""
    for m in range(MODELS):
        motion: EyeMotion = motions[m]
        for joint in range(2):
            motion.angle[joint] = goals[joint]
            motion.rate[joint] = motion.acceleration[joint] = 0.0
        c = motion.covariance
        c[0], c[3], c[5] = variance, _START_RATE**2, _SD[m] * _SD[m]
        c[1] = c[2] = c[4] = 0.0


@device
def switch(weights: FloatArray) -> None:
    """The probabilities before an image, from those after the last."""
    other = _SWITCHES / MODELS
    for m in range(WEIGHTS):
        weights[m] = (1.0 - _SWITCHES - other) * weights[m] + other


@device
def mix(motions: Motions, weights: FloatArray, mixed: FloatArray) -> None:
    """Let each model begin from the mean of those that may have turned into it.

    Args:
        motions: those of an eye, changed in place.
        weights: (WEIGHTS,) after the last image.
        mixed: (MODELS, 12) work space.
    """
    other = _SWITCHES / MODELS
    for m in range(MODELS):
        total = 1e-12
        for n in range(MODELS):
            total += ((1.0 - _SWITCHES) if n == m else other) * weights[n + 1]
        for i in range(12):
            mixed[m, i] = 0.0
        for n in range(MODELS):
            share = ((1.0 - _SWITCHES) if n == m else other) * weights[n + 1] / total
            motion: EyeMotion = motions[n]
            for joint in range(2):
                mixed[m, joint] += share * motion.angle[joint]
                mixed[m, 2 + joint] += share * motion.rate[joint]
                mixed[m, 4 + joint] += share * motion.acceleration[joint]
        for n in range(MODELS):
            share = ((1.0 - _SWITCHES) if n == m else other) * weights[n + 1] / total
            motion = motions[n]
            for i in range(6):
                mixed[m, 6 + i] += share * motion.covariance[i]
            for joint in range(2):
                q = motion.angle[joint] - mixed[m, joint]
                w = motion.rate[joint] - mixed[m, 2 + joint]
                a = motion.acceleration[joint] - mixed[m, 4 + joint]
                # the covariance is that of either joint: half of what both say
                half = 0.5 * share
                mixed[m, 6] += half * q * q
                mixed[m, 7] += half * q * w
                mixed[m, 8] += half * q * a
                mixed[m, 9] += half * w * w
                mixed[m, 10] += half * w * a
                mixed[m, 11] += half * a * a
    for m in range(MODELS):
        motion = motions[m]
        for joint in range(2):
            motion.angle[joint] = mixed[m, joint]
            motion.rate[joint] = mixed[m, 2 + joint]
            motion.acceleration[joint] = mixed[m, 4 + joint]
        for i in range(6):
            motion.covariance[i] = mixed[m, 6 + i]


@device
def carry_on(motions: Motions, time_s: float) -> None:
    """Go on by a time; the noise of the acceleration as it is for times much below T_a."""
    t = time_s
    t2, t3 = t * t, t * t * t
    for m in range(MODELS):
        motion: EyeMotion = motions[m]
        forgets = _FORGETS_S[m]
        left = exp(-t / forgets)
        f13 = forgets * forgets * (t / forgets - 1.0 + left)
        f23 = forgets * (1.0 - left)
        for joint in range(2):
            a = motion.acceleration[joint]
            motion.angle[joint] += t * motion.rate[joint] + f13 * a
            motion.rate[joint] += f23 * a
            motion.acceleration[joint] = left * a
        c, noise = motion.covariance, 2.0 * _SD[m] * _SD[m] / forgets
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


@device
def fits(motions: Motions, weights: FloatArray, goals: FloatArray, variance: FloatArray) -> bool:
    """Whether measured angles (2,) of some variances lie where a likely model has them."""
    for m in range(MODELS):
        motion: EyeMotion = motions[m]
        within, gate = True, _GATE if weights[m + 1] > _LIKELY else _NARROW
        for joint in range(2):
            off = goals[joint] - motion.angle[joint]
            within = within and off * off < gate * (motion.covariance[0] + variance[joint])
        if within:
            return True
    return False


@device
def update(motion: EyeMotion, goals: FloatArray, variance: float) -> None:
    """Take measured angles (2,) of a variance into one model."""
    c = motion.covariance
    spread = c[0] + variance
    k1, k2, k3 = c[0] / spread, c[1] / spread, c[2] / spread
    for joint in range(2):
        off = goals[joint] - motion.angle[joint]
        motion.angle[joint] += k1 * off
        rate = motion.rate[joint] + k2 * off
        motion.rate[joint] = min(max(rate, -_FASTEST), _FASTEST)
        motion.acceleration[joint] += k3 * off
    p11, p12, p13 = c[0], c[1], c[2]
    c[0], c[1], c[2] = p11 - k1 * p11, p12 - k1 * p12, p13 - k1 * p13
    c[3] -= k2 * p12
    c[4] -= k2 * p13
    c[5] -= k3 * p13


@device
def take_in(
    motions: Motions,
    goals: FloatArray,
    variance: FloatArray,
    exact: FloatArray,
    surprises: FloatArray,
) -> None:
    """Take measured angles into all models.

    Args:
        motions: those of an eye, changed in place.
        goals: (2,) rad.
        variance: (2,) theirs, rad^2.
        exact: (2,) variances that no prediction goes below, rad^2.
        surprises: (WEIGHTS,) to which it adds how little each model has expected them.
    """
    own = 0.5 * (variance[0] + variance[1])
    for m in range(MODELS):
        motion: EyeMotion = motions[m]
        for joint in range(2):
            off = goals[joint] - motion.angle[joint]
            known = motion.covariance[0] + variance[joint] + exact[joint]
            surprises[m + 1] += surprise(off, known)
        update(motion, goals, own)


@device
def infer(motions: Motions, goals: FloatArray, variance: FloatArray) -> None:
    """Take in what the other eye tells of where one eye's target is, of its own variances (2,)."""
    own = 0.5 * (variance[0] + variance[1]) + _INFERRED_RAD * _INFERRED_RAD
    for m in range(MODELS):
        update(motions[m], goals, own)


@device
def surprise(off: float, variance: float) -> float:
    """Minus the logarithm of the likelihood of what is off by so much, of such a variance."""
    return 0.5 * (min(off * off / variance, _WORST) + log(variance))


@device
def add_surprises(surprises: FloatArray, own: FloatArray) -> None:
    """Add those of one eye (WEIGHTS,), which may err: it rules nothing out by one image."""
    least = own[0]
    for m in range(1, WEIGHTS):
        least = min(least, own[m])
    for m in range(WEIGHTS):
        surprises[m] += min(own[m] - least, _DOUBT)


@device
def weigh_motions(weights: FloatArray, surprises: FloatArray) -> None:
    """Bring the probabilities up to date with an image, from what it said to rest and models."""
    rest = _REST if weights[0] > 0.5 else _STOPS
    least = surprises[0] - rest
    for m in range(MODELS):
        least = min(least, surprises[m + 1])
    total = 0.0
    for m in range(WEIGHTS):
        more = surprises[m] - (rest if m == 0 else 0.0) - least
        weights[m] = max(weights[m] * exp(-min(more, 50.0)), 1e-12)
        total += weights[m]
    for m in range(WEIGHTS):
        weights[m] /= total


@device
def rate_of(motions: Motions, weights: FloatArray, joint: int) -> float:
    """How fast an eye's target moves if it does, rad/s."""
    total, rate = 1e-12, 0.0
    for m in range(MODELS):
        total += weights[m + 1]
        rate += weights[m + 1] * motions[m].rate[joint]
    return rate / total


@device
def slow_share(motions: Motions, weights: FloatArray, sees: float) -> float:
    """With which share of its target's speed an eye sees it even if it has turned round."""
    speed = hypot(rate_of(motions, weights, 0), rate_of(motions, weights, 1))
    return min(max((sees - speed) / max(speed, 1e-6), _LEAST_SHARE), 1.0)


@device
def ahead_of(
    motions: Motions,
    weights: FloatArray,
    resting: float,
    joint: int,
    time_s: float,
    expected_s: float,
    slow_share: float,
) -> tuple[float, float]:
    """An angle and its rate a time after the newest image: the mean of all models.

    Args:
        motions: those of an eye.
        weights: (WEIGHTS,) the models' probabilities.
        resting: where the target is if it rests, rad.
        joint: which joint.
        time_s: the time.
        expected_s: that by which another image should have shown it.
        slow_share: with which share of its speed it is followed after that.
    """
    left = exp(-max(time_s - _UNSEEN_S, 0.0) / _RETURNS_S)
    slow = slow_share * max(min(time_s, _UNSEEN_S) - expected_s, 0.0)
    slower = left * (slow_share if time_s > expected_s else 1.0)
    time_s = min(time_s, _UNSEEN_S, expected_s)
    way = rate = 0.0
    for m in range(MODELS):
        motion: EyeMotion = motions[m]
        forgets, w, a = _FORGETS_S[m], motion.rate[joint], motion.acceleration[joint]
        kept = exp(-time_s / forgets)
        now = w + a * forgets * (1.0 - kept)
        turn = w * time_s + a * forgets * forgets * (time_s / forgets - 1.0 + kept)
        share = 1.0
        if m == ERRATIC:  # by then it may have turned
            share, lasts = slow_share, exp(-time_s / _LASTS_S)
            now, turn = lasts * now, turn * _LASTS_S * (1.0 - lasts) / max(time_s, 1e-9)
        way += weights[m + 1] * (motion.angle[joint] - resting + share * (turn + slow * now))
        rate += weights[m + 1] * share * slower * now
    return resting + left * way, rate
