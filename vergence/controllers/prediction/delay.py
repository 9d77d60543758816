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
from typing import Final, NamedTuple

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import (
    HYPOTHESES,
    LONGEST,
    RING,
    Image,
    Memory,
    place,
)
from vergence.models.parts import FloatArray

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
def remember_turn(image: Image, tilt_left: float, goal_pan: float, eye: int) -> None:
    """Remember how one eye's goals depend on the pan at exposure."""
    image.turn[eye, 0] = tan(goal_pan) * sin(tilt_left)
    image.turn[eye, 1] = cos(tilt_left)


@device
def remember_dates(image: Image, angles: FloatArray, count: float, delay: float) -> None:
    """Remember when an image was read, and what is left of its goals without the angles then."""
    image.read, image.delay = count, delay
    then = place(count, delay)
    for eye in range(2):
        pan = angles[then, eye, 1]
        image.rest[eye, 0] = image.goals[eye, 0] - angles[then, eye, 0] - image.turn[eye, 0] * pan
        image.rest[eye, 1] = image.goals[eye, 1] - image.turn[eye, 1] * pan


@device
def dated(image: Image, angles: FloatArray, delay: float, eye: int) -> tuple[float, float]:
    """The goals of one eye, tilt and pan, by a remembered image, were its delay another."""
    then = place(image.read, delay)
    pan = angles[then, eye, 1]
    return (
        image.rest[eye, 0] + angles[then, eye, 0] + image.turn[eye, 0] * pan,
        image.rest[eye, 1] + image.turn[eye, 1] * pan,
    )


class _Triple(NamedTuple):
    """Three images: their counts, and what the older two weigh in a second difference."""

    new: int
    old: int
    older: int
    middle: float
    last: float


class _Differences(NamedTuple):
    """Second differences of an eye's goals but for the angles at exposure, and their weights."""

    tilt: float
    tilt_new: float
    tilt_old: float
    tilt_older: float
    pan: float
    pan_new: float
    pan_old: float
    pan_older: float


@device
def _differences(images: list[Image], three: _Triple, eye: int) -> _Differences:
    new, old, older, middle, last = images[0], images[1], images[2], three.middle, three.last
    return _Differences(
        new.rest[eye, 0] + middle * old.rest[eye, 0] + last * older.rest[eye, 0],
        new.turn[eye, 0], middle * old.turn[eye, 0], last * older.turn[eye, 0],
        new.rest[eye, 1] + middle * old.rest[eye, 1] + last * older.rest[eye, 1],
        new.turn[eye, 1], middle * old.turn[eye, 1], last * older.turn[eye, 1],
    )  # fmt: skip


@device
def _of_delay(
    w: _Differences, three: _Triple, angles: FloatArray, delay: int, eye: int
) -> tuple[float, float]:
    """The second differences of one eye's goals under one hypothesis, tilt and pan."""
    i, j, k = place(three.new, delay), place(three.old, delay), place(three.older, delay)
    p, q, r = angles[i, eye, 1], angles[j, eye, 1], angles[k, eye, 1]
    tilt = w.tilt + angles[i, eye, 0] + three.middle * angles[j, eye, 0]
    tilt += three.last * angles[k, eye, 0]
    tilt = tilt + w.tilt_new * p + w.tilt_old * q + w.tilt_older * r
    return tilt, w.pan + w.pan_new * p + w.pan_old * q + w.pan_older * r


@device
def weigh_delays(memory: Memory, rig: Rig, still: bool) -> float:
    """Add the evidence of the three remembered images to the misfit of the delays.

    Args:
        memory: changed in place.
        rig: what is known of the joints.
        still: whether the joints have hardly moved in the periods that are remembered.

    Returns:
        The mean square of the second differences by that of white noise, rad^2, if no
        hypothesis differs from another: a measure of the noise; else -1.
    """
    images, angles = memory.images, memory.angles
    new, old, older = images[0], images[1], images[2]
    first, second = new.read - old.read, old.read - older.read
    if older.read < 0.0 or first + second + LONGEST >= RING:
        return -1.0
    ratio = first / second
    gain = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    variance = _MODEL_RAD**2 + rig.angle_step_rad**2 + gain * memory.noise
    left = isfinite(new.goals[0, 0] + old.goals[0, 0] + older.goals[0, 0])
    right = isfinite(new.goals[1, 0] + old.goals[1, 0] + older.goals[1, 0])
    if not (left or right):
        return -1.0
    three = _Triple(int(new.read), int(old.read), int(older.read), -(1.0 + ratio), ratio)
    of_left, of_right = _differences(images, three, 0), _differences(images, three, 1)
    lt = lp = rt = rp = 0.0
    if left:
        lt, lp = _of_delay(of_left, three, angles, 0, 0)
    if right:
        rt, rp = _of_delay(of_right, three, angles, 0, 1)
    square = (lt * lt + lp * lp + rt * rt + rp * rp) / (gain * 2.0 * (left + right))
    if still:
        return square
    scale = 1.0 / variance
    least, most = inf, 0.0
    for d in range(HYPOTHESES):
        if left:
            lt, lp = _of_delay(of_left, three, angles, d, 0)
        if right:
            rt, rp = _of_delay(of_right, three, angles, d, 1)
        total = min(lt * lt * scale, _WORST) + min(lp * lp * scale, _WORST)
        total += min(rt * rt * scale, _WORST) + min(rp * rp * scale, _WORST)
        memory.image_misfit[d] = total
        least, most = min(least, total), max(most, total)
    if most - least < _EXCITED:
        return square if most - least < 0.01 else -1.0
    for d in range(HYPOTHESES):
        memory.misfit[d] = _FORGET * memory.misfit[d] + memory.image_misfit[d] - least
    return -1.0


@device
def likely_delay(misfit: FloatArray, rig: Rig) -> int:
    """The hypothesis that explains the images best, the nominal one if none is clearly better."""
    nominal = int(rig.delay)
    best, least = nominal, misfit[nominal]
    for d in range(HYPOTHESES):
        cost = misfit[d] + _PRIOR + 0.1 * abs(d - nominal)
        if d != nominal and cost < least:
            best, least = d, cost
    return best


@device
def least_misfit(misfit: FloatArray) -> float:
    """The least misfit of all hypotheses."""
    least: float = misfit[0]
    for d in range(1, HYPOTHESES):
        least = min(least, misfit[d])
    return least


@device
def dating_error(memory: Memory, least: float, eye: int) -> tuple[float, float]:
    """How far the newest goals of one eye lie apart over the plausible delays, rad.

    Args:
        memory: what is remembered.
        least: what `least_misfit` returned.
        eye: which one.

    Returns:
        The most by which tilt and pan differ from those under the present delay.
    """
    image = memory.images[0]
    best_t, best_p = dated(image, memory.angles, image.delay, eye)
    tilt = pan = 0.0
    for d in range(HYPOTHESES):
        if memory.misfit[d] < least + _PLAUSIBLE:
            t, p = dated(image, memory.angles, d, eye)
            tilt, pan = max(tilt, abs(t - best_t)), max(pan, abs(p - best_p))
    return tilt, pan
