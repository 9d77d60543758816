"""The play of a head's actuators in its model: left out, or as it was found."""

from typing import Any

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray


def without_play(head: HeadModel) -> HeadModel:
    """A head whose readings are taken to be off by their steps alone."""
    return with_play(head, np.zeros(7))


def with_play(head: HeadModel, play_rad: FloatArray) -> HeadModel:
    """A head with play between the motors, whose angles are read, and what they move.

    Args:
        head: any head.
        play_rad: (7,) whole widths by actuator. Those of the neck have no place in a head. Where
            each joint of the eyes has a motor of its own, the greatest of theirs counts for all.
    """
    eyes = play_rad[EYES][: head.actuation.count]
    one = head.actuators is None
    sensor: dict[str, float | str] = {"backlash_rad": float(eyes.max(initial=0.0)) if one else 0.0}
    if eyes.any():
        sensor["encoder_side"] = "motor"
    own: dict[str, Any] = {} if one else {"actuators": {"backlash_rad": eyes}}
    return head.replace(sensor=sensor, **own)
