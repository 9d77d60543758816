"""What one image says of each eye's goals: when it was exposed, where they are, how surely."""

from math import isfinite, nan, sqrt
from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.dating import SPACING_S
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import Memory, angle_at
from vergence.models.fixation import fixate_step
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray
from vergence.models.pose import into
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image

_MODEL: Final = 0.004
"""Share of the angle to turn that the head's model leaves uncertain."""
_ENCODER: Final = 0.3
"""What tracking leaves of an encoder's step while the joint moves."""
JITTER_S: Final = 0.006
"""By how much a frame comes later or earlier than others, standard deviation."""
_MOVING_RAD_S: Final = 0.05
_NEWTON: Final = 10


@device
def date_image(
    memory: Memory,
    rig: Rig,
    came: float,
    low: int,
    high: int,
    weights: FloatArray,
    angles: FloatArray,
    then: FloatArray,
    spread: FloatArray,
) -> float:
    """The joints' angles at the exposure of an image that came at a time, in periods.

    Args:
        memory: what is remembered.
        rig: what is known of the head.
        came: when it came.
        low: the first of the delays in question.
        high: the one after the last.
        weights: (HYPOTHESES,) those of the delays.
        angles: (HYPOTHESES, 2, 2) result: the angles by each delay, rad.
        then: (2, 2) result: their means.
        spread: (2, 2) result: their variances, rad^2.

    Returns:
        The mean delay, s.
    """
    delay = 0.0
    for i in range(low, high):
        own = memory.first_delay_s + SPACING_S * i
        delay += weights[i] * own
        for eye in range(2):
            for joint in range(2):
                tick = came - own / rig.period_s
                angles[i, eye, joint] = angle_at(memory, rig.keep_every, tick, eye, joint)
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            for i in range(low, high):
                off = angles[i, eye, joint] - angles[low, eye, joint]
                mean += weights[i] * off
                square += weights[i] * off * off
            then[eye, joint] = angles[low, eye, joint] + mean
            spread[eye, joint] = max(square - mean * mean, 0.0)
    return delay


@device
def measure_goals(
    memory: Memory,
    p: PackedHead,
    then: FloatArray,
    error: FloatArray,
    most: float,
    goals: FloatArray,
) -> float:
    """The goals of an image from the joints' angles at its exposure.

    An eye that does not see the target gets the goals of where the other one sees it, at the depth
    that both saw last.

    Args:
        memory: the depths are changed in place.
        p: a packed head.
        then: (2, 2) the joints' angles, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        most: how far the rays of one target's images pass each other at most, by its distance.
        goals: (2, 2) result, rad; nan where there is none.

    Returns:
        How far the rays of both eyes pass each other, by the target's distance; nan where not both
        eyes see it.
    """
    left, right = rays_of_image(
        p,
        eye_frames(p, 0, then[0, 0], then[0, 1]).camera,
        eye_frames(p, 1, then[1, 0], then[1, 1]).camera,
        error,
    )
    depths = depths_on_rays(left, right)
    # one eye alone, and two that do not see one target, keep the depth that both saw last
    gap = nan
    if depths.found:
        (ax, ay, az), (bx, by, bz) = left
        (cx, cy, cz), (dx, dy, dz) = right
        x = ax + depths.left * bx - cx - depths.right * dx
        y = ay + depths.left * by - cy - depths.right * dy
        z = az + depths.left * bz - cz - depths.right * dz
        gap = sqrt(x * x + y * y + z * z) / depths.left
        if gap < most or memory.known[0] + memory.known[1] == 0.0:
            memory.depth[0], memory.depth[1] = depths.left, depths.right
    for eye in range(2):
        sees = eye
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            sees = 1 - eye
            if memory.known[eye] < 0.5 or not isfinite(error[sees, 0] + error[sees, 1]):
                goals[eye, 0] = goals[eye, 1] = nan
                continue
        z = memory.depth[sees]
        o, d = left if sees == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = then[eye, 0], then[eye, 1]
        if memory.known[eye] > 0.5:  # Newton's method from the last goal needs one step
            q1, q2 = memory.goals[eye, 0], memory.goals[eye, 1]
        for _ in range(_NEWTON):
            d1, d2 = fixate_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # what is left is its square
                break
        goals[eye, 0], goals[eye, 1] = q1, q2
        if sees != eye:
            continue
        frames = eye_frames(p, eye, q1, q2)
        memory.fixated_depth[eye] = into(frames.camera, x, y, z)[2]
    return gap


@device
def variance_of(
    memory: Memory, rig: Rig, exposed: float, eye: int, joint: int, turn: float
) -> float:
    """The variance of a measured goal but for its date, rad^2.

    Args:
        memory: what is remembered.
        rig: what is known of the head.
        exposed: when the image was exposed, in periods.
        eye: which eye.
        joint: which of its joints.
        turn: how far this has to turn, rad.
    """
    after = angle_at(memory, rig.keep_every, exposed + 0.5, eye, joint)
    before = angle_at(memory, rig.keep_every, exposed - 0.5, eye, joint)
    speed, model = (after - before) / rig.period_s, _MODEL * turn
    encoder = _ENCODER * rig.joint_step[eye, joint] if abs(speed) > _MOVING_RAD_S else 0.0
    jitter = JITTER_S * speed
    return memory.noise + jitter * jitter + model * model + encoder * encoder
