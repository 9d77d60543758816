r"""Saccade and trim: the eyes turn to the predicted goal in the shortest time, and stay there.

In each period every actuator takes the fastest command that still lets it stop at the goal
(`vergence.controllers.time_optimal`). There is no ballistic phase: the goal of `Predictor` is read
anew in each period, so an error of the head's model or of its joints is corrected as soon as an
image shows it. Close to the goal, where the fastest law would follow the noise of pixels and
encoders, a soft one takes over: `u = k (goal - q - lag v)`, which turns it without
overshoot at the rate k.

Braking late asks for a motor that is understood. Where the eyes have swung about a goal
(`vergence.controllers.prediction.swinging`), or a target rests and the response does not explain
how the eyes turned to it, a linear law turns them all the way, at a rate that falls with each
further swing. It does so too where the lag builds up, as that of a servo that overshoots
(`vergence.controllers.pole_placement`).

The same law follows a target that moves (`vergence.controllers.pursuit`): it is then that of a
joint as seen from its goal, and the goal's own speed is fed forward.
"""

from math import exp
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from vergence._jit import kernel
from vergence.controllers.least_command import least_command
from vergence.controllers.pole_placement import placed_command
from vergence.controllers.prediction.joints import RIG, RIG_SIZE, Rig
from vergence.controllers.prediction.swinging import MANY, calm_rate
from vergence.controllers.predictive import PredictiveController
from vergence.controllers.rows import named
from vergence.controllers.time_optimal import fastest_command, joint_timing
from vergence.envs.fields import at_least_zero, finite_above_zero, number
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_NEAR: Final = 2.0
"""The soft law holds within so many times what is not known of a period's way."""
_NOISY: Final = 4.0
"""And within so many standard deviations of a detection."""
_MOVING: Final = 2.0
"""And so many times farther from a target that moves."""
_RATE: Final = 1.5
"""Its rate by that of the lag, at most."""
_SEES: Final = 0.6
"""Share of the speed at which images smear that each of an eye's joints may have."""
_BLIND_S: Final = 0.12
"""For how long, at most about, a catch-up saccade is faster."""
_LEAST_LAG_S: Final = 0.004
SURE: Final = (
    "acceleration_ratio", "acceleration_sd", "latency_sd_s", "noise_rad", "misfit", "swings",
    "build_up",
)  # fmt: skip
"""What of a `Prediction` tells how fast the law may be."""
_UNEXPLAINED: Final = 4.0
"""Misfit of the response from which on the linear law alone turns the eyes."""
_CALM_RATE: Final = 12.0
"""Rate of the linear law where the eyes have swung too often, 1/s; each further swing halves it."""
_LINEAR_RATE: Final = 30.0
"""And where the lag builds up, 1/s."""
_MOST_ACCELERATION: Final = 1e3
"""Of an actuator without a limit, rad/s^2: what counts as one period's way."""


class Saccade(PredictiveController):
    """Time-optimal turns to the predicted goal of a target that rests between jumps.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        braking: with which share of the acceleration that it has found it counts for braking.
        caution: how many standard deviations of that it keeps as a margin on top.
        trim_px: distance from the goal, in pixels at the principal point, within which the
            soft law trims, at least; where detections are noisy, within four standard deviations.
        trim_gain: its rate k, 1/s.
        delay: `estimated` on line or `nominal`, see `Predictor`.
        lag: the same of the actuators' response.

    Raises:
        ConfigurationError: an option has a value that cannot be.
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
        if not 0.0 < number("braking", braking) <= 1.0:
            raise ConfigurationError(f"braking: expected a share above 0 up to 1, got {braking!r}")
        at_least_zero("caution", caution)
        at_least_zero("trim_px", trim_px)
        finite_above_zero("trim_gain", trim_gain)
        near = trim_px / float(np.mean(head.cameras.focal))
        gain = min(trim_gain, 0.5 / head.timing.period_s)
        self._law = np.array([braking, caution, near, gain])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        now = self.predictor.update(seen, state)
        sure = np.stack([getattr(now, name) for name in SURE], axis=-1)
        command = saccade_command(
            now.to_go,
            now.velocities,
            now.accelerations,
            now.rates,
            now.later_rates,
            now.known,
            now.lag_s,
            now.speed_gain,
            sure,
            self.predictor.rig,
            self._law,
        )
        return np.asarray(command)


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:],b1[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"(4),(4),(4),(4),(4),(2),(),(4),({len(SURE)}),({RIG_SIZE}),(4)->(4)",
)
def saccade_command(
    to_go: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    rate: FloatArray,
    later_rate: FloatArray,
    known: NDArray[np.bool_],
    lag_s: FloatArray,
    gain: FloatArray,
    sure: FloatArray,
    rig_row: FloatArray,
    law: FloatArray,
    out: FloatArray,
) -> None:
    """The commands of one period by actuator, rad/s.

    Args:
        to_go: (4,) angles to the goals, rad.
        velocity: (4,) rad/s.
        acceleration: (4,) rad/s^2.
        rate: (4,) velocities of the goals, rad/s.
        later_rate: (4,) the same when the command shows.
        known: (2,) whether each eye has a goal; an actuator that moves none with one is held.
        lag_s: () the lag of the head's timing.
        gain: (4,) speeds by commands.
        sure: (7,) accelerations by the model's, the standard deviation of their logarithm, that of
            the latency, s, and that of a detection, rad; the misfit of the response, swings, and
            the build-up of the lag.
        rig_row: a row of `vergence.controllers.prediction.joints.Rig`.
        law: the options `braking` and `caution`, the angle of a joint below which the soft law
            holds, rad, and its rate, 1/s.
        out: (4,) the commands.
    """
    rig: Rig = named(rig_row, RIG)
    period = rig.period_s
    unsure = min(sure[1] + sure[2] / period, 1.0)
    swings, unexplained, builds_up = sure[5] > MANY, sure[4] > _UNEXPLAINED, sure[6] > 0.0
    for j in range(4):
        out[j] = 0.0
        if not ((known[0] and rig.moves[j, 0] > 0.5) or (known[1] and rig.moves[j, 1] > 0.5)):
            continue
        # all that follows is seen from the goal
        v, lag = velocity[j] - rate[j], rig.lag_ratio[j] * lag_s[0]
        speed = max(gain[j] * rig.speed[j] - abs(rate[j]), 0.1 * gain[j] * rig.speed[j])
        if rate[j] != 0.0:  # a target that may turn is not lost sight of for long
            calm = max(_SEES * rig.sees / rig.leverage[j], abs(to_go[j]) / _BLIND_S)
            speed = min(speed, calm)
        a = sure[0] * rig.acceleration[j]
        # what a period of full acceleration turns, as far as it is not known
        wide = law[2] if rate[j] == 0.0 else _MOVING * law[2]
        soft = max(wide, _NOISY * sure[3]) / rig.leverage[j]
        near = max(soft, _NEAR * min(a, _MOST_ACCELERATION) * period**2 * unsure)
        calm = swings or (unexplained and rate[j] == 0.0)
        if calm or builds_up:
            linear_rate = calm_rate(_CALM_RATE, sure[5]) if calm else _LINEAR_RATE
            u = placed_command(to_go[j], v, acceleration[j], linear_rate, lag, sure[6])
        elif abs(to_go[j]) < near and abs(v) * lag < 3.0 * near:
            u = min(law[3], _RATE / max(lag, _LEAST_LAG_S)) * (to_go[j] - lag * v)
        else:
            slow = joint_timing(lag, speed, law[0] * exp(-min(law[1] * sure[1], 1.0)) * a, period)
            u = fastest_command(to_go[j], v, a, slow)
        u = (min(max(u, -speed), speed) + later_rate[j]) / gain[j]
        rests = to_go[j] - lag * (v + sure[6] * lag * acceleration[j])
        out[j] = least_command(u, rests, rig, gain[j])
