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

from math import copysign, exp, isfinite, sqrt
from typing import Any, Final, Literal

import numpy as np

from vergence._jit import kernel
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.prediction.target_motion import (
    EYE_FILTER,
    KNOWN,
    PERIOD,
    advance,
    ahead,
    angles_of_image,
    correct,
    filter_constants,
    forget,
    image_depths,
    reach_of,
)
from vergence.controllers.stateful import StatefulController
from vergence.envs.layout import AGE_S, Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

FORGET_AFTER_S: Final = 0.5
"""An eye that has not seen its target for this long has lost it, and is held."""

# the state beyond the two filters
_AGE: Final = 2 * EYE_FILTER
_UNSEEN: Final = _AGE + 1
SIZE: Final = _UNSEEN + 2
"""Length of the state."""

_GAIN, _FORGET, _BRAKE = range(3)


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
        self._model = filter_constants(
            head,
            acceleration_sd=acceleration_sd,
            acceleration_time_s=acceleration_time_s,
            start_velocity_sd=start_velocity_sd,
            gate_rad=gate_rad,
            pixel_sd=pixel_sd,
        )
        forget_after = round(FORGET_AFTER_S / layout.period_s)
        self._law = np.array([gain, forget_after, braking])
        self._timing = np.array([layout.latency_s, head.timing.lag_s])
        # a number in place of infinity, so that braking from any speed takes no time
        acceleration = np.minimum(head.limits.acceleration[EYES], 1e6)
        self._joints = np.concatenate([reach_of(head), acceleration])
        self._limit = np.array(layout.action_limits)

    def _initial(self) -> FloatArray:
        own = np.zeros(SIZE)
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
            self._model,
            self._law,
            timing,
            self._joints,
            self._limit,
            self.head.packed,
        )
        return np.asarray(command)


@kernel(
    [
        "(f8[:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])",
    ],
    "(s),(e,e),(),(j),(j),(j),(m),(l),(t),(b),(a),(p)->(s),(a)",
)
def pursue(
    before: Any, error: Any, age: Any, q_image: Any, q: Any, v: Any, model: Any, law: Any,
    timing: Any, joints: Any, limit: Any, p: Any, s: Any, out: Any,
) -> None:  # fmt: skip
    """Filters brought up to date, and velocities of the eyes' joints."""
    for k in range(SIZE):
        s[k] = before[k]
    period, delay, tau = model[PERIOD], timing[0], timing[1]
    # an image that has not been replaced is older by a period than the last time
    fresh = age[0] < s[_AGE] + 0.5 * period or s[_AGE] == 0.0
    fresh = fresh and age[0] < AGE_S
    s[_AGE] = age[0]
    seen_l = fresh and isfinite(error[0, 0]) and isfinite(error[0, 1])
    seen_r = fresh and isfinite(error[1, 0]) and isfinite(error[1, 1])
    cl, cr, depth_l, depth_r = image_depths(p, q_image, error)
    for eye in range(2):
        i = eye * EYE_FILTER
        if s[i + KNOWN] > 0.5:
            advance(s, i, model)
        if seen_l if eye == 0 else seen_r:
            camera, depth = (cl, depth_l) if eye == 0 else (cr, depth_r)
            tilt, pan = angles_of_image(p, eye, camera, q_image, error, depth)
            correct(s, i, model, tilt, pan)
            s[_UNSEEN + eye] = 0.0
        else:
            s[_UNSEEN + eye] += 1.0
            if s[_UNSEEN + eye] > law[_FORGET]:
                forget(s, i)
    decay = exp(-period / tau) if tau > 0.0 else 0.0
    for j in range(4):
        i = (j // 2) * EYE_FILTER
        out[j] = 0.0
        if not s[i + KNOWN] > 0.5:
            continue
        theta, w, _a = ahead(s, i + 3 * (j % 2), model, delay + period)
        if not joints[j] < theta < joints[4 + j]:
            theta, w = min(max(theta, joints[j]), joints[4 + j]), 0.0
        now = v[3 + j]
        left = theta - q[3 + j] - 0.5 * (now + w) * period
        a = joints[8 + j]
        half = 0.5 * law[_BRAKE] * a * period
        speed = min(
            law[_GAIN] * abs(left) / (1.0 + 0.5 * law[_GAIN] * period),
            sqrt(half * half + 2.0 * law[_BRAKE] * a * abs(left)) - half,
        )
        rise = w + copysign(speed, left) - now
        if abs(rise) > 0.95 * a * period:
            u = copysign(limit[j], rise)
        else:
            u = now + rise / (1.0 - decay)
        out[j] = min(max(u, -limit[j]), limit[j])
