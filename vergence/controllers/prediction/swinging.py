"""Whether the eyes swing about their goals: motions to and fro that do not die away.

A loop that is not understood (another servo than the model's, a wrong delay, lost commands) can
make any fast law swing for ever. Each eye joint's turns are watched: half a swing is the way from
one turn to the next. One that is about as long as the half before, back, and much longer than its
goal has moved meanwhile, is one too many. A first turn towards a new goal is none.
"""

from math import exp2, pi, sqrt
from typing import Annotated, Final

from vergence._jit import device
from vergence.controllers.prediction.joints import Rig
from vergence.models.parts import FloatArray

_LEAST_RAD: Final = 0.003
"""Half a swing, at least, beside what the encoder's step and the detections' noise make."""
_STEPS: Final = 2.0
_NOISES: Final = 4.0
_SLOW_S: Final = 0.6
"""Half a swing that takes longer is none."""
_SLOW_RAD_S: Final = 0.2
"""And one whose speed is, peak to peak, that of a sinusoid of less."""
_GOALS: Final = 2.0
"""Half a swing by how far the goal has moved meanwhile, at least."""
_DIES: Final = 0.3
"""Half a swing by the one before up to which swings die away."""
_LASTS: Final = 0.7
"""From which on they do not."""
_JUMP_LEAVES: Final = 0.5
"""What a jump of the target leaves of the number of swings."""
MANY: Final = 2.0
"""From so many on a law is to be calm."""
MOST: Final = 6.0
_SLOWEST: Final = 1.0
"""The slowest rate of a linear law, 1/s."""
FIRST_PATIENCE_S: Final = 1.0
"""Time constant with which swings are forgotten, at first."""


class Swinging:
    """The turns of each eye joint, (2, 2) by eye and joint, and how many are too many."""

    side: Annotated[FloatArray, 2, 2]
    """Where it turns: 1, -1, or 0 before it has moved."""
    turned_at: Annotated[FloatArray, 2, 2]
    """Its angle when it turned round last, rad."""
    farthest: Annotated[FloatArray, 2, 2]
    """The farthest that it has come since, rad."""
    aim: Annotated[FloatArray, 2, 2]
    """Its goal when that turn was seen, rad."""
    went: Annotated[FloatArray, 2, 2, 2]
    """How far from there it has been since, and from that before it, until that turn, rad."""
    half: Annotated[FloatArray, 2, 2]
    """Length of the half swing before, rad."""
    since: Annotated[FloatArray, 2, 2]
    """Periods since that turn was seen."""
    count: float
    """Half swings too many, lately; at most `MOST`."""
    patience_s: float
    """Time constant with which they are forgotten; it doubles each time that they are many."""


@device
def calm_rate(rate: float, swings: float) -> float:
    """The rate of a linear law after some swings: half for each beyond `MANY`, 1/s."""
    return max(rate * exp2(-max(swings - MANY, 0.0)), min(rate, _SLOWEST))


@device
def forgive(swinging: Swinging) -> None:
    """Give the eyes a new chance: the target is elsewhere."""
    swinging.count *= _JUMP_LEAVES


@device
def forget(swinging: Swinging, period_s: float) -> None:
    """Let a period pass."""
    swinging.count -= swinging.count * min(period_s / swinging.patience_s, 1.0)


@device
def begin_watch(swinging: Swinging, eye: int, joint: int, angle: float) -> None:
    """Begin at rest at an angle, rad."""
    swinging.turned_at[eye, joint] = swinging.farthest[eye, joint] = angle


@device
def watch(
    swinging: Swinging, rig: Rig, eye: int, joint: int, angle: float, aim: float, noise: float
) -> None:
    """Look at one eye joint for swings.

    Args:
        swinging: changed in place.
        rig: what is known of the head.
        eye: which eye.
        joint: which of its joints.
        angle: its angle now, rad.
        aim: the angle that it is to have, rad.
        noise: variance of a detection, rad^2.
    """
    least = _LEAST_RAD + _STEPS * rig.joint_step[eye, joint] + _NOISES * sqrt(noise)
    side, farthest = swinging.side[eye, joint], swinging.farthest[eye, joint]
    swinging.since[eye, joint] += 1.0
    went = abs(aim - swinging.aim[eye, joint])
    swinging.went[eye, joint, 0] = max(swinging.went[eye, joint, 0], went)
    if swinging.since[eye, joint] * rig.period_s > _SLOW_S:
        swinging.half[eye, joint] = 0.0
    if side == 0.0:
        off = angle - swinging.turned_at[eye, joint]
        if abs(off) > least:
            swinging.side[eye, joint] = 1.0 if off > 0.0 else -1.0
            swinging.farthest[eye, joint] = angle
            swinging.since[eye, joint], swinging.aim[eye, joint] = 0.0, aim
        return
    if side * (angle - farthest) >= 0.0:
        swinging.farthest[eye, joint] = angle
        return
    if side * (farthest - angle) < least:
        return
    half = abs(farthest - swinging.turned_at[eye, joint])
    went = max(swinging.went[eye, joint, 0], swinging.went[eye, joint, 1])
    swinging.went[eye, joint, 1], swinging.went[eye, joint, 0] = swinging.went[eye, joint, 0], 0.0
    before = swinging.half[eye, joint]
    time_s = (swinging.since[eye, joint]) * rig.period_s
    fast = pi * half > _SLOW_RAD_S * time_s
    if before > 0.0 and fast and half > _GOALS * went:
        share = (half / before - _DIES) / (_LASTS - _DIES)
        count = min(swinging.count + min(max(share, 0.0), 1.0), MOST)
        if swinging.count <= MANY < count:
            swinging.patience_s *= 2.0
        swinging.count = count
    swinging.half[eye, joint], swinging.aim[eye, joint] = half, aim
    swinging.side[eye, joint], swinging.since[eye, joint] = -side, 0.0
    swinging.turned_at[eye, joint], swinging.farthest[eye, joint] = farthest, angle
