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

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from vergence.controllers.prediction.joints import eyes_moved
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.prediction.resting_noise import calm_acceleration_sd
from vergence.controllers.prediction.target_motion import (
    TARGET_MODEL,
    target_model,
)
from vergence.controllers.prediction.virtual_joints import two_joints_an_eye
from vergence.controllers.pursuit_law import PURSUIT_LAW, PURSUIT_STATE, pursue, pursue_tied
from vergence.controllers.rows import make_row
from vergence.controllers.stateful import StatefulController
from vergence.envs.fields import finite_above_zero
from vergence.envs.layout import AGE_S, Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray

FORGET_AFTER_S: Final = 0.5
"""An eye that has not seen its target for this long has lost it, and is held."""
GAIN_A_PERIOD: Final = 0.7
"""k T at most by default: a share of the error that lets noise of one period die in the next."""
BORROWED_WANDER_PX: Final = 0.3
"""What noise may move the prediction by on a head that the options were not tuned for, px."""


class Pursuit(StatefulController):
    """Smooth pursuit with catch-up saccades.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, how fast the predicted present error is taken back, 1/s; None for 80, or less
            where a period is so long that it would be more than `GAIN_A_PERIOD` in one.
        braking: b as a share of the actuators' greatest acceleration.
        acceleration_sd: how much targets accelerate, rad/s^2; None for 1, or less where the
            eyes would wander with the noise of the readings: see
            `vergence.controllers.prediction.resting_noise`.
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
        gain: float | None = None,
        braking: float = 0.97,
        acceleration_sd: float | None = None,
        acceleration_time_s: float = 1.0,
        start_velocity_sd: float = 0.5,
        gate_rad: float = 0.02,
        pixel_sd: float | None = None,
        delay: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        if gain is None:
            gain = min(80.0, GAIN_A_PERIOD / layout.period_s)
        finite_above_zero("gain", gain)
        self._predictor: Predictor | None = None
        if delay != "nominal":
            self._predictor = Predictor(head=head, layout=layout, delay=delay)
        if not 0.0 < braking <= 1.0:
            raise ConfigurationError(f"braking: expected a share above 0 up to 1, got {braking!r}")
        if acceleration_sd is None:
            acceleration_sd = calm_acceleration_sd(
                head, acceleration_time_s=acceleration_time_s, pixel_sd=pixel_sd, most=1.0
            )
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

    @staticmethod
    def borrowed(options: Mapping[str, Any], head: HeadModel) -> dict[str, Any]:
        """Options that were tuned on another head for targets at rest, as they suit this one.

        Slower images and coarser encoders bring more noise over a longer delay, which only a
        calmer model of motion keeps from moving the eyes.

        Args:
            options: what was found for the other head.
            head: this one.

        Returns:
            The same with an `acceleration_sd` that noise at rest allows here.
        """
        calm = calm_acceleration_sd(
            head,
            acceleration_time_s=options["acceleration_time_s"],
            pixel_sd=options.get("pixel_sd"),
            most=options["acceleration_sd"],
            wander_px=BORROWED_WANDER_PX,
        )
        return {**options, "acceleration_sd": calm}

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
        law: Any = pursue if self.head.actuation.direct else pursue_tied
        own[...], command = law(
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
