r"""Whether a target moves, and where it will be: a second filter beside that of a target at rest.

Per eye and joint, the angle that fixates a moving target follows Singer's model
(`vergence.controllers.prediction.singer`): an acceleration that forgets itself with the time T_a,

    d/dt (theta, w, a) = (w, a, -a / T_a) + white noise on a of variance 2 sigma_a^2 / T_a.

It lives at the exposure of the newest image, in the time in which joints are read; an image's date
may lie anywhere between two periods. An error of the date moves a measured angle with the eye, and
the target has moved as far meanwhile: what remains is the slip of the eye on the target, so eyes
that follow are not disturbed by it.

Both filters predict each image. The logarithm of the ratio of their likelihoods adds up to the
evidence that the target moves; where that is positive the moving one's prediction counts.
"""

from math import exp, log
from typing import Annotated, Final

from vergence._jit import device
from vergence.models.parts import FloatArray

_FORGETS_S: Final = 1.0
"""T_a."""
_START_RATE: Final = 0.5
"""How fast a new target may be, rad/s, standard deviation."""
_GATE: Final = 36.0
_WORST: Final = 25.0
_MOST: Final = 12.0
"""The evidence is limited to it, so that what has changed shows within some images."""
_REST: Final = 1.5
"""What an image says for rest in advance."""


class EyeMotion:
    """What is known of one eye's target if it moves; arrays are by joint."""

    angle: Annotated[FloatArray, 2]
    """theta, rad."""
    rate: Annotated[FloatArray, 2]
    """w, rad/s."""
    acceleration: Annotated[FloatArray, 2]
    """a, rad/s^2."""
    covariance: Annotated[FloatArray, 6]
    """Of (theta, w, a), which both joints have in common: its upper triangle by rows."""


@device
def begin_motion(motion: EyeMotion, goals: FloatArray, variance: float, sd: float) -> None:
    """Let it begin at rest at some angles (2,).

    Args:
        motion: changed in place.
        goals: rad.
        variance: of these, rad^2.
        sd: sigma_a, rad/s^2.
    """
    for joint in range(2):
        motion.angle[joint] = goals[joint]
        motion.rate[joint] = motion.acceleration[joint] = 0.0
    c = motion.covariance
    c[0], c[3], c[5] = variance, _START_RATE**2, sd * sd
    c[1] = c[2] = c[4] = 0.0


@device
def carry_on(motion: EyeMotion, time_s: float, sd: float) -> None:
    """Go on by a time; the noise of the acceleration as it is for times much below T_a."""
    t = time_s
    left = exp(-t / _FORGETS_S)
    f13 = _FORGETS_S * _FORGETS_S * (t / _FORGETS_S - 1.0 + left)
    f23 = _FORGETS_S * (1.0 - left)
    for joint in range(2):
        a = motion.acceleration[joint]
        motion.angle[joint] += t * motion.rate[joint] + f13 * a
        motion.rate[joint] += f23 * a
        motion.acceleration[joint] = left * a
    c, noise = motion.covariance, 2.0 * sd * sd / _FORGETS_S
    p11, p12, p13, p22, p23, p33 = c[0], c[1], c[2], c[3], c[4], c[5]
    # rows of F P, then F P F'
    a11, a12, a13 = p11 + t * p12 + f13 * p13, p12 + t * p22 + f13 * p23, p13 + t * p23 + f13 * p33
    a22, a23 = p22 + f23 * p23, p23 + f23 * p33
    t2, t3 = t * t, t * t * t
    c[0] = a11 + t * a12 + f13 * a13 + noise * t2 * t3 / 20.0
    c[1] = a12 + f23 * a13 + noise * t2 * t2 / 8.0
    c[2] = left * a13 + noise * t3 / 6.0
    c[3] = a22 + f23 * a23 + noise * t3 / 3.0
    c[4] = left * a23 + noise * t2 / 2.0
    c[5] = left * left * p33 + noise * t


@device
def fits(motion: EyeMotion, goals: FloatArray, variance: FloatArray) -> bool:
    """Whether measured angles (2,) of some variances lie where the motion has them."""
    for joint in range(2):
        off = goals[joint] - motion.angle[joint]
        if off * off > _GATE * (motion.covariance[0] + variance[joint]):
            return False
    return True


@device
def take_in(motion: EyeMotion, goals: FloatArray, variance: FloatArray) -> None:
    """Take in measured angles (2,) of some variances."""
    c = motion.covariance
    own = 0.5 * (variance[0] + variance[1])
    spread = c[0] + own
    k1, k2, k3 = c[0] / spread, c[1] / spread, c[2] / spread
    for joint in range(2):
        off = goals[joint] - motion.angle[joint]
        motion.angle[joint] += k1 * off
        motion.rate[joint] += k2 * off
        motion.acceleration[joint] += k3 * off
    p11, p12, p13 = c[0], c[1], c[2]
    c[0], c[1], c[2] = p11 - k1 * p11, p12 - k1 * p12, p13 - k1 * p13
    c[3] -= k2 * p12
    c[4] -= k2 * p13
    c[5] -= k3 * p13


@device
def surprise(off: float, variance: float) -> float:
    """What a measurement says against a filter that has it off by so much, of such a variance."""
    return 0.5 * (min(off * off / variance, _WORST) + log(variance))


@device
def weighed(evidence: float, added: float) -> float:
    """The evidence that a target moves after one image more."""
    return min(max(evidence + added - _REST, -_MOST), _MOST)


@device
def ahead_of(motion: EyeMotion, joint: int, time_s: float) -> tuple[float, float]:
    """An angle and its rate a time later."""
    w, a = motion.rate[joint], motion.acceleration[joint]
    left = exp(-time_s / _FORGETS_S)
    turn = _FORGETS_S * _FORGETS_S * (time_s / _FORGETS_S - 1.0 + left)
    return motion.angle[joint] + w * time_s + a * turn, w + a * _FORGETS_S * (1.0 - left)
