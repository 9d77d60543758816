r"""Saccade and trim: the eyes turn to the predicted goal in the shortest time and stay there.

In each period every actuator takes the fastest command that still lets it stop at the goal
(`vergence.controllers.time_optimal`). There is no ballistic phase: the goal of `Predictor` is read
anew in each period, so an error of the head's model or its joints is corrected as soon as an image
shows it. Close to the goal, where the time-optimal law would follow the noise of pixels and
encoders, a soft law takes over, `u = k (goal - q - lag v)`, which approaches the goal without
overshoot at the rate k.

Late braking requires a well-known motor. A linear law is used for the whole turn if the eyes have
oscillated about a goal (`vergence.controllers.prediction.oscillation`), or if the target rests and
the response model does not explain the eyes' motion; its rate falls with each further half swing.
The linear law is also used if the lag builds up, as in a servo that overshoots
(`vergence.controllers.pole_placement`).

The same law follows a moving target (`vergence.controllers.pursuit`): it acts on the joint's motion
relative to its goal, and the goal's own velocity is fed forward.
"""

from math import exp
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from vergence._jit import kernel
from vergence.controllers.least_command import least_command
from vergence.controllers.pole_placement import pole_placement_command
from vergence.controllers.prediction.joints import RIG, RIG_SIZE, PredictorModel
from vergence.controllers.prediction.oscillation import MANY_HALF_SWINGS, calmed_rate
from vergence.controllers.predictive import PredictiveController
from vergence.controllers.rows import record_view
from vergence.controllers.time_optimal import fastest_command, joint_timing
from vergence.envs.layout import Observation, ObservationLayout
from vergence.envs.validation import check_above_zero, check_at_least_zero, check_number
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_NEAR: Final = 2.0
"""Width of the soft law's zone, in multiples of the uncertain angle of a period at full
acceleration (chosen)."""
_NOISY: Final = 4.0
"""Width of that zone, in standard deviations of a detection (chosen: 4 sigma)."""
_MOVING: Final = 2.0
"""Factor by which `trim_px` is wider for a moving target (chosen)."""
_RATE: Final = 1.5
"""Upper bound of the soft law's rate, as a multiple of 1 / lag (chosen: overshoot against
speed)."""
_SEES: Final = 0.6
"""Fraction of the motion-blur speed limit that each joint of an eye may have (chosen: margin for
two joints)."""
_BLIND_S: Final = 0.12
"""Approximate longest time for which a catch-up saccade exceeds that speed, s (chosen)."""
_LEAST_LAG_S: Final = 0.004
"""Lower bound of the lag in the soft law's rate, s (numerical)."""
TRUST_FIELDS: Final = (
    "acceleration_ratio", "acceleration_sd", "latency_sd_s", "noise_rad", "misfit",
    "half_swings", "build_up",
)  # fmt: skip
"""Fields of a `Prediction` that determine how fast the law may be."""
_UNEXPLAINED: Final = 4.0
"""Misfit of the response above which only the linear law turns the eyes (chosen)."""
_CALM_RATE: Final = 12.0
"""Rate of the linear law after oscillation or with that misfit, 1/s; each further half swing halves
it (chosen)."""
_LINEAR_RATE: Final = 30.0
"""Rate of the linear law if the lag builds up, 1/s (chosen)."""
_MOST_ACCELERATION: Final = 1e3
"""Upper bound of the acceleration in the width of the soft law's zone, for actuators without a
limit, rad/s^2 (numerical)."""


class Saccade(PredictiveController):
    """Time-optimal turns to the predicted goal of a target that rests between jumps.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        braking: fraction of the estimated acceleration that is used for braking.
        caution: standard deviations of that acceleration subtracted as an additional margin.
        trim_px: least distance from the goal within which the soft law trims, in pixels at the
            principal point; with noisy detections the distance is four standard deviations.
        trim_gain: rate k of the soft law, 1/s.
        delay: `estimated` on line or `nominal`, see `Predictor`.
        lag: `estimated` on line or `nominal` response of the actuators, see `Predictor`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        braking: float = 0.9,
        caution: float = 1.0,
        trim_px: float = 1.0,
        trim_gain: float = 50.0,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout, delay=delay, lag=lag)
        if not 0.0 < check_number("braking", braking) <= 1.0:
            raise ConfigurationError(f"braking: expected a share above 0 up to 1, got {braking!r}")
        check_at_least_zero("caution", caution)
        check_at_least_zero("trim_px", trim_px)
        check_above_zero("trim_gain", trim_gain)
        near = trim_px / float(np.mean(head.cameras.focal))
        gain = min(trim_gain, 0.5 / head.timing.period_s)
        self._law = np.array([braking, caution, near, gain])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        now = self.predictor.update(seen, state)
        trust = np.stack([getattr(now, name) for name in TRUST_FIELDS], axis=-1)
        command = saccade_command(
            now.angle_error,
            now.velocities,
            now.accelerations,
            now.rates,
            now.later_rates,
            now.known,
            now.lag_s,
            now.speed_gain,
            trust,
            self.predictor.rig,
            self._law,
        )
        return np.asarray(command)


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(4),(4),(4),(4),(4),(2),(),(4),({len(TRUST_FIELDS)}),({RIG_SIZE}),(4)->(4)",
)
def saccade_command(
    angle_error: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    rate: FloatArray,
    later_rate: FloatArray,
    known: NDArray[np.bool_],
    lag_s: FloatArray,
    gain: FloatArray,
    trust: FloatArray,
    rig_row: FloatArray,
    law: FloatArray,
    out: FloatArray,
) -> None:
    """Compute the actuators' commands of one period, rad/s.

    Args:
        angle_error: (4,) angles to the goals, rad.
        velocity: (4,) velocities of the actuators, rad/s.
        acceleration: (4,) accelerations of the actuators, rad/s^2.
        rate: (4,) velocities of the goals, rad/s.
        later_rate: (4,) velocities of the goals when the command shows, rad/s.
        known: (2,) True if an eye has a goal; an actuator that moves no such eye is held still.
        lag_s: () lag in the head's timing, s.
        gain: (4,) ratios of velocity to command.
        trust: (7,) ratio of the accelerations to the model's; standard deviations of its logarithm,
            of the latency, s, and of a detection, rad; misfit of the response; count of half
            swings; build-up of the lag. See `TRUST_FIELDS`.
        rig_row: a row of `vergence.controllers.prediction.joints.PredictorModel`.
        law: options `braking` and `caution`, the angle of a joint below which the soft law acts,
            rad, and its rate, 1/s.
        out: (4,) result: the commands, rad/s.
    """
    rig: PredictorModel = record_view(rig_row, RIG)
    period = rig.period_s
    unsure = min(trust[1] + trust[2] / period, 1.0)
    oscillates = trust[5] > MANY_HALF_SWINGS
    unexplained, builds_up = trust[4] > _UNEXPLAINED, trust[6] > 0.0
    for j in range(4):
        out[j] = 0.0
        if not (
            (known[0] and rig.moves_eye[j, 0] > 0.5) or (known[1] and rig.moves_eye[j, 1] > 0.5)
        ):
            continue
        # from here on velocities are relative to the goal
        v, lag = velocity[j] - rate[j], rig.lag_ratio[j] * lag_s[0]
        speed = max(gain[j] * rig.speed_limit[j] - abs(rate[j]), 0.1 * gain[j] * rig.speed_limit[j])
        if rate[j] != 0.0:  # lose sight only briefly of a target that may reverse
            visible_speed = max(
                _SEES * rig.max_slip_rad_s / rig.leverage[j], abs(angle_error[j]) / _BLIND_S
            )
            speed = min(speed, visible_speed)
        a = trust[0] * rig.acceleration_limit[j]
        # uncertain part of the angle turned in a period at full acceleration
        wide = law[2] if rate[j] == 0.0 else _MOVING * law[2]
        soft = max(wide, _NOISY * trust[3]) / rig.leverage[j]
        near = max(soft, _NEAR * min(a, _MOST_ACCELERATION) * period**2 * unsure)
        calm = oscillates or (unexplained and rate[j] == 0.0)
        if calm or builds_up:
            linear_rate = calmed_rate(_CALM_RATE, trust[5]) if calm else _LINEAR_RATE
            u = pole_placement_command(
                angle_error[j], v, acceleration[j], linear_rate, lag, trust[6]
            )
        elif abs(angle_error[j]) < near and abs(v) * lag < 3.0 * near:
            u = min(law[3], _RATE / max(lag, _LEAST_LAG_S)) * (angle_error[j] - lag * v)
        else:
            braking = law[0] * exp(-min(law[1] * trust[1], 1.0)) * a
            trusted = joint_timing(lag, speed, braking, period)
            u = fastest_command(angle_error[j], v, a, trusted)
        u = (min(max(u, -speed), speed) + later_rate[j]) / gain[j]
        resting_error = angle_error[j] - lag * (v + trust[6] * lag * acceleration[j])
        out[j] = least_command(u, resting_error, rig, gain[j])
