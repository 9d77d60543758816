r"""The time-optimal bound: no controller can settle before it.

Nothing can be known of a target's jump before the first image of it is readable. From then on
the slowest joint needs at least the time in which the actuator can bring it into the settling
band to stay:

    dv/dt = clip((u - v) / lag, -a, a),   dq/dt = v,   |u| <= u_max

from rest, by full command until a switch and full reverse after it, the switch being the latest
that still stops the joint within the far edge of its band. The joint is in when it crosses the
near edge. A trial is judged at its control steps, so the time is rounded up to whole periods.

Three relaxations keep this a bound for every controller. A joint's band is the widest that its
eye's error circle allows, whatever the eye's other joint does: `band sqrt(((J^T J)^-1)_ii)` with
J the true image Jacobian at the goal. Between two steps nobody looks: a joint may pass the far
edge by `a T^2 / 8` and be back within one period. And the switch need not fall on a step. None
is worth more than a few milliseconds.

The goal is where the true head's error is zero as the controller measures it: with model errors,
that is not where the true head fixates.
"""

from math import inf, isfinite, log, nan, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import compiled, device
from vergence.controllers.prediction.joints import RIG, Rig, joint_rig
from vergence.controllers.rows import named
from vergence.envs.plant import simulation_of
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.models.camera import pixel_error, point_to_pixel
from vergence.models.fixation import fixate_eye
from vergence.models.joint_response import follow_joint, share_left
from vergence.models.joints import EYES
from vergence.models.kinematics import point_in_eye
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray

_NEWTON_STEPS: Final = 30
_DIFFERENCE_RAD: Final = 1e-5
_TOLERANCE_PX: Final = 1e-9
_HALVINGS: Final = 60


def settle_bound(task: GazeTask, band_px: float = 1.0) -> FloatArray:
    """The earliest time at which both eyes can have settled, of the trials that just began.

    Args:
        task: trials at time zero, on a simulated plant. The targets are taken to stay where
            they are at time zero.
        band_px: the settling band, on the norm of each eye's true pixel error.

    Returns:
        (n,) seconds since time zero, in whole control periods; 0 for eyes that look there
        already, inf where a joint's range ends before the band.

    Raises:
        ConfigurationError: the plant is no simulation, trials have moved on, or the band is
            not above zero.
    """
    if not band_px > 0.0:
        raise ConfigurationError(f"band_px: expected more than 0, got {band_px}")
    simulation = simulation_of(task.plant)
    truth, conditions = simulation.truth(), simulation.conditions
    if truth.time_s.any():
        raise ConfigurationError(
            f"task: expected trials at time zero, got one at {truth.time_s.max():.3f} s"
        )
    period = task.head.timing.period_s
    motion_s = np.empty(task.num)
    _motion_times(
        conditions.heads,
        task.head.packed,
        truth.target,
        truth.positions[:, EYES],
        conditions.lag_s,
        joint_rig(task.head),
        band_px,
        motion_s,
    )
    inside = (np.linalg.norm(truth.pixel_error, axis=-1) < band_px).all(axis=-1)
    # a joint's band is wider than what the error circle leaves: an eye outside it has to move
    periods = np.maximum(np.ceil(motion_s / period - 1e-9), 1.0)
    return np.where(inside, 0.0, (conditions.latency_frames + periods) * period)


@compiled
def fastest_entry(near: float, far: float, lag: float, acceleration: float, speed: float) -> float:
    """The least time in which a joint at rest can pass `near` and still stop within `far`.

    Args:
        near: distance to the near edge of the band, rad.
        far: distance to its far edge, rad; inf for a joint that need not stop.
        lag: time constant of the joint's response, s.
        acceleration: greatest acceleration, rad/s^2, inf for none.
        speed: greatest command, rad/s.

    Returns:
        Seconds; 0 where `near` is no distance.
    """
    if near <= 0.0:
        return 0.0
    joint = _Joint(lag, acceleration, speed)
    switch = inf
    if far < inf:
        low, high = 0.0, _until_beyond(far, joint)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if _stop(middle, joint) <= far:
                low = middle
            else:
                high = middle
        switch = low
    low, high = 0.0, _until_beyond(near, joint)
    if switch < inf:
        # stopping at the far edge, the joint has passed the near one
        high = min(high, switch) + _stop_time(switch, joint)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _place(middle, switch, joint)[0] < near:
            low = middle
        else:
            high = middle
    return high


class _Joint(NamedTuple):
    """What moves a joint: its lag, s, and its greatest acceleration and command."""

    lag: float
    acceleration: float
    speed: float


@device
def _after(q: float, v: float, command: float, time: float, joint: _Joint) -> tuple[float, float]:
    decay = share_left(time, joint.lag)
    return follow_joint(q, v, command, joint.lag, joint.acceleration, time, decay)


@device
def _place(time: float, switch: float, joint: _Joint) -> tuple[float, float]:
    """Angle and velocity at a time, with full command until the switch and full reverse after."""
    q, v = _after(0.0, 0.0, joint.speed, min(time, switch), joint)
    if time > switch:
        q, v = _after(q, v, -joint.speed, time - switch, joint)
    return q, v


@device
def _stop_time(switch: float, joint: _Joint) -> float:
    """How long full reverse takes from the switch on to stop a joint."""
    _q, v = _place(switch, switch, joint)
    time = 0.0
    # the lag allows the greatest deceleration down to this velocity
    least = inf
    if joint.acceleration < inf:
        least = max(joint.acceleration * joint.lag - joint.speed, 0.0)
    if v > least:
        time = (v - least) / joint.acceleration
        v = least
    if v > 0.0 and joint.lag > 0.0:
        time += joint.lag * log((v + joint.speed) / joint.speed)
    return time


@device
def _stop(switch: float, joint: _Joint) -> float:
    """Where a joint stops that is reversed at the switch."""
    return _place(switch + _stop_time(switch, joint), switch, joint)[0]


@device
def _until_beyond(distance: float, joint: _Joint) -> float:
    """Some time after which full command has carried a joint beyond a distance."""
    time = distance / joint.speed + joint.lag + 1e-6
    while _place(time, inf, joint)[0] <= distance:
        time *= 2.0
    return time


@device
def _error(
    true: PackedHead, nominal: PackedHead, eye: int, tilt: float, pan: float, point: FloatArray
) -> tuple[float, float]:
    """The true pixel error as `Truth` has it: what a controller would measure without noise."""
    x, y, z = point_in_eye(true, eye, tilt, pan, point[0], point[1], point[2])
    u, v = point_to_pixel(true, eye, x, y, z, True)
    return pixel_error(nominal, eye, u, v)


class _Goal(NamedTuple):
    """An eye's angles of no error, rad, and the image Jacobian there; nan for none."""

    tilt: float
    pan: float
    ut: float
    up: float
    vt: float
    vp: float


@device
def _goal(true: PackedHead, nominal: PackedHead, eye: int, point: FloatArray) -> _Goal:
    tilt, pan = fixate_eye(true, eye, point[0], point[1], point[2])
    h = _DIFFERENCE_RAD
    for _ in range(_NEWTON_STEPS):
        u, v = _error(true, nominal, eye, tilt, pan, point)
        ua, va = _error(true, nominal, eye, tilt + h, pan, point)
        ub, vb = _error(true, nominal, eye, tilt - h, pan, point)
        uc, vc = _error(true, nominal, eye, tilt, pan + h, point)
        ud, vd = _error(true, nominal, eye, tilt, pan - h, point)
        ut, vt = 0.5 * (ua - ub) / h, 0.5 * (va - vb) / h
        up, vp = 0.5 * (uc - ud) / h, 0.5 * (vc - vd) / h
        determinant = ut * vp - up * vt
        if not isfinite(determinant) or determinant == 0.0:
            break
        if abs(u) + abs(v) < _TOLERANCE_PX:
            return _Goal(tilt, pan, ut, up, vt, vp)
        tilt -= (vp * u - up * v) / determinant
        pan -= (ut * v - vt * u) / determinant
    return _Goal(nan, nan, nan, nan, nan, nan)


@compiled
def _motion_times(
    heads: FloatArray,
    nominal: PackedHead,
    targets: FloatArray,
    start: FloatArray,
    lag: FloatArray,
    rig_row: FloatArray,
    band: float,
    times: FloatArray,
) -> None:
    """How long the slowest joint of each trial needs.

    Args:
        heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        targets: (n, 3) in N, m.
        start: (n, 4) the eyes' joint angles, rad.
        lag: (n,) s.
        rig_row: a row of `vergence.controllers.prediction.joints.Rig`, for the limits.
        band: px.
        times: (n,) result, s.
    """
    rig: Rig = named(rig_row, RIG)
    period = rig.period_s
    for n in range(targets.shape[0]):
        true = heads[n] if heads.shape[0] > 1 else heads[0]
        times[n] = 0.0
        for eye in range(2):
            goal = _goal(true, nominal, eye, targets[n])
            if not isfinite(goal.tilt):
                times[n] = inf
                continue
            ut, up, vt, vp = goal.ut, goal.up, goal.vt, goal.vp
            # diagonal of (J^T J)^-1, whose determinant is that of J squared; over the band the
            # image bends away from its tangent by less than the band's share of the focal length
            bend = 1.0 + band / camera_of(nominal, eye).focal_u
            widest = band * bend / abs(ut * vp - up * vt)
            for axis in range(2):
                j = 2 * eye + axis
                slack = widest * (sqrt(ut * ut + vt * vt) if axis else sqrt(up * up + vp * vp))
                turn = (goal.pan if axis else goal.tilt) - start[n, j]
                room = rig.upper[j] - start[n, j] if turn > 0.0 else start[n, j] - rig.lower[j]
                near = abs(turn) - slack
                far = abs(turn) + slack
                if rig.acceleration[j] < inf:
                    far += rig.acceleration[j] * period * period / 8.0
                if near > room:
                    times[n] = inf
                    continue
                if far >= room:
                    far = inf  # the end of the joint's range stops it
                entry = fastest_entry(near, far, lag[n], rig.acceleration[j], rig.speed[j])
                times[n] = max(times[n], entry)
