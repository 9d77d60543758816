r"""Saccade and trim: the eyes turn to the predicted goal in the shortest time, and stay there.

Every joint takes, period by period, the fastest command that still lets it stop at the goal
(`vergence.controllers.reach`). There is no ballistic phase: the goal of `Predictor` is looked at
anew in each period, so that what the head's model or its joints did not do as predicted is
trimmed away as soon as an image shows it. Close to the goal, where the fastest law would chase the
noise of pixels and encoders, a soft one takes over: `u = k (goal - q - lag v)`, which turns the
joint without overshoot at the rate k.
"""

from math import isfinite
from typing import Any, Literal

import numpy as np

from vergence._jit import compiled
from vergence.controllers.prediction.joints import ACCELERATION, PERIOD, SPEED
from vergence.controllers.prediction.predictor import Predictor
from vergence.controllers.reach import fastest_command, joint_timing
from vergence.controllers.stateful import StatefulController
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
        self._trim_rad = trim_px / float(np.mean(head.cameras.focal))
        self._trim_gain = min(trim_gain, 0.5 / head.timing.period_s)

    def _initial(self) -> FloatArray:
        return self.predictor.initial()

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        present = self.predictor.update(seen, state)
        command = np.empty_like(present.to_go)
        reach(
            present.to_go.reshape(-1, 4),
            present.velocities.reshape(-1, 4),
            present.known.reshape(-1, 2),
            present.lag_s.reshape(-1),
            self.predictor.rig,
            self._trim_rad,
            self._trim_gain,
            command.reshape(-1, 4),
        )
        return command


@compiled
def reach(
    to_go: Any, velocity: Any, known: Any, lag: Any, rig: Any, near: float, gain: float,
    command: Any,
) -> None:  # fmt: skip
    """The commands of one period.

    Args:
        to_go: (n, 4) angles to the goals, rad.
        velocity: (n, 4) rad/s.
        known: (n, 2) whether each eye has a goal; one that has none is held.
        lag: (n,) s.
        rig: see `vergence.controllers.prediction.joints.joint_rig`.
        near: angle below which the soft law holds, rad.
        gain: its rate, 1/s.
        command: (n, 4) result, rad/s.
    """
    period = rig[PERIOD]
    for n in range(to_go.shape[0]):
        for j in range(4):
            u_max, a = rig[SPEED + j], rig[ACCELERATION + j]
            v = velocity[n, j]
            if not known[n, j // 2]:
                command[n, j] = 0.0
                continue
            if abs(to_go[n, j]) < near and abs(v) * lag[n] < near:
                u = gain * (to_go[n, j] - lag[n] * v)
            else:
                timing = joint_timing(lag[n], u_max, a, period)
                u = fastest_command(to_go[n, j], v, timing, u_max, a, period)
            command[n, j] = min(max(u, -u_max), u_max)
