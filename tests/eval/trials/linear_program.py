"""Check that an actuator can reach its band in time, as a linear program in its accelerations.

The motor's equation dv/dt = clip((u - v) / lag, -a, a) with |u| <= u_max allows an acceleration w
where |w| <= a and |v + lag w| <= u_max. With w constant over short pieces, angles and velocities
are linear in them, and so is "in the band at this step and all later ones, and at rest at last".
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

AFTER_S = 0.25
"""Time to come to rest within the band."""


class Actuator(NamedTuple):
    """Limits of an actuator, and its task."""

    turn: float
    """Angle to turn, rad."""
    half_band: float
    """Half width of its band, rad."""
    lag: float
    acceleration: float
    top: float
    """Greatest command, gain included, rad/s."""


def is_in_time(one: Actuator, time_s: float, period_s: float, pieces: int = 5) -> bool:
    """True if an actuator at rest can be in its band from a time on, at all control steps.

    Args:
        one: the actuator.
        time_s: the time, which ends at a control step.
        period_s: from one control step to the next.
        pieces: pieces of constant acceleration per period.
    """
    if time_s <= 0.0:
        return abs(one.turn) <= one.half_band
    before = max(int(np.ceil(time_s / period_s * pieces - 1e-9)), 1)
    after = int(np.ceil(AFTER_S / period_s))
    length = np.concatenate(
        [np.full(before, time_s / before), np.full(after * pieces, period_s / pieces)]
    )
    ends = np.cumsum(length)
    begins = ends - length
    done = ends[:, None] >= ends - 1e-12  # which pieces are over at the end of each
    speed = done * length
    place = done * length * (ends[:, None] - begins - 0.5 * length)
    eye = np.eye(len(length))
    at_begin = np.vstack([np.zeros(len(length)), speed[:-1]]) + one.lag * eye
    at_end = speed + one.lag * eye
    looked = before - 1 + pieces * np.arange(after + 1)
    upper = np.vstack([at_begin, -at_begin, at_end, -at_end, place[looked], -place[looked]])
    limits = np.concatenate(
        [
            np.full(4 * len(length), one.top),
            np.full(after + 1, one.turn + one.half_band),
            np.full(after + 1, one.half_band - one.turn),
        ]
    )
    # lengths near one, for the solver's tolerances
    scale = one.acceleration
    found = linprog(
        np.zeros(len(length)),
        A_ub=scale * upper,
        b_ub=limits,
        A_eq=scale * speed[-1:],
        b_eq=[0.0],
        bounds=(-1.0, 1.0),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-9},
    )
    assert found.status in (0, 2), found.message
    return bool(found.status == 0)
