"""Exposure times of images on the clock of the joint readings: a bank of delay hypotheses.

An image measures the joint angles that put each eye's target on its axis, `g = q(t) + a`: the
angles at the exposure plus the angles that the eye still had to turn. The joint reading that
belongs to the exposure is found by the delay D: the latency of images minus the latency of joint
readings. Each hypothesis of D has its own filtered goal. Under the true delay the goal of a target
stays where it was, whatever the eye does; under a wrong one the eye's own motion leaks into it. The
cost of a hypothesis is the sum of its squared normalised innovations, and its weight is
exp(-cost / 2), normalised. While the eyes rest, all hypotheses agree and nothing is learned;
during a saccade, 8 ms of delay are tens of pixels.

The angles left to turn depend on the pose at the exposure too. To first order the goal moves with
the joint angles assumed at the exposure: a hypothesis takes the goal computed at the mean angles
and adds the difference between its own angles and the mean. Close to the goal, where accuracy
matters, this is exact.
"""

from math import exp, floor, log
from typing import Final

import numpy as np

from vergence.kernels import inlined
from vergence.models.parts import FloatArray

HYPOTHESES: Final = 32
"""Number of delay hypotheses (numerical)."""
SPACING_S: Final = 0.008
"""Delay between neighbouring hypotheses, s (numerical)."""
_MAX_EARLIER_HYPOTHESES: Final = 12
"""Largest number of hypotheses below the head's nominal delay (numerical)."""
_MIN_DELAY_S: Final = -0.03
"""Shortest delay considered, s (chosen: stamped images may be newer than the joint readings)."""
_PRIOR_SD_S: Final = 0.035
"""Prior standard deviation of the delay, s (chosen: trust in data sheets against reaction time)."""
_STAMPED_PRIOR_SD_S: Final = 0.012
"""The prior standard deviation if the camera stamps exposures, s (chosen)."""
MAX_IMAGE_COST: Final = 16.0
"""Bound of one joint's cost in an image (chosen: what fits no hypothesis is no evidence)."""
_RULED_OUT_COST: Final = 150.0
"""Excess over the least cost that rules out a delay (chosen: a weight below exp(-75))."""
_LARGEST_COST: Final = 2000.0
"""Upper bound of a cost, so that a ruled-out delay can return (chosen)."""
_COST_DECAY: Final = 0.97
"""Factor left of costs after a fully informative image (chosen: noise against a changing delay)."""
DOUBTED_COST_FACTOR: Final = 0.5
"""Factor that remains of the costs once no hypothesis explains the images (chosen)."""


def first_hypothesis_delay(nominal_delay_s: float) -> float:
    """Delay of hypothesis 0, s, for a nominal delay; the nominal delay is one of the hypotheses."""
    earlier = max(floor((nominal_delay_s - _MIN_DELAY_S) / SPACING_S), 0)
    return nominal_delay_s - min(_MAX_EARLIER_HYPOTHESES, earlier) * SPACING_S


def prior_delay_costs(nominal_delay_s: float, stamped: bool, learn: bool) -> FloatArray:
    """(HYPOTHESES,) costs before the first image: a Gaussian prior, sharp if nothing is learned."""
    delays = first_hypothesis_delay(nominal_delay_s) + SPACING_S * np.arange(HYPOTHESES)
    sd = _STAMPED_PRIOR_SD_S if stamped else _PRIOR_SD_S
    return np.asarray(((delays - nominal_delay_s) / (sd if learn else 1e-6)) ** 2)


@inlined
def _least(values: FloatArray, low: int, high: int) -> float:
    """Least value from `low` to below `high`; unlike `min`, the loop is fast in kernels."""
    least: float = values[low]
    for i in range(low, high):
        least = min(least, values[i])
    return least


@inlined
def active_delay_range(cost: FloatArray) -> tuple[int, int]:
    """Index of the first delay that is not ruled out, and one past the last."""
    least, low, high = _least(cost, 0, HYPOTHESES), 0, HYPOTHESES
    while cost[low] - least > _RULED_OUT_COST:
        low += 1
    while cost[high - 1] - least > _RULED_OUT_COST:
        high -= 1
    return low, high


@inlined
def delay_posterior(cost: FloatArray, low: int, high: int, weights: FloatArray) -> None:
    """Compute the normalised weights of the delays from `low` to below `high`."""
    least, total = _least(cost, low, high), 0.0
    for i in range(low, high):
        weights[i] = exp(-0.5 * (cost[i] - least))
        total += weights[i]
    for i in range(low, high):
        weights[i] /= total


@inlined
def marginal_nll(cost: FloatArray, low: int, high: int, added: FloatArray) -> float:
    """Negative log-likelihood of an image over the delays, from the costs that it adds."""
    least, first = _least(cost, low, high), _least(added, low, high)
    total = likely = 0.0
    for i in range(low, high):
        weight = exp(-0.5 * (cost[i] - least))
        total, likely = total + weight, likely + weight * exp(-0.5 * (added[i] - first))
    nll: float = 0.5 * first - log(max(likely / total, 1e-30))
    return nll


@inlined
def decay_and_add_costs(cost: FloatArray, low: int, high: int, added: FloatArray) -> None:
    """Add an image's costs; all old ones decay the more, the more the image tells of the delay."""
    least = most = _least(added, low, high)
    for i in range(low, high):
        most = max(most, added[i])
    forget = 1.0 - (1.0 - _COST_DECAY) * min(most - least, 1.0)
    for i in range(HYPOTHESES):
        cost[i] *= forget
        if low <= i < high:
            cost[i] += added[i] - least
        cost[i] = min(cost[i], _LARGEST_COST)
