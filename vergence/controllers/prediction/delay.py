r"""Which delay explains the images: hypotheses of whole control periods, compared on line.

An image measures where each eye's joints should be, `g = q(t - d) + a`, the angles at its exposure
and those the eye then had still to turn. Under the true delay d the goal of a target that moves
smoothly changes smoothly whatever the eye does, so the second difference of three successive
images vanishes; under a wrong one the eye's own accelerations remain in it:

    r_d = g_d(k) - g_d(k') - (k - k') / (k' - k'') (g_d(k') - g_d(k''))

At rest all hypotheses agree and nothing is learned. During a saccade each period of error leaves
about a T^2 = 8 mrad, five pixels, in one image. A hypothesis has accumulated misfit; those with
little more than the least are plausible.

The angles a pose leaves to turn depend on the pose: a pan at another angle carries the tilt's
effect along. With the goal's pan P from the perpendicular and the tilt D still to turn, a goal
found with the pan wrong by e is wrong by `e tan(P) sin(D)` in tilt and `e cos(D)` in pan, which
moves a goal from one hypothesis to another without triangulating again.
"""

from math import cos, inf, isfinite, sin, tan
from typing import Any, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.joints import ANGLE_STEP, NOMINAL_DELAY

LONGEST: Final = 20
"""The longest hypothesis, in control periods."""
HYPOTHESES: Final = LONGEST + 1
RING: Final = 32
"""Angles of so many periods are remembered."""

# a remembered image: when it was read, the delay it was dated with, its goals, the factors
READ: Final = 0
DATED: Final = 1
GOAL: Final = 2
TURN: Final = 6
REST: Final = 10
IMAGE: Final = 14
"""Length of a remembered image."""

_MODEL_RAD: Final = 1e-3
"""What the head's model leaves in a second difference."""
_WORST: Final = 25.0
"""Misfit of one joint in one image, at most: an image that fits nothing is no proof."""
_EXCITED: Final = 4.0
"""Hypotheses that differ less in an image's misfit are not told apart by it."""
_FORGET: Final = 0.97
_PRIOR: Final = 12.0
"""Misfit that the nominal delay is allowed in advance."""
_PLAUSIBLE: Final = 12.0
"""Additional misfit of a hypothesis that is still plausible."""


@device
def remember_turn(image: Any, tilt_left: float, goal_pan: float, eye: int) -> None:
    """Remember how one eye's goal depends on the pan at exposure."""
    image[TURN + 2 * eye] = tan(goal_pan) * sin(tilt_left)
    image[TURN + 2 * eye + 1] = cos(tilt_left)


@device
def remember_dates(image: Any, ring: Any, count: int, delay: int) -> None:
    """Remember when an image was read, and what is left of its goals without the angles then."""
    image[READ], image[DATED] = count, delay
    then = 4 * ((count - delay) % RING)
    for j in range(0, 4, 2):
        pan = ring[then + j + 1]
        image[REST + j] = image[GOAL + j] - ring[then + j] - image[TURN + j] * pan
        image[REST + j + 1] = image[GOAL + j + 1] - image[TURN + j + 1] * pan


@device
def dated(image: Any, ring: Any, delay: int, eye: int) -> Any:
    """The goals of one eye, tilt and pan, by a remembered image, were its delay another."""
    j = 2 * eye
    then = np.uintp(4 * ((int(image[READ]) - delay) & (RING - 1)))
    pan = ring[then + np.uintp(j + 1)]
    return (
        image[REST + j] + ring[then + np.uintp(j)] + image[TURN + j] * pan,
        image[REST + j + 1] + image[TURN + j + 1] * pan,
    )


@device
def _weights(new: Any, old: Any, older: Any, middle: float, last: float, eye: int) -> Any:
    """What the second differences of one eye's goals take of the three images, read once."""
    t, p = 2 * eye, 2 * eye + 1
    return (
        new[REST + t] + middle * old[REST + t] + last * older[REST + t],
        new[TURN + t], middle * old[TURN + t], last * older[TURN + t],
        new[REST + p] + middle * old[REST + p] + last * older[REST + p],
        new[TURN + p], middle * old[TURN + p], last * older[TURN + p],
    )  # fmt: skip


@device
def _difference(
    w: Any, slots: Any, middle: float, last: float, ring: Any, delay: int, eye: int
) -> Any:
    """The second differences of one eye's goals under one hypothesis, tilt and pan."""
    i = np.uintp(4 * ((slots[0] - delay) & (RING - 1)) + 2 * eye)
    j = np.uintp(4 * ((slots[1] - delay) & (RING - 1)) + 2 * eye)
    k = np.uintp(4 * ((slots[2] - delay) & (RING - 1)) + 2 * eye)
    one = np.uintp(1)
    p, q, r = ring[i + one], ring[j + one], ring[k + one]
    tilt = w[0] + ring[i] + middle * ring[j] + last * ring[k] + w[1] * p + w[2] * q + w[3] * r
    return tilt, w[4] + w[5] * p + w[6] * q + w[7] * r


@device
def weigh_delays(
    misfit: Any, ring: Any, new: Any, old: Any, older: Any, rig: Any, noise: float, still: bool
) -> float:
    """Add three images' evidence to the hypotheses' misfit.

    Args:
        misfit: (2 HYPOTHESES,) changed in place; the second half is room to work in.
        ring: (4 RING,) the joints' angles of the last periods.
        new: the newest image, see `IMAGE`.
        old: the one before.
        older: the one before that.
        rig: see `joint_rig`.
        noise: variance of one image's goals, rad^2.
        still: whether the joints have hardly moved in the periods that are remembered.

    Returns:
        The mean square of the second differences by that of white noise, rad^2, if no
        hypothesis differs from another: a measure of the noise; else -1.
    """
    first, second = new[READ] - old[READ], old[READ] - older[READ]
    if older[READ] < 0.0 or first + second + LONGEST >= RING:
        return -1.0
    ratio = first / second
    gain = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    variance = _MODEL_RAD**2 + rig[ANGLE_STEP] ** 2 + gain * noise
    left = isfinite(new[GOAL] + old[GOAL] + older[GOAL])
    right = isfinite(new[GOAL + 2] + old[GOAL + 2] + older[GOAL + 2])
    if not (left or right):
        return -1.0
    middle = -(1.0 + ratio)
    slots = (int(new[READ]), int(old[READ]), int(older[READ]))
    wl = _weights(new, old, older, middle, ratio, 0)
    wr = _weights(new, old, older, middle, ratio, 1)
    lt = lp = rt = rp = 0.0
    if left:
        lt, lp = _difference(wl, slots, middle, ratio, ring, 0, 0)
    if right:
        rt, rp = _difference(wr, slots, middle, ratio, ring, 0, 1)
    square = (lt * lt + lp * lp + rt * rt + rp * rp) / (gain * 2.0 * (left + right))
    if still:
        return square  # type: ignore[no-any-return]
    scale = 1.0 / variance
    least, most = inf, 0.0
    for d in range(HYPOTHESES):
        if left:
            lt, lp = _difference(wl, slots, middle, ratio, ring, d, 0)
        if right:
            rt, rp = _difference(wr, slots, middle, ratio, ring, d, 1)
        total = min(lt * lt * scale, _WORST) + min(lp * lp * scale, _WORST)
        total += min(rt * rt * scale, _WORST) + min(rp * rp * scale, _WORST)
        misfit[HYPOTHESES + d] = total
        least, most = min(least, total), max(most, total)
    if most - least < _EXCITED:
        return square if most - least < 0.01 else -1.0
    for d in range(HYPOTHESES):
        misfit[d] = _FORGET * misfit[d] + misfit[HYPOTHESES + d] - least
    return -1.0


@device
def likely_delay(misfit: Any, rig: Any) -> int:
    """The hypothesis that explains the images best, the nominal one if none is clearly better."""
    nominal = int(rig[NOMINAL_DELAY])
    best, least = nominal, misfit[nominal]
    for d in range(HYPOTHESES):
        cost = misfit[d] + _PRIOR + 0.1 * abs(d - nominal)
        if d != nominal and cost < least:
            best, least = d, cost
    return best


@device
def least_misfit(misfit: Any) -> float:
    """The least misfit of all hypotheses."""
    least = misfit[0]
    for d in range(1, HYPOTHESES):
        least = min(least, misfit[d])
    return least  # type: ignore[no-any-return]


@device
def dating_error(misfit: Any, least: float, ring: Any, image: Any, eye: int) -> Any:
    """How far the goals of one eye, tilt and pan, may lie apart over the plausible delays, rad."""
    best_t, best_p = dated(image, ring, int(image[DATED]), eye)
    tilt = pan = 0.0
    for d in range(HYPOTHESES):
        if misfit[d] < least + _PLAUSIBLE:
            t, p = dated(image, ring, d, eye)
            tilt, pan = max(tilt, abs(t - best_t)), max(pan, abs(p - best_p))
    return tilt, pan
