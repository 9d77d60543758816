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

from math import exp, inf, isfinite, log, nan, sqrt
from typing import Any, Final

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.plant import simulation_of
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.models.camera import pixel_error, point_to_pixel
from vergence.models.fixation import fixate_eye
from vergence.models.joint_response import follow_joint
from vergence.models.joints import EYES
from vergence.models.kinematics import point_in_eye
from vergence.models.packed import camera_of
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
    limits, period = task.head.limits, task.head.timing.period_s
    motion_s = np.empty(task.num)
    _motion_times(
        conditions.heads,
        task.head.packed,
        truth.target,
        truth.positions[:, EYES],
        conditions.lag_s,
        limits.lower[EYES],
        limits.upper[EYES],
        limits.velocity[EYES],
        limits.acceleration[EYES],
        period,
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
    switch = inf
    if far < inf:
        low, high = 0.0, _until_beyond(far, lag, acceleration, speed)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if _stop(middle, lag, acceleration, speed) <= far:
                low = middle
            else:
                high = middle
        switch = low
    low, high = 0.0, _until_beyond(near, lag, acceleration, speed)
    if switch < inf:
        # stopping at the far edge, the joint has passed the near one
        high = min(high, switch) + _stop_time(switch, lag, acceleration, speed)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _place(middle, switch, lag, acceleration, speed)[0] < near:
            low = middle
        else:
            high = middle
    return high


@device
def _decay(time: float, lag: float) -> Any:
    return exp(-time / lag) if lag > 0.0 else 0.0


@device
def _place(time: float, switch: float, lag: float, acceleration: float, speed: float) -> Any:
    """Angle and velocity at a time, with full command until the switch and full reverse after."""
    first = min(time, switch)
    q, v = follow_joint(0.0, 0.0, speed, lag, acceleration, first, _decay(first, lag))
    if time > switch:
        rest = time - switch
        q, v = follow_joint(q, v, -speed, lag, acceleration, rest, _decay(rest, lag))
    return q, v


@device
def _brake_time(v: float, lag: float, acceleration: float, speed: float) -> float:
    """How long full reverse takes to stop a joint."""
    time = 0.0
    # the lag allows the greatest deceleration down to this velocity
    least = max(acceleration * lag - speed, 0.0) if acceleration < inf else inf
    if v > least:
        time = (v - least) / acceleration
        v = least
    if v > 0.0 and lag > 0.0:
        time += lag * log((v + speed) / speed)
    return time


@device
def _stop_time(switch: float, lag: float, acceleration: float, speed: float) -> Any:
    _q, v = _place(switch, switch, lag, acceleration, speed)
    return _brake_time(v, lag, acceleration, speed)


@device
def _stop(switch: float, lag: float, acceleration: float, speed: float) -> Any:
    """Where a joint stops that is reversed at the switch."""
    time = switch + _stop_time(switch, lag, acceleration, speed)
    return _place(time, switch, lag, acceleration, speed)[0]


@device
def _until_beyond(distance: float, lag: float, acceleration: float, speed: float) -> float:
    """Some time after which full command has carried a joint beyond a distance."""
    time = distance / speed + lag + 1e-6
    while _place(time, inf, lag, acceleration, speed)[0] <= distance:
        time *= 2.0
    return time


@device
def _error(true: Any, nominal: Any, eye: int, tilt: float, pan: float, point: Any) -> Any:
    """The true pixel error as `Truth` has it: what a controller would measure without noise."""
    x, y, z = point_in_eye(true, eye, tilt, pan, point[0], point[1], point[2])
    u, v = point_to_pixel(true, eye, x, y, z, True)
    return pixel_error(nominal, eye, u, v)


@device
def _goal(true: Any, nominal: Any, eye: int, point: Any) -> Any:
    """Angles of no error, and du/dtilt, du/dpan, dv/dtilt, dv/dpan there; nan for none."""
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
            return tilt, pan, ut, up, vt, vp
        tilt -= (vp * u - up * v) / determinant
        pan -= (ut * v - vt * u) / determinant
    return nan, nan, nan, nan, nan, nan


@compiled
def _motion_times(
    heads: Any, nominal: Any, targets: Any, start: Any, lag: Any, lower: Any, upper: Any,
    speed: Any, acceleration: Any, period: float, band: float, times: Any,
) -> None:  # fmt: skip
    """How long the slowest joint of each trial needs.

    Args:
        heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        targets: (n, 3) in N, m.
        start: (n, 4) the eyes' joint angles, rad.
        lag: (n,) s.
        lower: (4,) rad.
        upper: (4,) rad.
        speed: (4,) rad/s.
        acceleration: (4,) rad/s^2.
        period: control period, s.
        band: px.
        times: (n,) result, s.
    """
    for n in range(targets.shape[0]):
        true = heads[n] if heads.shape[0] > 1 else heads[0]
        times[n] = 0.0
        for eye in range(2):
            tilt, pan, ut, up, vt, vp = _goal(true, nominal, eye, targets[n])
            if not isfinite(tilt):
                times[n] = inf
                continue
            # diagonal of (J^T J)^-1, whose determinant is that of J squared; over the band the
            # image bends away from its tangent by less than the band's share of the focal length
            bend = 1.0 + band / camera_of(nominal, eye).focal_u
            widest = band * bend / abs(ut * vp - up * vt)
            for axis in range(2):
                i = 2 * eye + axis
                goal = pan if axis else tilt
                slack = widest * (sqrt(ut * ut + vt * vt) if axis else sqrt(up * up + vp * vp))
                turn = goal - start[n, i]
                room = upper[i] - start[n, i] if turn > 0.0 else start[n, i] - lower[i]
                near = abs(turn) - slack
                far = abs(turn) + slack
                if acceleration[i] < inf:
                    far += acceleration[i] * period * period / 8.0
                if near > room:
                    times[n] = inf
                    continue
                if far >= room:
                    far = inf  # the end of the joint's range stops it
                entry = fastest_entry(near, far, lag[n], acceleration[i], speed[i])
                times[n] = max(times[n], entry)
