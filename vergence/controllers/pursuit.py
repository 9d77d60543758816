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

and the joint's greatest speed where v' needs all of its acceleration.
"""

from math import copysign, isfinite, sqrt
from typing import Annotated, Final, Literal

import numpy as np

from vergence._jit import device, kernel
from vergence.controllers.freshness import is_fresh
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
from vergence.controllers.rows import make_row, named, row_layout, row_size
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import AGE_S, Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joint_response import share_left
from vergence.models.joints import EYES
from vergence.models.kinematics import eye_frames
from vergence.models.packed import PackedHead
from vergence.models.parts import FloatArray
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image

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
    """The constants of the law; arrays of four are by eye joint."""

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


PURSUIT_STATE: Final = row_layout(PursuitState)
_SIZE: Final = row_size(PURSUIT_STATE)
PURSUIT_LAW: Final = row_layout(PursuitLaw)


class Pursuit(StatefulController):
    """Smooth pursuit with catch-up saccades.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, how fast the predicted present error is taken back, 1/s.
        braking: b as a share of the joints' greatest acceleration.
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
        acceleration = np.minimum(head.limits.acceleration[EYES], 1e6)
        self._law = make_row(
            PURSUIT_LAW,
            target=model.view(TARGET_MODEL),
            gain=gain,
            forget_after=round(FORGET_AFTER_S / layout.period_s),
            braking=braking * acceleration,
            acceleration=acceleration,
            lower=head.limits.lower[EYES],
            upper=head.limits.upper[EYES],
        )
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
            q[..., EYES], v[..., EYES] = found.positions, found.velocities
            timing = np.stack([found.delay_s, found.lag_s], axis=-1)
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
            self.head.packed,
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
) -> None:
    """Bring the filters up to date with the newest image and the angles at its exposure."""
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
            tilt, pan = angles_of_image(p, eye, camera, q, error, depth)
            correct(target, law.target, tilt, pan)
            s.unseen[eye] = 0.0
        else:
            s.unseen[eye] += 1.0
            if s.unseen[eye] > law.forget_after:
                forget(target)


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
    """The state brought up to date, and velocities of the eyes' joints.

    Args:
        before: a row of `PursuitState`.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        age_s: () age of the newest image.
        q_image: (7,) joint angles at its exposure, rad.
        q: (7,) present joint angles, rad.
        v: (7,) present joint velocities, rad/s.
        timing: delay of an image and lag of the joints, s.
        law_row: a row of `PursuitLaw`.
        limit: (4,) greatest joint speeds, rad/s.
        p: a packed head.
        after: the state after.
        out: (4,) the velocities, rad/s.
    """
    for k in range(_SIZE):
        after[k] = before[k]
    s: PursuitState = named(after, PURSUIT_STATE)
    law: PursuitLaw = named(law_row, PURSUIT_LAW)
    _see(s, law, error, age_s[0], q_image, p)
    period, delay, tau = law.target.period_s, timing[0], timing[1]
    decay = share_left(period, tau)
    for j in range(4):
        target = s.eyes[j // 2]
        out[j] = 0.0
        if not target.known > 0.5:
            continue
        theta, w = ahead(target, j % 2, law.target, delay + period)
        if not law.lower[j] < theta < law.upper[j]:
            theta, w = min(max(theta, law.lower[j]), law.upper[j]), 0.0
        now = v[3 + j]
        left = theta - q[3 + j] - 0.5 * (now + w) * period
        half = 0.5 * law.braking[j] * period
        speed = min(
            law.gain * abs(left) / (1.0 + 0.5 * law.gain * period),
            sqrt(half * half + 2.0 * law.braking[j] * abs(left)) - half,
        )
        rise = w + copysign(speed, left) - now
        if abs(rise) > 0.95 * law.acceleration[j] * period:
            u = copysign(limit[j], rise)
        else:
            u = now + rise / (1.0 - decay)
        out[j] = min(max(u, -limit[j]), limit[j])
