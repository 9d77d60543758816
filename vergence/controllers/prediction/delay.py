r"""Which delay explains the images: hypotheses of whole control periods, compared on line.

An image measures where each eye's joints should be, `g = q(t - d) + a`, the angles at its exposure
and those the eye then had still to turn. Under the true delay d the goal of a target that moves
smoothly changes smoothly whatever the eye does, so the second difference of three successive
images vanishes; under a wrong one the eye's own accelerations remain in it:

    r_d = g_d(k) - g_d(k') - (k - k') / (k' - k'') (g_d(k') - g_d(k''))

At rest all hypotheses agree and nothing is learned. During a saccade each period of error leaves
about a T^2 = 8 mrad, five pixels, in one image. A hypothesis has accumulated misfit; those with
little more than the least are plausible.

The angles a pose leaves to turn depend on the pose. With the first joint wrong by e at the
exposure, the first joint's goal is wrong by e, as all behind it turns along; with the second
wrong by e, both goals are, by `e turn`. With a_1 and a_2 the unit axes and d the optical axis at
the goal, and D the angle that the first joint still has to turn, to first order in e

    a_2(q) - turn_1 a_1 - turn_2 a_2  parallel to  d,   a_2(q) = a_2 turned about a_1 by -D

Where a_1, a_2 and the optical axis at zero are at right angles and the second goal is P, those are
`turn = (tan(P) sin(D), cos(D))`, whether an eye tilts first or pans first. So a goal goes from one
hypothesis to another without triangulating again.
"""

from math import cos, inf, isfinite, sin, sqrt, tan
from typing import Final, NamedTuple

from vergence._jit import device, subroutine
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import (
    HYPOTHESES,
    LONGEST,
    RING,
    Image,
    Memory,
    place,
)
from vergence.models.kinematics import EyeFrames
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
def remember_turn(
    image: Image, rig: Rig, eye: int, first_left: float, goals: FloatArray, frames: EyeFrames
) -> None:
    """Remember how one eye's goals depend on the second joint's angle at exposure.

    Args:
        image: changed in place.
        rig: what is known of the head.
        eye: which one.
        first_left: what its first joint still had to turn at the exposure, rad.
        goals: (2,) its joints' goals, rad.
        frames: the eye's frames at them.
    """
    if rig.square[eye] > 0.5:
        image.turn[eye, 0] = tan(goals[1]) * sin(first_left)
        image.turn[eye, 1] = cos(first_left)
    else:
        image.turn[eye, 0], image.turn[eye, 1] = turn_of_axes(first_left, frames)


@subroutine
def turn_of_axes(first_left: float, frames: EyeFrames) -> tuple[float, float]:
    """How an eye's goals depend on the second joint's angle at exposure, for axes at any angle.

    Args:
        first_left: what the first joint still had to turn at the exposure, rad.
        frames: the eye's frames at its goals.

    Returns:
        The changes of the first and the second goal by that of the angle.
    """
    ax, ay, az = frames.first.xz, frames.first.yz, frames.first.zz
    bx, by, bz = frames.second.xz, frames.second.yz, frames.second.zz
    dx, dy, dz = frames.camera.xz, frames.camera.yz, frames.camera.zz
    along = ax * bx + ay * by + az * bz
    across = sqrt(max(1.0 - along * along, 0.0))
    # an orthonormal frame of a_1, of what a_2 has across it, and of both their normal
    if not across > 1e-6:
        return 0.0, 1.0
    bx, by, bz = (bx - along * ax) / across, (by - along * ay) / across, (bz - along * az) / across
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    d1, d2 = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    d3 = nx * dx + ny * dy + nz * dz
    if not abs(d3) > 1e-6:
        return 0.0, 1.0
    second = cos(first_left) + sin(first_left) * d2 / d3
    return along * (1.0 - second) + across * sin(first_left) * d1 / d3, second


@device
def remember_dates(image: Image, angles: FloatArray, count: float, delay: float) -> None:
    """Remember when an image was read, and what is left of its goals without the angles then."""
    image.read, image.delay = count, delay
    then = place(count, delay)
    for eye in range(2):
        q2 = angles[then, eye, 1]
        image.rest[eye, 0] = image.goals[eye, 0] - angles[then, eye, 0] - image.turn[eye, 0] * q2
        image.rest[eye, 1] = image.goals[eye, 1] - image.turn[eye, 1] * q2


@device
def dated(image: Image, angles: FloatArray, delay: float, eye: int) -> tuple[float, float]:
    """The goals of one eye's joints by a remembered image, were its delay another."""
    then = place(image.read, delay)
    q2 = angles[then, eye, 1]
    return (
        image.rest[eye, 0] + angles[then, eye, 0] + image.turn[eye, 0] * q2,
        image.rest[eye, 1] + image.turn[eye, 1] * q2,
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

    first: float
    first_new: float
    first_old: float
    first_older: float
    second: float
    second_new: float
    second_old: float
    second_older: float


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
    """The second differences of one eye's goals under one hypothesis, first and second joint."""
    i, j, k = place(three.new, delay), place(three.old, delay), place(three.older, delay)
    p, q, r = angles[i, eye, 1], angles[j, eye, 1], angles[k, eye, 1]
    one = w.first + angles[i, eye, 0] + three.middle * angles[j, eye, 0]
    one += three.last * angles[k, eye, 0]
    one = one + w.first_new * p + w.first_old * q + w.first_older * r
    return one, w.second + w.second_new * p + w.second_old * q + w.second_older * r


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
    step = max(
        rig.joint_step[0, 0], rig.joint_step[0, 1], rig.joint_step[1, 0], rig.joint_step[1, 1]
    )
    variance = _MODEL_RAD**2 + step**2 + gain * memory.noise
    left = isfinite(new.goals[0, 0] + old.goals[0, 0] + older.goals[0, 0])
    right = isfinite(new.goals[1, 0] + old.goals[1, 0] + older.goals[1, 0])
    if not (left or right):
        return -1.0
    three = _Triple(int(new.read), int(old.read), int(older.read), -(1.0 + ratio), ratio)
    of_left, of_right = _differences(images, three, 0), _differences(images, three, 1)
    l1 = l2 = r1 = r2 = 0.0
    if left:
        l1, l2 = _of_delay(of_left, three, angles, 0, 0)
    if right:
        r1, r2 = _of_delay(of_right, three, angles, 0, 1)
    square = (l1 * l1 + l2 * l2 + r1 * r1 + r2 * r2) / (gain * 2.0 * (left + right))
    if still:
        return square
    scale = 1.0 / variance
    least, most = inf, 0.0
    for d in range(HYPOTHESES):
        if left:
            l1, l2 = _of_delay(of_left, three, angles, d, 0)
        if right:
            r1, r2 = _of_delay(of_right, three, angles, d, 1)
        total = min(l1 * l1 * scale, _WORST) + min(l2 * l2 * scale, _WORST)
        total += min(r1 * r1 * scale, _WORST) + min(r2 * r2 * scale, _WORST)
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
        The most by which both goals differ from those under the present delay.
    """
    image = memory.images[0]
    best_1, best_2 = dated(image, memory.angles, image.delay, eye)
    first = second = 0.0
    for d in range(HYPOTHESES):
        if memory.misfit[d] < least + _PLAUSIBLE:
            one, two = dated(image, memory.angles, d, eye)
            first, second = max(first, abs(one - best_1)), max(second, abs(two - best_2))
    return first, second
