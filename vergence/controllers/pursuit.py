r"""Smooth pursuit: follow a moving target without lagging behind it by the loop's delay.

Per eye, a Kalman filter (`vergence.controllers.prediction.target_motion`) estimates the angles
that fixate the target, their rates and their accelerations at the exposure of the newest image.
They are carried on over the delay to the end of the coming period, r, w. The joints' own angles q
and velocities v are known without delay, so the rest is a loop without one: with T the period, the
velocity to have at its end is

    v' = w + sign(e) min(k |e| / (1 + k T / 2), sqrt((b T / 2)^2 + 2 b |e|) - b T / 2)
    e  = r - q - (v + w) T / 2

where e is what would be left at its end with the target's own velocity. The first branch is
proportional feedback on the predicted present error, with the target's rate fed forward. The
second is the greatest speed from which braking at b still stops on the target: far behind, the
eye catches up by a saccade. The command that gives v' is that of the actuator's lag undone,

    u = (v' - v exp(-T / tau)) / (1 - exp(-T / tau))

and the actuator's greatest speed where v' needs all of its acceleration. Where actuators tie the
eyes' joints, r and w are the actuators' angles and rates that come nearest to those of both eyes in
pixels (`vergence.controllers.prediction.aim`).
"""

from math import copysign, isfinite, nan, sqrt
from typing import Annotated, Final, Literal

import numpy as np

from vergence._jit import device, kernel
from vergence.controllers.freshness import is_fresh
from vergence.controllers.prediction.aim import aim
from vergence.controllers.prediction.joints import eyes_moved
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.prediction.target_motion import (
    TARGET_MODEL,
    EyeFilter,
    TargetModel,
    advance,
    ahead,
    angles_of_image,
    correct,
    forget,
    target_model,
)
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.controllers.rows import make_row, named, row_layout, row_size
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import AGE_S, Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joint_response import share_left
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead, is_direct
from vergence.models.parts import FloatArray
from vergence.models.projection import share_of_actuators
from vergence.triangulation.lines_of_sight import Depths, depths_on_rays, rays_of_image

FORGET_AFTER_S: Final = 0.5
"""An eye that has not seen its target for this long has lost it, and is held."""


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
    """`FORGET_AFTER_S` in periods."""
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


class Pursuit(StatefulController):
    """Smooth pursuit with catch-up saccades.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, how fast the predicted present error is taken back, 1/s.
        braking: b as a share of the actuators' greatest acceleration.
        acceleration_sd: how much targets accelerate, rad/s^2.
        acceleration_time_s: for how long, s.
        start_velocity_sd: how fast a target is when it appears, rad/s.
        gate_rad: a jump by more is another target, rad.
        pixel_sd: noise of a detection, px; None for the head's own.
        delay: `estimated` finds delay and lag on line and smooths the readings, see
            `Predictor`; `nominal` takes the head's own.

    Raises:
        ConfigurationError: an option has a value that cannot be.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        gain: float = 80.0,
        braking: float = 0.97,
        acceleration_sd: float = 1.0,
        acceleration_time_s: float = 1.0,
        start_velocity_sd: float = 0.5,
        gate_rad: float = 0.02,
        pixel_sd: float | None = None,
        delay: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        if not (isfinite(gain) and gain > 0.0):
            raise ConfigurationError(f"gain: expected a finite number above 0, got {gain!r}")
        self._predictor: Predictor | None = None
        if delay != "nominal":
            self._predictor = Predictor(head=head, layout=layout, delay=delay)
        if not 0.0 < braking <= 1.0:
            raise ConfigurationError(f"braking: expected a share above 0 up to 1, got {braking!r}")
        model = target_model(
            head,
            acceleration_sd=acceleration_sd,
            acceleration_time_s=acceleration_time_s,
            start_velocity_sd=start_velocity_sd,
            gate_rad=gate_rad,
            pixel_sd=pixel_sd,
        )
        # a number in place of infinity, so that braking from any speed takes no time
        actuation = head.actuation
        acceleration = np.minimum(actuation.acceleration[EYES], 1e6)
        self._law = make_row(
            PURSUIT_LAW,
            target=model.view(TARGET_MODEL),
            gain=gain,
            forget_after=round(FORGET_AFTER_S / layout.period_s),
            braking=braking * acceleration,
            acceleration=acceleration,
            lower=actuation.lower[EYES],
            upper=actuation.upper[EYES],
            lag_ratio=actuation.lag_ratio[EYES],
            moves=eyes_moved(head),
        )
        self._packed = two_joints_an_eye(head)
        self._timing = np.array([layout.latency_s, head.timing.lag_s])
        self._limit = np.array(layout.action_limits)

    def _initial(self) -> FloatArray:
        own = make_row(PURSUIT_STATE, image_age_s=AGE_S)
        return own if self._predictor is None else np.append(self._predictor.initial(), own)

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        q_image, q, v = seen.positions_at_exposure, seen.positions, seen.velocities
        timing, own = self._timing, state
        if self._predictor is not None:
            found = self._predictor.update(seen, state)
            own = state[..., self._predictor.size :]
            # the observation was decoded for this call alone
            q_image[..., EYES] = self._predictor.angles_at_exposure(state)
            q[..., EYES], v[..., EYES] = found.actuators, found.velocities
            timing = np.stack([found.delay_s, found.lag_s], axis=-1)
        elif not self.head.actuation.direct:
            q = self.head.actuation.actuators_of(q)
            v[..., EYES] = v[..., EYES] @ self.head.actuation.to_actuators.T
        own[...], command = pursue(
            own,
            seen.pixel_error,
            seen.image_age_s,
            q_image,
            q,
            v,
            timing,
            self._law,
            self._limit,
            self._packed,
        )
        return np.asarray(command)


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
    """The state brought up to date, and velocities of the eyes' actuators.

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
    depths = _see(s, law, error, age_s[0], q_image, p)
    period, delay = law.target.period_s, timing[0]
    if is_direct(p):
        decay = share_left(period, timing[1])
        for j in range(4):
            theta, w, known = _goal(s, law, j, delay + period)
            out[j] = 0.0
            if known:
                out[j] = _command(law, j, theta, w, q[3 + j], v[3 + j], decay, limit[j])
        return
    goals = np.zeros((4, 2))
    _tied_goals(s, law, delay + period, depths, q[3:], p, goals)
    for j in range(4):
        out[j] = 0.0
        if isfinite(goals[j, 0]) and limit[j] > 0.0:
            decay = share_left(period, law.lag_ratio[j] * timing[1])
            out[j] = _command(law, j, goals[j, 0], goals[j, 1], q[3 + j], v[3 + j], decay, limit[j])
