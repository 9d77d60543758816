"""Simulation parameters that reproduce the measured loop of a robot."""

from typing import Final

import numpy as np

from vergence.envs.plants.conditions import Variation, make_variation
from vergence.hardware.config import HardwareConfig

_LOOP_OPTIONS: Final = (
    "jitter_s", "command_latency_s", "lag_s", "speed_gain", "backlash_rad", "acceleration_ratio"
)  # fmt: skip


def loop_variation(config: HardwareConfig) -> Variation:
    """Make the variation of simulated trials whose loop is that of a robot.

    Args:
        config: the robot.

    Returns:
        The mean latency of its cameras, a random phase of exposure, and all measured values of its
        loop; the other values are those of its head.
    """
    latency_s, loop = float(np.mean([camera.latency_s for camera in config.cameras])), config.loop
    values: dict[str, float | None] = {"latency_s": latency_s}
    if loop is not None:
        values = {name: getattr(loop, name) for name in _LOOP_OPTIONS}
        # in simulation detection and computing a command take no time
        values["latency_s"] = latency_s + loop.computing_s
        # the encoder readings date everything else, so they have no latency themselves
        values["feedback_latency_s"] = 0.0
    ranges = {name: (value, value) for name, value in values.items() if value is not None}
    found = make_variation({"frame_phase": (0.0, 1.0), **ranges})
    assert found is not None
    return found
