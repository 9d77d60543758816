"""The law of smooth pursuit, compiled: see `vergence.controllers.pursuit` for its equations."""

from math import copysign, isfinite, nan, sqrt
from typing import Annotated, Final

import numpy as np

from vergence._jit import device, kernel
from vergence.controllers.freshness import is_fresh
from vergence.controllers.prediction.aim import aim
from vergence.controllers.prediction.target_motion import (
    EyeFilter,
    TargetModel,
    advance,
    ahead,
    angles_of_image,
    correct,
    forget,
)
from vergence.controllers.rows import named, row_layout, row_size
from vergence.models.joint_response import share_left
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray
from vergence.models.projection import share_of_actuators
from vergence.triangulation.lines_of_sight import Depths, depths_on_rays, rays_of_image


class PursuitState:
    """What is remembered of one head, besides what the predictor remembers."""

    eyes: Annotated[list[EyeFilter], 2]
    image_age_s: float
    """Age of the newest image."""
    unseen: Annotated[FloatArray, 2]
    """Periods since an image showed each eye its target."""


class PursuitLaw:
    """The constants of the law; arrays of four are by actuator of the eyes."""

    target: TargetModel
    gain: float
    """k, 1/s."""
    forget_after: float
    """Periods without a sight of it after which a target is lost."""
    braking: Annotated[FloatArray, 4]
    """b, rad/s^2."""
    acceleration: Annotated[FloatArray, 4]
    """Greatest accelerations, rad/s^2."""
    lower: Annotated[FloatArray, 4]
    """Least angles, rad."""
    upper: Annotated[FloatArray, 4]
    """Greatest angles, rad."""
    lag_ratio: Annotated[FloatArray, 4]
    """Lags by that of the head's timing."""
    moves: Annotated[FloatArray, 4, 2]
    """Whether each actuator turns each eye: 1 or 0."""


PURSUIT_STATE: Final = row_layout(PursuitState)
_SIZE: Final = row_size(PURSUIT_STATE)
PURSUIT_LAW: Final = row_layout(PursuitLaw)


@device
def _see(
    s: PursuitState,
    law: PursuitLaw,
    error: FloatArray,
    age_s: float,
    q: FloatArray,
    p: PackedHead,
) -> Depths:
    """Bring the filters up to date with the newest image and the angles at its exposure.

    Returns:
        The depths at which it shows the target.
    """
    fresh = is_fresh(age_s, s.image_age_s, law.target.period_s)
    s.image_age_s = age_s
    left = eye_frames(p, 0, q[3], q[4]).camera
    right = eye_frames(p, 1, q[5], q[6]).camera
    ray_l, ray_r = rays_of_image(p, left, right, error)
    depths = depths_on_rays(ray_l, ray_r)
    for eye in range(2):
        target = s.eyes[eye]
        if target.known > 0.5:
            advance(target, law.target)
        if fresh and isfinite(error[eye, 0]) and isfinite(error[eye, 1]):
            camera, depth = (left, depths.left) if eye == 0 else (right, depths.right)
            first, second = angles_of_image(p, eye, camera, q, error, depth)
            correct(target, law.target, first, second)
            s.unseen[eye] = 0.0
        else:
            s.unseen[eye] += 1.0
            if s.unseen[eye] > law.forget_after:
                forget(target)
    return depths


@device
def _goal(s: PursuitState, law: PursuitLaw, j: int, h: float) -> tuple[float, float, bool]:
    """An eye joint's goal a time h later and its rate, and whether there is one."""
    target = s.eyes[j // 2]
    if not target.known > 0.5:
        return 0.0, 0.0, False
    theta, w = ahead(target, j % 2, law.target, h)
    return theta, w, True


@device
def _tied_goals(
    s: PursuitState,
    law: PursuitLaw,
    h: float,
    depths: Depths,
    q: FloatArray,
    p: PackedHead,
    goals: FloatArray,
) -> None:
    """The actuators' goals (4, 2), angle and rate; nan for one that moves no eye with a target."""
    angles, rates = np.zeros((2, 2)), np.zeros((2, 2))
    jacobian, out = np.zeros((2, 2, 2)), np.zeros(4)
    left, right = s.eyes[0].known > 0.5, s.eyes[1].known > 0.5
    for j in range(4):
        angles[j // 2, j % 2], rates[j // 2, j % 2], _known = _goal(s, law, j, h)
    aim(p, angles, depths.left, depths.right, left, right, q, jacobian, out)
    for k in range(4):
        moves = (left and law.moves[k, 0] > 0.5) or (right and law.moves[k, 1] > 0.5)
        goals[k, 0] = out[k] if moves else nan
    # how the targets move in the images while the eyes rest there
    for eye in range(2):
        one, two = rates[eye, 0], rates[eye, 1]
        for axis in range(2):
            rates[eye, axis] = jacobian[eye, axis, 0] * one + jacobian[eye, axis, 1] * two
    share_of_actuators(p, jacobian, rates, left, right, out)
    for k in range(4):
        goals[k, 1] = out[k]


@device
def _command(
    law: PursuitLaw,
    j: int,
    theta: float,
    w: float,
    q: float,
    v: float,
    decay: float,
    limit: float,
) -> float:
    """The command of one actuator, rad/s.

    Args:
        law: the constants.
        j: which actuator.
        theta: its goal at the end of the coming period, rad.
        w: the goal's rate then, rad/s.
        q: its angle, rad.
        v: its velocity, rad/s.
        decay: what a period leaves of a difference between command and velocity.
        limit: its greatest speed, rad/s.
    """
    period = law.target.period_s
    if not law.lower[j] < theta < law.upper[j]:
        theta, w = min(max(theta, law.lower[j]), law.upper[j]), 0.0
    left = theta - q - 0.5 * (v + w) * period
    half = 0.5 * law.braking[j] * period
    speed = min(
        law.gain * abs(left) / (1.0 + 0.5 * law.gain * period),
        sqrt(half * half + 2.0 * law.braking[j] * abs(left)) - half,
    )
    rise = w + copysign(speed, left) - v
    if abs(rise) > 0.95 * law.acceleration[j] * period:
        u = copysign(limit, rise)
    else:
        u = v + rise / (1.0 - decay)
    return min(max(u, -limit), limit)


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    "(s),(e,e),(),(j),(j),(j),(t),(l),(a),(p)->(s),(a)",
)
def pursue(
    before: FloatArray,
    error: FloatArray,
    age_s: FloatArray,
    q_image: FloatArray,
    q: FloatArray,
    v: FloatArray,
    timing: FloatArray,
    law_row: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    after: FloatArray,
    out: FloatArray,
) -> None:
    """The state brought up to date, and velocities of the eyes' actuators, which are its joints.

    Args:
        before: a row of `PursuitState`.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        age_s: () age of the newest image.
        q_image: (7,) joint angles at its exposure, rad.
        q: (7,) present angles of the neck and the actuators, rad.
        v: (7,) their present velocities, rad/s.
        timing: delay of an image and lag of the head's timing, s.
        law_row: a row of `PursuitLaw`.
        limit: (4,) greatest speeds of the actuators, rad/s.
        p: a packed head with two joints for either eye.
        after: the state after.
        out: (4,) the velocities, rad/s.
    """
    for k in range(_SIZE):
        after[k] = before[k]
    s: PursuitState = named(after, PURSUIT_STATE)
    law: PursuitLaw = named(law_row, PURSUIT_LAW)
    _see(s, law, error, age_s[0], q_image, p)
    decay = share_left(law.target.period_s, timing[1])
    for j in range(4):
        theta, w, known = _goal(s, law, j, timing[0] + law.target.period_s)
        out[j] = 0.0
        if known:
            out[j] = _command(law, j, theta, w, q[3 + j], v[3 + j], decay, limit[j])


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    "(s),(e,e),(),(j),(j),(j),(t),(l),(a),(p)->(s),(a)",
)
def pursue_tied(
    before: FloatArray,
    error: FloatArray,
    age_s: FloatArray,
    q_image: FloatArray,
    q: FloatArray,
    v: FloatArray,
    timing: FloatArray,
    law_row: FloatArray,
    limit: FloatArray,
    p: PackedHead,
    after: FloatArray,
    out: FloatArray,
) -> None:
    """As `pursue`, where actuators tie the eyes' joints."""
    for k in range(_SIZE):
        after[k] = before[k]
    s: PursuitState = named(after, PURSUIT_STATE)
    law: PursuitLaw = named(law_row, PURSUIT_LAW)
    depths, period = _see(s, law, error, age_s[0], q_image, p), law.target.period_s
    goals = np.zeros((4, 2))
    _tied_goals(s, law, timing[0] + period, depths, q[3:], p, goals)
    for j in range(4):
        out[j] = 0.0
        if isfinite(goals[j, 0]) and limit[j] > 0.0:
            decay = share_left(period, law.lag_ratio[j] * timing[1])
            out[j] = _command(law, j, goals[j, 0], goals[j, 1], q[3 + j], v[3 + j], decay, limit[j])
