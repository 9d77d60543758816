r"""When an image was exposed, in the time in which joints are read: hypotheses, weighed on line.

An image measures where each eye's joints should be, `g = q(t) + a`: the angles at its exposure and
those the eye then had still to turn. Which reading of the joints belongs to the exposure depends on
the image's delay less that of the readings, D. Each of some delays has a filtered goal of its own;
under the true one a target's goal goes on as it was, whatever the eye does, and under a wrong one
the eye's own motion remains in it. So a delay's misfit is the sum of its squared innovations, by
their variance, and its weight falls exponentially with it. While the eyes rest all agree and
nothing is learned; during a saccade, 8 ms are tens of pixels.

The angles a pose leaves to turn depend on the pose too. To first order the goal moves with the
joints' angles as they are taken to be at the exposure; a hypothesis takes the goal of the mean
angles and adds by how much its own differ. Close to the goal, where it counts, that is exact.
"""

from math import exp, floor, log
from typing import Final

import numpy as np

from vergence._jit import device
from vergence.models.parts import FloatArray

HYPOTHESES: Final = 32
SPACING_S: Final = 0.008
"""From one hypothesis to the next."""
_EARLIER: Final = 12
"""How many of them are shorter than a head says."""
_LEAST_S: Final = -0.03
"""The least delay in question: that of stamps is less than that of the readings."""
_SD_S: Final = 0.035
"""How far a delay may be from what a head says, standard deviation."""
_STAMPED_SD_S: Final = 0.012
_WORST: Final = 16.0
"""Misfit of one joint in one image, at most: an image that fits nothing is no proof."""
_OUT: Final = 150.0
"""Misfit by that of the best one beyond which a delay is out of question."""
_MOST: Final = 2000.0
_FORGET: Final = 0.97
_DOUBT: Final = 0.5
"""What is left of the misfits when nothing explains the images."""


def first_delay(latency_s: float) -> float:
    """The first of the delays in question where a head says this one, which is one of them, s."""
    earlier = min(_EARLIER, max(floor((latency_s - _LEAST_S) / SPACING_S), 0))
    return latency_s - earlier * SPACING_S


def first_misfits(latency_s: float, stamped: bool, learn: bool) -> FloatArray:
    """(HYPOTHESES,) the delays' misfits before the first image.

    Args:
        latency_s: what the head says.
        stamped: whether images are dated by the camera.
        learn: whether it may be otherwise.
    """
    delays = first_delay(latency_s) + SPACING_S * np.arange(HYPOTHESES)
    sd = _STAMPED_SD_S if stamped else _SD_S
    return np.asarray(((delays - latency_s) / (sd if learn else 1e-6)) ** 2)


@device
def in_question(misfit: FloatArray) -> tuple[int, int]:
    """The first of the delays that it may be, and the one after the last."""
    least = misfit[0]
    for i in range(HYPOTHESES):
        least = min(least, misfit[i])
    low, high = 0, HYPOTHESES
    while misfit[low] - least > _OUT:
        low += 1
    while misfit[high - 1] - least > _OUT:
        high -= 1
    return low, high


@device
def weigh(misfit: FloatArray, low: int, high: int, weights: FloatArray) -> None:
    """The weights of the delays in question, from `low` to below `high`; they sum to 1."""
    least = misfit[low]
    for i in range(low, high):
        least = min(least, misfit[i])
    total = 0.0
    for i in range(low, high):
        weights[i] = exp(-0.5 * (misfit[i] - least))
        total += weights[i]
    for i in range(low, high):
        weights[i] /= total


@device
def add_misfit(added: FloatArray, square: float, i: int) -> None:
    """Add a squared innovation by its variance to what an image adds to a delay's misfit."""
    added[i] += min(square, _WORST)


@device
def unlikely(misfit: FloatArray, low: int, high: int, added: FloatArray) -> float:
    """Minus the logarithm of the likelihood of an image, over all delays, from what it adds."""
    least, first = misfit[low], added[low]
    for i in range(low, high):
        least, first = min(least, misfit[i]), min(first, added[i])
    total = likely = 0.0
    for i in range(low, high):
        weight = exp(-0.5 * (misfit[i] - least))
        total, likely = total + weight, likely + weight * exp(-0.5 * (added[i] - first))
    surprise: float = 0.5 * first - log(max(likely / total, 1e-30))
    return surprise


@device
def take_misfits(misfit: FloatArray, low: int, high: int, added: FloatArray) -> None:
    """Take what an image has added into the misfits; old ones fade as new ones come.

    Those of delays that are not in question fade too, until they are again.
    """
    least = most = added[low]
    for i in range(low, high):
        least, most = min(least, added[i]), max(most, added[i])
    forget = 1.0 - (1.0 - _FORGET) * min(most - least, 1.0)
    for i in range(HYPOTHESES):
        misfit[i] *= forget
        if low <= i < high:
            misfit[i] += added[i] - least
        misfit[i] = min(misfit[i], _MOST)


@device
def doubt_delays(misfit: FloatArray) -> None:
    """Let a part of what is known of the delays be forgotten."""
    for i in range(HYPOTHESES):
        misfit[i] *= _DOUBT
