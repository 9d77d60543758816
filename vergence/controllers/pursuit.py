r"""Pursuit: the law of saccades, applied to targets that may move freely.

The predictor estimates whether each target rests or moves and how
(`vergence.controllers.prediction.moving`), extrapolates it over the delay, and predicts its
velocity at the time the command shows in the motion. `vergence.controllers.saccade` then turns each
actuator in the shortest time to the predicted target angle: a catch-up saccade in the frame of a
moving goal. Close to the goal its velocity is fed forward, and the soft law corrects the rest,

    u = k (goal - q - lag (v - w)) + w'

with w the goal's velocity when the command begins to act and w' its velocity when the command
shows, a lag later. A target that is taken to rest has w = w' = 0, so the eyes turn to a target that
rests between jumps as under `saccade`.
"""

from typing import ClassVar

from vergence.controllers.saccade import Saccade


class Pursuit(Saccade):
    """Time-optimal turns to the predicted goal of a target that may move, followed by pursuit.

    The options are those of `Saccade`.
    """

    _targets_move: ClassVar[bool] = True
