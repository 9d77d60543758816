r"""Saccade and trim: the eyes turn to the predicted goal in the shortest time, and stay there.

In each period every actuator takes the fastest command that still lets it stop at the goal
(`vergence.controllers.time_optimal`). There is no ballistic phase: the goal of `Predictor` is read
anew in each period, so an error of the head's model or of its joints is corrected as soon as an
image shows it. Close to the goal, where the fastest law would follow the noise of pixels and
encoders, a soft one takes over: `u = k (goal - q - lag v)`, which turns it without
overshoot at the rate k.
"""

from math import isfinite
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vergence._jit import kernel
from vergence.controllers.prediction.joints import RIG, Rig
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.rows import named
from vergence.controllers.stateful import StatefulController
from vergence.controllers.time_optimal import fastest_command, joint_timing
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray


class Saccade(StatefulController):
    """Time-optimal turns to the predicted goal.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        trim_px: distance from the goal, in pixels at the principal point, within which the
            soft law trims.
        trim_gain: its rate k, 1/s.
        delay: `estimated` on line or `nominal`, see `Predictor`.
        lag: the same of the joints' lag.

    Raises:
        ConfigurationError: an option has a value that cannot be.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        trim_px: float = 0.5,
        trim_gain: float = 40.0,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        super().__init__(head=head, layout=layout)
        if not (isfinite(trim_px) and trim_px >= 0.0):
            raise ConfigurationError(f"trim_px: expected pixels of at least 0, got {trim_px!r}")
        if not (isfinite(trim_gain) and trim_gain > 0.0):
            raise ConfigurationError(f"trim_gain: expected 1/s above 0, got {trim_gain!r}")
        self.predictor = Predictor(head=head, layout=layout, delay=delay, lag=lag)
        near = trim_px / float(np.mean(head.cameras.focal))
        self._trim = np.array([near, min(trim_gain, 0.5 / head.timing.period_s)])

    def _initial(self) -> FloatArray:
        return self.predictor.initial()

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = self.predictor.update(seen, state)
        command = saccade_command(
            present.to_go,
            present.velocities,
            present.known,
            present.lag_s,
            self.predictor.rig,
            self._trim,
        )
        return np.asarray(command)


@kernel(
    ["(f8[:],f8[:],b1[:],f8[:],f8[:],f8[:],f8[:])"],
    "(a),(a),(e),(),(r),(t)->(a)",
)
def saccade_command(
    to_go: FloatArray,
    velocity: FloatArray,
    known: NDArray[np.bool_],
    lag_s: FloatArray,
    rig_row: FloatArray,
    trim: FloatArray,
    out: FloatArray,
) -> None:
    """The commands of one period by actuator, rad/s.

    Args:
        to_go: (4,) angles to the goals, rad.
        velocity: (4,) rad/s.
        known: (2,) whether each eye has a goal; an actuator that moves none with one is held.
        lag_s: () the lag of the head's timing.
        rig_row: a row of `vergence.controllers.prediction.joints.Rig`.
        trim: the angle of a joint below which the soft law holds, rad, and its rate, 1/s.
        out: (4,) the commands.
    """
    rig: Rig = named(rig_row, RIG)
    gain = trim[1]
    for j in range(4):
        v, lag, near = velocity[j], rig.lag_ratio[j] * lag_s[0], trim[0] / rig.leverage[j]
        if not ((known[0] and rig.moves[j, 0] > 0.5) or (known[1] and rig.moves[j, 1] > 0.5)):
            out[j] = 0.0
            continue
        if abs(to_go[j]) < near and abs(v) * lag < near:
            u = gain * (to_go[j] - lag * v)
        else:
            joint = joint_timing(lag, rig.speed[j], rig.acceleration[j], rig.period_s)
            u = fastest_command(to_go[j], v, joint)
        out[j] = min(max(u, -rig.speed[j]), rig.speed[j])
