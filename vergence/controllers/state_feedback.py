"""Linear state feedback on the prediction: the simplest law for a known present state.

With e the angle that an actuator still has to turn when the command begins to act, v its velocity
at that time and g its ratio of velocity to command, all of them predicted
(`vergence.controllers.prediction.predictor`),

    u = k (e - c lag v) / g

An actuator that follows its command with a lag is a second-order system; the constants k (1/s) and
c place its two poles. With c = 1 one of them cancels the lag, and the other one is at the rate k. k
is reduced if the eyes oscillate nevertheless (`vergence.controllers.prediction.oscillation`).

An actuator whose lag builds up, such as a servo that overshoots, has one more pole. It follows its
command by `m l^2 dw/dt + l w + v = u`, see `vergence.controllers.prediction.response`. The law

    u = k (e - l' v - m l^2 w) - (l' - l) w,   l' = max(l, 2 d sqrt(m) l)

places three poles: one at the rate k, and two at the servo's own natural frequency, with a damping
ratio of at least d. If k is fast for the servo, it overshoots the goal by up to one or two percent
of the angle. With m = 0 the law reduces to `u = k (e - l v)`.

`DelayCompensatedIBVS` is the article's law on the predicted error. It needs no outlier gate,
because the predictor has its own.
"""

from math import sqrt
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.controllers.controller import StatefulController
from vergence.controllers.gate import CommandQuantiser
from vergence.controllers.ibvs import IBVS, Depth
from vergence.controllers.prediction.oscillation import (
    OSCILLATING_HALF_SWINGS,
    oscillation_reduced_rate,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    PREDICTOR_PARAMETERS_SIZE,
    PredictorParameters,
)
from vergence.controllers.prediction.predictor import (
    PREDICTION,
    PREDICTION_SIZE,
    Prediction,
    SmithPredictor,
    prediction_fields,
)
from vergence.envs.observation import Observation, ObservationLayout
from vergence.envs.reading import check_above_zero, check_at_least_zero
from vergence.kernels import inlined, kernel, record_view
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, SLOTS, FloatArray

Estimate = Literal["estimated", "nominal"]
"""Option of the laws: a value estimated on line, or the model's, see `SmithPredictor`."""


class PredictiveController(StatefulController):
    """A controller whose state is that of a `SmithPredictor`."""

    _targets_move: ClassVar[bool] = False
    """True if targets may move other than by jumps."""

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        delay: Estimate = "estimated", lag: Estimate = "estimated",
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout)
        self.predictor = SmithPredictor(
            head=head, layout=layout, delay=delay, lag=lag, targets_move=self._targets_move
        )

    def _initial(self) -> FloatArray:
        return self.predictor.initial()


_DAMPING: Final = 0.8
"""d, least damping ratio of the servo's poles (chosen: oscillation against speed)."""


@inlined
def pole_placement_command(
    angle_error: float, v: float, w: float, pole_rate: float, lag_s: float, build_up: float
) -> float:
    """Compute the law's command, rad/s, for a rate k, 1/s, lag l and build-up m of the lag."""
    damped = max(lag_s, 2.0 * _DAMPING * sqrt(build_up) * lag_s)
    return (
        pole_rate * (angle_error - damped * v - build_up * lag_s * lag_s * w) - (damped - lag_s) * w
    )


@inlined
def compensate_dead_zone(
    u: float, error_after_coasting: float, params: PredictorParameters, gain: float
) -> float:
    """Replace a command too small to move the motor by the smallest effective pulse, or by zero.

    `error_after_coasting` is the angle to the goal at rest after zero command, rad; `gain` the
    ratio of velocity to command.
    """
    step = params.command_step
    if step == 0.0 or abs(u) >= 1.5 * step:
        return u
    push = 2.0 * step
    if abs(u) > 0.3 * step and abs(error_after_coasting) > 0.6 * push * gain * params.period_s:
        return push if u > 0.0 else -push
    return 0.0


DEFAULT_LAW: Final = (20.0, 1.0)
"""Default options: `gain` k, 1/s, and `damping` c (chosen)."""


class StateFeedback(PredictiveController):
    """Linear feedback of the predicted angle and velocity of each actuator.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k, 1/s.
        damping: c, fraction of the coasting distance lag*v subtracted from the error.
        delay, lag: images' delay and actuators' response, `estimated` on line or `nominal`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        gain: float = DEFAULT_LAW[0], damping: float = DEFAULT_LAW[1],
        delay: Estimate = "estimated", lag: Estimate = "estimated",
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout, delay=delay, lag=lag)
        check_above_zero("gain", gain)
        check_at_least_zero("damping", damping)
        self._law = np.full(SLOTS, gain), damping

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        now = self.predictor.update(seen, state)
        return np.asarray(linear_command(now, self.predictor.params, *self._law))


@kernel(
    ["(f8[:],f8[:],f8[:],f8[:],f8[:])"],
    f"({PREDICTION_SIZE}),({PREDICTOR_PARAMETERS_SIZE}),(4),()->(4)",
)
def linear_command(
    prediction: FloatArray,
    params_row: FloatArray,
    rate: FloatArray,
    damping: FloatArray,
    out: FloatArray,
) -> None:
    """Compute the actuators' commands (4) of one period, rad/s.

    An actuator that moves no eye whose target is known is held still.

    Args:
        prediction: a row of `Prediction`.
        params_row: a row of `PredictorParameters`.
        rate: (4,) the option `gain`, 1/s.
        damping: () the option `damping`.
        out: the commands.
    """
    now: Prediction = record_view(prediction, PREDICTION)
    params: PredictorParameters = record_view(params_row, PREDICTOR_PARAMETERS)
    for j in range(4):
        out[j] = 0.0
        if not (
            (now.known[0] > 0.5 and params.moves_eye[j, 0] > 0.5)
            or (now.known[1] > 0.5 and params.moves_eye[j, 1] > 0.5)
        ):
            continue
        k, gain = oscillation_reduced_rate(rate[j], now.half_swing_count), now.speed_gain[j]
        v, w, lag = now.velocities[j], now.accelerations[j], params.lag_ratio[j] * now.lag_s
        limit = gain * params.speed_limit[j]
        damped = damping[0] if now.build_up == 0.0 else 1.0
        u = pole_placement_command(now.angle_error[j], v, w, k, damped * lag, now.build_up)
        u = min(max(u, -limit), limit)
        resting_error = now.angle_error[j] - lag * (v + now.build_up * lag * w)
        out[j] = compensate_dead_zone(u / gain, resting_error, params, gain)


DEFAULT_GAIN: Final = 10.0
"""Default gain, 1/s (chosen): only the joints' lag is left in the loop, and it bounds the gain."""


class DelayCompensatedIBVS(StatefulController):
    """Applies the law of `IBVS` to the predicted present pixel errors.

    The state is the predictor's state, followed by the rounding errors of the commands.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain, depth, speed_limit: see `IBVS`.
        delay: images' delay and actuators' response, `estimated` on line or `nominal`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout, gain: ArrayLike = DEFAULT_GAIN,
        depth: Depth = "triangulated", speed_limit: float | None = None,
        delay: Estimate = "estimated",
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout)
        self.law = IBVS(head=head, layout=layout, gain=gain, depth=depth, speed_limit=speed_limit)
        self.predictor = SmithPredictor(head=head, layout=layout, delay=delay, lag=delay)
        self._quantiser = CommandQuantiser(head, self.layout.action_limits)

    def _initial(self) -> FloatArray:
        return np.concatenate([self.predictor.initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = prediction_fields(self.predictor.update(seen, state))
        q = seen.positions.copy()
        q[..., EYES] = present["positions"]
        command = self.law.command(q, present["pixel_error"])
        # the law is linear: scaling its command scales its gain
        excess = np.maximum(present["half_swing_count"] - OSCILLATING_HALF_SWINGS, 0.0)
        command = command * np.exp2(-excess)[..., None]
        return self._quantiser.quantise(command, state[..., -SLOTS:])
