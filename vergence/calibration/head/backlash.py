"""Backlash (play) of the actuators in a head model: removed, or set as calibrated."""

from typing import Any

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.parts import FloatArray


def without_backlash(head: HeadModel) -> HeadModel:
    """Remove the backlash: readings have only quantisation errors."""
    return with_backlash(head, np.zeros(7))


def with_backlash(head: HeadModel, actuator_backlash_rad: FloatArray) -> HeadModel:
    """Set the backlash between the motors, whose angles are read, and the joints.

    Args:
        head: any head.
        actuator_backlash_rad: (7,) whole width of the backlash by actuator. A head model cannot
            hold the neck's. If each joint of the eyes has its own motor, the largest width applies
            to all.
    """
    eyes = actuator_backlash_rad[EYES][: head.actuation.count]
    one = head.actuators is None
    sensor: dict[str, float | str] = {"backlash_rad": float(eyes.max(initial=0.0)) if one else 0.0}
    if eyes.any():
        sensor["encoder_side"] = "motor"
    own: dict[str, Any] = {} if one else {"actuators": {"backlash_rad": eyes}}
    return head.replace(sensor=sensor, **own)
