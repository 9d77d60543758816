"""Backlash (play) of the actuators in a head model: removed, or set as calibrated."""

from typing import Any

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray


def without_backlash(head: HeadModel) -> HeadModel:
    """Remove the backlash: readings have only quantisation errors."""
    return with_backlash(head, np.zeros(7))


def with_backlash(head: HeadModel, actuator_backlash_rad: FloatArray) -> HeadModel:
    """Set (7,) widths of backlash, not the neck's; one, the largest, if joints have own motors."""
    eyes = actuator_backlash_rad[EYES][: head.actuation.count]
    one = head.actuators is None
    sensor: dict[str, float | str] = {"backlash_rad": float(eyes.max(initial=0.0)) if one else 0.0}
    if eyes.any():
        sensor["encoder_side"] = "motor"
    own: dict[str, Any] = {} if one else {"actuators": {"backlash_rad": eyes}}
    return head.replace(sensor=sensor, **own)
