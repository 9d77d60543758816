r"""Gain schedules: the article's law with gains that change from step to step.

A schedule chooses K of the law `theta_dot = J^-1 K (p* - p)` (see `vergence.controllers.ibvs`)
for each eye and image axis, between 0 and 20 per second. It can therefore reshape a law that is
understood, and no more: the eyes never turn away from where the newest image shows the target,
and where that error is zero they rest, whatever the gains.

An action of a schedule is four numbers in [-1, 1], for left v, left u, right v and right u, the
order of the joints that answer them (a tilt moves v, a pan u):

    gain = 5 (1 + action)^2 per second

The square gives small gains, which brake, more of the range.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.ibvs import ibvs_command
from vergence.envs.layout import Observation, ObservationLayout
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

GAIN_LIMIT: Final = 20.0
"""The greatest gain, 1/s; the least is 0."""
GAIN_NAMES: Final = ("left_v", "left_u", "right_v", "right_u")
"""What the four numbers of a schedule's action are the gains of."""
_TRIANGULATED: Final = np.nan


def gains_of(action: ArrayLike) -> FloatArray:
    """The gains that a schedule's action asks for.

    Args:
        action: (..., 4) in the order of `GAIN_NAMES`; limited to [-1, 1].

    Returns:
        (..., 2, 2) gains in 1/s, 0 to 20, by eye and image axis (u, v).
    """
    share = 0.5 * (1.0 + np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0))
    gains = (GAIN_LIMIT * share**2).reshape(*share.shape[:-1], 2, 2)
    return np.ascontiguousarray(gains[..., ::-1])


def action_of(gains: ArrayLike) -> NDArray[np.float32]:
    """The schedule's action that asks for gains, the inverse of `gains_of`.

    Args:
        gains: (..., 2, 2) by eye and image axis, 1/s; limited to 0 to 20.

    Returns:
        (..., 4) actions.
    """
    share = np.sqrt(np.clip(np.asarray(gains, dtype=np.float64), 0.0, GAIN_LIMIT) / GAIN_LIMIT)
    return (2.0 * share - 1.0)[..., ::-1].reshape(*share.shape[:-2], 4).astype(np.float32)


class ScheduledLaw:
    """The article's law with gains from outside.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
    """

    def __init__(self, head: HeadModel, layout: ObservationLayout) -> None:
        self.head = head
        self.layout = layout

    def action(self, observation: ArrayLike, gains: ArrayLike) -> NDArray[np.float32]:
        """The gaze task's action under the law.

        Args:
            observation: (..., 27) observations of the gaze task.
            gains: (..., 2, 2) by eye and image axis, 1/s.

        Returns:
            (..., 4) actions.
        """
        return self.layout.action(self.command(self.layout.decode(observation), gains))

    def command(self, seen: Observation, gains: ArrayLike) -> FloatArray:
        """The law on physical units.

        Args:
            seen: a decoded observation.
            gains: (..., 2, 2) by eye and image axis, 1/s.

        Returns:
            (..., 4) velocities of the eyes' joints, rad/s; an eye that does not see is held.
        """
        command: Any = ibvs_command(
            seen.positions_at_exposure,
            seen.pixel_error,
            np.asarray(gains, dtype=np.float64),
            _TRIANGULATED,
            self.layout.action_limits,
            self.head.packed,
        )
        return np.asarray(command)
