"""The simulated loop of a robot."""

import numpy as np

from vergence.envs.plants.variation import Variation
from vergence.hardware.config import HardwareConfig


def loop_variation(config: HardwareConfig) -> Variation:
    """What trials in simulation run with, so that their loop is that of a robot.

    Args:
        config: the robot.

    Returns:
        The mean latency of its cameras, which expose at any phase; all else as its head has it.
    """
    latency_s = float(np.mean([camera.latency_s for camera in config.cameras]))
    return Variation(latency_s=(latency_s, latency_s), frame_phase=(0.0, 1.0))
