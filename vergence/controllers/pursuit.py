r"""Pursuit: the law of saccades, on targets that may move as they like.

The predictor weighs whether each target rests or moves and how
(`vergence.controllers.prediction.moving`), carries it on through the delay, and tells how fast it
moves when the command shows. `vergence.controllers.saccade` then turns each actuator in the
shortest time to where the target will be: a catch-up saccade, seen from a goal that moves. Close to
it, its speed is fed forward and the soft law holds the rest,

    u = k (goal - q - lag (v - w)) + w'

with w the goal's speed when the command begins to act and w' that when it shows, a lag later. A
target that is taken to rest is one at w = w' = 0, so that what rests between jumps is turned to as
by `saccade`.
"""

from typing import ClassVar

from vergence.controllers.saccade import Saccade


class Pursuit(Saccade):
    """Time-optimal turns to the predicted goal of a target that may move, and with it.

    The options are those of `Saccade`.
    """

    _follows: ClassVar[bool] = True
