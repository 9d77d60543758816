"""What the predictor remembers of a head: a row of numbers, and how the joints' part is kept."""

from math import nan
from typing import Any, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.delay import HYPOTHESES, IMAGE, RING
from vergence.controllers.prediction.joints import (
    LAG,
    LAG_INFORMATION,
    NOMINAL_DELAY,
    PIXEL_SIGMA,
    learn_lag,
    track_joint,
)
from vergence.models.parts import FloatArray
from vergence.triangulation.lines_of_sight import DEFAULT_DEPTH_M

COUNT: Final = 0
"""Periods since the trial began."""
DELAY: Final = 1
"""The delay from exposure to reading, in periods."""
PRESENT_LAG: Final = 2
"""The joints' lag, s."""
INFORMATION: Final = 3
"""Information on the lag, see `learn_lag`."""
NOISE: Final = 4
"""Variance of one image's goals, rad^2."""
UNSEEN: Final = 5
"""Periods since an image showed each eye its target."""
DEPTH: Final = 7
"""Depth at which each eye saw its target last, m."""
RANGE: Final = 9
"""Depth of each eye's target once fixated, m."""
STILL: Final = 11
"""Periods since the eyes have moved."""
VELOCITY: Final = 12
"""Velocities of the eye joints, rad/s."""
GOALS: Final = 16
"""Angles of the eye joints that fixate the target, rad; nan unknown."""
VARIANCE: Final = 20
"""Variances of the goals, rad^2."""
ANGLES: Final = 24
"""Ring of the eye joints' angles in the last periods, rad."""
IMAGES: Final = ANGLES + 4 * RING
"""Room for a new image, the last and the one before."""
MISFIT: Final = IMAGES + 3 * IMAGE
"""Misfits of the delays in question, and room to work in."""
SIZE: Final = MISFIT + 2 * HYPOTHESES
"""Length of the row."""

_STILL_RAD_S: Final = 0.005
"""Slower, no delay in question moves the eye by a pixel."""


def initial_row(rig: FloatArray) -> FloatArray:
    """(SIZE,) what is remembered before the first observation.

    Args:
        rig: see `vergence.controllers.prediction.joints.joint_rig`.
    """
    row = np.zeros(SIZE)
    row[DELAY] = rig[NOMINAL_DELAY]
    row[PRESENT_LAG], row[INFORMATION] = rig[LAG], LAG_INFORMATION
    row[NOISE] = rig[PIXEL_SIGMA] ** 2
    row[DEPTH : DEPTH + 2] = DEFAULT_DEPTH_M
    row[GOALS : GOALS + 4] = nan
    row[IMAGES:MISFIT:IMAGE] = -1.0
    return row


@device
def track(row: Any, positions: Any, velocities: Any, command: Any, rig: Any, learn: bool) -> None:
    """Bring the ring of angles, the velocities and the lag up to date."""
    count = int(row[COUNT])
    row[COUNT] = count + 1
    if count == 0:
        # a trial begins at rest
        for slot in range(RING):
            for j in range(4):
                row[ANGLES + 4 * slot + j] = positions[3 + j]
        for j in range(4):
            row[VELOCITY + j] = velocities[3 + j]
        return
    before, now = (count - 1) % RING, count % RING
    lag, information = row[PRESENT_LAG], row[INFORMATION]
    for j in range(4):
        q, v, u = row[ANGLES + 4 * before + j], row[VELOCITY + j], command[j]
        q_read, v_read = positions[3 + j], velocities[3 + j]
        if learn:
            lag, information = learn_lag(rig, j, v, u, v_read, lag, information)
        q, v = track_joint(rig, j, q, v, u, row[PRESENT_LAG], q_read, v_read)
        row[ANGLES + 4 * now + j] = q
        row[VELOCITY + j] = v
        if abs(v) > _STILL_RAD_S:
            row[STILL] = -1.0
    row[STILL] += 1.0
    row[PRESENT_LAG], row[INFORMATION] = lag, information
