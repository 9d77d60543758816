"""What the predictor remembers of a head, and how its part on the joints is kept up to date.

Arrays (2, 2) are by eye and joint, first and second; arrays of four by actuator of the eyes.
"""

from math import nan
from typing import Annotated, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.joints import (
    LAG_INFORMATION,
    RIG,
    JointReading,
    Rig,
    learn_lag,
    track_joint,
)
from vergence.controllers.rows import make_row, row_layout, row_size
from vergence.envs.layout import AGE_S
from vergence.models.packed import (
    PackedHead,
    actuator_at,
    actuator_rate,
    is_direct,
    joint_at,
)
from vergence.models.parts import FloatArray
from vergence.triangulation.lines_of_sight import DEFAULT_DEPTH_M

LONGEST: Final = 20
"""The longest delay in question, in control periods."""
HYPOTHESES: Final = LONGEST + 1
RING: Final = 32
"""Angles of so many periods are remembered."""
_STILL_RAD_S: Final = 0.005
"""Slower, no delay in question moves the eye by a pixel."""


class Image:
    """An image: when it was read, and the goals that it shows under any delay.

    Under a delay d the goals are `rest + turn times the second joint's angle of d periods before`,
    and the first joint's angle then for the first; see `vergence.controllers.prediction.delay`.
    """

    read: float
    """The count of periods when it was read; negative for no image."""
    delay: float
    """The delay by which it is dated, in periods."""
    goals: Annotated[FloatArray, 2, 2]
    """The joint angles that fixate the target under that delay, rad; nan for an eye that did
    not see it."""
    turn: Annotated[FloatArray, 2, 2]
    """How the goals change with the second joint's angle at exposure."""
    rest: Annotated[FloatArray, 2, 2]
    """What is left of the goals without the angles at exposure, rad."""


class Memory:
    """What is remembered of one head."""

    count: float
    """Periods since the first observation of the trial, -1 before it."""
    delay: float
    """The delay from an exposure to its reading, in periods."""
    lag_s: float
    """The lag of the head's timing."""
    lag_information: float
    """Information on the lag, see `learn_lag`."""
    noise: float
    """Variance of one image's goals, rad^2."""
    image_age_s: float
    """Age of the newest image, for the next period to tell whether there is a newer one."""
    unseen: Annotated[FloatArray, 2]
    """Periods since an image showed each eye its target."""
    depth: Annotated[FloatArray, 2]
    """Depth at which each eye saw its target last, m."""
    fixated_depth: Annotated[FloatArray, 2]
    """Depth of each eye's target once it is on the axis, m."""
    still: float
    """Periods since the eyes have moved."""
    actuators: Annotated[FloatArray, 4]
    """Angles of the actuators, rad."""
    velocity: Annotated[FloatArray, 4]
    """Velocities of the actuators, rad/s."""
    goals: Annotated[FloatArray, 2, 2]
    """Angles that fixate the target, rad; nan where it is not known."""
    variance: Annotated[FloatArray, 2, 2]
    """Variances of the goals, rad^2."""
    angles: Annotated[FloatArray, RING, 2, 2]
    """The joints' angles by period, a ring in which period k has the place k modulo `RING`."""
    images: Annotated[list[Image], 3]
    """Room for a new image, the last one, and the one before."""
    misfit: Annotated[FloatArray, HYPOTHESES]
    """How badly each delay, from 0 periods on, has explained the images."""
    image_misfit: Annotated[FloatArray, HYPOTHESES]
    """Room for what one image adds to the misfits."""


MEMORY: Final = row_layout(Memory)
SIZE: Final = row_size(MEMORY)
"""Length of the row."""


def initial_row(rig_row: FloatArray) -> FloatArray:
    """(SIZE,) what is remembered before the first observation.

    Args:
        rig_row: see `vergence.controllers.prediction.joints.joint_rig`.
    """
    rig: Rig = rig_row.view(RIG)[0]
    images = np.zeros(3, dtype=MEMORY["images"].base)
    images["read"] = -1.0
    return make_row(
        MEMORY,
        count=-1.0,
        delay=rig.delay,
        lag_s=rig.lag_s,
        lag_information=LAG_INFORMATION,
        noise=rig.pixel_rad**2,
        image_age_s=AGE_S,
        depth=DEFAULT_DEPTH_M,
        goals=nan,
        images=images,
    )


@device
def place(count: float, delay: float) -> np.uintp:
    """The place in the ring of the angles some periods before a count."""
    # unsigned, so that no index is counted from the end
    return np.uintp(int(count - delay) & (RING - 1))


@device
def track(
    memory: Memory,
    rig: Rig,
    p: PackedHead,
    positions: FloatArray,
    velocities: FloatArray,
    command: FloatArray,
    learn: bool,
) -> None:
    """Bring the angles, the velocities and the lag up to date with a period's readings.

    Args:
        memory: changed in place.
        rig: what is known of the head.
        p: a packed head.
        positions: (7,) joint angles as read, rad.
        velocities: (7,) joint velocities as read, rad/s.
        command: (4,) the actuators' velocities that were commanded, rad/s.
        learn: whether to learn the lag.
    """
    memory.count += 1.0
    direct, begins = is_direct(p), memory.count == 0.0
    lag, information = memory.lag_s, memory.lag_information
    for j in range(4):
        angle, rate = positions[3 + j], velocities[3 + j]
        if not direct:
            angle = actuator_at(p, j, positions[3:])
            rate = actuator_rate(p, j, velocities[3:])
        q, v = memory.actuators[j], memory.velocity[j]
        if begins:  # at rest
            q, v = angle, rate
        else:
            read = JointReading(command[j], angle, rate)
            if learn:
                lag, information = learn_lag(rig, j, v, lag, information, read)
            q, v = track_joint(rig, j, q, v, rig.lag_ratio[j] * memory.lag_s, read)
            if abs(v) > _STILL_RAD_S:
                memory.still = -1.0
        memory.actuators[j], memory.velocity[j] = q, v
    now = place(memory.count, 0.0)
    for j in range(4):
        q = memory.actuators[j] if direct else joint_at(p, j, memory.actuators)
        if begins:
            for slot in range(RING):
                memory.angles[slot, j // 2, j % 2] = q
        memory.angles[now, j // 2, j % 2] = q
    if begins:
        return
    memory.still += 1.0
    memory.lag_s, memory.lag_information = lag, information
